"""Uncertain parameters of a prediction: draws of friction, mass, perceived pose and tool.

The paper names rollouts under uncertain parameters as future work. Each control sequence is tried in several *draws* of
the world, and its cost is the mean over them, the worst, or the mean of the worst (CVaR).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from oimppi_warp.config.settings import Uncertainty


@dataclass(frozen=True, eq=False)
class Draws:
    """Draws of the world for rollouts: rollout r uses draw ``r % count``. None of several draws is the nominal world.

    They are drawn once and kept, so that plans differ by their controls, not by chance.

    Attributes:
        per_sample: Number of rollouts of each control sequence (M).
        worst: Number of the costliest of these rollouts, whose mean cost is the cost of the sequence.
        friction: Factor on the object's friction on the table and obstacles, shape [count].
        tool_friction: Factor on the object's friction on the tool, shape [count].
        mass: Factor on the object's mass, shape [count].
        pose: Error of the object's perceived pose (x, y [m], yaw [rad]), shape [count, 3].
        tool: Offset of the tool's tip across the tool, in the tip's frame [m], shape [count, 2].
    """

    per_sample: int
    worst: int
    friction: np.ndarray
    tool_friction: np.ndarray
    mass: np.ndarray
    pose: np.ndarray
    tool: np.ndarray

    @property
    def count(self) -> int:
        """Returns the number of draws."""
        return len(self.friction)


_ONE = np.ones(1)
CERTAIN = Draws(1, 1, _ONE, _ONE, _ONE, np.zeros((1, 3)), np.zeros((1, 2)))
"""The nominal world alone."""


def draw(uncertainty: Uncertainty, *, samples: int, seed: int) -> Draws:
    """Makes the draws of the world for a planner; the nominal world alone if uncertainty is off.

    Factors are log-normal, so that they stay positive; errors are normal.

    Args:
        uncertainty: Settings of the uncertainty.
        samples: Number of samples of a plan.
        seed: Seed of the draws.
    """
    if uncertainty.draws == 0:
        return CERTAIN
    count = uncertainty.draws * (1 if uncertainty.shared else samples)
    rng = np.random.default_rng(seed)
    friction, tool_friction, mass = (
        np.exp(spread * rng.standard_normal(count))
        for spread in (uncertainty.friction, uncertainty.friction, uncertainty.mass)
    )
    worst = {"mean": 1.0, "worst": 0.0, "cvar": uncertainty.tail}[uncertainty.measure]
    return Draws(
        per_sample=uncertainty.draws,
        worst=max(math.ceil(worst * uncertainty.draws - 1e-9), 1),
        friction=friction,
        tool_friction=tool_friction,
        mass=mass,
        pose=rng.standard_normal((count, 3)) * uncertainty.pose,
        tool=rng.standard_normal((count, 2)) * uncertainty.tool,
    )
