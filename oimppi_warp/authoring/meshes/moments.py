"""Volume, centre and inertia of a closed surface, also where its parts reach into each other."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import trimesh
from scipy.stats import qmc

_POINTS, _SPENT = 20_000, 2e8  # points that overlapping parts are sampled with, and how many times their triangles


@dataclass(frozen=True, eq=False)
class Moments:
    """A solid of uniform density.

    Attributes:
        volume: [m^3].
        center: Its centre, shape [3] [m].
        inertia: About the centre, of one kilogram of it, shape [3, 3] [m^2].
    """

    volume: float
    center: np.ndarray
    inertia: np.ndarray


def moments(mesh: trimesh.Trimesh) -> Moments:
    """Moments of a closed surface: exact, but of parts that may overlap those of points within any of them."""
    if not _may_overlap(mesh):
        return Moments(float(mesh.volume), np.asarray(mesh.center_mass), mesh.moment_inertia / mesh.volume)
    points, box = points_in_box(mesh.bounds, int(np.clip(_SPENT / len(mesh.faces), 1000, _POINTS)))
    inside = points[winding(mesh, points) > 0.5]
    second = np.cov(inside.T, bias=True)
    volume = box * len(inside) / len(points)
    return Moments(volume, inside.mean(axis=0), np.trace(second) * np.eye(3) - second)


def _may_overlap(mesh: trimesh.Trimesh) -> bool:
    """Whether the boxes around two parts do."""
    if mesh.body_count == 1:
        return False
    bounds = [part.bounds for part in mesh.split(only_watertight=False, repair=False)]
    return any((a[0] < b[1]).all() and (b[0] < a[1]).all() for a, b in combinations(bounds, 2))


def winding(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """How often a closed surface goes round each point: the solid angle of its triangles (van Oosterom, Strackee)."""
    turns = np.zeros(len(points))
    for chunk in np.array_split(np.arange(len(points)), max(1, len(points) * len(mesh.faces) // 2_000_000)):
        a, b, c = np.moveaxis(mesh.triangles[None] - points[chunk, None, None], 2, 0)
        la, lb, lc = (np.linalg.norm(side, axis=-1) for side in (a, b, c))
        ab, bc, ca = (np.einsum("pti,pti->pt", *pair) for pair in ((a, b), (b, c), (c, a)))
        triple = np.einsum("pti,pti->pt", a, np.cross(b, c))
        turns[chunk] = np.arctan2(triple, la * lb * lc + ab * lc + bc * la + ca * lb).sum(axis=1) / (2.0 * np.pi)
    return turns


def points_in_box(bounds: np.ndarray, count: int) -> tuple[np.ndarray, float]:
    """Points that fill a box evenly (Halton), shape [count, 3] [m], and the box's volume [m^3]."""
    unit = qmc.Halton(3, scramble=False).random(count)
    return bounds[0] + unit * (bounds[1] - bounds[0]), float(np.prod(bounds[1] - bounds[0]))
