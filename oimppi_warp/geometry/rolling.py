"""Finds objects that roll when they are pushed: balls, and rods and cones that lie on their round side.

The planner's quasi-static model knows sliding only, and so does the limit surface (equation 5).
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from oimppi_warp.geometry.footprint import core_points
from oimppi_warp.scene import PushedObject

Rolling = Literal["", "one way", "every way"]
"""Directions in which an object rolls: none, one (a rod), or all (a ball)."""

IN_WORDS: dict[Rolling, str] = {
    "one way": "the object lies on its round side and rolls when it is pushed across its axis",
    "every way": "the object is round like a ball and rolls when it is pushed",
}
"""Warning about an object that rolls, by its directions."""

REMEDY = "lay it on a flat side, if it has one (a mesh: --lay flat); otherwise it may roll away"
"""Remedy that is added to the warning."""

LEVEL = 0.05
"""Relative change of the centre of mass's height up to which turning the object over counts as rolling.

A prism of 12 sides (3.5 %) rolls; one of eight sides (8 %) has to be tipped over.
"""

_TURNS = np.radians(np.arange(5.0, 46.0, 5.0))  # how far it is turned over
_STEEPEST = 0.5  # squared sine of the largest angle between the table and an axis to roll about
_WAYS = np.radians(np.arange(0.0, 360.0, 2.0))  # directions in which it is turned over


def rolling(body: PushedObject) -> Rolling:
    """Returns how an object rolls over the table from its pose.

    An object rolls in a direction if its centre of mass stays at its height ``h(phi) = max over its points of
    (p - c) . d(phi)`` while it is turned over, where ``d(phi)`` is the direction that then points down.
    """
    cores = [core_points(collider) for collider in body.colliders]
    points = np.vstack([each for each, _ in cores])
    radii = np.concatenate([np.full(len(each), radius) for each, radius in cores])
    return rolling_of_points(points - body.center_of_mass, radii)


def rolling_of_points(points: np.ndarray, radii: np.ndarray | float = 0.0) -> Rolling:
    """Returns how the convex hull of balls rolls over a level table.

    Args:
        points: Centres of the balls relative to the centre of mass, shape [n, 3] [m].
        radii: Their radii, shape [n] [m], or one for all.
    """
    _, axes = np.linalg.eigh(np.cov(points[:, :2].T)) if len(points) > 1 else (None, np.eye(2))
    angles = np.arctan2(axes[1, 0], axes[0, 0]) + _WAYS  # a long rod rolls exactly across its axis only
    sideways = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
    down = -np.cos(_TURNS)[:, None, None] * np.array([0.0, 0.0, 1.0]) + np.sin(_TURNS)[:, None, None] * sideways
    radii = np.broadcast_to(radii, len(points))
    now = float((radii - points[:, 2]).max())
    heights = np.stack([(points @ way.T + radii[:, None]).max(axis=0) for way in down])
    ways = np.asarray((np.abs(heights / now - 1.0) <= LEVEL).all(axis=0))
    if ways.all():
        return "every way"
    one_way = (ways & np.roll(ways, ways.size // 2)).any() or _rolls_about_own_axis(points, radii, now)
    return "one way" if one_way else ""


def _rolls_about_own_axis(points: np.ndarray, radii: np.ndarray, now: float) -> bool:
    """Returns whether the object rolls about one of its principal axes, as a cone does, whose axis is not level."""
    if len(points) < 2:
        return False
    start = np.array([0.0, 0.0, -1.0])
    for axis in np.linalg.eigh(np.cov(points.T))[1].T:
        rise = axis[2] ** 2
        if rise > _STEEPEST:
            continue
        # The direction that points down goes round the axis until it has turned by the same angles as above.
        cosine = np.maximum((np.cos(_TURNS) - rise) / (1.0 - rise), -1.0)
        sine = np.sqrt(1.0 - cosine**2)
        ahead = np.outer(cosine, start) + np.outer(1.0 - cosine, axis * (axis @ start))
        aside = np.outer(sine, np.cross(axis, start))
        down = np.concatenate([ahead + aside, ahead - aside])
        heights = (points @ down.T + radii[:, None]).max(axis=0)
        if (np.abs(heights / now - 1.0) <= LEVEL).all():
            return True
    return False
