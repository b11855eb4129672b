"""A heap of triangles as separate parts, each with corners of its own, also where they touch."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

_SAME_ANGLE = 1e-6  # faces of a wall lie back to back [rad]


def cleaned(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh with corners that are the same joined, without faces that are nothing, its parts told apart.

    A face that is there twice counts once, and two that lie back to back are an inner wall and count for nothing;
    unless the surface is closed with them only, as that of parts is which overlap and have faces in common.
    """
    mesh.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=7)
    mesh.update_faces(mesh.nondegenerate_faces())
    mesh.remove_unreferenced_vertices()
    once = separated(_each_face_once(mesh))
    if once.is_watertight:
        return once
    every = separated(mesh)
    return every if every.is_watertight else once


def _each_face_once(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh without second faces at the same corners, and without both that look opposite ways."""
    a, b, c = mesh.faces.T
    ways = np.where((b - a) * (c - b) * (a - c) < 0, 1, -1)  # even permutations of ascending corners, and odd ones
    groups = np.unique(np.sort(mesh.faces, axis=1), axis=0, return_inverse=True)[1].ravel()
    balance = np.bincount(groups, weights=ways)
    kept = np.zeros(len(ways), dtype=bool)
    for way in (1, -1):
        rows = np.flatnonzero((ways == way) & (np.sign(balance[groups]) == way))
        kept[rows[np.unique(groups[rows], return_index=True)[1]]] = True
    once = mesh.copy()
    once.update_faces(kept)
    once.remove_unreferenced_vertices()
    return once


def separated(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The same faces, with corners of their own where parts touch: then an edge has two faces, or one at a hole.

    Faces share a corner if they meet at an edge that leads to it; at an edge of more than two faces, those meet that
    have the solid between them.
    """
    meetings = [(f, g, a, b) for (f, g), (a, b) in zip(mesh.face_adjacency, mesh.face_adjacency_edges, strict=True)]
    crowded = _meetings_at_crowded_edges(mesh)
    if not crowded:
        return mesh
    f, g, a, b = np.array(meetings + crowded).T
    pairs = [np.stack([_corner(mesh, f, end), _corner(mesh, g, end)], axis=1) for end in (a, b)]
    one, other = np.vstack(pairs).T
    count = mesh.faces.size
    graph = coo_matrix((np.ones(len(one)), (one, other)), shape=(count, count))
    number, labels = connected_components(graph, directed=False)
    corners = np.zeros(number, dtype=int)
    corners[labels] = mesh.faces.ravel()
    return trimesh.Trimesh(mesh.vertices[corners], labels.reshape(-1, 3), process=False)


def _corner(mesh: trimesh.Trimesh, faces: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Number of the corner that each face has at a vertex, three a face."""
    return 3 * faces + (mesh.faces[faces] == vertices[:, None]).argmax(axis=1)


def _meetings_at_crowded_edges(mesh: trimesh.Trimesh) -> list[tuple[int, int, int, int]]:
    """At each edge of more than two faces, the pairs of faces that meet there, with the edge's two vertices."""
    edges, owner = np.sort(mesh.edges, axis=1), mesh.edges_face
    part = trimesh.graph.connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
    ends, groups, counts = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    found = []
    for group in np.flatnonzero(counts > 2):
        rows = np.flatnonzero(groups.ravel() == group)
        against = mesh.edges[rows, 0] == ends[group, 1]
        around = _around(mesh, ends[group], owner[rows], against)
        found += [(f, g, *ends[group]) for f, g in _brackets(owner[rows][around], against[around], part)]
    return found


def _around(mesh: trimesh.Trimesh, ends: np.ndarray, faces: np.ndarray, against: np.ndarray) -> np.ndarray:
    """The order of faces around their common edge, from where there is no solid.

    A face that runs against the edge has its inside at larger angles about it, one that runs along it at smaller ones:
    they open and close like brackets.
    """
    a, b = mesh.vertices[ends]
    along = (b - a) / np.linalg.norm(b - a)
    away = mesh.vertices[mesh.faces[faces]].sum(axis=1) - b - 2.0 * a
    away -= np.outer(away @ along, along)
    x = away[0] / np.linalg.norm(away[0])
    angle = np.arctan2(away @ np.cross(along, x), away @ x)
    step = np.round(np.where(angle > np.pi - _SAME_ANGLE, -np.pi, angle) / _SAME_ANGLE)
    order = np.lexsort((against, step))
    depth = np.cumsum(np.where(against[order], 1, -1))
    return np.roll(order, -int(np.argmin(depth)) - 1)


def _brackets(faces: np.ndarray, opens: np.ndarray, part: np.ndarray) -> list[tuple[int, int]]:
    """Faces in the order in which they open and close a solid, in pairs: of the same part, if there is such a pair.

    Args:
        faces: In that order.
        opens: Which of them open.
        part: The part of each face of the mesh; parts that meet become one.
    """
    found, waiting = [], []
    for face, opening in zip(faces.tolist(), opens, strict=True):
        if opening:
            waiting.append(face)
        elif waiting:
            same = [other for other in waiting if part[other] == part[face]]
            waiting.remove(partner := (same or waiting)[-1])
            found.append((partner, face))
            part[part == part[partner]] = part[face]
    return found
