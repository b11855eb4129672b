"""Letters and words as objects."""
