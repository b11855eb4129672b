"""Dynamics with a known optimum, to test optimizers on."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import warp as wp
from support.device import DEVICE

from oimppi_warp.compute.step import Compute, Launch

ROOT = np.array([[0.30, 0.0], [0.12, 0.05]])
"""A square root of the noise's covariance, its two entries correlated."""


TARGET = np.array([0.4, -0.2])


FAR = 1e3
"""A bound that is never reached."""


@dataclass
class Valley:
    """Dynamics whose cost is the squared distance of the controls to a target; ``spoiled`` samples cost ``spoil``."""

    bound: np.ndarray
    spoiled: int = 0
    spoil: float = float("nan")
    offset: float = 0.0
    size: int = 2
    compute: Compute = field(default_factory=lambda: Compute(DEVICE))

    def rollout(self, controls: wp.array, costs: wp.array) -> Launch:
        def roll() -> None:
            found = np.sum((controls.numpy() - TARGET) ** 2, axis=(1, 2)) + self.offset
            found[len(found) - self.spoiled :] = self.spoil
            costs.assign(found.astype(np.float32))

        return roll


def within_five_sigma(found: np.ndarray, covariance: np.ndarray, samples: int) -> None:
    """A sample covariance of normal numbers is off by sqrt((S_ii S_jj + S_ij^2) / K)."""
    deviation = np.sqrt((np.outer(np.diag(covariance), np.diag(covariance)) + covariance**2) / samples)
    assert (np.abs(found - covariance) < 5.0 * deviation).all()


ROUND = 0.2 * np.eye(2)
"""A square root of noise that is the same in all directions."""
