"""The cross-entropy method (CEM), a second optimizer beside the paper's MPPI."""

from __future__ import annotations

from collections.abc import Sequence

import warp as wp

from oimppi_warp.compute.step import Launch
from oimppi_warp.config import settings
from oimppi_warp.kernels.optimizers.cem import make_refit, make_sample_deviating, make_shift_deviation, select_elites
from oimppi_warp.planning.engines.dynamics import Dynamics
from oimppi_warp.planning.optimizers.optimizer import Optimizer


class Cem(Optimizer):
    """Refits mean and standard deviation of the samples to the cheapest of them, the elites E.

    Samples are ``u_h = mu_h + root (s_h * e_h)`` with the nominal ``mu``, a square root ``root`` of Sigma_u, standard
    normal ``e`` and a deviation ``s`` for each step and axis of the noise (each control, where Sigma_u is diagonal). An
    update is ``mu <- a mu + (1 - a) mean_E(u)`` and ``s <- a s + (1 - a) std_E(s e)``, with the smoothing ``a`` and
    ``s`` kept within the least deviation and one.

    Attributes:
        deviation: The deviations s, [horizon] of vectors.
    """

    Settings = settings.Cem
    one_graph = True

    def __init__(self, dynamics: Dynamics, settings: settings.Cem, *, seed: int) -> None:
        super().__init__(dynamics, settings, seed=seed)
        self._settings = settings
        self._perturbations = wp.zeros_like(self.controls)
        self.deviation = wp.zeros_like(self.nominal)
        self._restart()

    def sample(self, seed: int) -> Sequence[Launch]:
        """Prepares drawing with the current deviations; see :meth:`Optimizer.sample`."""
        kernel = make_sample_deviating(self.dynamics.size)
        inputs = [self.nominal, self.deviation, self.noise.array, self.basis, self.bound, self.counter, seed]
        inputs += [int(self.settings.special_samples), self.settings.least_noise]
        outputs = [self.controls, self._perturbations]
        return [self.compute.launch_samples(kernel, self.settings.samples, inputs, outputs)]

    def update(self) -> Sequence[Launch]:
        """Prepares choosing the elites and refitting to them; see :meth:`Optimizer.update`."""
        settings = self._settings
        elites = max(round(settings.elites * settings.samples), 1)
        select = self.compute.launch_blocks(select_elites, None, [self.costs, elites], [self.weights, self.stats.array])
        inputs = [self.controls, self._perturbations, self.weights, settings.smoothing, settings.least_deviation]
        kernel = make_refit(self.dynamics.size)
        refit = self.compute.launch_blocks(kernel, settings.horizon, inputs, [self.nominal, self.deviation])
        return [select, refit]

    def advance(self) -> Sequence[Launch]:
        """Prepares shifting nominal and deviations by one step; the last deviation is reset."""
        kernel = make_shift_deviation(self.dynamics.size)
        deviation = self.compute.launch(kernel, 1, [self._settings.recovery], [self.deviation])
        return [*super().advance(), deviation]

    def forget(self) -> None:
        """Sets the nominal to zero and the deviations to one."""
        super().forget()
        self._restart()

    def _restart(self) -> None:
        self.deviation.fill_(1.0)
