"""Meshes as they come from elsewhere, made for the tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import shapely
import trimesh
from shapely.geometry.polygon import orient

L_SHAPE = shapely.Polygon([(0, 0), (0.12, 0), (0.12, 0.03), (0.03, 0.03), (0.03, 0.10), (0, 0.10)])
"""An L of 0.12 x 0.10 m, its legs 0.03 m wide."""


def prism(outline: shapely.Polygon, height: float) -> trimesh.Trimesh:
    """An outline with a thickness [m], closed."""
    corners, faces = [], []
    for triangle in shapely.constrained_delaunay_triangles(outline).geoms:
        ring = np.asarray(orient(triangle).exterior.coords)[:3]
        for z, order in ((0.0, (2, 1, 0)), (height, (0, 1, 2))):
            faces.append([len(corners) + i for i in order])
            corners += [(x, y, z) for x, y in ring]
    ring = np.asarray(orient(outline).exterior.coords)[:-1]
    for (ax, ay), (bx, by) in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        n = len(corners)
        corners += [(ax, ay, 0.0), (bx, by, 0.0), (bx, by, height), (ax, ay, height)]
        faces += [[n, n + 1, n + 2], [n, n + 2, n + 3]]
    return trimesh.Trimesh(corners, faces)


def bracket(height: float = 0.04) -> trimesh.Trimesh:
    """An L-shaped bracket that lies on its side."""
    return prism(L_SHAPE, height)


def saved(mesh: trimesh.Trimesh, folder: Path, name: str, *, scale: float = 1.0) -> Path:
    """A mesh in a file, its lengths multiplied by ``scale``."""
    copy = mesh.copy()
    copy.apply_scale(scale)
    copy.export(folder / name)
    return folder / name
