"""An arm on ROS 2: its joint states, its commands, and what is wrong with them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from oimppi_warp.errors import HardwareError
from oimppi_warp.plants.real.arm import Check, JointReports, check_limits
from oimppi_warp.plants.ros2.link import Link, Qos, why_no_messages, why_nobody_listens
from oimppi_warp.plants.ros2.messages import JOINT_STATE, seconds
from oimppi_warp.plants.ros2.outlet import Outlet, Way, outlet_class
from oimppi_warp.scene import Robot

WATCHDOG = 0.25
"""Time within which what receives the commands should stop the arm when they cease [s]."""
SIMULATED = "oimppi_simulation"
"""Frame of joint states that come from our own simulated lab."""
_OLDEST, _NEWEST = 0.2, -0.05
"""Largest and least age of a joint state by its stamp, when it arrives [s]."""
_FASTEST, _JUMP = 3.5, 0.05
"""Speed of any joint [rad/s], and amount beyond it by which joint states that follow each other may differ [rad]."""
_STICKY = 0.5
"""Time for which a defect of a joint state counts [s]."""
_REST = 0.25
"""Time for which zeros are published after a stop [s]."""
_LEAST_RATE = 20.0
"""Least rate of the joint states [1/s]."""
_MEASURED = 0.5
"""Time over which their rate is measured [s]."""
_FIRST = 5.0
"""Time to wait for the first joint state, and for somebody who listens [s]."""
_INTERVAL = 0.01
"""Interval of the zeros at the end [s]."""
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
        clock: Returns the time of the stamps, since 1970 [s].

    Attributes:
        address: The topics, for messages.
        place: Domain and topic of the commands.
        simulated: Whether the joint states are those of our own simulated lab.
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
        self._defect, self._defect_until = "", -math.inf
        self._others_seen: set[str] = set()
        self._stopped = -math.inf
        self._outlet: Outlet | None = None
        outlet_class(command_type)
        self.reports, self.simulated = JointReports(), False
        link.subscribe(states, JOINT_STATE, self._take)
        self.address = f"{link.name}, {states}"
        self.place = f"{link.name}, {commands}"
        until = time.monotonic() + _FIRST
        while self.reports.count < 2 and time.monotonic() < until:
            time.sleep(0.01)
        if self.reports.count < 2 and self._defect:
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
            self._states_check(),
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
        for problem in (self._others(), self._wait_for_listener(), self._present_defect()):
            if problem:
                raise HardwareError(problem)
        way = Way(self._topic, self._names, self.reports.latest()[1], self._clock)
        self._outlet, self._stopped = outlet_class(self._kind)(self._link, way), -math.inf

    def send(self, joint_velocity: np.ndarray) -> str:
        """Publishes joint velocities, shape [dof] [rad/s]; nobody refuses them."""
        if self._outlet is not None:
            self._outlet.send(joint_velocity)
        return ""

    def rest(self) -> bool:
        """Publishes zeros: for a while after a stop, otherwise as long as nothing else is to be sent."""
        over = self._stopped > -math.inf and time.monotonic() > self._stopped + _REST
        if self._outlet is None or over:
            return False
        self.send(np.zeros(len(self._names)))
        return True

    def stop(self) -> None:
        """Publishes zeros, which :meth:`rest` repeats for a while."""
        self._stopped = time.monotonic()
        with suppress(Exception):  # whatever fails here, the receiver's watchdog has to stop the arm
            self.send(np.zeros(len(self._names)))

    def lost(self) -> str:
        """Returns nothing: the age of the joint states tells."""
        return ""

    def fault(self, tick: int, *, moving: bool) -> str:
        """Returns why the arm must not move: joint states that cannot be used, or others that command the arm."""
        if defect := self._present_defect():
            return defect
        if moving and tick % _POLLS == 0:
            return self._others() or why_nobody_listens(self._link, self._topic, self._kind, Qos())
        return ""

    def disconnect(self) -> None:
        """Publishes zeros for a while if the arm was enabled, since one could be lost, and ends the connection."""
        with suppress(Exception):
            while self._stopped > -math.inf and self.rest():
                time.sleep(_INTERVAL)
        self._link.close()

    def _take(self, message: Any) -> None:
        """Takes a joint state: positions by name, in any order."""
        if not set(self._names) <= set(message.name) or len(message.position) != len(message.name):
            self._others_seen.update(message.name)  # such as those of a gripper
            return
        joints = np.array([message.position[message.name.index(name)] for name in self._names], dtype=float)
        stamp = seconds(message.header.stamp)
        age = self._clock() - stamp if stamp else 0.0
        problem = self._problem(joints, age)
        if problem:
            self._defect, self._defect_until = problem, time.monotonic() + _STICKY
            return
        self.simulated = message.header.frame_id == SIMULATED
        self.reports.take(joints, age=max(age, 0.0))

    def _problem(self, joints: np.ndarray, age: float) -> str:
        """Returns in words why a joint state cannot be used; empty if it can."""
        if not np.isfinite(joints).all():
            return f"{self._states} has joint positions that are not finite\n  to do:   restart what publishes them"
        if not _NEWEST <= age <= _OLDEST:
            when = f"{age:.2f} s old" if age > 0 else f"{-age:.2f} s in the future"
            return (
                f"the joint states of {self._states} are {when} by their stamps\n"
                "  to do:   synchronise the clocks of arm and planner (NTP), or set use_sim_time"
            )
        if self.reports.count:
            at, before = self.reports.latest()
            jump = float(np.abs(joints - before).max())
            if jump > _JUMP + _FASTEST * max(time.monotonic() - age - at, 0.0):
                return (
                    f"the joint states of {self._states} jump by {jump:.2f} rad\n"
                    "  to do:   see whether more than one program publishes them (`ros2 topic info -v`)"
                )
        return ""

    def _present_defect(self) -> str:
        return self._defect if time.monotonic() < self._defect_until else ""

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

    def _states_check(self) -> Check:
        count = sum(end.publishes and not end.own for end in self._link.endpoints(self._states))
        what = f"{count} programs publish {self._states}" if count != 1 else f"one program publishes {self._states}"
        return Check(what, count == 1, "make sure that each publishes other joints", needed=False)

    def _wait_for_listener(self) -> str:
        """Waits until somebody listens to the commands; returns in words why nobody does."""
        until = time.monotonic() + _FIRST
        while True:
            problem = why_nobody_listens(self._link, self._topic, self._kind, Qos())
            if not problem or time.monotonic() > until:
                return problem
            time.sleep(0.02)
