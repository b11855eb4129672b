"""Settings: every setting with its help and bounds, presets, and how settings are named, changed and resolved."""
