"""Meshes as objects: read, repaired, weighed and cut into convex pieces."""
