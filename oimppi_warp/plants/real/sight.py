"""Selects poses of the object that are recent enough to use, and gives the reason when there are none."""

from __future__ import annotations

import time

import numpy as np

from oimppi_warp.errors import HardwareError
from oimppi_warp.perception.pose_source import PoseSource, StampedPose

FUTURE = 0.2
"""Largest time by which the stamp of a pose may be in the future [s]."""
_AGREE = 0.03
"""Distance of two detections that agree [m]."""


class Sight:
    """The object's pose as its source reports it.

    Args:
        source: The source.
        timeout: Age of a pose from which on it must not be used to push [s].
    """

    def __init__(self, source: PoseSource, *, timeout: float) -> None:
        self._source = source
        self._timeout = timeout

    @property
    def latest(self) -> StampedPose | None:
        """Returns the newest pose; ``None`` if there is none, or its stamp is in the future."""
        seen = self._newest()
        return None if seen is None or seen.age < -FUTURE else seen

    @property
    def ever(self) -> bool:
        """Returns whether any pose has arrived."""
        return bool(self._source.poses)

    @property
    def problem(self) -> str:
        """Returns why poses do not arrive, or cannot be used; empty if nothing is known of it."""
        seen = self._newest()
        if seen is not None and seen.age < -FUTURE:
            return (
                f"the object's pose is stamped {-seen.age:.1f} s in the future\n"
                "  to do:   synchronise the clocks of camera and planner (NTP)"
            )
        if seen is not None and seen.age > self._timeout:
            return (
                f"the object's pose was {seen.age:.1f} s old when it arrived\n"
                "  to do:   synchronise the clocks of camera and planner (NTP), or see why the camera is late"
            )
        return self._source.problem

    def agreed(self, *, oldest: float, wait: float) -> np.ndarray | None:
        """Waits until the latest two detections agree; returns the later pose, shape [3] [m, m, rad].

        Args:
            oldest: Largest age of the later one [s].
            wait: Time after which ``None`` is returned [s].
        """
        until = time.monotonic() + wait
        while time.monotonic() < until:
            latest = self._source.poses[-2:]
            if len(latest) == 2:
                before, seen = latest
                timely = seen.age >= -FUTURE and time.monotonic() - seen.taken <= oldest
                if timely and np.hypot(*(seen.pose - before.pose)[:2]) < _AGREE:
                    return seen.pose
            time.sleep(0.02)
        return None

    def error(self) -> HardwareError:
        """Returns the error of an object that is not seen."""
        why = self.problem or "no two detections of the object agree"
        remedy = "" if "to do:" in why else "\n  to do:   start what detects the object, and let nothing hide it"
        return HardwareError(f"{why}{remedy} (docs/hardware.md)")

    def close(self) -> None:
        """Stops the source."""
        self._source.close()

    def _newest(self) -> StampedPose | None:
        poses = self._source.poses
        return poses[-1] if poses else None
