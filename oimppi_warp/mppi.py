"""MPPI (the paper's Algorithm 1): sample, roll out, weigh, update, shift. It knows neither robot nor object."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import warp as wp

from oimppi_warp import config
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
        nominal: The nominal control sequence, [horizon] of vectors, on the device.
        controls: The samples of the latest update, [sample, horizon] of vectors.
        costs, weights: Their costs and weights, [sample].
    """

    def __init__(self, dynamics: Dynamics, settings: config.Mppi, *, seed: int) -> None:
        self._dynamics = dynamics
        self._settings = settings
        self._seed = seed
        size, device = dynamics.size, dynamics.device
        vec = control_type(size)
        samples, horizon = settings.samples, settings.horizon
        self.nominal = wp.zeros(horizon, dtype=vec, device=device)
        self.controls = wp.zeros((samples, horizon), dtype=vec, device=device)
        self.costs = wp.zeros(samples, dtype=float, device=device)
        self.weights = wp.zeros(samples, dtype=float, device=device)
        self._stats = wp.zeros(1, dtype=WeightStats, device=device)  # pyright: ignore[reportArgumentType]
        self._counter = wp.zeros(1, dtype=int, device=device)
        self._bound = wp.array(dynamics.bound[None].astype(np.float32), dtype=vec, device=device)
        self._basis = wp.array(noise_basis(horizon, settings.knots).astype(np.float32), dtype=float, device=device)
        matrix = wp.types.matrix(shape=(size, size), dtype=float)
        self._noise_map = wp.zeros(1, dtype=matrix, device=device)
        self._sample = make_sample_controls(size)
        self._update = make_update_nominal(size)
        self._shift = make_shift_nominal(size)

    def set_noise(self, root: np.ndarray) -> None:
        """Sets the noise by a square root [m, m] of its covariance Sigma_u (``Sigma_u = root root^T``)."""
        self._noise_map.assign(np.asarray(root, dtype=np.float32)[None])

    def step(self) -> Update:
        """Improves the nominal from the dynamics' present state (equations 9 to 12)."""
        settings, device = self._settings, self._dynamics.device
        few, many = (share * settings.samples for share in settings.effective_samples)
        for i in range(settings.iterations):
            wp.launch(
                self._sample,
                dim=settings.samples,
                inputs=[
                    self.nominal,
                    self._noise_map,
                    self._basis,
                    self._bound,
                    self._counter,
                    self._seed + 104729 * i,
                    int(settings.special_samples),
                ],
                outputs=[self.controls],
                device=device,
            )
            self._dynamics.rollout(self.controls, self.costs)
            inputs = [self.costs, settings.temperature, few, many]
            wp.launch(weigh_samples, dim=1, inputs=inputs, outputs=[self.weights, self._stats], device=device)
            inputs = [self.controls, self.weights]
            wp.launch(self._update, dim=settings.horizon, inputs=inputs, outputs=[self.nominal], device=device)
        found = self._stats.numpy()[0]
        least, temperature, effective, lost = (
            found[name].item() for name in ("min_cost", "temperature", "effective_samples", "lost")
        )
        return Update(least if lost < settings.samples else math.nan, temperature, effective, lost)

    def shift(self) -> None:
        """Moves the nominal on by one step; the new last control repeats the one before."""
        outputs = [self.nominal, self._counter]
        wp.launch(self._shift, dim=1, inputs=[1], outputs=outputs, device=self._dynamics.device)

    def reset(self) -> None:
        """Forgets the nominal and begins the noise anew."""
        self.nominal.zero_()
        self._stats.zero_()
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
