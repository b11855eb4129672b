"""Splits a triangle soup into separate parts that share no vertices, even where they touch."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

_SAME_ANGLE = 1e-6  # for faces of a wall to count as back to back [rad]


def merged(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Returns the mesh itself, with duplicate vertices merged and degenerate faces removed."""
    mesh.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=7)
    if len(mesh.faces):
        mesh.update_faces(mesh.nondegenerate_faces())
    mesh.remove_unreferenced_vertices()
    return mesh


def cleaned(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Returns a mesh without duplicate vertices (:func:`merged`) with its parts separated.

    A duplicate face is kept once. Two faces lying back to back are an inner wall and are both removed, unless the
    surface is closed only with them, as is that of overlapping parts with faces in common.
    """
    once = separated(_each_face_once(mesh))
    if once.is_watertight:
        return once
    every = separated(mesh)
    return every if every.is_watertight else once


def _each_face_once(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Returns the mesh without duplicate faces, and without pairs of identical faces of opposite orientation."""
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
    """Returns the same faces with separate vertices where parts touch: each edge then has two faces, or one at a hole.

    Faces share a vertex if they meet at an edge that leads to it. At an edge of more than two faces, those faces meet
    that enclose the solid between them.
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
    """Returns the corner number of each face at a vertex, three corners per face."""
    return 3 * faces + (mesh.faces[faces] == vertices[:, None]).argmax(axis=1)


def _meetings_at_crowded_edges(mesh: trimesh.Trimesh) -> list[tuple[int, int, int, int]]:
    """Returns, for each edge of more than two faces, the pairs of faces that meet there and the edge's two vertices."""
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
    """Returns the order of faces around their common edge, starting outside the solid.

    A face that runs against the edge has its inside at larger angles about it, a face that runs along it at smaller
    ones: together they open and close like brackets.
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
    """Pairs faces, in the order in which they open and close a solid, preferring pairs within the same part.

    Args:
        faces: Faces in that order.
        opens: Flags of the faces that open the solid.
        part: The part of each face of the mesh; parts that meet are merged.
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
