"""Finds a start pose for an arm: its tool upright, the tip slightly above the table in front of it."""

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
"""Range of tip heights allowed for a robot that cannot move its tool vertically [m]."""
ROOM = 0.02
"""Clearance that every link must have to the table [m]."""
_DISTANCES = (0.36, 0.45, 0.30, 0.55, 0.25, 0.65, 0.80, 1.0)
"""Distances from the base at which a tip position is tried, in this order [m]."""
_AZIMUTH = -0.588
"""Direction in which it is tried: slightly to one side, as in the shipped tasks [rad]."""
_TRIES = 60
_SPARE = 0.03
"""Margin that every joint must have to its limits, as a share of its whole range."""


def with_start(arm: Arm, *, file: object = "") -> Arm:
    """Returns the arm with a start pose, its joint positions rounded for readability.

    Args:
        arm: The arm, at any joint positions.
        file: Path of the robot's source file, for the error message.

    Raises:
        SceneError: No start pose was found.
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
        "no joint positions were found that hold the tool upright above the table in front of the arm",
        file=file,
        allowed=f"a tip {HEIGHT:g} m above z = 0, {min(_DISTANCES):g} to {max(_DISTANCES):g} m from the base",
        fix="check --flange and --tool-axis, and that z points up and is zero at the table's top",
    )


def _limits(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Returns lower and upper limits, at most half a turn either way for joints that go further, shape [dof] each."""
    lower, upper = (np.array([getattr(joint, end) for joint in robot.joints]) for end in ("lower", "upper"))
    revolute = revolute_joints(robot)
    return np.where(revolute, np.maximum(lower, -np.pi), lower), np.where(revolute, np.minimum(upper, np.pi), upper)


def _guesses(robot: Robot, random: np.random.Generator) -> list[np.ndarray]:
    """Returns initial guesses of joint positions: the first joint turned towards the tip, some of the others bent."""
    lower, upper = _limits(robot)
    middle, guesses = (lower + upper) / 2, []
    for _ in range(_TRIES):
        bent = np.where(random.random(robot.dof) < 0.6, random.uniform(lower, upper), middle)
        bent[0] = np.clip(_AZIMUTH, lower[0], upper[0]) if revolute_joints(robot)[0] else middle[0]
        guesses.append(bent)
    return [middle, *guesses]


def _score(robot: Robot, joints: np.ndarray) -> float:
    """Rates a start by table clearance, margin to the limits and lack of twists; not above 0 if it is unusable."""
    lower, upper = _limits(robot)
    room = table_clearance(robot, joints)
    spare = float(np.min(np.minimum(joints - lower, upper - joints) / (upper - lower)))
    if (room < ROOM and not is_flat(robot)) or spare < _SPARE:
        return -np.inf
    twisted = float(np.linalg.norm((joints - (lower + upper) / 2) * revolute_joints(robot)))
    return 1.0 + min(room, 0.1) + 0.2 * min(spare, 0.2) - 0.02 * twisted


def _rounded(robot: Robot, joints: np.ndarray) -> np.ndarray:
    """Returns the joint positions without whole turns, where the limits allow, rounded to a few digits."""
    wrapped = np.mod(joints + np.pi, 2.0 * np.pi) - np.pi
    lower, upper = (np.array([getattr(joint, end) for joint in robot.joints]) for end in ("lower", "upper"))
    allowed = revolute_joints(robot) & (lower <= wrapped) & (wrapped <= upper)
    return np.clip(np.round(np.where(allowed, wrapped, joints), 4) + 0.0, lower, upper)


def is_flat(robot: Robot) -> bool:
    """Returns whether the tool moves only horizontally.

    That is the case if every revolute axis is vertical and every prismatic axis is horizontal.
    """
    rotations = link_frames(robot, np.zeros(robot.dof))[0]
    upright = np.abs(rotations[:, 2, 2])
    return bool(np.where(revolute_joints(robot), upright > 1.0 - 1e-6, upright < 1e-6).all())


def table_clearance(robot: Robot, joints: np.ndarray) -> float:
    """Returns the height of the lowest point of the moving links, excluding the stick [m]."""
    rotations, positions = link_frames(robot, joints)
    lowest = [1.0]
    for link, rotation, position in zip(robot.links, rotations, positions, strict=True):
        for collider in link.colliders:
            balls = collider_spheres(collider)
            lowest.append(float((position[2] + balls[:, :3] @ rotation[2] - balls[:, 3]).min()))
    return min(lowest)


def _check_height(robot: Robot, joints: np.ndarray, height: float, file: object) -> None:
    """Raises SceneError if a robot without vertical motion has a tilted tool, or one at a wrong height for pushing."""
    if tip_frame(robot, joints)[0][2, 2] > -1.0 + 1e-6:
        raise SceneError(
            "the stick does not point down",
            file=file,
            allowed="a stick that points down",
            fix="choose another axis of the flange with --tool-axis",
        )
    low, high = PUSHING
    if not low <= height <= high:
        raise SceneError(
            f"the robot cannot raise or lower its tool, and the tip is at {height:.3f} m",
            file=file,
            allowed=f"{low:g} to {high:g} m above the table",
            fix=f"{'increase' if height > high else 'decrease'} --tool-length by {abs(height - 0.012):.3f} m",
        )
