"""What a plant tells a planner, all that the two share besides joint velocities."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from oimppi_warp.scene import PlanarPose


@dataclass(frozen=True, eq=False)
class Observation:
    """What a plant knows of itself at one instant.

    Attributes:
        time: Since the start of the episode [s].
        joint_position: Shape [dof] [rad].
        joint_velocity: Shape [dof] [rad/s].
        object_pose: The object from above, as it was last seen: (x [m], y [m], yaw [rad]), shape [3]; NaN before.
        object_transform: The object's pose (position, quaternion xyzw), shape [7].
        object_time: When the object was seen so [s]; ``None`` where it always is, at ``time``. NaN before it was.
        trail: Time [s] and joint positions [rad] since the observation before, that one's included, shape [n, 1 + dof];
            empty where a plant reports no more than once in a control period.
    """

    time: float
    joint_position: np.ndarray
    joint_velocity: np.ndarray
    object_pose: np.ndarray
    object_transform: np.ndarray
    object_time: float | None = None
    trail: np.ndarray = field(default_factory=lambda: np.zeros((0, 1)))


def planar_transform(pose: PlanarPose, height: float) -> np.ndarray:
    """A planar pose as a transform (position, quaternion xyzw), shape [7].

    Args:
        pose: (x, y, yaw).
        height: z [m].
    """
    x, y, yaw = pose
    return np.array([x, y, height, 0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)])


def planar_pose(transform: np.ndarray) -> np.ndarray:
    """A transform (position, quaternion xyzw) seen from above: (x, y, yaw), yaw within (-pi, pi], shape [3]."""
    x, y, _, qx, qy, qz, qw = transform
    return np.array([x, y, np.arctan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))])
