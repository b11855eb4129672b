"""Tells a surface whose faces are listed for both sides from one that is listed once, and keeps one side of each face.

Modelling programs export such double-sided surfaces so that they are visible from inside and outside. The two sides may
be cut into triangles differently.
"""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

DOUBLE = 0.9
"""Share of the area that must be listed for both sides in a double-sided surface."""

_FOLDED = -1.0 + 1e-6  # cosine between the normals of two faces that lie back to back
_NEAR = 2e-5  # distance of two sides that coincide, relative to the length of the mesh
_SAME_PLANE = 1e-2  # relative singular value below which the faces at a vertex count as lying in one plane
_SHARPEST = 3.0  # longest motion of a vertex between faces that lean apart, relative to the thickness
_CANDIDATES = 24  # nearest faces that are examined for each face


def one_side(mesh: trimesh.Trimesh) -> trimesh.Trimesh | None:
    """Returns a double-sided surface with each face once, or ``None`` if the surface is not double-sided.

    Of two sides, the one that encloses a positive volume is kept.

    Args:
        mesh: A surface without duplicate vertices.
    """
    opposite = _opposites(mesh)
    if mesh.area_faces[opposite >= 0].sum() < DOUBLE * mesh.area_faces.sum():
        return None
    layer = _layers(mesh)
    a, b, c = np.moveaxis(mesh.triangles, 1, 0)
    volumes = np.bincount(layer, weights=np.einsum("fi,fi->f", a, np.cross(b, c)))
    behind = [np.unique(layer[opposite[(layer == each) & (opposite >= 0)]]) for each in range(len(volumes))]
    dropped = np.zeros(len(volumes), dtype=bool)
    for each in np.argsort(-volumes, kind="stable"):
        if not dropped[each]:
            dropped[behind[each][behind[each] != each]] = True
    kept = mesh.copy()
    kept.update_faces(~dropped[layer])
    kept.remove_unreferenced_vertices()
    return kept


def _opposites(mesh: trimesh.Trimesh) -> np.ndarray:
    """Returns for each face one that covers its centre and looks the other way, shape [face]; -1 if there is none."""
    normals, centers = mesh.face_normals, mesh.triangles_center
    near = _NEAR * float(np.linalg.norm(mesh.extents))
    _, candidates = KDTree(centers).query(centers, k=min(_CANDIDATES, len(centers)))
    found = np.full(len(centers), -1)
    for other in np.asarray(candidates).T[::-1]:  # the nearest last: it overwrites the others
        back = np.einsum("fi,fi->f", normals, normals[other]) < _FOLDED + 1e-4
        level = np.abs(np.einsum("fi,fi->f", centers - centers[other], normals)) < near
        rows = np.flatnonzero(back & level)
        closest = trimesh.triangles.closest_point(mesh.triangles[other[rows]], centers[rows])
        rows = rows[np.linalg.norm(closest - centers[rows], axis=1) < near]
        found[rows] = other[rows]
    return found


def _layers(mesh: trimesh.Trimesh) -> np.ndarray:
    """Returns the number of the side that each face belongs to, shape [face].

    Faces of one side meet at edges that they run along in opposite directions, and do not lie back to back.
    """
    edges, owner = mesh.edges, mesh.edges_face
    forward = edges[:, 0] < edges[:, 1]
    order = np.lexsort((forward, *np.sort(edges, axis=1).T))
    keys, groups = np.sort(edges, axis=1)[order], []
    starts = np.flatnonzero(np.r_[True, (keys[1:] != keys[:-1]).any(axis=1)])
    pairs: list[tuple[int, int]] = []
    for rows in np.split(order, starts[1:]):
        groups = [rows[forward[rows]], rows[~forward[rows]]]
        pairs += [(owner[a], owner[b]) for a in groups[0] for b in groups[1]]
    if not pairs:
        return np.arange(len(mesh.faces))
    one, other = np.array(pairs).T
    facing = np.einsum("pi,pi->p", mesh.face_normals[one], mesh.face_normals[other]) > _FOLDED
    one, other = one[facing], other[facing]
    graph = coo_matrix((np.ones(len(one)), (one, other)), shape=(len(mesh.faces),) * 2)
    return connected_components(graph, directed=False)[1]


def thickened(mesh: trimesh.Trimesh, thickness: float) -> trimesh.Trimesh:
    """Returns a closed solid: a surface with a wall of this thickness [m] grown on its inner side.

    Args:
        mesh: A surface with consistently oriented faces; the inner side is the one that its faces look away from.
        thickness: Thickness of the wall [m].
    """
    count, corners = len(mesh.vertices), mesh.faces.ravel()
    normals = np.repeat(mesh.face_normals, 3, axis=0)
    # The motion v of a vertex moves all of its faces by one: n . v = 1 for each normal n, by least squares.
    matrices, sums = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(matrices, corners, normals[:, :, None] * normals[:, None, :])
    np.add.at(sums, corners, normals)
    motion = np.einsum("vij,vj->vi", np.linalg.pinv(matrices, rcond=_SAME_PLANE, hermitian=True), sums)
    length = np.linalg.norm(motion, axis=1)
    motion *= (np.minimum(length, _SHARPEST) / np.maximum(length, 1e-12))[:, None]
    inner = mesh.vertices - thickness * motion
    rim = mesh.edges[trimesh.grouping.group_rows(mesh.edges_sorted, require_count=1)]
    a, b = rim.T
    faces = [mesh.faces, mesh.faces[:, ::-1] + count, np.c_[b, a, a + count], np.c_[b, a + count, b + count]]
    return trimesh.Trimesh(np.vstack([mesh.vertices, inner]), np.vstack(faces), process=False)
