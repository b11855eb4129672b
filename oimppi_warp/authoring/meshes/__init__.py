"""Imports meshes as objects: reads, repairs and weighs them, and cuts them into convex pieces."""
