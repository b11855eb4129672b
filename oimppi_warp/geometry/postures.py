"""Postures of an arm that holds its tool upright: joint positions as a function of the tip's position.

With the tool upright, five numbers of the tip's pose are given. A redundant arm, or one whose last joint only turns the
tool about itself, takes the joint positions nearest to its start.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from oimppi_warp.compute.cache import cached, content_of_data, source_content
from oimppi_warp.geometry.footprint import rotation_matrix
from oimppi_warp.geometry.kinematics import ROUNDED_ANGLE, is_level, link_frames, revolute_joints, tip_frame
from oimppi_warp.geometry.reach import can_correct, can_lift, can_tilt, correctable, reach_of, without_slight
from oimppi_warp.scene import Robot

STEP = 0.02
"""Grid step of the tip's positions [m]."""
_DAMPING = 1e-6
"""Damping of the least-squares steps, in squared units of the Jacobian."""
_HOME = 0.3
"""Share of the difference to the start that a redundant arm removes in each least-squares step."""
_LONGEST = 0.08
"""Longest correction of the tip in one least-squares step [m]."""
_TOLERANCE = 1e-3
"""Largest error of a posture: of the tip [m], and of the tool's axis."""
_SOLVED = 1e-5
"""Largest error of a posture that is solved from a guess."""
_SEEDS = 9
"""Nodes next to the start from which the postures are continued."""
_FIRST, _NEXT = 60, 8
"""Least-squares steps from the start, and from a neighbouring posture."""


@dataclass(frozen=True, eq=False)
class Postures:
    """Postures on a grid of tip positions.

    Attributes:
        origin: Tip position of the first node [m].
        joints: Joint positions, shape [nx, ny, nz, dof] [rad; m for a prismatic joint]; without a posture, those of the
            nearest node that has one.
        effort: Largest joint velocity per horizontal speed of the tip, for each joint, shape [nx, ny, nz, dof] [1/m].
        reached: Whether there is a posture, shape [nx, ny, nz].
    """

    origin: np.ndarray
    joints: np.ndarray
    effort: np.ndarray
    reached: np.ndarray


def postures_of(robot: Robot, top: float) -> Postures:
    """Computes the postures of an arm for tip positions up to a height, or reads them from the cache.

    From the tip's start the postures are continued from node to node: over the lowest layer above the table first, then
    from layer to layer. Nodes that cannot be reached so, within the joints' limits, have none.

    Args:
        robot: The arm.
        top: Height of the highest layer, rounded up to the grid [m].
    """
    low, high = reach_of(robot).bounds
    first = np.floor(low / STEP) * STEP
    nx, ny = np.ceil((high - first) / STEP).astype(int) + 1
    layers = int(np.ceil(top / STEP - 1e-9)) + 1
    origin = np.array([*first, 0.0])
    xs, ys, zs = first[0] + STEP * np.arange(nx), first[1] + STEP * np.arange(ny), STEP * np.arange(layers)
    nodes = np.stack(np.meshgrid(xs, ys, zs, indexing="ij"), axis=-1)

    def compute() -> np.ndarray:
        from scipy.ndimage import distance_transform_edt

        joints, reached = _continued(robot, nodes)
        if reached.any() and not reached.all():
            nearest = np.asarray(distance_transform_edt(~reached, return_distances=False, return_indices=True))
            joints = joints[nearest[0], nearest[1], nearest[2]]
        effort = np.zeros_like(joints)
        effort[reached] = np.linalg.norm(_inverse(_rates(robot, joints[reached])[2])[:, :2], axis=1)
        return np.concatenate([joints, effort, reached[..., None]], axis=-1)

    sources = (f"geometry/{name}.py" for name in ("postures", "kinematics", "reach", "footprint"))
    content = content_of_data(source_content(*sources), robot, origin, nodes.shape)
    packed = cached("postures", content, compute)
    dof = robot.dof
    return Postures(origin, packed[..., :dof], packed[..., dof : 2 * dof], packed[..., -1] > 0.5)


def upright_from(robot: Robot, guesses: np.ndarray, tip: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Solves for joint positions with the tip at a point and the tool pointing down, from several guesses at once.

    Where no joint can correct a tilt, one of :data:`.ROUNDED_ANGLE` is accepted. The height of the point does not count
    for a robot all of whose links stay at their heights.

    Args:
        robot: The robot.
        guesses: Initial joint positions, shape [n, dof] [rad; m for a prismatic joint].
        tip: Desired position of the tip in the world frame, shape [3] [m].

    Returns:
        The joint positions, and whether each is a solution, shape [n].
    """
    joints, good = _from_guesses(robot, guesses, tip, exact=True)
    left = np.flatnonzero(~good & ~can_correct(_all_rates(robot, joints)[2][:, 3:]))
    if len(left):
        joints[left], good[left] = _from_guesses(robot, guesses[left], tip, exact=False)
    return joints, good


def _from_guesses(robot: Robot, guesses: np.ndarray, tip: np.ndarray, *, exact: bool) -> tuple[np.ndarray, np.ndarray]:
    """Returns joint positions from guesses, and which are solutions: with no tilt if ``exact``, else with a slight one.

    If it is not ``exact``, joint positions at which the tool can be tilted to every side are no solutions.
    """
    lower, upper = np.array([(joint.lower, joint.upper) for joint in robot.joints]).T
    q = np.array(guesses, dtype=float)
    good, flat = np.zeros(len(q), dtype=bool), bool(is_level(robot).all())
    for _ in range(_FIRST + 1):
        at, axis, jacobian = _all_rates(robot, q)
        tilt, upright = axis[:, :2], axis[:, 2] < 0.0
        if not exact:
            stiff = ~can_correct(jacobian[:, 3:])
            upright &= stiff & (np.linalg.norm(tilt, axis=1) < ROUNDED_ANGLE)
            tilt = correctable(jacobian[:, 3:], tilt)
            jacobian[:, 3:] = without_slight(jacobian[:, 3:])
        error = np.concatenate([tip - at, -tilt], axis=1)
        if flat:
            error[:, 2], jacobian[:, 2] = 0.0, 0.0
        good = (np.abs(error).max(axis=1) < _SOLVED) & upright
        if good.all():
            break
        step = np.einsum("nij,ni->nj", _inverse(jacobian), error)
        q = np.where(good[:, None], q, np.clip(q + step, lower, upper))
    return q, good


def halved(values: np.ndarray, *, jump: float = np.inf) -> np.ndarray:
    """Returns values on a grid of half the step, linear between nodes, shape [2 nx - 1, 2 ny - 1, 2 nz - 1, n].

    Args:
        values: Values at the nodes, shape [nx, ny, nz, n].
        jump: Difference of two neighbours beyond which the first is repeated between them: the joint positions on both
            sides of an arm's turn of half a circle have nothing in common.
    """
    for axis in range(3):
        lower, upper = (np.take(values, range(i, values.shape[axis] + i - 1), axis) for i in (0, 1))
        apart = np.abs(upper - lower).max(axis=-1, keepdims=True) > jump
        between = np.where(apart, lower, 0.5 * (lower + upper))
        shape = list(values.shape)
        shape[axis] = 2 * shape[axis] - 1
        finer = np.empty(shape, dtype=values.dtype)
        where = [slice(None)] * values.ndim
        where[axis] = slice(0, None, 2)
        finer[tuple(where)] = values
        where[axis] = slice(1, None, 2)
        finer[tuple(where)] = between
        values = finer
    return values


def _continued(robot: Robot, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns joint positions [nx, ny, nz, dof] with the tip at nodes [nx, ny, nz, 3], and which were found."""
    shape = nodes.shape[:3]
    joints, reached = np.zeros((*shape, robot.dof)), np.zeros(shape, dtype=bool)
    base = min(1, shape[2] - 1)
    at = np.abs(nodes[:, :, base, :2] - tip_frame(robot, robot.start)[1][:2]).max(axis=-1)
    i, j = np.unravel_index(np.argsort(at, axis=None)[:_SEEDS], at.shape)  # the nearest may be out of reach
    found, good = _solved(robot, np.tile(robot.start, (len(i), 1)), nodes[i, j, base], _FIRST)
    i, j = i[good], j[good]
    joints[i, j, base], reached[i, j, base] = found[good], True
    front = set(zip(i.tolist(), j.tolist(), strict=True))
    while front:
        # The neighbours of the front, each with the posture that it is continued from.
        begin = {}
        for a, b in sorted(front):
            for node in ((a + 1, b), (a - 1, b), (a, b + 1), (a, b - 1)):
                if 0 <= node[0] < shape[0] and 0 <= node[1] < shape[1] and not reached[(*node, base)]:
                    begin.setdefault(node, (a, b))
        if not begin:
            break
        a, b = np.array(list(begin)).T
        c, d = np.array(list(begin.values())).T
        found, good = _solved(robot, joints[c, d, base], nodes[a, b, base], _NEXT)
        joints[a[good], b[good], base], reached[a[good], b[good], base] = found[good], True
        front = set(zip(a[good].tolist(), b[good].tolist(), strict=True))
    for order in (range(base, shape[2]), range(base, -1, -1)):
        for below, above in pairwise(order):
            a, b = np.nonzero(reached[:, :, below])
            found, good = _solved(robot, joints[a, b, below], nodes[a, b, above], _NEXT)
            joints[a[good], b[good], above], reached[a[good], b[good], above] = found[good], True
    return joints, reached


def _solved(robot: Robot, joints: np.ndarray, tips: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Solves for joint positions [n, dof] with the tips at positions [n, 3], from joint positions [n, dof].

    Returns:
        The joint positions, and whether each is a solution, shape [n].
    """
    lower, upper = np.array([(joint.lower, joint.upper) for joint in robot.joints]).T
    q = joints
    for _ in range(steps):
        error, _, jacobian = _errors(robot, q, tips)
        error[:, :3] *= np.minimum(1.0, _LONGEST / np.maximum(np.linalg.norm(error[:, :3], axis=1), 1e-9))[:, None]
        inverse = _inverse(jacobian)
        home = _HOME * (robot.start - q)
        home -= np.einsum("nij,nik,nk->nj", inverse, jacobian, home)
        q = np.clip(q + np.einsum("nij,ni->nj", inverse, error) + home, lower, upper)
    error, axis, _ = _errors(robot, q, tips)
    upright = (axis[:, 2] < 0.0) & (can_tilt(robot) | (np.linalg.norm(axis[:, :2], axis=1) < ROUNDED_ANGLE))
    return q, (np.abs(error).max(axis=1) < _TOLERANCE) & upright


def _errors(robot: Robot, joints: np.ndarray, tips: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the errors [n, 5] of tip and tool axis, the axis [n, 3], and the Jacobian [n, 5, dof].

    A robot that cannot lift its tool has no error of height, and one that cannot tilt it to every side none of a tilt
    that comes of rounded angles.
    """
    tip, axis, jacobian = _rates(robot, joints)
    tilt = axis[:, :2] if can_tilt(robot) else correctable(jacobian[:, 3:], axis[:, :2])
    error = np.concatenate([tips - tip, -tilt], axis=1)
    if not can_lift(robot):
        error[:, 2], jacobian[:, 2] = 0.0, 0.0
    return error, axis, jacobian


def _rates(robot: Robot, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns tip [n, 3] [m], tool axis [n, 3] and their Jacobian [n, 5, dof]: of the tip, and of the axis in x, y."""
    tip, axis, jacobian = _all_rates(robot, joints)
    if not can_tilt(robot):
        jacobian[:, 3:] = without_slight(jacobian[:, 3:])
    return tip, axis, jacobian


def _all_rates(robot: Robot, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns what :func:`_rates` does, with all rates of the axis."""
    rotations, positions = link_frames(robot, joints)
    tip = positions[:, -1] + rotations[:, -1] @ robot.tip[:3]
    axis = (rotations[:, -1] @ rotation_matrix(robot.tip[3:]))[:, :, 2]
    axes, revolute = rotations[..., 2], revolute_joints(robot)[:, None]
    linear = np.where(revolute, np.cross(axes, tip[:, None] - positions), axes)
    tilting = np.where(revolute, np.cross(axes, axis[:, None]), 0.0)[..., :2]
    return tip, axis, np.concatenate([linear, tilting], axis=-1).transpose(0, 2, 1)


def _inverse(jacobian: np.ndarray) -> np.ndarray:
    """Returns the transposed, damped pseudo-inverse of Jacobians, shape [n, 5, dof]."""
    square = jacobian @ jacobian.transpose(0, 2, 1) + _DAMPING * np.eye(jacobian.shape[1])
    return np.linalg.solve(square, jacobian)
