"""Where the arm begins, so that neither its tool nor its links are in anything."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import shapely

from oimppi_warp.feasibility import object_outline, reach_of
from oimppi_warp.footprint import core_points, footprint, height_range, outline
from oimppi_warp.kinematics import link_frames, tip_frame, tip_jacobian
from oimppi_warp.scene import Collider, Robot, Scene

ROOM = 0.02
"""Around the stick at the start [m], beyond its radius."""

_RADII = np.arange(0.25, 0.60, 0.05)
_ANGLES = np.radians(np.arange(-150.0, 151.0, 10.0))


def clear_start(scene: Scene) -> tuple[float, ...] | None:
    """Joint positions to begin with.

    Args:
        scene: The task.

    Returns:
        None where the robot's own start is clear of object and obstacles; otherwise joint positions [rad] with the tip
        as high and the tool as upright as there, as near to it as it can be.

    Where no such start is found, the robot's own is kept, and :func:`oimppi_warp.feasibility.check_task` has the word.
    """
    robot = scene.robot
    if _clear(scene, robot.start):
        return None
    tip = tip_frame(robot, robot.start)[1]
    for place in _places(tip, reach_of(robot)):
        joints = reach_for(robot, place)
        if joints is not None and _clear(scene, joints):
            return tuple(round(float(q), 5) for q in joints)
    return None


def reach_for(robot: Robot, tip: np.ndarray) -> np.ndarray | None:
    """Joint positions with the tip at a place [3] [m] and the tool as upright as at the robot's start.

    Damped Gauss-Newton from the robot's start, its first joint turned towards the place.

    Returns:
        Joint positions, shape [dof] [rad]; ``None`` where none within the limits were found.
    """
    lower, upper = np.array([j.lower for j in robot.joints]), np.array([j.upper for j in robot.joints])
    rotation, own = tip_frame(robot, robot.start)
    wanted = rotation[:, 2]
    q = np.array(robot.start, dtype=float)
    q[0] += np.remainder(np.arctan2(tip[1], tip[0]) - np.arctan2(own[1], own[0]) + np.pi, 2.0 * np.pi) - np.pi
    q = np.clip(q, lower, upper)
    for _ in range(80):
        rotation, at = tip_frame(robot, q)
        axis = rotation[:, 2]
        error = np.concatenate([at - tip, axis[:2] - wanted[:2]])
        if np.abs(error).max() < 1e-5 and axis[2] * wanted[2] > 0.0:
            return q
        linear, angular = np.split(tip_jacobian(robot, q), 2)
        jacobian = np.vstack([linear, np.cross(angular.T, axis).T[:2]])
        step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-6 * np.eye(5), error)
        q = np.clip(q - step, lower, upper)
    return None


def _places(tip: np.ndarray, reach: float) -> Iterator[np.ndarray]:
    """Places for the tip at its height, the nearest first [m]."""
    grid = [np.array([r * np.cos(a), r * np.sin(a), tip[2]]) for r in _RADII if r < reach for a in _ANGLES]
    yield from sorted(grid, key=lambda place: float(np.linalg.norm(place - tip)))


def _clear(scene: Scene, joints: np.ndarray) -> bool:
    """Whether the arm, so posed, is clear of the object at its start and of the obstacles."""
    rotations, positions = link_frames(scene.robot, joints)
    tip = tip_frame(scene.robot, joints)[1]
    stick = shapely.Point(tip[:2]).buffer(scene.robot.tool_radius + ROOM)
    if shapely.intersects(stick, object_outline(scene, scene.start)):
        return False
    around = [collider for obstacle in scene.obstacles for collider in obstacle.colliders]
    if any(shapely.intersects(stick, outline(footprint([c], lower=tip[2]))) for c in around):
        return False
    links = [
        (collider, rotation, position)
        for link, rotation, position in zip(scene.robot.links, rotations, positions, strict=True)
        for collider in link.colliders
    ]
    return not any(_meet(link, collider) for link in links for collider in around)


def _meet(link: tuple[Collider, np.ndarray, np.ndarray], other: Collider) -> bool:
    """Whether a link's shape and an obstacle overlap from above and in height: no less than they do in space."""
    collider, rotation, position = link
    points, radius = core_points(collider)
    points = points @ rotation.T + position
    low, high = height_range([other])
    if points[:, 2].min() - radius > high or points[:, 2].max() + radius < low:
        return False
    shape = shapely.MultiPoint(points[:, :2]).convex_hull.buffer(radius)
    return bool(shapely.intersects(shape, outline(footprint([other]))))
