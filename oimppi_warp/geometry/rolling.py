"""Finds objects that roll when they are pushed: balls, and rods that lie on their round side.

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
    return "one way" if (ways & np.roll(ways, ways.size // 2)).any() else ""
