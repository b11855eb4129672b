"""Fits a convex collider to a mesh: a capsule if one fits well, otherwise a simplified convex hull."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError

from oimppi_warp.authoring.robots.arm import capsule_between
from oimppi_warp.scene import Collider

POINTS = 64
"""Maximum number of vertices of a simplified hull."""
ROOMY = 1.3
"""Maximum volume of a capsule, relative to the hull's, for it to replace the hull."""


def fit_collider(name: str, points: np.ndarray) -> Collider:
    """Fits a convex collider named ``name`` around points, shape [n, 3] [m]; a hull has up to :data:`POINTS` vertices.

    Raises:
        ValueError: The points are coplanar.
    """
    try:
        ConvexHull(points)
    except QhullError:
        raise ValueError("a collision mesh encloses no volume") from None
    hull = trimesh.convex.convex_hull(points)
    vertices = np.asarray(hull.vertices)
    capsules = [_capsule(name, vertices, axis) for axis in _axes(hull)]
    best = min(capsules, key=_volume)
    if _volume(best) <= ROOMY * hull.volume:
        return best
    return Collider(name, "mesh", np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), vertices=_simplified(vertices))


def _axes(hull: trimesh.Trimesh) -> np.ndarray:
    """Returns the principal axes of a hull as rows, shape [3, 3]."""
    return np.linalg.eigh(np.asarray(hull.moment_inertia))[1].T


def _capsule(name: str, points: np.ndarray, axis: np.ndarray) -> Collider:
    """Returns the shortest capsule of least radius along an axis that contains all points."""
    along = points @ axis
    across = points - np.outer(along, axis)
    center, radius = _circle(across)
    over = np.sqrt(np.maximum(radius**2 - ((across - center) ** 2).sum(axis=1), 0.0))
    low, high = (along + over).min(), (along - over).max()
    if high - low < 1e-3:
        low, high = (low + high) / 2 - 5e-4, (low + high) / 2 + 5e-4
    return capsule_between(name, center + low * axis, center + high * axis, radius)


def _circle(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Returns centre and radius of a small ball around points in a plane, shape [n, 3] [m], found iteratively."""
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    for step in range(1, 200):  # Badoiu and Clarkson: move towards the farthest point, by less each time
        center = center + (points[np.argmax(((points - center) ** 2).sum(axis=1))] - center) / (step + 1)
    return center, float(np.sqrt(((points - center) ** 2).sum(axis=1).max()))


def _volume(capsule: Collider) -> float:
    radius, half = capsule.size
    return np.pi * radius**2 * (2.0 * half + 4.0 / 3.0 * radius)


def _simplified(vertices: np.ndarray) -> np.ndarray:
    """Returns a hull with fewer vertices that contains all of these, shape [n, 3].

    It keeps the vertices that are extreme in directions spread evenly over a sphere, and moves them outwards until all
    points are inside.
    """
    if len(vertices) <= POINTS:
        return vertices
    turn, height = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(POINTS), 1.0 - 2.0 * (np.arange(POINTS) + 0.5) / POINTS
    ring = np.sqrt(1.0 - height**2)
    directions = np.column_stack([ring * np.cos(turn), ring * np.sin(turn), height])
    even = vertices / np.maximum(np.ptp(vertices, axis=0), 1e-9)  # scaled to equal extents along all axes
    kept = vertices[np.unique(np.argmax(even @ directions.T, axis=0))]
    middle, planes = kept.mean(axis=0), ConvexHull(kept).equations
    out = ((vertices - middle) @ planes[:, :3].T).max(axis=0) / -(planes[:, :3] @ middle + planes[:, 3])
    return middle + max(float(out.max()), 1.0) * (kept - middle)
