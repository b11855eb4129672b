"""Pushes on which an engine and the plant are compared."""

from __future__ import annotations

import numpy as np
import shapely

from oimppi_warp.geometry.footprint import footprint, outline, planar_points
from oimppi_warp.scene import Scene

SPEED = 0.12
"""Speed of the tool [m/s]."""


def tip_before(scene: Scene, pose: np.ndarray, center: np.ndarray, way: float, *, aside: float) -> np.ndarray:
    """Returns the tip 10 mm clear of the object, to push it along ``way``, ``aside`` of its centre [m]."""
    body = outline([piece.moved(pose) for piece in footprint(scene.object.colliders)])
    distances = np.arange(0.0, 0.3, 0.002)
    line = planar_points((center[0], center[1], way), np.column_stack([-distances, np.full_like(distances, aside)]))
    clear = shapely.distance(shapely.points(line), body) > scene.robot.tool_radius + 0.01
    return line[len(clear) - np.argmin(clear[::-1])]
