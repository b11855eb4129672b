"""Volume, centre and inertia of a closed surface, including one whose parts overlap."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import trimesh
from scipy.stats import qmc

_POINTS, _SPENT = 20_000, 2e8  # sample points for overlapping parts, and the limit on points times triangles


@dataclass(frozen=True, eq=False)
class Moments:
    """Moments of a solid of uniform density.

    Attributes:
        volume: Volume [m^3].
        center: Centre of mass, shape [3] [m].
        inertia: Inertia about the centre per kilogram, shape [3, 3] [m^2].
    """

    volume: float
    center: np.ndarray
    inertia: np.ndarray


def moments(mesh: trimesh.Trimesh) -> Moments:
    """Computes the moments of a closed surface: exactly, or by sampling points inside it if its parts may overlap."""
    if not _may_overlap(mesh):
        return Moments(float(mesh.volume), np.asarray(mesh.center_mass), mesh.moment_inertia / mesh.volume)
    points, box = points_in_box(mesh.bounds, int(np.clip(_SPENT / len(mesh.faces), 1000, _POINTS)))
    inside = points[winding(mesh, points) > 0.5]
    second = np.cov(inside.T, bias=True)
    volume = box * len(inside) / len(points)
    return Moments(volume, inside.mean(axis=0), np.trace(second) * np.eye(3) - second)


def _may_overlap(mesh: trimesh.Trimesh) -> bool:
    """Returns whether the bounding boxes of any two parts overlap."""
    if mesh.body_count == 1:
        return False
    bounds = [part.bounds for part in mesh.split(only_watertight=False, repair=False)]
    return any((a[0] < b[1]).all() and (b[0] < a[1]).all() for a, b in combinations(bounds, 2))


def winding(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Returns winding numbers of a closed surface about points, from solid angles (van Oosterom, Strackee)."""
    turns = np.zeros(len(points))
    for chunk in np.array_split(np.arange(len(points)), max(1, len(points) * len(mesh.faces) // 2_000_000)):
        a, b, c = np.moveaxis(mesh.triangles[None] - points[chunk, None, None], 2, 0)
        la, lb, lc = (np.linalg.norm(side, axis=-1) for side in (a, b, c))
        ab, bc, ca = (np.einsum("pti,pti->pt", *pair) for pair in ((a, b), (b, c), (c, a)))
        triple = np.einsum("pti,pti->pt", a, np.cross(b, c))
        turns[chunk] = np.arctan2(triple, la * lb * lc + ab * lc + bc * la + ca * lb).sum(axis=1) / (2.0 * np.pi)
    return turns


def points_in_box(bounds: np.ndarray, count: int) -> tuple[np.ndarray, float]:
    """Returns points that fill a box evenly (Halton), shape [count, 3] [m], and the box's volume [m^3].

    ``bounds`` are the box's lower and upper corner, shape [2, 3] [m].
    """
    unit = qmc.Halton(3, scramble=False).random(count)
    return bounds[0] + unit * (bounds[1] - bounds[0]), float(np.prod(bounds[1] - bounds[0]))
