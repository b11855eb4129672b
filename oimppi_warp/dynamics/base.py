"""The seam between MPPI and what it plans with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import warp as wp

from oimppi_warp.compute import Compute, Launch, Slot
from oimppi_warp.observation import Observation


class Dynamics(Protocol):
    """A model with a state of its own that turns control sequences into costs.

    Attributes:
        size: Length m of one control.
        bound: Largest magnitude of each control entry, shape [m].
        compute: Where it computes.
    """

    size: int
    bound: np.ndarray
    compute: Compute

    def rollout(self, controls: wp.array, costs: wp.array) -> Launch:
        """Prepares writing the cost of each control sequence from the state that is set when it runs.

        Args:
            controls: [sample, horizon] of vectors [m].
            costs: [sample], written.
        """
        ...


@dataclass(frozen=True, eq=False)
class Trace:
    """What a control sequence leads to.

    Attributes:
        tips: Tool tip, shape [horizon + 1, 3] [m].
        poses: Object (friction centre), shape [horizon + 1, 3].
        terms: Weighted cost terms summed over the horizon, in the order of ``TERMS``.
    """

    tips: np.ndarray
    poses: np.ndarray
    terms: np.ndarray


class RobotDynamics(Dynamics, Protocol):
    """A rollout engine of the robot level; controls are joint velocities [rad/s].

    Attributes:
        one_graph: Whether its launches can be captured in a CUDA graph.
        terms: Names of the cost terms.
        reference: Where the object should be at each step from now, poses of its friction centre, an input of the step
            (:class:`oimppi_warp.compute.Compute`); its length is the number of poses that the engine needs.
        guide: Where the tip is called to and the weight of that, an input [1] of (x, y, z [m], weight [1/m^2]).
    """

    one_graph: bool
    terms: tuple[str, ...]
    reference: Slot
    guide: Slot

    def set_state(self, observation: Observation, goal: np.ndarray) -> None:
        """The state to plan from, and the goal [3] of the object's friction centre."""
        ...

    def trace(self, nominal: wp.array, costs: wp.array) -> Launch:
        """Prepares what :meth:`traced` reads, after an update.

        Args:
            nominal: The updated nominal, [horizon] of vectors.
            costs: Costs of the samples that it was made from, [sample].
        """
        ...

    def traced(self) -> Trace:
        """Where the plan leads: its nominal, or its best sample in an engine where another rollout would be dear."""
        ...

    def paths(self, controls: wp.array, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What some samples of the latest rollout led to, for people to look at.

        Args:
            controls: The controls that were rolled out, [sample, horizon] of vectors.
            samples: Which of them, shape [n].

        Returns:
            Tool tips, shape [n, steps, 3] [m], and weighted cost terms, shape [n, terms].
        """
        ...


def control_type(size: int) -> type:
    """Warp's vector type for controls of ``size`` numbers (the same object the kernels use)."""
    return wp.types.vector(length=size, dtype=float)
