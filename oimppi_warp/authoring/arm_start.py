"""Chooses a starting pose for the arm in which neither its tool nor its links touch anything."""

from __future__ import annotations

import math

import numpy as np
import shapely

from oimppi_warp.geometry.feasibility import object_outline
from oimppi_warp.geometry.footprint import core_points, footprint, height_range, outline
from oimppi_warp.geometry.kinematics import link_frames, tip_frame
from oimppi_warp.geometry.reach import Reach, inverse_kinematics, reach_of
from oimppi_warp.scene import Collider, Robot, Scene

MARGIN = 0.02
"""Clearance kept around the stick at the start, beyond its radius [m]."""

_RADII = np.arange(0.25, 0.60, 0.05)
_SHORT = 0.5
"""Reach below which the tip is placed at half of these distances [m]."""
_ANGLES = np.radians(np.arange(-150.0, 151.0, 10.0))


def clear_start(scene: Scene) -> tuple[float, ...] | None:
    """Finds collision-free joint positions for the start of an episode.

    Args:
        scene: The task.

    Returns:
        Joint positions [rad; m] with the tip at the height of the robot's own start, as close to it as possible, and
        the tool pointing down. ``None`` if the robot's own start is clear of the object and the obstacles, or if no
        clear one is found; ``feasibility.check_task`` then reports the problem.
    """
    robot = scene.robot
    if _is_clear(scene, robot.start):
        return None
    tip = tip_frame(robot, robot.start)[1]
    for position in _tip_positions(tip, reach_of(robot)):
        joints = inverse_kinematics_from_start(robot, position)
        if joints is not None and _is_clear(scene, joints):
            return tuple(round(float(q), 5) for q in joints)
    return None


def inverse_kinematics_from_start(robot: Robot, tip: np.ndarray) -> np.ndarray | None:
    """Returns joint positions with the tip at a point, shape [3] [m], and the tool down; ``None`` if none are found.

    The search begins at the robot's start pose with its first joint turned towards the point.
    """
    joints = np.array(robot.start, dtype=float)
    if robot.joints[0].kind == "revolute":
        own = tip_frame(robot, joints)[1]
        turn = np.arctan2(tip[1], tip[0]) - np.arctan2(own[1], own[0])
        joints[0] = np.clip(joints[0] + math.remainder(turn, 2.0 * np.pi), robot.joints[0].lower, robot.joints[0].upper)
    return inverse_kinematics(robot, joints, tip)


def _tip_positions(tip: np.ndarray, reach: Reach) -> list[np.ndarray]:
    """Returns candidate tip positions at the tip's height and within reach, nearest first [m]."""
    radii = _RADII if reach.radius > _SHORT else 0.5 * _RADII
    grid = np.array([(r * np.cos(a), r * np.sin(a), tip[2]) for r in radii for a in _ANGLES])
    within = grid[reach.margin(grid[:, :2]) > 0.0]
    return list(within[np.argsort(np.linalg.norm(within - tip, axis=1), kind="stable")])


def _is_clear(scene: Scene, joints: np.ndarray) -> bool:
    """Returns whether the arm, in this pose, is clear of the object at its start and of the obstacles."""
    rotations, positions = link_frames(scene.robot, joints)
    tip = tip_frame(scene.robot, joints)[1]
    stick = shapely.Point(tip[:2]).buffer(scene.robot.tool_radius + MARGIN)
    if shapely.intersects(stick, object_outline(scene, scene.start)):
        return False
    obstacles = [collider for obstacle in scene.obstacles for collider in obstacle.colliders]
    if any(shapely.intersects(stick, outline(footprint([c], lower=tip[2]))) for c in obstacles):
        return False
    links = [
        (collider, rotation, position)
        for link, rotation, position in zip(scene.robot.links, rotations, positions, strict=True)
        for collider in link.colliders
    ]
    return not any(_overlap(link, collider) for link in links for collider in obstacles)


def _overlap(link: tuple[Collider, np.ndarray, np.ndarray], other: Collider) -> bool:
    """Returns whether a link's shape and an obstacle overlap in plan view and in height, a conservative 3D test."""
    collider, rotation, position = link
    points, radius = core_points(collider)
    points = points @ rotation.T + position
    low, high = height_range([other])
    if points[:, 2].min() - radius > high or points[:, 2].max() + radius < low:
        return False
    shape = shapely.MultiPoint(points[:, :2]).convex_hull.buffer(radius)
    return bool(shapely.intersects(shape, outline(footprint([other]))))
