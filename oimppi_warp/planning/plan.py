"""The results of planning: a plan, and samples of it for display."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oimppi_warp.planning.optimizers.optimizer import Update


@dataclass(frozen=True, eq=False)
class Plan:
    """One control step's plan.

    Attributes:
        command: Joint velocities to apply now, shape [dof] [rad/s].
        update: Statistics of the robot level's update.
        object_update: Statistics of the object level's update, if it planned.
        object_seconds: Wall time of the object level [s]; NaN if it did not plan, or if it cannot be measured because
            the whole step is one CUDA graph.
        terms: Weighted cost terms of the robot's nominal, summed over the horizon.
        tips: Tool tip along the nominal, shape [horizon + 1, 3] [m].
        object_poses: Object poses along the nominal, shape [horizon + 1, 3].
        reference: The object plan that was tracked, from the object's present pose on, shape [n, 3].
        problem: Reason why no plan could be made and the command is zero; empty if a plan was made.
    """

    command: np.ndarray
    update: Update
    object_update: Update | None
    object_seconds: float
    terms: np.ndarray
    tips: np.ndarray
    object_poses: np.ndarray
    reference: np.ndarray
    problem: str = ""


@dataclass(frozen=True, eq=False)
class Samples:
    """Some samples of a plan, the cheapest first.

    Attributes:
        tips: Tool paths, shape [n, steps, 3] [m].
        weights: Their weights relative to the largest, shape [n].
        terms: Weighted cost terms of the cheapest.
    """

    tips: np.ndarray
    weights: np.ndarray
    terms: dict[str, float]
