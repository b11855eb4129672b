"""Conversions applied to a stage as it is opened: property types, units, and the up axis."""
