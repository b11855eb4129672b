"""The topic on which joint velocities are commanded, in the forms that controllers take."""

from __future__ import annotations

import time
from typing import Any, Protocol

import numpy as np

from oimppi_warp.errors import ConfigError
from oimppi_warp.plants.ros2.link import Link
from oimppi_warp.plants.ros2.messages import JOINT_JOG, NUMBERS, TRAJECTORY, header, time_fields

_AHEAD, _BRAKE = 0.1, 0.2
"""Time for which a trajectory goes on with its velocity, and then to brake [s]."""
_ASTRAY = 0.05
"""Distance of the joints from where trajectories have led them, from which on these begin at the joints again [rad]."""


class Outlet(Protocol):
    """Publishes joint velocities.

    Attributes:
        kind: Type of the messages.
    """

    kind: str

    def send(self, joint_velocity: np.ndarray, joints: np.ndarray) -> None:
        """Publishes joint velocities.

        Args:
            joint_velocity: Joint velocities, shape [dof] [rad/s].
            joints: Joint positions, shape [dof] [rad].
        """
        ...


class NumbersOutlet:
    """Joint velocities as a list of numbers, as ros2_controllers' velocity controllers take them."""

    kind = NUMBERS

    def __init__(self, link: Link, topic: str, joint_names: list[str]) -> None:
        self._publish = link.advertise(topic, self.kind)

    def send(self, joint_velocity: np.ndarray, joints: np.ndarray) -> None:
        """Publishes joint velocities; see :class:`Outlet`."""
        self._publish({"data": joint_velocity.tolist()})


class JointJogOutlet:
    """Joint velocities with names, as MoveIt Servo takes them."""

    kind = JOINT_JOG

    def __init__(self, link: Link, topic: str, joint_names: list[str]) -> None:
        self._publish, self._names = link.advertise(topic, self.kind), joint_names

    def send(self, joint_velocity: np.ndarray, joints: np.ndarray) -> None:
        """Publishes joint velocities; see :class:`Outlet`."""
        values = {"joint_names": self._names, "velocities": joint_velocity.tolist()}
        self._publish({"header": header(time.time(), ""), **values})


class TrajectoryOutlet:
    """A short trajectory that goes on with the velocity and then brakes, as joint trajectory controllers take it.

    If no other follows, the arm comes to rest at its end.
    """

    kind = TRAJECTORY

    def __init__(self, link: Link, topic: str, joint_names: list[str]) -> None:
        self._publish, self._names = link.advertise(topic, self.kind), joint_names
        self._reference: np.ndarray | None = None
        self._sent = 0.0

    def send(self, joint_velocity: np.ndarray, joints: np.ndarray) -> None:
        """Publishes joint velocities; see :class:`Outlet`."""
        now = time.monotonic()
        if self._reference is None or np.abs(self._reference - joints).max() > _ASTRAY:
            self._reference, self._sent = joints.copy(), now
        here = self._reference
        self._reference = here + min(now - self._sent, _AHEAD) * joint_velocity
        self._sent = now
        ahead = self._reference + _AHEAD * joint_velocity
        points = [
            {"positions": ahead, "velocities": joint_velocity, "time_from_start": _AHEAD},
            {
                "positions": ahead + 0.5 * _BRAKE * joint_velocity,
                "velocities": np.zeros_like(joint_velocity),
                "time_from_start": _AHEAD + _BRAKE,
            },
        ]
        # A stamp of zero means: from now on.
        self._publish({"joint_names": self._names, "points": [_point(**each) for each in points]})


OUTLETS: dict[str, type[NumbersOutlet | JointJogOutlet | TrajectoryOutlet]] = {
    outlet.kind: outlet for outlet in (NumbersOutlet, JointJogOutlet, TrajectoryOutlet)
}
"""Outlets by the type of their messages."""


def make_outlet(link: Link, topic: str, kind: str, joint_names: list[str]) -> Outlet:
    """Makes the outlet of a type of messages.

    Args:
        link: The connection.
        topic: Name of the topic.
        kind: Type of the messages.
        joint_names: Names of the joints, in the scene's order.

    Raises:
        ConfigError: There is no such outlet.
    """
    if kind not in OUTLETS:
        raise ConfigError(f"command_type {kind} cannot be published\n  allowed: {', '.join(OUTLETS)}")
    return OUTLETS[kind](link, topic, joint_names)


def _point(*, positions: np.ndarray, velocities: np.ndarray, time_from_start: float) -> dict[str, Any]:
    return {
        "positions": positions.tolist(),
        "velocities": velocities.tolist(),
        "time_from_start": time_fields(time_from_start),
    }
