"""The commands of a real arm: those that are due, those that were sent, and whether the arm did what it was told."""

from __future__ import annotations

import threading
import time
from collections import deque
from itertools import takewhile

import numpy as np

from oimppi_warp.plants.real.arm import OLDEST, Arm

TICK = 0.01
"""Interval of the commands [s]."""
LATENCY = 0.02
"""Time from a command to its effect: sending, the controller's cycle, and the arm's response [s]."""
_PATIENCE = 0.5
"""Control periods by which the control loop may be late before the arm is let stop."""
_ASTRAY, _ASTRAY_SECONDS = 0.06, 0.4
"""Deviation of the motion within this time [s] from what was commanded, from which on somebody else moves the arm or
something holds it [rad]."""
_LEAST_ASTRAY = 0.3
"""Least share of this deviation that counts, at a low speed."""
_COMING = 0.05
"""Age of the newest report up to which reports come [s]."""
_MOST_REPORTS = 0.85
"""Share of the usual number of joint reports that have to be there for this to be judged."""
_RESPONSE, _SURELY = 0.06, 0.003
"""Time after which a command has surely moved the arm [s], and motion that its reports surely show [rad]."""


class Commands:
    """The commands of an arm, each for one :data:`TICK`; it may be used from several threads.

    Args:
        arm: The arm.
        period: Control period [s].
        speed: Share of the usual speed.
    """

    def __init__(self, arm: Arm, *, period: float, speed: float) -> None:
        self._arm, self._period, self._speed = arm, period, speed
        self._lock = threading.RLock()
        self._queue: deque[tuple[float, np.ndarray]] = deque()
        self._sent: deque[tuple[float, np.ndarray]] = deque(maxlen=200)

    def put(self, joint_velocities: np.ndarray) -> None:
        """Takes joint velocities for the following ticks, shape [tick, dof] [rad/s], instead of all earlier ones."""
        began = time.monotonic()
        with self._lock:
            self._queue.clear()
            self._queue.extend((began + i * TICK, command) for i, command in enumerate(joint_velocities))

    def due(self) -> np.ndarray | None:
        """Returns the joint velocities that are due, shape [dof] [rad/s]; ``None`` once the last ones are over."""
        now = time.monotonic()
        with self._lock:
            while len(self._queue) > 1 and self._queue[1][0] <= now + 0.5 * TICK:
                self._queue.popleft()
            if not self._queue or now > self._queue[-1][0] + TICK + _PATIENCE * self._period:
                return None
            return self._queue[0][1]

    def note(self, joint_velocity: np.ndarray) -> None:
        """Notes that joint velocities, shape [dof] [rad/s], have just been sent."""
        with self._lock:
            self._sent.append((time.monotonic(), joint_velocity))

    def forget(self) -> None:
        """Forgets everything, such as before going on after a fault."""
        with self._lock:
            self._queue.clear()
            self._sent.clear()

    @property
    def any_sent(self) -> bool:
        """Returns whether any command was sent."""
        return bool(self._sent)

    def deviation(self) -> str:
        """Returns in words how the arm has moved otherwise than it was told to; empty if it has not."""
        return self._frozen() or self._astray()

    def _told(self, begin: float, end: float) -> np.ndarray | None:
        """Returns by how much the joints were told to move between two times, shape [dof] [rad].

        ``None`` if the commands of that time are not all known.
        """
        with self._lock:
            sent = list(self._sent)
        if not sent or sent[0][0] > begin:
            return None
        starts = np.array([at for at, _ in sent])
        ends = np.minimum([*starts[1:], np.inf], starts + self._arm.expires)
        durations = np.clip(ends, begin, end) - np.clip(starts, begin, end)
        return durations @ np.array([command for _, command in sent])

    def _frozen(self) -> str:
        """Returns a fault if the joint reports have not changed although the arm was told to move."""
        if not self._sent:
            return ""
        reports = self._arm.reports.since(0.0)
        same = takewhile(lambda report: np.array_equal(report[1], reports[-1][1]), reversed(reports))
        now, since = time.monotonic(), min(at for at, _ in same)
        if now - since < OLDEST - TICK or now - reports[-1][0] > _COMING:
            return ""  # they may not come at all, which is another fault
        told = self._told(max(since, self._sent[0][0]), now - _RESPONSE)
        if told is None or np.abs(told).max() < _SURELY:
            return ""
        return (
            "the joint reports do not change although the arm was told to move\n"
            "  to do:   see whether the arm moved; if it did, restart what reports its joints"
        )

    def _astray(self) -> str:
        """Returns a fault if the arm has moved otherwise than it was told to."""
        now = time.monotonic()
        begin = now - _ASTRAY_SECONDS
        told = self._told(begin - LATENCY, now - LATENCY)
        reports = self._arm.reports.since(begin)
        if told is None or len(reports) < _MOST_REPORTS * self._arm.report_rate * _ASTRAY_SECONDS:
            return ""  # reports were held up: it is not known when the arm was where
        moved = (reports[-1][1] - reports[0][1])[: len(told)]
        off = np.abs(told - moved)
        worst = int(np.argmax(off))
        if off[worst] < _ASTRAY * max(self._speed, _LEAST_ASTRAY):
            return ""
        return (
            f"joint {worst + 1} moved {moved[worst]:+.2f} rad in {_ASTRAY_SECONDS:g} s, not {told[worst]:+.2f} rad as "
            "commanded\n  to do:   see whether another program commands the arm, or something holds it"
        )
