"""Reduces the number of triangles of a surface by merging the vertices in each cell of a grid."""

from __future__ import annotations

import numpy as np
import trimesh

_PULL = (
    1e-3  # weight of a cell's mean beside the planes of its faces: decides where these leave the vertex undetermined
)

_KEPT = 0.02
"""Largest relative change of the volume: walls as thin as the cells would collapse."""


def coarsened(mesh: trimesh.Trimesh, faces: int) -> trimesh.Trimesh:
    """Returns a surface with about this many triangles, or the mesh itself if it has no more.

    The vertices in a cell are replaced by the point nearest to the planes of their faces (quadric error metric, Garland
    and Heckbert, 1997; in cells, Lindstrom, 2000), so that edges and flat sides keep their place. Thin parts may touch
    themselves afterwards. Of a surface with thin walls, more triangles are kept.

    Args:
        mesh: A closed surface [m].
        faces: Number of triangles to keep.
    """
    while len(mesh.faces) > faces:
        found = _clustered(mesh, float(np.sqrt(2.0 * mesh.area / faces)))  # a cell of a flat side keeps two triangles
        if abs(found.volume - mesh.volume) < _KEPT * mesh.volume:
            return found
        faces *= 2  # its walls are thinner than the cells
    return mesh


def _clustered(mesh: trimesh.Trimesh, cell: float) -> trimesh.Trimesh:
    """Returns the surface with one vertex per cell of a grid [m]."""
    places = np.floor((mesh.vertices - mesh.bounds[0]) / cell + 0.5).astype(np.int64)
    _, group = np.unique(places, axis=0, return_inverse=True)
    group = group.ravel()
    number = int(group.max()) + 1
    mean = np.stack([np.bincount(group, mesh.vertices[:, i], number) for i in range(3)], axis=1)
    mean /= np.bincount(group, minlength=number)[:, None]
    corner, normals = group[mesh.faces], mesh.face_normals
    matrices, sums = np.zeros((number, 3, 3)), np.zeros((number, 3))
    area = np.zeros(number)
    for k in range(3):
        # minimize sum of area (n . (x - p))^2 over the faces at the cell's vertices, x relative to the cell's mean
        level = np.einsum("fi,fi->f", normals, mesh.triangles[:, k] - mean[corner[:, k]])
        outer = mesh.area_faces[:, None, None] * normals[:, :, None] * normals[:, None, :]
        for i in range(3):
            sums[:, i] += np.bincount(corner[:, k], mesh.area_faces * level * normals[:, i], number)
            for j in range(3):
                matrices[:, i, j] += np.bincount(corner[:, k], outer[:, i, j], number)
        area += np.bincount(corner[:, k], mesh.area_faces, number)
    matrices += (_PULL * area + 1e-30)[:, None, None] * np.eye(3)
    moved = np.linalg.solve(matrices, sums[:, :, None])[:, :, 0]
    moved *= np.minimum(1.0, cell / np.maximum(np.linalg.norm(moved, axis=1), 1e-12))[:, None]
    a, b, c = corner.T
    kept = corner[(a != b) & (b != c) & (c != a)]
    found = trimesh.Trimesh(mean + moved, kept, process=False)
    found.update_faces(found.unique_faces())
    found.remove_unreferenced_vertices()
    return found
