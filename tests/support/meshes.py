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


def one_sided(holes: int) -> trimesh.Trimesh:
    """A Moebius strip of 0.02 m whose rim is closed by a fan of triangles, of which ``holes`` are missing."""
    count = 40
    turn = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)[:, None]
    across = np.array([-0.01, 0.01])
    radius = 0.05 + across * np.cos(turn / 2.0)
    points = np.stack([radius * np.cos(turn), radius * np.sin(turn), across * np.sin(turn / 2.0)], axis=-1)
    here = np.arange(count)
    after = (here + 1) % count
    a, b, c, d = 2 * here, 2 * here + 1, 2 * after, 2 * after + 1
    c[-1], d[-1] = d[-1], c[-1]  # half a turn later, the edges have changed places
    strip = np.vstack([np.c_[a, b, d], np.c_[a, d, c]])
    rim = np.vstack([np.c_[a, c], np.c_[b, d]])
    fan = np.c_[rim, np.full(len(rim), 2 * count)]
    return trimesh.Trimesh(np.vstack([points.reshape(-1, 3), [0.0, 0.0, 0.03]]), np.vstack([strip, fan[holes:]]))


def saved(mesh: trimesh.Trimesh, folder: Path, name: str, *, scale: float = 1.0) -> Path:
    """A mesh in a file, its lengths multiplied by ``scale``."""
    copy = mesh.copy()
    copy.apply_scale(scale)
    copy.export(folder / name)
    return folder / name
