"""Where the tip of a robot gets on the table with its tool pointing down, and joint positions that take it there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
import shapely

from oimppi_warp.geometry.kinematics import link_frames, revolute_joints, tip_frame, tip_jacobian
from oimppi_warp.scene import Robot, Scene

_SIDES = 32
"""Sides of the polygon around a disc that is carried along."""
_UP = np.array([0.0, 0.0, 1.0])

TipErrors = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""What is asked of a tip [3]: directions [n, 3], and how far it is from where it should be along each, [n] [m]."""


@dataclass(frozen=True, eq=False)
class Reach:
    """Where the tip gets at table height with the tool pointing down.

    Attributes:
        radius: The farthest from the base's axis [m].
        border: Corners of the region, shape [n, 2] [m]; ``None`` for an arm that turns about the base's axis, which
            gets all around.
    """

    radius: float
    border: np.ndarray | None = None

    def margin(self, points: np.ndarray) -> np.ndarray:
        """How far inside of the region points [n, 2] are; negative outside [m]."""
        if self.border is None:
            return self.radius - np.hypot(*np.asarray(points, dtype=float).T)
        region, at = shapely.convex_hull(shapely.multipoints(self.border)), shapely.points(points)
        away = shapely.distance(at, shapely.boundary(region))
        return np.where(shapely.covers(region, at), away, -away)

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner of the rectangle around it [m]."""
        if self.border is None:
            return np.full(2, -self.radius), np.full(2, self.radius)
        return self.border.min(axis=0), self.border.max(axis=0)


@lru_cache(maxsize=8)
def reach_of(robot: Robot) -> Reach:
    """Where a robot's tip gets.

    From its start configuration the tip is led to the table and away from the axis of the first joint that turns, until
    no joint positions within the limits are found any more: the arm gets so far to all sides. Joints that slide before
    that one carry this disc along. A robot of sliding joints alone gets wherever their limits leave room. Where the
    first joint that turns does not stand upright, the stretched length of the chain is the bound.
    """
    revolute = np.flatnonzero(revolute_joints(robot))
    if not len(revolute):
        return _region(_corners(robot, robot.dof))
    first = int(revolute[0])
    rotations, positions = link_frames(robot, robot.start)
    axis, carried = positions[first][:2], np.hypot(*rotations[:first, :2, 2].T) > 1e-6
    if abs(rotations[first][2, 2]) < 1.0 - 1e-9:
        return Reach(stretched_length(robot))
    free = np.append(~carried, np.ones(robot.dof - first, dtype=bool))
    radius = _max_radius(robot, axis, free)
    if not carried.any() and np.hypot(*axis) < 1e-9:
        return Reach(radius)
    angles = np.arange(_SIDES) * 2.0 * np.pi / _SIDES
    disc = radius / np.cos(np.pi / _SIDES) * np.column_stack([np.cos(angles), np.sin(angles)])
    offset = axis - tip_frame(robot, robot.start)[1][:2]
    return _region((_corners(robot, first)[:, None] + offset + disc).reshape(-1, 2))


def object_bounds(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the rectangle within which the object is to stay [m]: the table's, or what of it the robot reaches.

    An arm that turns about its base is kept to its reach by a cost instead, as that is no rectangle.
    """
    lower, upper, reach = np.array(scene.table.lower), np.array(scene.table.upper), reach_of(scene.robot)
    if reach.border is None:
        return lower, upper
    behind = 2.0 * scene.robot.tool_radius
    return np.maximum(lower, reach.bounds[0] + behind), np.minimum(upper, reach.bounds[1] - behind)


def stretched_length(robot: Robot) -> float:
    """A bound on how far the tip can be from the base's axis [m]."""
    links = [np.linalg.norm(joint.parent_transform[:3]) for joint in robot.joints[1:]]
    strokes = [max(abs(joint.lower), abs(joint.upper)) for joint in robot.joints if joint.kind == "prismatic"]
    aside = np.linalg.norm(robot.joints[0].parent_transform[:2])
    return float(sum(links) + np.linalg.norm(robot.tip[:3]) + aside + sum(strokes))


def _region(points: np.ndarray) -> Reach:
    """The convex hull of points [n, 2]."""
    border = shapely.get_coordinates(shapely.convex_hull(shapely.multipoints(points)))[:-1]
    return Reach(float(np.hypot(*border.T).max()), border)


@lru_cache(maxsize=8)
def can_lift(robot: Robot) -> bool:
    """Whether the robot can raise its tool without tilting it; one that cannot has to go around things."""
    linear, tilting = _rates(robot, robot.start)
    both = np.vstack([tilting, linear[2]])
    return bool(np.linalg.matrix_rank(both, tol=1e-6) > np.linalg.matrix_rank(tilting, tol=1e-6))


def inverse_kinematics(robot: Robot, joints: np.ndarray, tip: np.ndarray) -> np.ndarray | None:
    """Joint positions with the tip at a point [3] [m] and the tool pointing down; ``None`` where none are found.

    Args:
        robot: The robot.
        joints: Joint positions to begin with, shape [dof] [rad].
        tip: Where the tip should be.
    """
    return _solve_ik(robot, joints, lambda at: (np.eye(3), at - tip))


def _corners(robot: Robot, count: int) -> np.ndarray:
    """Where the tip is with each of the first sliding joints at one of its limits, the others at their start [m]."""
    limits = product(*[(joint.lower, joint.upper) for joint in robot.joints[:count]])
    return np.array([tip_frame(robot, np.array([*ends, *robot.start[count:]]))[1][:2] for ends in limits])


def _max_radius(robot: Robot, axis: np.ndarray, free: np.ndarray) -> float:
    """How far from an axis [2] the tip gets with the joints that are free, led there step by step; 0: nowhere [m]."""
    start = tip_frame(robot, robot.start)[1]
    height = 0.0 if can_lift(robot) else start[2]

    def at_radius(radius: float) -> TipErrors:
        def errors(tip: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            x, y = tip[:2] - axis
            outwards = np.array([x, y, 0.0]) / max(np.hypot(x, y), 1e-9)
            return np.array([outwards, _UP]), np.array([np.hypot(x, y) - radius, tip[2] - height])

        return errors

    radius = float(np.linalg.norm(start[:2] - axis))
    joints, step = _solve_ik(robot, robot.start, at_radius(radius), free), 0.05
    while step > 5e-4 and joints is not None:
        further = _solve_ik(robot, joints, at_radius(radius + step), free)
        if further is None:
            step /= 2.0
        else:
            joints, radius = further, radius + step
    return 0.0 if joints is None else radius


def _rates(robot: Robot, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """By the joint velocities: the tip's velocity [3, dof], and the change of its z axis in x and y [2, dof]."""
    axis = tip_frame(robot, joints)[0][:, 2]
    linear, angular = np.split(tip_jacobian(robot, joints), 2)
    return linear, np.cross(angular.T, axis).T[:2]


def _solve_ik(
    robot: Robot, joints: np.ndarray, tip_errors: TipErrors, free: np.ndarray | None = None
) -> np.ndarray | None:
    """Joint positions without errors of the tip and the tool pointing down: damped Gauss-Newton within the limits.

    Only the joints that are free [dof] move; default: all.
    """
    lower, upper = np.array([j.lower for j in robot.joints]), np.array([j.upper for j in robot.joints])
    q = np.array(joints, dtype=float)
    for _ in range(60):
        rotation, tip = tip_frame(robot, q)
        axis = rotation[:, 2]
        directions, errors = tip_errors(tip)
        error = np.array([*errors, axis[0], axis[1]])
        if np.abs(error).max() < 1e-5 and axis[2] < 0.0:
            return q
        linear, tilting = _rates(robot, q)
        jacobian = np.vstack([directions @ linear, tilting])
        if free is not None:
            jacobian = jacobian * free
        q = q - jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-6 * np.eye(len(error)), error)
        q = np.clip(q, lower, upper)
    return None
