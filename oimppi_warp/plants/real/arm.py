"""The connection to a real arm, as the plant needs it, and the joint reports that arrive over it."""

from __future__ import annotations

import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from oimppi_warp.priority import real_time_priority
from oimppi_warp.scene import Robot

OLDEST = 0.2
"""Age of the joint reports from which on the arm must not move [s]; it is at rest before they are 0.25 s old."""
_KEPT = 400
"""Number of joint reports that are kept."""


@dataclass(frozen=True)
class Check:
    """One item of a check.

    Attributes:
        what: What was checked, with the value found.
        good: Whether it is as it should be.
        remedy: What to do if it is not.
        needed: Whether the arm must not move otherwise.
    """

    what: str
    good: bool
    remedy: str = ""
    needed: bool = True


def check_limits(joints: np.ndarray, robot: Robot) -> Check:
    """Checks that joint positions, shape [dof] [rad], are within a robot's limits."""
    lower, upper = np.array([(joint.lower, joint.upper) for joint in robot.joints]).T
    outside = [f"joint {i + 1}" for i in np.flatnonzero((joints < lower) | (joints > upper))]
    what = f"{', '.join(outside)} beyond its limits" if outside else "joints within the scene's limits"
    return Check(what, not outside, "move the arm by hand (manual mode)")


def check_priority() -> Check:
    """Checks whether the commands can be sent with priority over other programs."""
    with real_time_priority() as given:
        what = "real-time priority" if given else "no real-time priority: other programs can delay the commands"
        return Check(what, given, "add `YOUR_USER - rtprio 20` to /etc/security/limits.conf, and log in anew", False)


class JointReports:
    """The newest joint reports, with their times; it may be used from several threads.

    Attributes:
        count: Number of joint reports so far.
    """

    def __init__(self) -> None:
        self.count = 0
        self._reports: deque[tuple[float, np.ndarray]] = deque(maxlen=_KEPT)
        self._lock = threading.Lock()

    def take(self, joints: np.ndarray, *, age: float = 0.0) -> None:
        """Adds a report that has just arrived.

        Args:
            joints: Joint positions, shape [joint] [rad].
            age: Time since the joints had these positions [s].
        """
        at = time.monotonic() - age
        with self._lock:
            self.count += 1
            self._reports.append((max(at, self._reports[-1][0] + 1e-6) if self._reports else at, joints))

    def latest(self) -> tuple[float, np.ndarray]:
        """Returns the newest report: its time, of ``time.monotonic`` [s], and joint positions, shape [joint] [rad].

        Raises:
            IndexError: There is none yet.
        """
        with self._lock:
            return self._reports[-1]

    def since(self, time: float) -> list[tuple[float, np.ndarray]]:
        """Returns the reports since a time; see :meth:`latest`."""
        with self._lock:
            return [report for report in self._reports if report[0] >= time]


class Arm(Protocol):
    """A connection to a real arm that takes joint velocities.

    The arm does not move before :meth:`enable`.

    Attributes:
        address: Where the arm is, as messages name it.
        place: What a person would call another set-up if it changed: the arm is slow in its first run at a new one.
        simulated: Whether it is surely no real arm.
        reports: The joint reports; at least one has arrived.
        report_rate: Rate at which they should arrive [1/s].
        expires: Time after which a command moves the arm no more if no other follows [s].
    """

    address: str
    place: str
    simulated: bool
    reports: JointReports
    report_rate: float
    expires: float

    def check(self, robot: Robot) -> list[Check]:
        """Compares what is found with the arm of a scene.

        Raises:
            HardwareError: The connection is lost.
        """
        ...

    def enable(self) -> None:
        """Gets ready to take joint velocities.

        Raises:
            HardwareError: The arm has a fault that only a person can clear, or refuses.
        """
        ...

    def send(self, joint_velocity: np.ndarray) -> str:
        """Sends joint velocities, shape [dof] [rad/s]; returns why they are refused, empty if not."""
        ...

    def rest(self) -> bool:
        """Is called instead of :meth:`send`, at the same rate, while nothing is to be sent.

        Returns whether it commanded the arm to be at rest.
        """
        ...

    def stop(self) -> None:
        """Stops the arm; it may be called from any thread, at any time, and raises nothing."""
        ...

    def lost(self) -> str:
        """Returns why no joint reports arrive, in words; empty if the connection is open. It does not wait."""
        ...

    def fault(self, tick: int, *, moving: bool) -> str:
        """Returns why the arm must not move, in words, with what to do; empty if it may.

        Args:
            tick: Number of the call, so that what takes time can be asked for in turn.
            moving: Whether commands are being sent.
        """
        ...

    def disconnect(self) -> None:
        """Ends the connection, after :meth:`stop` if the arm was enabled."""
        ...
