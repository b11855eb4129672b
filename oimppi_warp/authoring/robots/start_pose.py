"""Where an arm begins: its tool upright, the tip a little over the table in front of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from oimppi_warp.authoring.robots.arm import Arm
from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.kinematics import collider_spheres, link_frames, revolute_joints, tip_frame
from oimppi_warp.geometry.reach import inverse_kinematics
from oimppi_warp.scene import Robot

HEIGHT = 0.05
"""Height of the tip at the start [m]."""
PUSHING = (0.004, 0.03)
"""Height that the tip of a robot without a way up must have [m]."""
ROOM = 0.02
"""Room that every link must have to the table [m]."""
_DISTANCES = (0.36, 0.45, 0.30, 0.55, 0.25, 0.65, 0.80, 1.0)
"""Distances from the base at which a place for the tip is looked for, in this order [m]."""
_AZIMUTH = -0.588
"""Direction in which it is looked for: a little aside, as the shipped tasks begin [rad]."""
_TRIES = 60
_SPARE = 0.03
"""Way that every joint must have to its limits, as a share of all its way."""


def with_start(arm: Arm, *, file: object = "") -> Arm:
    """An arm with joint positions to begin with, rounded to be read.

    Args:
        arm: The arm, at any positions.
        file: Where it comes from, for the error.

    Raises:
        SceneError: None are found.
    """
    robot = arm.robot()
    lower, upper = _limits(robot)
    middle, height = (lower + upper) / 2, HEIGHT
    if is_flat(robot):
        height = float(tip_frame(robot, middle)[1][2])
        _check_height(robot, middle, height, file)
    guesses, best = _guesses(robot, np.random.default_rng(0)), (-np.inf, ())
    for distance in _DISTANCES:
        target = np.array([distance * np.cos(_AZIMUTH), distance * np.sin(_AZIMUTH), height])
        for guess in guesses:
            joints = inverse_kinematics(robot, guess, target)
            if joints is not None:
                joints = _rounded(robot, joints)
                best = max(best, (_score(robot, joints), tuple(joints.tolist())))
        if best[0] > 0.0:
            return replace(arm, start=best[1])
    raise SceneError(
        "no joint positions put the tool upright over the table in front of the arm",
        file=file,
        allowed=f"a tip {HEIGHT:g} m over z = 0, {min(_DISTANCES):g} to {max(_DISTANCES):g} m from the base",
        fix="check --flange and --tool-axis, and that the arm stands at the table with z up",
    )


def _limits(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper limits, half a turn to either side for joints that go further, shape [dof] each."""
    lower, upper = (np.array([getattr(joint, end) for joint in robot.joints]) for end in ("lower", "upper"))
    revolute = revolute_joints(robot)
    return np.where(revolute, np.maximum(lower, -np.pi), lower), np.where(revolute, np.minimum(upper, np.pi), upper)


def _guesses(robot: Robot, random: np.random.Generator) -> list[np.ndarray]:
    """Joint positions to begin with: the first joint towards the tip, some of the others bent."""
    lower, upper = _limits(robot)
    middle, guesses = (lower + upper) / 2, []
    for _ in range(_TRIES):
        bent = np.where(random.random(robot.dof) < 0.6, random.uniform(lower, upper), middle)
        bent[0] = np.clip(_AZIMUTH, lower[0], upper[0]) if revolute_joints(robot)[0] else middle[0]
        guesses.append(bent)
    return [middle, *guesses]


def _score(robot: Robot, joints: np.ndarray) -> float:
    """How good a start is: room over the table, spare way to the limits, no needless twists; not above 0: none."""
    lower, upper = _limits(robot)
    room = table_clearance(robot, joints)
    spare = float(np.min(np.minimum(joints - lower, upper - joints) / (upper - lower)))
    if (room < ROOM and not is_flat(robot)) or spare < _SPARE:
        return -np.inf
    twisted = float(np.linalg.norm((joints - (lower + upper) / 2) * revolute_joints(robot)))
    return 1.0 + min(room, 0.1) + 0.2 * min(spare, 0.2) - 0.02 * twisted


def _rounded(robot: Robot, joints: np.ndarray) -> np.ndarray:
    """The same joint positions without whole turns, where the limits allow that, in a few digits."""
    wrapped = np.mod(joints + np.pi, 2.0 * np.pi) - np.pi
    lower, upper = (np.array([getattr(joint, end) for joint in robot.joints]) for end in ("lower", "upper"))
    allowed = revolute_joints(robot) & (lower <= wrapped) & (wrapped <= upper)
    return np.clip(np.round(np.where(allowed, wrapped, joints), 4) + 0.0, lower, upper)


def is_flat(robot: Robot) -> bool:
    """Whether no joint moves the tool up, down or askew: all turn about upright axes or slide across them."""
    rotations = link_frames(robot, np.zeros(robot.dof))[0]
    upright = np.abs(rotations[:, 2, 2])
    return bool(np.where(revolute_joints(robot), upright > 1.0 - 1e-6, upright < 1e-6).all())


def table_clearance(robot: Robot, joints: np.ndarray) -> float:
    """Height of the lowest point of the moving links, the stick left out [m]."""
    rotations, positions = link_frames(robot, joints)
    lowest = [1.0]
    for link, rotation, position in zip(robot.links, rotations, positions, strict=True):
        for collider in link.colliders:
            balls = collider_spheres(collider)
            lowest.append(float((position[2] + balls[:, :3] @ rotation[2] - balls[:, 3]).min()))
    return min(lowest)


def _check_height(robot: Robot, joints: np.ndarray, height: float, file: object) -> None:
    """Raise SceneError for a robot without a way up whose tool is not upright, or not where it pushes."""
    if tip_frame(robot, joints)[0][2, 2] > -1.0 + 1e-6:
        raise SceneError("its stick does not point down", file=file, allowed="down", fix="choose another --tool-axis")
    low, high = PUSHING
    if not low <= height <= high:
        raise SceneError(
            f"it cannot lower its tool, and the tip is at {height:.3f} m",
            file=file,
            allowed=f"{low:g} to {high:g} m over the table",
            fix=f"give a --tool-length that is {height - 0.012:.3f} m more",
        )
