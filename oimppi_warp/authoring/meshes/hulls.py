"""Convex pieces, with few corners, rounded as they are written to files."""

from __future__ import annotations

import numpy as np
import trimesh

Hull = tuple[np.ndarray, np.ndarray]
"""Corners [n, 3] [m] and triangles [m, 3] of a convex piece."""


def limited_hull(points: np.ndarray, corners: int) -> Hull:
    """Returns the convex hull of points, with its corners rounded as they are written.

    A hull with more corners than allowed is replaced by the hull of fewer of them, one per cell of a grid; it shrinks
    by at most one cell.

    Args:
        points: Shape [n, 3] [m].
        corners: Maximum number of corners.
    """
    hull = trimesh.convex.convex_hull(np.round(points, 5))
    cell = 0.0005
    while len(hull.vertices) > corners:
        _, kept = np.unique(np.round(hull.vertices / cell), axis=0, return_index=True)
        hull, cell = trimesh.convex.convex_hull(hull.vertices[np.sort(kept)]), 1.5 * cell
    return np.asarray(hull.vertices), np.asarray(hull.faces)
