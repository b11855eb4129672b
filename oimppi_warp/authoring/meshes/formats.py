"""Files that objects are read from."""

MESHES = (".stl", ".obj", ".glb", ".gltf", ".ply", ".off")
"""Endings of mesh files."""
