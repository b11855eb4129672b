"""A source of the object's pose, as a real plant sees it, and a pose with its times."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np


@dataclass(frozen=True, eq=False)
class StampedPose:
    """A pose as it was received.

    Attributes:
        pose: Planar pose of the object's frame in the world, shape [3] [m, m, rad].
        arrived: Time at which it arrived, of ``time.monotonic`` [s].
        age: Time since the object had this pose when it arrived, by the clocks of both machines [s]; negative if the
            sender's clock is ahead.
        stamp: Time at which the object had it as the sender gave it, in seconds since 1970.
    """

    pose: np.ndarray
    arrived: float
    age: float
    stamp: float

    @property
    def taken(self) -> float:
        """Returns the time at which the object had the pose, of ``time.monotonic`` [s]."""
        return self.arrived - self.age


class PoseSource(Protocol):
    """Detects the object, or receives its detections, in the background."""

    @property
    def poses(self) -> list[StampedPose]:
        """Returns the newest poses, the latest last; empty before the first one."""
        ...

    @property
    def problem(self) -> str:
        """Returns why no poses arrive at present, in words; empty if none is known."""
        ...

    def close(self) -> None:
        """Stops."""
        ...
