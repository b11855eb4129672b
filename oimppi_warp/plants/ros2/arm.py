"""An arm on ROS 2: its joint states, its commands, and what is wrong with them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from oimppi_warp.errors import HardwareError
from oimppi_warp.plants.real.arm import Check, JointReports, check_limits
from oimppi_warp.plants.ros2.link import Link, Qos, why_no_messages, why_nobody_listens
from oimppi_warp.plants.ros2.messages import JOINT_STATE, seconds
from oimppi_warp.plants.ros2.outlet import make_outlet
from oimppi_warp.scene import Robot

WATCHDOG = 0.25
"""Time within which what receives the commands should stop the arm when they cease [s]."""
OLDEST_STAMP, NEWEST_STAMP = 0.25, -0.25
"""Largest and least age of a joint state by its stamp [s]."""
_REST = 0.25
"""Time for which zeros are published after a stop [s]."""
_LEAST_RATE = 20.0
"""Least rate of the joint states [1/s]."""
_MEASURED = 0.5
"""Time over which their rate is measured [s]."""
_FIRST = 5.0
"""Time to wait for the first joint state, and for somebody who listens [s]."""
_LAST = 0.05
"""Time that the last message has to arrive [s]."""
_POLLS = 10
"""Ticks between two looks at who is on the topics."""


class Ros2Arm:
    """An arm that publishes joint states and takes joint velocities (:class:`oimppi_warp.plants.real.arm.Arm`).

    Args:
        link: The connection; the arm ends it.
        joint_names: Names of the joints, in the scene's order.
        states: Topic of the joint states.
        commands: Topic of the commands.
        command_type: Type of their messages.
        simulated: Returns whether the arm is surely simulated.
        clock: Returns the time of the stamps, since 1970 [s].

    Attributes:
        address: The topics, for messages.
        place: Domain and topic of the commands.
        simulated: Whether it is surely no real arm.
        reports: The joint states, in the scene's order.
        report_rate: Their rate, as it was measured [1/s].
        expires: :data:`WATCHDOG`.

    Raises:
        ConfigError: The type of the commands is not known.
        HardwareError: No joint states arrive, or they are of other joints.
    """

    expires = WATCHDOG

    def __init__(
        self,
        link: Link,
        joint_names: list[str],
        *,
        states: str,
        commands: str,
        command_type: str,
        simulated: Callable[[], bool] = lambda: False,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._link, self._names, self._states, self._topic, self._kind = (
            link,
            joint_names,
            states,
            commands,
            command_type,
        )
        self._clock = clock
        self._defect = ""
        self._others_seen: set[str] = set()
        self._stopped = -math.inf
        self.reports = JointReports()
        self._outlet = make_outlet(link, commands, command_type, joint_names)
        link.subscribe(states, JOINT_STATE, self._take)
        self.address = f"{link.name}, {states}"
        self.place = f"{link.name}, {commands}"
        until = time.monotonic() + _FIRST
        while self.reports.count < 2 and not self._defect and time.monotonic() < until:
            time.sleep(0.01)
        if self._defect:
            raise HardwareError(self._defect)
        if self.reports.count < 2 and self._others_seen:
            found = sorted(self._others_seen)
            raise HardwareError(
                f"{states} has the joints {', '.join(found)}, not {', '.join(joint_names)}\n"
                f"  to do:   --plant-options joint_names={','.join(found[: len(joint_names)])}"
            )
        if self.reports.count < 2:
            raise HardwareError(why_no_messages(link, states, JOINT_STATE))
        before, began = self.reports.count, time.monotonic()
        time.sleep(_MEASURED)
        self.report_rate = (self.reports.count - before) / (time.monotonic() - began)
        self.simulated = simulated()

    def check(self, robot: Robot) -> list[Check]:
        """Compares what is on the topics with the arm of a scene."""
        silent = self._wait_for_listener()
        return [
            Check(f"joint states of {', '.join(self._names)}", True),
            check_limits(self.reports.latest()[1], robot),
            Check(
                f"joint states at {self.report_rate:.0f} Hz",
                self.report_rate >= 0.9 * 100.0,
                "publish them at 100 Hz or more, so that the planner knows where the arm is",
                needed=self.report_rate < _LEAST_RATE,
            ),
            self._others_check(),
            Check(
                silent.partition("\n")[0] if silent else f"somebody listens to {self._topic}",
                not silent,
                silent.partition("to do:   ")[2],
            ),
            Check(
                "the simulated arm has a watchdog"
                if self.simulated
                else f"if this planner dies, only what receives {self._topic} can stop the arm",
                self.simulated,
                f"make sure that it does, {WATCHDOG:g} s after the last command: velocity controllers of "
                "ros2_controllers keep the last velocity for ever (docs/ros2.md)",
                needed=False,
            ),
        ]

    def enable(self) -> None:
        """Checks that somebody takes commands, and from nobody else.

        Raises:
            HardwareError: Nobody does, or somebody else sends commands.
        """
        for problem in (self._wait_for_listener(), self._others()):
            if problem:
                raise HardwareError(problem)
        self._defect, self._stopped = "", -math.inf

    def send(self, joint_velocity: np.ndarray) -> str:
        """Publishes joint velocities, shape [dof] [rad/s]; nobody refuses them."""
        self._outlet.send(joint_velocity, self.reports.latest()[1])
        return ""

    def rest(self) -> None:
        """Publishes zeros, for a while after a stop, and as long as nothing else is to be sent."""
        if time.monotonic() < self._stopped + _REST or self._stopped == -math.inf:
            self.send(np.zeros(len(self._names)))

    def stop(self) -> None:
        """Publishes zeros, which :meth:`rest` repeats for a while."""
        self._stopped = time.monotonic()
        try:
            self.send(np.zeros(len(self._names)))
        except Exception:  # whatever fails here, the receiver's watchdog has to stop the arm
            return

    def lost(self) -> str:
        """Returns nothing: the age of the joint states tells."""
        return ""

    def fault(self, tick: int, *, moving: bool) -> str:
        """Returns why the arm must not move: joint states that cannot be used, or others that command the arm."""
        if self._defect:
            return self._defect
        if moving and tick % _POLLS == 0:
            return self._others() or why_nobody_listens(self._link, self._topic, self._kind, Qos())
        return ""

    def disconnect(self) -> None:
        """Ends the connection, once the last message has had time to arrive."""
        time.sleep(_LAST)
        self._link.close()

    def _take(self, message: Any) -> None:
        """Takes a joint state: positions by name, in any order."""
        if not set(self._names) <= set(message.name) or len(message.position) != len(message.name):
            self._others_seen.update(message.name)  # such as those of a gripper
            return
        joints = np.array([message.position[message.name.index(name)] for name in self._names], dtype=float)
        if not np.isfinite(joints).all():
            self._defect = (
                f"{self._states} has joint positions that are not finite\n  to do:   restart what publishes it"
            )
            return
        stamp = seconds(message.header.stamp)
        age = self._clock() - stamp if stamp else 0.0
        if not NEWEST_STAMP <= age <= OLDEST_STAMP:
            when = f"{age:.2f} s old" if age > 0 else f"{-age:.2f} s in the future"
            self._defect = (
                f"the joint states of {self._states} are {when} by their stamps\n"
                "  to do:   synchronise the clocks of arm and planner (NTP), or set use_sim_time"
            )
            return
        self.reports.take(joints)

    def _others(self) -> str:
        """Returns a fault if somebody else publishes commands."""
        others = sum(end.publishes and not end.own for end in self._link.endpoints(self._topic))
        if not others:
            return ""
        who = "another program publishes" if others == 1 else f"{others} other programs publish"
        return f"{who} {self._topic} too\n  to do:   end what else commands the arm"

    def _others_check(self) -> Check:
        others = self._others()
        what, _, remedy = others.partition("\n  to do:   ")
        return Check(what or f"nobody else publishes {self._topic}", not others, remedy)

    def _wait_for_listener(self) -> str:
        """Waits until somebody listens to the commands; returns in words why nobody does."""
        until = time.monotonic() + _FIRST
        while True:
            problem = why_nobody_listens(self._link, self._topic, self._kind, Qos())
            if not problem or time.monotonic() > until:
                return problem
            time.sleep(0.02)
