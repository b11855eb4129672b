"""The topic on which joint velocities are commanded, in the forms that controllers take."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from oimppi_warp.errors import ConfigError
from oimppi_warp.plants.ros2.link import Link
from oimppi_warp.plants.ros2.messages import JOINT_JOG, NUMBERS, TRAJECTORY, header, time_fields

_AHEAD, _BRAKE = 0.1, 0.1
"""Time for which a trajectory goes on with its velocity, and then to brake [s]."""


class Outlet(Protocol):
    """Publishes joint velocities.

    Attributes:
        kind: Type of the messages.
    """

    kind: str

    def send(self, joint_velocity: np.ndarray) -> None:
        """Publishes joint velocities, shape [dof] [rad/s]."""
        ...


class NumbersOutlet:
    """Joint velocities as a list of numbers, as ros2_controllers' velocity controllers take them."""

    kind = NUMBERS

    def __init__(self, link: Link, way: Way) -> None:
        self._publish = link.advertise(way.topic, self.kind)

    def send(self, joint_velocity: np.ndarray) -> None:
        """Publishes joint velocities, shape [dof] [rad/s]."""
        self._publish({"data": joint_velocity.tolist()})


class JointJogOutlet:
    """Joint velocities with names, as MoveIt Servo takes them."""

    kind = JOINT_JOG

    def __init__(self, link: Link, way: Way) -> None:
        self._publish, self._way = link.advertise(way.topic, self.kind), way

    def send(self, joint_velocity: np.ndarray) -> None:
        """Publishes joint velocities, shape [dof] [rad/s]."""
        values = {"joint_names": self._way.joint_names, "velocities": joint_velocity.tolist()}
        self._publish({"header": header(self._way.clock(), ""), **values})


class TrajectoryOutlet:
    """A short trajectory that goes on with the velocity and then brakes, as joint trajectory controllers take it.

    It leads on from where the trajectories before have led, beginning at the joints' positions at first. If no other
    follows, the arm comes to rest at its end.
    """

    kind = TRAJECTORY

    def __init__(self, link: Link, way: Way) -> None:
        self._publish, self._names = link.advertise(way.topic, self.kind), way.joint_names
        self._reference, self._sent = way.joints.copy(), time.monotonic()

    def send(self, joint_velocity: np.ndarray) -> None:
        """Publishes joint velocities, shape [dof] [rad/s]."""
        now = time.monotonic()
        self._reference = self._reference + min(now - self._sent, _AHEAD) * joint_velocity
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


@dataclass(frozen=True, eq=False)
class Way:
    """Topic, joints and clock of an outlet.

    Attributes:
        topic: Name of the topic.
        joint_names: Names of the joints, in the scene's order.
        joints: Positions of the joints now, shape [dof] [rad].
        clock: Returns the time of the stamps, since 1970 [s].
    """

    topic: str
    joint_names: list[str]
    joints: np.ndarray
    clock: Callable[[], float]


OUTLETS: dict[str, type[NumbersOutlet | JointJogOutlet | TrajectoryOutlet]] = {
    outlet.kind: outlet for outlet in (NumbersOutlet, JointJogOutlet, TrajectoryOutlet)
}
"""Outlets by the type of their messages."""


def outlet_class(kind: str) -> type[NumbersOutlet | JointJogOutlet | TrajectoryOutlet]:
    """Returns the outlet for a type of messages.

    Raises:
        ConfigError: There is none.
    """
    if kind not in OUTLETS:
        raise ConfigError(f"command_type {kind} cannot be published\n  allowed: {', '.join(OUTLETS)}")
    return OUTLETS[kind]


def _point(*, positions: np.ndarray, velocities: np.ndarray, time_from_start: float) -> dict[str, Any]:
    return {
        "positions": positions.tolist(),
        "velocities": velocities.tolist(),
        "time_from_start": time_fields(time_from_start),
    }
