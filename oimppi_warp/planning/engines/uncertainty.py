"""What a prediction may be wrong about: draws of friction, mass, perceived pose and tool, and what costs make of them.

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
    """Worlds that a rollout may be in; rollout r is in draw ``r % count``, draw 0 of several is no special one.

    They are made once and stay: what differs from plan to plan is the controls, not the luck.

    Attributes:
        per_sample: Rollouts of each control sequence (M).
        worst: Number of them, the costliest, whose mean is the cost.
        friction: Factor on the object's friction on the table and obstacles, shape [count].
        tool_friction: Factor on its friction on the tool, shape [count].
        mass: Factor on its mass, shape [count].
        pose: Error of its perceived pose: (x, y [m], yaw [rad]), shape [count, 3].
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
        """Number of draws."""
        return len(self.friction)


_ONE = np.ones(1)
CERTAIN = Draws(1, 1, _ONE, _ONE, _ONE, np.zeros((1, 3)), np.zeros((1, 2)))
"""The world as it was given, and no other."""


def draw(uncertainty: Uncertainty, *, samples: int, seed: int) -> Draws:
    """Draws for a plan of ``samples`` samples; a single certain one where uncertainty is off.

    Factors are log-normal, so that they stay positive; errors are normal.
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
