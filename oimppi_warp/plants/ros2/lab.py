"""A laboratory simulated in real time on ROS 2 topics."""

from __future__ import annotations

import math
import threading
import time
from contextlib import suppress
from typing import Any

import numpy as np

from oimppi_warp.config import ros2_topics
from oimppi_warp.config.lab import LabConfig
from oimppi_warp.errors import ConfigError
from oimppi_warp.observation import Observation
from oimppi_warp.plants.realtime_lab import CYCLE, RealTimeLab
from oimppi_warp.plants.ros2.arm import SIMULATED, WATCHDOG
from oimppi_warp.plants.ros2.link import Link
from oimppi_warp.plants.ros2.messages import (
    CLOCK,
    JOINT_JOG,
    JOINT_STATE,
    NUMBERS,
    TRAJECTORY,
    header,
    seconds,
    time_fields,
)
from oimppi_warp.plants.ros2.poses import pose_publisher
from oimppi_warp.scene import PlanarPose, Scene

ACCELERATION = 10.0
"""Largest acceleration of a joint [rad/s^2]."""
_STATES = 2
"""Cycles per joint state: 125 of them a second."""
_HOLD = 0.07
"""Time by which the watchdog is early, so that the arm is at rest when it should be [s]."""


class Ros2Lab(RealTimeLab):
    """A simulated laboratory that publishes joint states, clock and the object's pose, and takes joint velocities.

    Commands of all three types are taken, each on a topic of its own. A watchdog stops the arm :data:`WATCHDOG` after
    the last command; trajectories are followed to their end instead.

    Args:
        scene, lab, start, joints, seed: See :class:`oimppi_warp.plants.realtime_lab.RealTimeLab`.
        link: The connection; the lab ends it.
        joint_names: Names of the joints; ``None``: those in the scene.
        commands: Topic of the commands as ``std_msgs/msg/Float64MultiArray``; those of the other types are below it.

    Attributes:
        taken: Number of commands taken so far.
        refused: Number of commands that were not finite, or of other joints.
        expired: Number of times that the watchdog stopped a moving arm.
        watchdog: Time after the last command after which the watchdog stops the arm [s].
        frozen: Whether joint states are no longer published, as a fault.
        stamp_error: Offset of the joint states' stamps [s], as a fault.
    """

    def __init__(
        self,
        scene: Scene,
        lab: LabConfig,
        link: Link,
        *,
        start: PlanarPose | None = None,
        joints: np.ndarray | None = None,
        seed: int = 0,
        joint_names: list[str] | None = None,
        commands: str = ros2_topics.NOMINAL_COMMANDS,
    ) -> None:
        super().__init__(scene, lab, start=start, joints=joints, seed=seed)
        dof = scene.robot.dof
        self.names = joint_names or [joint.name for joint in scene.robot.joints]
        self.taken = self.refused = self.expired = 0
        self.watchdog = WATCHDOG - _HOLD
        self.frozen, self.stamp_error = False, 0.0
        self._link, self._cycles = link, 0
        self._command_lock = threading.Lock()
        self._wanted, self._driven, self._heard = np.zeros(dof), np.zeros(dof), -math.inf
        self._way: list[tuple[float, np.ndarray]] = []  # ends of the parts of a trajectory [s], and their velocities
        self._states = link.advertise(ros2_topics.JOINT_STATES, JOINT_STATE)
        self._see = pose_publisher(link, scene.object.rest_height)
        self._clock = link.advertise(ros2_topics.CLOCK, CLOCK, reliable=False)
        link.subscribe(commands, NUMBERS, lambda message: self._take(message.data))
        with suppress(ConfigError):  # of messages that a ROS installation may lack
            link.subscribe(f"{commands}/joint_trajectory", TRAJECTORY, self._take_trajectory)
            link.subscribe(f"{commands}/joint_jog", JOINT_JOG, self._take_jog)

    def drive(self) -> np.ndarray:
        """Returns the joint velocities of the next cycle: as commanded, with limited acceleration, [dof] [rad/s]."""
        with self._command_lock:
            now = time.monotonic()
            while self._way and now > self._way[0][0]:
                self._way.pop(0)
                self._wanted = self._way[0][1] if self._way else np.zeros_like(self._wanted)
            if not self._way and now > self._heard + self.watchdog:
                self.expired += bool(np.any(self._wanted))
                self._wanted = np.zeros_like(self._wanted)
            wanted = self._wanted
        most = ACCELERATION * CYCLE
        self._driven = self._driven + np.clip(wanted - self._driven, -most, most)
        return self._driven

    def sense(self, state: Observation) -> None:
        """Publishes joint state and clock."""
        self._cycles += 1
        if self._cycles % _STATES or self.frozen:
            return
        now = time.time()
        self._clock({"clock": time_fields(now)})
        self._states(
            {
                "header": header(now + self.stamp_error, SIMULATED),
                "name": self.names,
                "position": state.joint_position.tolist(),
                "velocity": state.joint_velocity.tolist(),
            }
        )

    def see(self, pose: np.ndarray, stamp: float) -> None:
        """Publishes a detection, on a topic and as a frame."""
        self._see(pose, stamp)

    def disconnect(self) -> None:
        """Ends the connection."""
        self._link.close()

    def _take(self, velocities: Any) -> None:
        """Takes joint velocities in the order of the joints."""
        wanted = np.array(velocities, dtype=float)
        with self._command_lock:
            if wanted.shape != self._wanted.shape or not np.isfinite(wanted).all():
                self.refused += 1
                return
            self.taken += 1
            self._wanted, self._heard, self._way = wanted, time.monotonic(), []

    def _take_jog(self, message: Any) -> None:
        self._take(self._sorted(message.joint_names, message.velocities))

    def _take_trajectory(self, message: Any) -> None:
        """Takes a trajectory: straight from here to each of its points."""
        here, began, way = self.state()[0], time.monotonic(), []
        at = 0.0
        for point in message.points:
            target, then = np.array(self._sorted(message.joint_names, point.positions)), seconds(point.time_from_start)
            if len(target) != len(here) or then <= at:
                self._take([])
                return
            way.append((began + then, (target - here) / (then - at)))
            here, at = target, then
        self._take(way[0][1] if way else [])
        with self._command_lock:
            self._way = way

    def _sorted(self, names: list[str], values: list[float]) -> list[float]:
        """Returns values in the order of the joints; none if they are of other joints."""
        if sorted(names) != sorted(self.names) or len(values) != len(names):
            return []
        return [values[names.index(name)] for name in self.names]
