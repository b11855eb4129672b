"""Stage costs: the terms and their sum."""
