"""Where the tip of a robot gets on the table with its tool pointing down, and joint positions that take it there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
import shapely

from oimppi_warp.footprint import rotation_matrix
from oimppi_warp.kinematics import tip_frame, tip_jacobian, turning
from oimppi_warp.scene import Robot

_DIRECTIONS = 24
"""Directions in which the border is looked for, where an arm does not turn about the base's axis."""
_UP = np.array([0.0, 0.0, 1.0])

Wanted = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
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

    def room(self, points: np.ndarray) -> np.ndarray:
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

    From its start configuration the tip is led to the table and outwards, until no joint positions within the limits
    are found any more: in one direction where the arm turns about the base's axis, else in all. A robot of sliding
    joints gets wherever their limits leave room.
    """
    if turns_about_base(robot):
        start = float(np.linalg.norm(tip_frame(robot, robot.start)[1][:2]))
        return Reach(_farthest(robot, start, lambda radius: lambda tip: _at_radius(tip, radius)))
    border = _corners(robot) if not turning(robot).any() else _border(robot)
    return Reach(float(np.hypot(*border.T).max()), border)


def turns_about_base(robot: Robot) -> bool:
    """Whether the first joint turns all that follows about the base's axis."""
    first = robot.joints[0]
    upright = abs(rotation_matrix(first.parent_transform[3:])[2, 2]) > 1.0 - 1e-9
    return first.kind == "revolute" and upright and bool(np.hypot(*first.parent_transform[:2]) < 1e-9)


@lru_cache(maxsize=8)
def can_lift(robot: Robot) -> bool:
    """Whether the robot can raise its tool without tilting it; one that cannot has to go around things."""
    linear, tilting = _rates(robot, robot.start)
    both = np.vstack([tilting, linear[2]])
    return bool(np.linalg.matrix_rank(both, tol=1e-6) > np.linalg.matrix_rank(tilting, tol=1e-6))


def joints_for(robot: Robot, joints: np.ndarray, tip: np.ndarray) -> np.ndarray | None:
    """Joint positions with the tip at a point [3] [m] and the tool pointing down; ``None`` where none are found.

    Args:
        robot: The robot.
        joints: Joint positions to begin with, shape [dof] [rad].
        tip: Where the tip should be.
    """
    return _led(robot, joints, lambda at: (np.eye(3), at - tip))


def _at_radius(tip: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """At a distance from the base's axis, on the table."""
    outwards = np.array([tip[0], tip[1], 0.0]) / max(np.hypot(tip[0], tip[1]), 1e-9)
    return np.array([outwards, _UP]), np.array([outwards @ tip - radius, tip[2]])


def _along(tip: np.ndarray, direction: np.ndarray, distance: float, height: float) -> tuple[np.ndarray, np.ndarray]:
    """So far in a direction from the origin, at a height."""
    return np.array([direction, _UP]), np.array([direction @ tip - distance, tip[2] - height])


def _corners(robot: Robot) -> np.ndarray:
    """Where the tip is with each sliding joint at one of its limits, shape [n, 2] [m]."""
    limits = [(joint.lower, joint.upper) for joint in robot.joints]
    return np.array([tip_frame(robot, np.array(joints))[1][:2] for joints in product(*limits)])


def _border(robot: Robot) -> np.ndarray:
    """The farthest point in each direction, shape [direction, 2] [m]."""
    tip, points = tip_frame(robot, robot.start)[1], []
    height = 0.0 if can_lift(robot) else float(tip[2])
    for angle in (np.arange(_DIRECTIONS) + 0.5) * 2.0 * np.pi / _DIRECTIONS:
        direction = np.array([np.cos(angle), np.sin(angle), 0.0])
        distance = _farthest(robot, float(direction @ tip), lambda d, n=direction: lambda at: _along(at, n, d, height))
        points.append((distance, direction[:2]))
    # The region's corners are where the lines across the directions meet.
    ends, normals = np.array([d for d, _ in points]), np.array([n for _, n in points])
    pairs = np.stack([normals, np.roll(normals, -1, axis=0)], axis=1)
    return np.linalg.solve(pairs, np.stack([ends, np.roll(ends, -1)], axis=1)[..., None])[..., 0]


def _farthest(robot: Robot, begin: float, wanted: Callable[[float], Wanted]) -> float:
    """The largest distance for which joint positions are found, led there step by step; zero where none are [m]."""
    joints, step, distance = _led(robot, robot.start, wanted(begin)), 0.05, begin
    if joints is None:
        return 0.0
    while step > 5e-4:
        further = _led(robot, joints, wanted(distance + step))
        if further is None:
            step /= 2.0
        else:
            joints, distance = further, distance + step
    return distance


def _rates(robot: Robot, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """By the joint velocities: the tip's velocity [3, dof], and the change of its z axis in x and y [2, dof]."""
    axis = tip_frame(robot, joints)[0][:, 2]
    linear, angular = np.split(tip_jacobian(robot, joints), 2)
    return linear, np.cross(angular.T, axis).T[:2]


def _led(robot: Robot, joints: np.ndarray, wanted: Wanted) -> np.ndarray | None:
    """Joint positions with the tip as wanted and the tool pointing down: damped Gauss-Newton within the limits."""
    lower, upper = np.array([j.lower for j in robot.joints]), np.array([j.upper for j in robot.joints])
    q = np.array(joints, dtype=float)
    for _ in range(60):
        rotation, tip = tip_frame(robot, q)
        axis = rotation[:, 2]
        directions, away = wanted(tip)
        error = np.array([*away, axis[0], axis[1]])
        if np.abs(error).max() < 1e-5 and axis[2] < 0.0:
            return q
        linear, tilting = _rates(robot, q)
        jacobian = np.vstack([directions @ linear, tilting])
        q = q - jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-6 * np.eye(len(error)), error)
        q = np.clip(q, lower, upper)
    return None
