"""Meshes as they come from elsewhere, made for the tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import shapely
import trimesh

L_SHAPE = shapely.Polygon([(0, 0), (0.12, 0), (0.12, 0.03), (0.03, 0.03), (0.03, 0.10), (0, 0.10)])
"""An L of 0.12 x 0.10 m, its legs 0.03 m wide."""


def prism(outline: shapely.Polygon, height: float) -> trimesh.Trimesh:
    """An outline with a thickness [m], closed."""
    triangles = shapely.get_coordinates(shapely.constrained_delaunay_triangles(outline)).reshape(-1, 4, 2)[:, :3]
    corners, faces = np.unique(triangles.reshape(-1, 2), axis=0, return_inverse=True)
    return trimesh.creation.extrude_triangulation(corners, faces.reshape(-1, 3), height)


def bracket(height: float = 0.04) -> trimesh.Trimesh:
    """An L-shaped bracket that lies on its side."""
    return prism(L_SHAPE, height)


def saved(mesh: trimesh.Trimesh, folder: Path, name: str, *, scale: float = 1.0) -> Path:
    """A mesh in a file, its lengths multiplied by ``scale``."""
    copy = mesh.copy()
    copy.apply_scale(scale)
    copy.export(folder / name)
    return folder / name
