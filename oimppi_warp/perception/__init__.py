"""Sources of the object's pose for a real plant: a camera in this process, or a detector reached over TCP."""
