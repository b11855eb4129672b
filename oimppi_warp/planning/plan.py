"""The results of planning: a plan, and samples of it for display."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from oimppi_warp.planning.optimizers.optimizer import Update


@dataclass(frozen=True, eq=False)
class PlanDetails:
    """Predictions and statistics of a plan, for logs and displays.

    Attributes:
        update: Statistics of the robot level's update.
        object_update: Statistics of the object level's update, if it planned.
        terms: Weighted cost terms of the robot's nominal, summed over the horizon.
        tips: Tool tip along the nominal, shape [horizon + 1, 3] [m].
        object_poses: Object poses along the nominal, shape [horizon + 1, 3].
        reference: The object plan that was tracked, from the object's present pose on, shape [n, 3].
    """

    update: Update
    object_update: Update | None
    terms: np.ndarray
    tips: np.ndarray
    object_poses: np.ndarray
    reference: np.ndarray


class Later:
    """Details that are fetched when they are asked for, and then kept; any thread may ask.

    Args:
        fetch: Returns the details, as long as the planner has not begun its next plan or episode.
    """

    def __init__(self, fetch: Callable[[], PlanDetails]) -> None:
        self._fetch: Callable[[], PlanDetails] | None = fetch
        self._fetched: PlanDetails | None = None
        self._lock = threading.Lock()

    def __call__(self) -> PlanDetails:
        """Returns the details."""
        with self._lock:
            if self._fetched is None:
                assert self._fetch is not None
                self._fetched, self._fetch = self._fetch(), None  # a plan does not keep its planner alive
            return self._fetched


@dataclass(frozen=True, eq=False)
class Plan:
    """One control step's plan.

    On a GPU the command is known before the rest, the *details*. They are properties of the plan, as documented at
    :class:`PlanDetails`, and the first of them that is read waits for the GPU.

    Attributes:
        command: Joint velocities to apply now, shape [dof] [rad/s].
        object_seconds: Wall time of the object level [s]; NaN if it did not plan, or if it cannot be measured because
            the whole step is one CUDA graph.
        details: Returns the details.
        problem: Reason why no plan could be made and the command is zero; empty if a plan was made.
    """

    command: np.ndarray
    object_seconds: float
    details: Callable[[], PlanDetails]
    problem: str = ""

    @property
    def update(self) -> Update:
        """Statistics of the robot level's update."""
        return self.details().update

    @property
    def object_update(self) -> Update | None:
        """Statistics of the object level's update, if it planned."""
        return self.details().object_update

    @property
    def terms(self) -> np.ndarray:
        """Weighted cost terms of the robot's nominal, summed over the horizon."""
        return self.details().terms

    @property
    def tips(self) -> np.ndarray:
        """Tool tip along the nominal, shape [horizon + 1, 3] [m]."""
        return self.details().tips

    @property
    def object_poses(self) -> np.ndarray:
        """Object poses along the nominal, shape [horizon + 1, 3]."""
        return self.details().object_poses

    @property
    def reference(self) -> np.ndarray:
        """The object plan that was tracked, from the object's present pose on, shape [n, 3]."""
        return self.details().reference


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
