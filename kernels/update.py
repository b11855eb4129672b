"""Weights of the samples and the update of the nominal controls (equations 11 and 12)."""

from functools import lru_cache

import warp as wp

wp.set_module_options({"enable_backward": False})

LOST = wp.constant(1.0e30)
"""Cost from which a sample counts as lost: it gets no weight."""


@wp.struct
class WeightStats:
    """What one weighting found.

    Attributes:
        min_cost: Smallest cost.
        temperature: lambda that was used.
        effective_samples: Effective sample size, 1 / sum of squared weights.
        lost: Number of samples whose cost was not finite.
    """

    min_cost: float
    temperature: float
    effective_samples: float
    lost: int


@wp.func
def effective_samples(costs: wp.array[float], low: float, temperature: float) -> float:
    """Effective sample size at a temperature."""
    total = float(0.0)
    squares = float(0.0)
    for k in range(costs.shape[0]):
        c = costs[k]
        if c < LOST:
            w = wp.exp((low - c) / temperature)
            total += w
            squares += w * w
    return total * total / wp.max(squares, 1.0e-30)


@wp.kernel
def weigh_samples(
    # in:
    costs: wp.array[float],
    temperature: float,
    fewest: float,
    most: float,
    # out:
    weights: wp.array[float],
    stats: wp.array[WeightStats],
):
    """Softmin weights of the costs, summing to one; launched with one thread.

    Where ``most`` is above zero, the temperature is moved until the effective sample size lies in [fewest, most].
    A cost that is not finite loses its sample; when all are lost, all weights are zero. Shapes: ``costs`` and
    ``weights`` [sample], ``stats`` [1].
    """
    low = float(LOST)
    lost = int(0)
    for k in range(costs.shape[0]):
        c = costs[k]
        if wp.isfinite(c) and c < LOST:
            low = wp.min(low, c)
        else:
            lost += 1

    heat = stats[0].temperature
    if most <= 0.0 or heat <= 0.0:
        heat = temperature
    if most > 0.0 and low < LOST:
        for _ in range(12):
            found = effective_samples(costs, low, heat)
            if found < fewest:
                heat *= 1.3
            elif found > most:
                heat /= 1.3
            else:
                break
        heat = wp.clamp(heat, 1.0e-4, 1.0e6)  # equal costs would wind it to nothing

    total = float(0.0)
    squares = float(0.0)
    for k in range(costs.shape[0]):
        c = costs[k]
        w = float(0.0)
        if wp.isfinite(c) and c < LOST:
            w = wp.exp((low - c) / heat)
        weights[k] = w
        total += w
        squares += w * w
    if total > 0.0:
        for k in range(costs.shape[0]):
            weights[k] = weights[k] / total

    out = WeightStats()
    out.min_cost = low
    out.temperature = heat
    out.lost = lost
    out.effective_samples = 0.0
    if squares > 0.0:
        out.effective_samples = total * total / squares
    stats[0] = out


@lru_cache
def make_update_nominal(size: int) -> wp.Kernel:
    """The update kernel for controls of ``size`` numbers."""
    vec = wp.types.vector(length=size, dtype=float)

    @wp.kernel(module=f"oimppi_warp.kernels.update_nominal_{size}", enable_backward=False)
    def update_nominal(
        # in:
        controls: wp.array2d[vec],
        weights: wp.array[float],
        # out:
        nominal: wp.array[vec],
    ):
        """The weighted mean of the samples' controls; zero where every sample was lost.

        Since weights sum to one, this is the nominal plus the weighted perturbations of equation 11.
        Shapes: ``controls`` [sample, horizon], ``weights`` [sample], ``nominal`` [horizon].
        """
        h = wp.tid()
        mean = vec()
        for k in range(weights.shape[0]):
            w = weights[k]
            if w > 1.0e-9:
                mean = mean + w * controls[k, h]
        nominal[h] = mean

    return update_nominal


@lru_cache
def make_shift_nominal(size: int) -> wp.Kernel:
    """The kernel that moves a nominal of controls of ``size`` numbers on by one step."""
    vec = wp.types.vector(length=size, dtype=float)

    @wp.kernel(module=f"oimppi_warp.kernels.shift_nominal_{size}", enable_backward=False)
    def shift_nominal(
        # in:
        repeat_last: int,
        # out:
        nominal: wp.array[vec],
        counter: wp.array[int],
    ):
        """Drops the first control and repeats the last (or ends with zero); launched with one thread."""
        last = nominal.shape[0] - 1
        for h in range(last):
            nominal[h] = nominal[h + 1]
        if repeat_last == 0:
            nominal[last] = vec()
        counter[0] = counter[0] + 1

    return shift_nominal
