"""The seam between MPPI and what it plans with."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import warp as wp


class Dynamics(Protocol):
    """A model with a state of its own that turns control sequences into costs.

    Attributes:
        size: Length m of one control.
        bound: Largest magnitude of each control entry, shape [m].
        device: Warp device of all arrays.
    """

    size: int
    bound: np.ndarray
    device: str

    def rollout(self, controls: wp.array, costs: wp.array) -> None:
        """Writes the cost of each control sequence from the present state.

        Args:
            controls: [sample, horizon] of vectors [m].
            costs: [sample], written.
        """
        ...


def control_type(size: int) -> type:
    """Warp's vector type for controls of ``size`` numbers (the same object the kernels use)."""
    return wp.types.vector(length=size, dtype=float)
