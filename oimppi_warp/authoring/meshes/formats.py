"""File formats that objects can be read from."""

MESHES = (".stl", ".obj", ".glb", ".gltf", ".ply", ".off")
"""File name extensions of mesh files."""
