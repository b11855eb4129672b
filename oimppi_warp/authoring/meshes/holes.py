"""Closes the holes of a surface, each with a fan of triangles about its middle."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import trimesh


def fill_holes(mesh: trimesh.Trimesh) -> None:
    """Closes every hole of a surface with consistently oriented faces.

    Args:
        mesh: The surface, which is changed.
    """
    rims = _rims(mesh)
    if not rims:
        return
    count = len(mesh.vertices)
    middles = np.array([mesh.vertices[rim].mean(axis=0) for rim in rims])
    # A rim runs as its faces do: the triangles beyond it run the other way.
    fans = [np.c_[np.roll(rim, -1), rim, np.full(len(rim), count + i)] for i, rim in enumerate(rims) if len(rim) > 3]
    lids = [np.array([rim[::-1]]) for rim in rims if len(rim) == 3]
    faces = np.vstack([mesh.faces, *fans, *lids])
    vertices = np.vstack([mesh.vertices, middles])
    mesh.vertices, mesh.faces = vertices, faces
    mesh.remove_unreferenced_vertices()


def _rims(mesh: trimesh.Trimesh) -> list[np.ndarray]:
    """Returns the rims of holes: closed sequences of vertices, in the direction in which their faces run.

    Where holes touch at a vertex, the rim is cut there, so that none passes a vertex twice.
    """
    lone = mesh.edges[trimesh.grouping.group_rows(mesh.edges_sorted, require_count=1)]
    after: dict[int, list[int]] = defaultdict(list)
    for a, b in lone.tolist():
        after[a].append(b)
    found = []
    for first in list(after):
        path, place = [first], {first: 0}
        while after[path[-1]]:
            vertex = after[path[-1]].pop()
            if vertex in place:
                rim = path[place[vertex] :]
                if len(rim) > 2:
                    found.append(np.array(rim))
                for left in rim[1:]:
                    del place[left]
                path = path[: place[vertex] + 1]
            else:
                place[vertex] = len(path)
                path.append(vertex)
    return found
