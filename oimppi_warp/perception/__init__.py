"""Where a real plant gets the object's pose from."""
