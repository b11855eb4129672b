"""The command ``oimppi``."""
