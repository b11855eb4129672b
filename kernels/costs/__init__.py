"""Stage costs: the terms and how they add up."""
