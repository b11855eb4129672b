"""Reach of a robot's tip over the table with the tool pointing down, and inverse kinematics for such positions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product

import numpy as np
import shapely

from oimppi_warp.geometry.kinematics import (
    ROUNDED_ANGLE,
    cross,
    is_level,
    link_frames,
    parallel,
    revolute_joints,
    tip_frame,
    tip_jacobian,
)
from oimppi_warp.scene import Robot, Scene

_SIDES = 32
"""Sides of the polygon that approximates a disc carried by sliding joints."""
_AZIMUTHS = 12
"""Directions in which the reach of an arm with a tilted first axis is searched for."""
_UP = np.array([0.0, 0.0, 1.0])
_HIGH = 0.3
"""Height of the tip beyond which nobody asks [m]."""
_RADII = (1.0, 0.85, 0.7, 0.55, 0.4, 0.25)
"""Distances from the axis at which the tip is lowered to the table, relative to that at the start."""
_CENTERED = 1e-3
"""Distance of the first axis from the base's origin up to which the arm counts as turning about its base [m]."""
_NO_RATE = 2.0 * ROUNDED_ANGLE
"""Rate of tilt or height per joint velocity below which a joint does not change it [rad/rad; m/rad]."""

TipErrors = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Function of a tip position [3] that returns directions [n, 3] and the position error along each, [n] [m]."""


@dataclass(frozen=True, eq=False)
class Reach:
    """Region that the tip reaches at table height with the tool pointing down.

    Attributes:
        radius: Largest distance of the tip from the base's axis [m].
        border: Corners of the region, shape [n, 2] [m]; ``None`` for an arm that turns about the base's axis, which
            reaches all around.
        offset: For an arm that turns about another vertical axis than the base's: the distance of the two [m].
        disc: For such an arm, the largest distance of the tip from the axis that it turns about; else 0 [m].
    """

    radius: float
    border: np.ndarray | None = None
    offset: float = 0.0
    disc: float = 0.0

    def margin(self, points: np.ndarray) -> np.ndarray:
        """Returns the distance of points, shape [n, 2] [m], to the region's border, shape [n] [m]; negative outside."""
        if self.border is None:
            return self.radius - np.hypot(*np.asarray(points, dtype=float).T)
        region, at = shapely.convex_hull(shapely.multipoints(self.border)), shapely.points(points)
        away = shapely.distance(at, shapely.boundary(region))
        return np.where(shapely.covers(region, at), away, -away)

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Returns the lower and upper corners of the region's bounding rectangle [m]."""
        if self.border is None:
            return np.full(2, -self.radius), np.full(2, self.radius)
        return self.border.min(axis=0), self.border.max(axis=0)


@lru_cache(maxsize=8)
def reach_of(robot: Robot) -> Reach:
    """Computes the reach of a robot's tip.

    From its start configuration the tip is moved to the table and away from the axis of the first joint that turns,
    until no joint positions within the limits are found: that is the arm's reach to all sides, zero if the tip does not
    get down to the table. Sliding joints before that one move this disc along. A robot with sliding joints only reaches
    everything within their limits. If the axis of the first joint that turns is tilted by more than
    :data:`ROUNDED_ANGLE`, the arm does not reach equally far to all sides, and the smallest distance counts.
    """
    revolute = np.flatnonzero(revolute_joints(robot))
    if not len(revolute):
        return _region(_corners(robot, robot.dof))
    first = int(revolute[0])
    rotations, positions = link_frames(robot, robot.start)
    axis, carried = positions[first][:2], ~parallel(rotations[:first, :, 2], _UP)
    free = np.append(~carried, np.ones(robot.dof - first, dtype=bool))
    search = _max_radius if parallel(rotations[first][:, 2], _UP) else _radius_to_all_sides
    radius = search(robot, axis, free)
    if not radius or (not carried.any() and np.hypot(*axis) < _CENTERED):
        return Reach(radius)
    angles = np.arange(_SIDES) * 2.0 * np.pi / _SIDES
    disc = radius / np.cos(np.pi / _SIDES) * np.column_stack([np.cos(angles), np.sin(angles)])
    offset = axis - tip_frame(robot, robot.start)[1][:2]
    region = _region((_corners(robot, first)[:, None] + offset + disc).reshape(-1, 2))
    return region if carried.any() else replace(region, offset=float(np.hypot(*axis)), disc=radius)


def object_bounds(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Returns the corners of the rectangle that the object must stay in: the table, or the part of it in reach [m].

    For an arm that turns about its base, whose reach is not a rectangle, a cost limits it instead.
    """
    lower, upper, reach = np.array(scene.table.lower), np.array(scene.table.upper), reach_of(scene.robot)
    if reach.border is None:
        return lower, upper
    behind = 2.0 * scene.robot.tool_radius
    return np.maximum(lower, reach.bounds[0] + behind), np.minimum(upper, reach.bounds[1] - behind)


def stretched_length(robot: Robot) -> float:
    """Returns an upper bound on the tip's distance from the base's axis [m]."""
    links = [np.linalg.norm(joint.parent_transform[:3]) for joint in robot.joints[1:]]
    strokes = [max(abs(joint.lower), abs(joint.upper)) for joint in robot.joints if joint.kind == "prismatic"]
    aside = np.linalg.norm(robot.joints[0].parent_transform[:2])
    return float(sum(links) + np.linalg.norm(robot.tip[:3]) + aside + sum(strokes))


def _region(points: np.ndarray) -> Reach:
    """Returns the convex hull of tip positions, shape [n, 2] [m], as a region of reach."""
    border = shapely.get_coordinates(shapely.convex_hull(shapely.multipoints(points)))[:-1]
    return Reach(float(np.hypot(*border.T).max()), border)


@lru_cache(maxsize=8)
def can_lift(robot: Robot) -> bool:
    """Returns whether the robot can raise its tool without tilting it; otherwise it has to go around objects."""
    linear, tilting = tip_rates(robot, robot.start)
    both = np.vstack([tilting, linear[2]])
    return bool(np.linalg.matrix_rank(both, tol=_NO_RATE) > np.linalg.matrix_rank(tilting, tol=_NO_RATE))


@lru_cache(maxsize=8)
def can_tilt(robot: Robot) -> bool:
    """Returns whether the robot can tilt its tool to every side, and so correct a tilt; many of five joints cannot."""
    return bool(can_correct(_all_rates(robot, robot.start)[1]))


@lru_cache(maxsize=8)
def highest_tip(robot: Robot) -> float:
    """Returns about how high the tip gets at its place at the start with the tool pointing down, at most 0.3 m [m]."""
    joints, (x, y, height), step = robot.start, tip_frame(robot, robot.start)[1], 0.02
    while can_lift(robot) and step > 2e-3 and height < _HIGH:
        higher = inverse_kinematics(robot, joints, np.array([x, y, height + step]))
        if higher is None:
            step /= 2.0
        else:
            joints, height = higher, height + step
    return float(height)


def lowest_tip(robot: Robot, joints: np.ndarray) -> float:
    """Returns about how low the tip gets with the tool pointing down, at any place [m].

    Args:
        robot: The robot.
        joints: Joint positions with the tool pointing down, from which the tip is lowered, shape [dof] [rad; m].
    """
    height, step = float(tip_frame(robot, joints)[1][2]), 0.02
    while step > 5e-4:
        target = height - step
        lower = _solve_ik(robot, joints, lambda tip, target=target: (_UP[None], np.array([tip[2] - target])))
        if lower is None:
            step /= 2.0
        else:
            joints, height = lower, target
    return height


def inverse_kinematics(robot: Robot, joints: np.ndarray, tip: np.ndarray) -> np.ndarray | None:
    """Finds joint positions, shape [dof], with the tip at a point and the tool pointing down; ``None`` if it fails.

    The height of the point does not count for a robot all of whose links stay at their heights.

    Args:
        robot: The robot.
        joints: Initial joint positions, shape [dof] [rad; m for a prismatic joint].
        tip: Desired position of the tip in the world frame, shape [3] [m].
    """
    held = 2 if is_level(robot).all() else 3
    return _solve_ik(robot, joints, lambda at: (np.eye(3)[:held], (at - tip)[:held]))


def _corners(robot: Robot, count: int) -> np.ndarray:
    """Returns the tip positions with the first ``count`` joints, which slide, at each combination of limits [m]."""
    limits = product(*[(joint.lower, joint.upper) for joint in robot.joints[:count]])
    return np.array([tip_frame(robot, np.array([*ends, *robot.start[count:]]))[1][:2] for ends in limits])


def _max_radius(robot: Robot, axis: np.ndarray, free: np.ndarray) -> float:
    """Returns the tip's largest distance from an axis [2] with the free joints, found step by step; 0 if none [m]."""
    start = tip_frame(robot, robot.start)[1]
    height = 0.0 if can_lift(robot) else start[2]

    def at_radius(radius: float) -> TipErrors:
        def errors(tip: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            x, y = tip[:2] - axis
            outwards = np.array([x, y, 0.0]) / max(np.hypot(x, y), 1e-9)
            return np.array([outwards, _UP]), np.array([np.hypot(x, y) - radius, tip[2] - height])

        return errors

    return _outwards(robot, robot.start, float(np.linalg.norm(start[:2] - axis)), at_radius, free)[0]


def _radius_to_all_sides(robot: Robot, axis: np.ndarray, free: np.ndarray) -> float:
    """Returns the smallest of the tip's largest distances from a point [2] in several directions; 0 if none [m].

    As for a vertical axis, the limits of the first joint that turns do not count, nor do directions in which the tip
    gets down to the table nowhere.
    """
    first = int(np.flatnonzero(revolute_joints(robot))[0])
    turning = replace(robot.joints[first], lower=-np.inf, upper=np.inf)
    endless = replace(robot, joints=(*robot.joints[:first], turning, *robot.joints[first + 1 :]))
    start = tip_frame(robot, robot.start)[1]
    height = 0.0 if can_lift(robot) else start[2]
    ahead, distance = np.arctan2(*(start[:2] - axis)[::-1]), float(np.linalg.norm(start[:2] - axis))
    steps = np.arange(_AZIMUTHS // 2 + 1) * 2.0 * np.pi / _AZIMUTHS
    radii = []
    for side in (steps, -steps[1:-1]):
        joints = robot.start
        for azimuth in ahead + side:
            target = np.array([*axis, height]), np.array([np.cos(azimuth), np.sin(azimuth), 0.0])

            def at_radius(radius: float, target: tuple[np.ndarray, np.ndarray] = target) -> TipErrors:
                return lambda tip: (np.eye(3), tip - target[0] - radius * target[1])

            radius, found = _outwards(endless, joints, distance, at_radius, free)
            if found is not None:
                radii.append(radius)
                joints = found
    return min(radii, default=0.0)


def _outwards(
    robot: Robot,
    joints: np.ndarray,
    distance: float,
    at_radius: Callable[[float], TipErrors],
    free: np.ndarray,
) -> tuple[float, np.ndarray | None]:
    """Returns the tip's largest radius [m], found step by step, and joint positions at the first; else 0, ``None``.

    Args:
        robot: The robot.
        joints: Joint positions to begin at, shape [dof] [rad; m].
        distance: Radius at which the tip is first moved to the table, or a share of it in :data:`_RADII` [m].
        at_radius: Function of a radius [m] that returns the tip's errors there.
        free: Whether a joint may move, shape [dof].
    """
    found = ((share * distance, _solve_ik(robot, joints, at_radius(share * distance), free)) for share in _RADII)
    radius, first = next(((r, q) for r, q in found if q is not None), (0.0, None))
    last, step = first, 0.05
    while step > 5e-4 and last is not None:
        further = _solve_ik(robot, last, at_radius(radius + step), free)
        if further is None:
            step /= 2.0
        else:
            last, radius = further, radius + step
    return radius, first


def tip_rates(robot: Robot, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the Jacobians of the tip's position, shape [3, dof], and of its z axis in x and y, shape [2, dof].

    Of a robot that cannot tilt its tool to every side, the second has no rates that come of rounded angles alone: the
    joints are not for correcting such a tilt.
    """
    linear, tilting = _all_rates(robot, joints)
    return linear, tilting if can_tilt(robot) else without_slight(tilting)


def can_correct(tilting: np.ndarray) -> np.ndarray:
    """Returns whether joints with Jacobians of the tool's axis, shape [..., 2, dof], tilt it to every side."""
    sizes = np.linalg.svd(tilting, compute_uv=False)
    return (sizes[..., -1] >= _NO_RATE) & (sizes.shape[-1] == 2)


def without_slight(tilting: np.ndarray) -> np.ndarray:
    """Returns Jacobians of the tool's axis, shape [..., 2, dof], without what comes of rounded angles."""
    left, size, right = np.linalg.svd(tilting, full_matrices=False)
    return (left * np.where(size < _NO_RATE, 0.0, size)[..., None, :]) @ right


def correctable(tilting: np.ndarray, tilts: np.ndarray) -> np.ndarray:
    """Returns the parts of tilts, shape [..., 2] [rad], that joints correct; ``tilting`` is [..., 2, dof]."""
    left, size, _ = np.linalg.svd(tilting, full_matrices=False)
    left = left * (size >= _NO_RATE)[..., None, :]
    return np.einsum("...ij,...kj,...k->...i", left, left, tilts)


def _all_rates(robot: Robot, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the Jacobians of :func:`tip_rates`, with all rates."""
    axis = tip_frame(robot, joints)[0][:, 2]
    linear, angular = np.split(tip_jacobian(robot, joints), 2)
    return linear, cross(angular.T, axis).T[:2]


def _solve_ik(
    robot: Robot, joints: np.ndarray, tip_errors: TipErrors, free: np.ndarray | None = None
) -> np.ndarray | None:
    """Solves for joint positions without tip errors and with the tool pointing down, by damped Gauss-Newton.

    Joint limits are kept. Only the joints marked in ``free`` [dof] move; ``None``: all. Where no joint can correct a
    tilt, as in an arm of five joints, one of :data:`ROUNDED_ANGLE` is accepted.
    """
    found, last = _iterated(robot, joints, tip_errors, free)
    if not found and not can_correct(_all_rates(robot, last)[1]):
        found, last = _iterated(robot, joints, tip_errors, free, exact=False)
    return last if found else None


def _iterated(
    robot: Robot, joints: np.ndarray, tip_errors: TipErrors, free: np.ndarray | None, *, exact: bool = True
) -> tuple[bool, np.ndarray]:
    """Returns whether :func:`_solve_ik` succeeded, without a tilt if ``exact``, and its joint positions."""
    lower, upper = np.array([j.lower for j in robot.joints]), np.array([j.upper for j in robot.joints])
    q = np.array(joints, dtype=float)
    for _ in range(60):
        rotation, tip = tip_frame(robot, q)
        axis = rotation[:, 2]
        directions, errors = tip_errors(tip)
        linear, tilting = tip_rates(robot, q) if exact else _all_rates(robot, q)
        tilt = axis[:2]
        if not exact:
            tilt, tilting = correctable(tilting, axis[:2]), without_slight(tilting)
        error = np.array([*errors, *tilt])
        if np.abs(error).max() < 1e-5 and axis[2] < 0.0 and (exact or np.hypot(*axis[:2]) < ROUNDED_ANGLE):
            return True, q
        jacobian = np.vstack([directions @ linear, tilting])
        if free is not None:
            jacobian = jacobian * free
        q = q - jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-6 * np.eye(len(error)), error)
        q = np.clip(q, lower, upper)
    return False, q
