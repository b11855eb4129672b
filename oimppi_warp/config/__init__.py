"""Settings with help and bounds, presets, and functions that name, change and check settings."""
