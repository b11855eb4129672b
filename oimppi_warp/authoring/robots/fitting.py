"""A convex collider for a mesh: a capsule where one fits well, else the convex hull of a few of its points."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError

from oimppi_warp.authoring.robots.arm import capsule_between
from oimppi_warp.scene import Collider

POINTS = 64
"""Points that a hull keeps at the most."""
ROOMY = 1.3
"""Volume of a capsule, as a multiple of the hull's, up to which it is taken for it."""


def fit_collider(name: str, points: np.ndarray) -> Collider:
    """A convex collider around points [n, 3] [m]; of a fine mesh a hull with few points.

    Raises:
        ValueError: The points lie in a plane.
    """
    try:
        ConvexHull(points)
    except QhullError:
        raise ValueError("a mesh without a volume") from None
    hull = trimesh.convex.convex_hull(points)
    vertices = np.asarray(hull.vertices)
    capsules = [_capsule(name, vertices, axis) for axis in _axes(hull)]
    best = min(capsules, key=_volume)
    if _volume(best) <= ROOMY * hull.volume:
        return best
    return Collider(name, "mesh", np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), vertices=_simplified(vertices))


def _axes(hull: trimesh.Trimesh) -> np.ndarray:
    """Principal axes of a hull, shape [3, 3]."""
    return np.linalg.eigh(np.asarray(hull.moment_inertia))[1].T


def _capsule(name: str, points: np.ndarray, axis: np.ndarray) -> Collider:
    """The shortest capsule of the least radius along an axis that holds all points."""
    along = points @ axis
    across = points - np.outer(along, axis)
    center, radius = _circle(across)
    over = np.sqrt(np.maximum(radius**2 - ((across - center) ** 2).sum(axis=1), 0.0))
    low, high = (along + over).min(), (along - over).max()
    if high - low < 1e-3:
        low, high = (low + high) / 2 - 5e-4, (low + high) / 2 + 5e-4
    return capsule_between(name, center + low * axis, center + high * axis, radius)


def _circle(points: np.ndarray) -> tuple[np.ndarray, float]:
    """A small ball around points [n, 3] in a plane: the middle of the two furthest apart, moved towards what is out."""
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    for step in range(1, 200):  # Badoiu and Clarkson: the farthest point pulls, ever less
        center = center + (points[np.argmax(((points - center) ** 2).sum(axis=1))] - center) / (step + 1)
    return center, float(np.sqrt(((points - center) ** 2).sum(axis=1).max()))


def _volume(capsule: Collider) -> float:
    radius, half = capsule.size
    return np.pi * radius**2 * (2.0 * half + 4.0 / 3.0 * radius)


def _simplified(vertices: np.ndarray) -> np.ndarray:
    """A hull with fewer vertices that holds all of these, shape [n, 3].

    Those are kept that are farthest in directions spread evenly over a sphere, and moved outwards until all are inside.
    """
    if len(vertices) <= POINTS:
        return vertices
    turn, height = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(POINTS), 1.0 - 2.0 * (np.arange(POINTS) + 0.5) / POINTS
    ring = np.sqrt(1.0 - height**2)
    directions = np.column_stack([ring * np.cos(turn), ring * np.sin(turn), height])
    even = vertices / np.maximum(np.ptp(vertices, axis=0), 1e-9)  # as if it were as long as it is wide
    kept = vertices[np.unique(np.argmax(even @ directions.T, axis=0))]
    middle, planes = kept.mean(axis=0), ConvexHull(kept).equations
    out = ((vertices - middle) @ planes[:, :3].T).max(axis=0) / -(planes[:, :3] @ middle + planes[:, 3])
    return middle + max(float(out.max()), 1.0) * (kept - middle)
