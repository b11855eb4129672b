"""Extracts the parts of a scene that top-view figures show (outlines, goal, table, reach), as plain lists.

An outline is a list of rings, a ring a list of points (x, y) [m]; the object's rings are in its own frame.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import shapely

from oimppi_warp.geometry.footprint import footprint, outline
from oimppi_warp.geometry.reach import reach_of
from oimppi_warp.scene import Collider, Scene


def scene_footprints(scene: Scene) -> dict[str, Any]:
    """Returns the outlines of a scene's parts seen from above, and its goal [m, rad], as JSON-serializable lists.

    Its title, its position tolerance [m] and the reach of the arm [m] are included.
    """
    return {
        "title": scene.title,
        "table": [list(scene.table.lower), list(scene.table.upper)],
        "base": _rings(scene.robot.base.colliders),
        "obstacles": [_rings(obstacle.colliders) for obstacle in scene.obstacles],
        "object": _rings(scene.object.colliders),
        "goal": list(scene.goal),
        "tolerance": scene.tolerance.position,
        "reach": round(reach_of(scene.robot).radius, 3),
    }


def transformed(rings: Iterable[Any], pose: Any) -> list[np.ndarray]:
    """Transforms rings, shape [n, 2] [m] each, from the frame of an object at a planar pose to the world."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    turn = np.array([[c, s], [-s, c]])
    return [np.asarray(ring) @ turn + np.asarray(pose[:2]) for ring in rings]


def _rings(colliders: Iterable[Collider]) -> list[list[list[float]]]:
    parts = shapely.get_parts(outline(footprint(colliders)))
    return [np.asarray(part.exterior.coords).round(4).tolist() for part in parts if part.geom_type == "Polygon"]
