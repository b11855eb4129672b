"""Sampling-based optimizers of a control sequence: sample, roll out, update, shift; independent of robot and object.

A new one is a subclass of :class:`Optimizer` that overrides ``update`` and, if it samples differently, ``sample``; it
is added by name to :data:`oimppi_warp.registries.OPTIMIZERS`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
import warp as wp

from oimppi_warp.compute.step import Launch, in_order, using_gpu
from oimppi_warp.config.settings import Sampling
from oimppi_warp.errors import ConfigError
from oimppi_warp.kernels.optimizers.sampling import make_sample_controls
from oimppi_warp.kernels.optimizers.update import WeightStats, make_shift_nominal
from oimppi_warp.planning.engines.dynamics import Dynamics, control_type
from oimppi_warp.registries import OPTIMIZERS


@dataclass(frozen=True)
class Update:
    """Statistics of one update.

    Attributes:
        min_cost: Smallest cost of all samples; NaN where all were lost.
        temperature: The lambda that was used; 0 for an optimizer without one.
        effective_samples: Effective sample size, 1 / sum of squared weights.
        lost: Samples whose cost was not finite.
    """

    min_cost: float
    temperature: float
    effective_samples: float
    lost: int


class Optimizer(ABC):
    """Base class of all sampling-based optimizers; each works over any dynamics, at either level.

    Args:
        dynamics: Turns control sequences into costs.
        settings: Settings, an instance of the class's ``Settings``.
        seed: Seed of the noise; the same seed gives the same plans.

    Attributes:
        Settings: The class's settings, a frozen dataclass derived from :class:`oimppi_warp.config.settings.Sampling`.
        one_graph: Whether its launches can be captured in a CUDA graph, unlike work on the host.
        settings: The settings.
        seed: Seed of the noise.
        nominal: The nominal control sequence, [horizon] of vectors, on the device.
        controls: The samples of the latest update, [sample, horizon] of vectors.
        costs, weights: Their costs, and their weights in the update, [sample].
        stats: Statistics of the latest update, an output [1]; every update writes it.
        command: The control to apply now, an output [1]: the nominal's first, after the shift.
        noise: A square root [1, m, m] of the noise's covariance Sigma_u (``Sigma_u = root root^T``), an input.
        bound: Largest magnitude of each control entry, [1] of vectors.
        basis: Contribution of each knot to the noise of each step, [horizon, knot], see :func:`noise_basis`.
        counter: Number of plans made so far, [1]: each draws different noise.
    """

    Settings: ClassVar[type[Sampling]]
    one_graph: ClassVar[bool] = False

    def __init__(self, dynamics: Dynamics, settings: Sampling, *, seed: int) -> None:
        if not isinstance(settings, self.Settings):
            raise ConfigError(
                f"optimizer {settings.kind!r}: its settings are of the type {type(settings).__name__}\n"
                f"  allowed: {self.Settings.__name__}"
            )
        self.dynamics = dynamics
        self.compute = dynamics.compute
        self.settings = settings
        self.seed = seed
        size, device = dynamics.size, self.compute.device
        vec = control_type(size)
        samples, horizon = settings.samples, settings.horizon
        self.nominal = wp.zeros(horizon, dtype=vec, device=device)
        self.controls = wp.zeros((samples, horizon), dtype=vec, device=device)
        self.costs = wp.zeros(samples, dtype=float, device=device)
        self.weights = wp.zeros(samples, dtype=float, device=device)
        self.noise = self.compute.input(1, wp.types.matrix(shape=(size, size), dtype=float))
        self.command = self.compute.output(1, vec)
        self.stats = self.compute.output(1, WeightStats)
        self.counter = wp.zeros(1, dtype=int, device=device)
        self.bound = wp.array(dynamics.bound[None].astype(np.float32), dtype=vec, device=device)
        self.basis = wp.array(noise_basis(horizon, settings.knots).astype(np.float32), dtype=float, device=device)

    @cached_property
    def improve(self) -> list[Launch]:
        """Returns the launches of one plan from the dynamics' current state: ``iterations`` updates of the nominal.

        An update is Algorithm 1: sample (lines 1 to 4), roll out and evaluate S (lines 5 and 6), update (line 7).
        """
        rollout, update = self.dynamics.rollout(self.controls, self.costs), self.update()
        launches: list[Launch] = []
        for i in range(self.settings.iterations):
            launches += [*self.sample(wrapped_seed(self.seed + 104729 * i)), rollout, *update]
        return launches

    @cached_property
    def shift(self) -> Launch:
        """Returns the launch that takes the command out of the nominal and shifts everything by one step.

        This is ``u <- u_nominal`` and ``U <- shift(U)``: Algorithm 2, line 7, and Algorithm 3, lines 6 and 13.
        """
        return in_order(self.advance())

    def sample(self, seed: int) -> Sequence[Launch]:
        """Prepares drawing ``controls`` around the nominal: ``u = u_nominal + eps``, ``eps ~ N(0, Sigma_u)``.

        This is equation 9, and lines 1 to 4 of Algorithm 1.

        Args:
            seed: A signed 32-bit number.
        """
        knots = self.settings.knots if self.settings.knots < self.settings.horizon else 0
        kernel = make_sample_controls(self.dynamics.size, knots)
        inputs = [self.nominal, self.noise.array, self.basis, self.bound, self.counter, seed]
        inputs += [int(self.settings.special_samples), self.settings.least_noise]
        return [self.compute.launch_samples(kernel, self.settings.samples, inputs, [self.controls])]

    @abstractmethod
    def update(self) -> Sequence[Launch]:
        """Prepares one update: from ``controls`` and ``costs`` to ``weights``, ``stats`` and ``nominal``.

        A sample whose cost is not finite, or 1e30 and more, is lost: it gets no weight. If all are lost, the nominal
        becomes zero, so that the robot stops.
        """

    def advance(self) -> Sequence[Launch]:
        """Prepares the shift by one step: the nominal's first control becomes ``command``, its last is repeated.

        An optimizer that keeps more than the nominal from plan to plan shifts that as well.
        """
        kernel = make_shift_nominal(self.dynamics.size)
        return [self.compute.launch(kernel, 1, [1], [self.nominal, self.counter, self.command.array])]

    def found(self) -> Update:
        """Returns the statistics of the latest update; to be called after the step, which copies them to the host."""
        found = self.stats.host[0]
        least, temperature, effective, lost = (
            found[name].item() for name in ("min_cost", "temperature", "effective_samples", "lost")
        )
        return Update(least if lost < self.settings.samples else math.nan, temperature, effective, lost)

    def reset(self) -> None:
        """Sets the nominal to zero and restarts the sequence of the noise."""
        self.forget()
        with using_gpu:
            self.counter.zero_()

    def forget(self) -> None:
        """Sets the nominal to zero; the noise goes on, so that the next plan is another one.

        An optimizer that keeps more than the nominal from plan to plan resets that as well.
        """
        with using_gpu:
            self.nominal.zero_()
            self.stats.array.zero_()


def make_optimizer(dynamics: Dynamics, settings: Sampling, *, seed: int) -> Optimizer:
    """Makes the optimizer named by ``settings.kind``.

    Args:
        dynamics: Turns control sequences into costs.
        settings: Settings of the optimizer; ``kind`` is a key of :data:`oimppi_warp.registries.OPTIMIZERS`.
        seed: Seed of the noise.

    Raises:
        ConfigError: There is no such optimizer, or ``settings`` has the wrong type for it.
    """
    return OPTIMIZERS.get_checked(settings.kind)(dynamics, settings, seed=seed)


def wrapped_seed(seed: int) -> int:
    """Converts a non-negative seed to the signed 32-bit number (two's complement) that kernels take.

    Numbers below 2^31 are unchanged. Bits above the 32nd are mixed in, so that seeds that differ only in them give
    different noise.
    """
    low = (seed ^ ((seed >> 32) * 0x9E3779B9)) & 0xFFFFFFFF
    return low - (1 << 32) if low >= 1 << 31 else low


def noise_basis(horizon: int, knots: int) -> np.ndarray:
    """Returns the contribution of each knot to the noise of each step, shape [horizon, knots].

    Knots are evenly spaced over the horizon and joined by a natural cubic spline; each step keeps unit variance. With
    ``knots=0`` every step is its own knot: white noise, as in the paper.
    """
    if knots == 0 or knots >= horizon:
        return np.eye(horizon)
    if knots == 1:
        return np.ones((horizon, 1))
    at = np.linspace(0.0, knots - 1.0, horizon)
    left = np.minimum(at.astype(int), knots - 2)
    a, b = left + 1.0 - at, at - left
    # Second derivatives m of a natural spline through y solve a tridiagonal system: m = solve(lhs, rhs @ y).
    lhs, rhs = np.eye(knots), np.zeros((knots, knots))
    for i in range(1, knots - 1):
        lhs[i, i - 1 : i + 2] = 1.0, 4.0, 1.0
        rhs[i, i - 1 : i + 2] = 6.0, -12.0, 6.0
    curvature = np.linalg.solve(lhs, rhs)
    rows = np.eye(knots)
    basis = (
        a[:, None] * rows[left]
        + b[:, None] * rows[left + 1]
        + ((a**3 - a)[:, None] * curvature[left] + (b**3 - b)[:, None] * curvature[left + 1]) / 6.0
    )
    return basis / np.linalg.norm(basis, axis=1, keepdims=True)
