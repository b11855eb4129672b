"""Observations, which a plant sends to a planner, and functions that check them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from oimppi_warp.errors import ObservationError
from oimppi_warp.scene import PlanarPose, Robot

FARTHEST_OBJECT = 10.0
"""Distance from the world's origin beyond which an object's pose is considered a perception error [m]."""
BEYOND_LIMITS = 0.5
"""Distance outside the limits of a joint beyond which its reported position is considered a sensor error [rad; m]."""


@dataclass(frozen=True, eq=False)
class Observation:
    """The state of a plant as reported at one instant, in the world frame.

    Attributes:
        time: Time since the start of the episode [s].
        joint_position: Joint positions, shape [dof] [rad; m for a prismatic joint].
        joint_velocity: Joint velocities, shape [dof] [rad/s; m/s for a prismatic joint].
        object_pose: Planar pose of the object's frame as last detected: (x [m], y [m], yaw [rad]), shape [3]; NaN
            before the first detection.
        object_transform: The same pose in space: position [m] and quaternion xyzw, shape [7]; NaN before the first
            detection.
        object_time: Time at which the object had this pose [s]; NaN before the first detection. ``None`` if the plant
            always knows the pose; the pose is then that at ``time``.
        trail: Joint reports from that of the previous observation to the latest one: time [s] and joint positions
            [rad; m for a prismatic joint], shape [n, 1 + dof]; empty if the plant reports only once per control period.
    """

    time: float
    joint_position: np.ndarray
    joint_velocity: np.ndarray
    object_pose: np.ndarray
    object_transform: np.ndarray
    object_time: float | None = None
    trail: np.ndarray = field(default_factory=lambda: np.zeros((0, 1)))


def planar_transform(pose: PlanarPose, height: float) -> np.ndarray:
    """Returns the transform (position [m], quaternion xyzw) of an upright body at a planar pose, shape [7].

    Args:
        pose: (x [m], y [m], yaw [rad]).
        height: z of the body's frame [m].
    """
    x, y, yaw = pose
    return np.array([x, y, height, 0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)])


def planar_pose(transform: np.ndarray) -> np.ndarray:
    """Projects a transform to the table.

    Args:
        transform: Position [m] and quaternion xyzw, shape [7].

    Returns:
        (x [m], y [m], yaw [rad]) with the yaw from -pi to pi, shape [3].
    """
    x, y, _, qx, qy, qz, qw = transform
    return np.array([x, y, np.arctan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))])


def check_shapes(observation: Observation, dof: int) -> None:
    """Checks the shapes of an observation's arrays.

    Args:
        observation: The observation.
        dof: Number of the robot's joints.

    Raises:
        ObservationError: An array has the wrong shape; the message names the array.
    """
    for name, length in (
        ("joint_position", dof),
        ("joint_velocity", dof),
        ("object_pose", 3),
        ("object_transform", 7),
    ):
        shape = np.shape(getattr(observation, name))
        if shape != (length,):
            robot = " for this robot" if name.startswith("joint") else ""
            raise ObservationError(f"observation.{name} has shape {shape}\n  allowed: ({length},){robot}")
    shape = np.shape(observation.trail)
    if len(shape) != 2 or (shape[0] > 0 and shape[1] != 1 + dof):
        raise ObservationError(
            f"observation.trail has shape {shape}\n  allowed: (n, {1 + dof}): time and joint positions for this robot"
        )


def implausible(observation: Observation, robot: Robot) -> str:
    """Returns the reason why an observation is implausible; empty if it is plausible.

    An observation is implausible, and nothing is planned from it, if a number is not finite, the object is farther than
    :data:`FARTHEST_OBJECT` from the origin, or a joint is more than :data:`BEYOND_LIMITS` outside its limits.

    Args:
        observation: An observation whose shapes are correct; see :func:`check_shapes`.
        robot: The robot, for its joint limits.
    """
    values = {
        "the joint positions": observation.joint_position,
        "the joint velocities": observation.joint_velocity,
        "the object's pose": observation.object_pose,
        "the object's transform": observation.object_transform,
    }
    for name, value in values.items():
        if not all(map(math.isfinite, np.asarray(value, dtype=float).tolist())):
            return f"non-finite values in {name}: {np.round(np.asarray(value, dtype=float), 4).tolist()}"
    distance = max(math.hypot(*observation.object_pose[:2]), math.hypot(*observation.object_transform[:3]))
    if distance > FARTHEST_OBJECT:
        return f"the object is reported {distance:.4g} m from the origin (more than {FARTHEST_OBJECT:g} m)"
    beyond = beyond_limits(robot, observation.joint_position)
    number = int(np.argmax(beyond))
    if beyond[number] > BEYOND_LIMITS:
        unit = "rad" if robot.joints[number].kind == "revolute" else "m"
        return f"joint {number + 1} is reported {beyond[number]:.4g} {unit} beyond its limits"
    return ""


def beyond_limits(robot: Robot, joint_position: np.ndarray) -> np.ndarray:
    """Returns how far joint positions are outside the joints' limits, negative inside, shape [..., dof] [rad; m].

    Args:
        robot: The robot.
        joint_position: Joint positions, shape [..., dof] [rad; m].
    """
    lower, upper = _limits(robot)
    return np.maximum(lower - joint_position, joint_position - upper)


@lru_cache(maxsize=8)
def _limits(robot: Robot) -> np.ndarray:
    """Returns lower and upper limits of all joints, shape [2, dof] [rad; m]."""
    return np.array([(joint.lower, joint.upper) for joint in robot.joints]).T
