"""MPPI (the paper's Algorithm 1): sample, roll out, weigh, update, shift. It knows neither robot nor object."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import warp as wp

from oimppi_warp import config
from oimppi_warp.compute import Launch
from oimppi_warp.dynamics.base import Dynamics, control_type
from oimppi_warp.kernels.sampling import make_sample_controls
from oimppi_warp.kernels.update import WeightStats, make_shift_nominal, make_update_nominal, weigh_samples


@dataclass(frozen=True)
class Update:
    """What one update found.

    Attributes:
        min_cost: Smallest cost of all samples; NaN where all were lost.
        temperature: lambda that was used.
        effective_samples: Effective sample size, 1 / sum of squared weights.
        lost: Samples whose cost was not finite.
    """

    min_cost: float
    temperature: float
    effective_samples: float
    lost: int


class Mppi:
    """One MPPI over any dynamics.

    Args:
        dynamics: Turns control sequences into costs.
        settings: Samples, horizon, temperature and noise.
        seed: Of the noise; the same seed gives the same plans.

    Attributes:
        seed: Of the noise.
        nominal: The nominal control sequence, [horizon] of vectors, on the device.
        controls: The samples of the latest update, [sample, horizon] of vectors.
        costs, weights: Their costs and weights, [sample].
        command: The control to apply now, an output [1]: the nominal's first, once it is shifted out.
        noise: A square root [1, m, m] of the noise's covariance Sigma_u (``Sigma_u = root root^T``), an input.
        improve: Launches of one update of the nominal from the dynamics' present state (equations 9 to 12).
        shift: Launch that takes the command out of the nominal and moves it on by one step; the new last control
            repeats the one before.
    """

    def __init__(self, dynamics: Dynamics, settings: config.Mppi, *, seed: int) -> None:
        self._settings = settings
        self.seed = seed
        compute = dynamics.compute
        size, device = dynamics.size, compute.device
        vec = control_type(size)
        samples, horizon = settings.samples, settings.horizon
        self.nominal = wp.zeros(horizon, dtype=vec, device=device)
        self.controls = wp.zeros((samples, horizon), dtype=vec, device=device)
        self.costs = wp.zeros(samples, dtype=float, device=device)
        self.weights = wp.zeros(samples, dtype=float, device=device)
        self.noise = compute.input(1, wp.types.matrix(shape=(size, size), dtype=float))
        self.command = compute.output(1, vec)
        self._stats = compute.output(1, WeightStats)
        self._counter = wp.zeros(1, dtype=int, device=device)
        bound = wp.array(dynamics.bound[None].astype(np.float32), dtype=vec, device=device)
        basis = wp.array(noise_basis(horizon, settings.knots).astype(np.float32), dtype=float, device=device)
        few, many = (share * samples for share in settings.effective_samples)

        rollout = dynamics.rollout(self.controls, self.costs)
        weigh = compute.launch_blocks(
            weigh_samples, None, [self.costs, settings.temperature, few, many], [self.weights, self._stats.array]
        )
        update = compute.launch_blocks(
            make_update_nominal(size), horizon, [self.controls, self.weights], [self.nominal]
        )
        self.improve: list[Launch] = []
        for i in range(settings.iterations):
            inputs = [self.nominal, self.noise.array, basis, bound, self._counter, seed + 104729 * i]
            inputs.append(int(settings.special_samples))
            sample = compute.launch_samples(make_sample_controls(size), samples, inputs, [self.controls])
            self.improve += [sample, rollout, weigh, update]
        self.shift = compute.launch(make_shift_nominal(size), 1, [1], [self.nominal, self._counter, self.command.array])

    def found(self) -> Update:
        """What the latest update found, once the host has its outputs."""
        found = self._stats.host[0]
        least, temperature, effective, lost = (
            found[name].item() for name in ("min_cost", "temperature", "effective_samples", "lost")
        )
        return Update(least if lost < self._settings.samples else math.nan, temperature, effective, lost)

    def reset(self) -> None:
        """Forgets the nominal and begins the noise anew."""
        self.nominal.zero_()
        self._stats.array.zero_()
        self._counter.zero_()


def noise_basis(horizon: int, knots: int) -> np.ndarray:
    """What each knot adds to the noise of each step, shape [horizon, knots].

    Knots stand evenly over the horizon and are joined by a natural cubic spline; each step keeps unit variance. With
    ``knots=0`` every step is its own knot: white noise, as the paper has it.
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
