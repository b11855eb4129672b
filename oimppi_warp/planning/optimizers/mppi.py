"""MPPI (the paper's Algorithm 1)."""

from __future__ import annotations

from collections.abc import Sequence

from oimppi_warp.compute.step import Launch
from oimppi_warp.config import settings
from oimppi_warp.kernels.optimizers.update import make_update_nominal, weigh_samples
from oimppi_warp.planning.engines.dynamics import Dynamics
from oimppi_warp.planning.optimizers.optimizer import Optimizer


class Mppi(Optimizer):
    """Sets the nominal to the mean of the samples, weighted by ``w_k ~ exp(-(S_k - min S) / lambda)``.

    ``S_k`` is a sample's cost and lambda the temperature; the weights are those of equation 12, the mean is the update
    of equation 11. With :meth:`Optimizer.improve`, which samples and rolls out before, this is Algorithm 1.
    """

    Settings = settings.Mppi
    one_graph = True

    def __init__(self, dynamics: Dynamics, settings: settings.Mppi, *, seed: int) -> None:
        super().__init__(dynamics, settings, seed=seed)
        self._settings = settings

    def update(self) -> Sequence[Launch]:
        """Prepares the weights and the weighted mean (Algorithm 1, line 7); see :meth:`Optimizer.update`."""
        settings = self._settings
        few, many = (share * settings.samples for share in settings.effective_samples)
        weigh = self.compute.launch_blocks(
            weigh_samples, None, [self.costs, settings.temperature, few, many], [self.weights, self.stats.array]
        )
        update = self.compute.launch_blocks(
            make_update_nominal(self.dynamics.size), settings.horizon, [self.controls, self.weights], [self.nominal]
        )
        return [weigh, update]
