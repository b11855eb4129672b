"""Orients the faces of a surface consistently."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components


def orient(mesh: trimesh.Trimesh) -> None:
    """Flips faces so that neighbours agree: they run along their common edge in opposite directions.

    Where a surface has only one side, some still disagree. In each part, the orientation of one of its faces is kept.

    Args:
        mesh: The surface, which is changed; edges of more than two faces are left out.
    """
    if mesh.is_winding_consistent or not len(mesh.face_adjacency):
        return
    count = len(mesh.faces)
    _, first_time = np.unique(mesh.face_adjacency, axis=0, return_index=True)  # two faces may meet at two edges
    (one, other), (a, b) = mesh.face_adjacency[first_time].T, mesh.face_adjacency_edges[first_time].T
    agree = _runs_along(mesh.faces[one], a, b) != _runs_along(mesh.faces[other], a, b)
    weights = np.where(agree, 1, 2)
    both = np.r_[one, other], np.r_[other, one]
    graph = csr_matrix((np.r_[weights, weights], both), shape=(count, count))
    number, parts = connected_components(graph, directed=False)
    flipped = np.zeros(count, dtype=bool)
    for first in np.unique(parts, return_index=True)[1] if number > 1 else [0]:
        order, before = breadth_first_order(graph, int(first), directed=False)
        if len(order) == 1:  # a face without neighbours
            continue
        turns = np.asarray(graph[before[order[1:]], order[1:]]).ravel() == 2
        for face, previous, turn in zip(order[1:].tolist(), before[order[1:]].tolist(), turns.tolist(), strict=True):
            flipped[face] = flipped[previous] ^ turn
    faces = mesh.faces.copy()
    faces[flipped] = faces[flipped, ::-1]
    mesh.faces = faces


def _runs_along(faces: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Returns whether faces [n, 3] run along their edges from vertex a [n] to vertex b [n], shape [n]."""
    place = (faces == a[:, None]).argmax(axis=1)
    return faces[np.arange(len(faces)), (place + 1) % 3] == b
