"""Weights of the samples, the update of the nominal controls, and their shift by one step."""

from functools import lru_cache

import warp as wp

wp.set_module_options({"enable_backward": False})

LOST = wp.constant(1.0e30)
"""Cost from which a sample counts as lost: it gets no weight."""


@wp.struct
class WeightStats:
    """Statistics of one weighting of the samples.

    Attributes:
        min_cost: Smallest cost.
        temperature: The lambda that was used.
        effective_samples: Effective sample size, 1 / sum of squared weights.
        lost: Number of samples whose cost was not finite.
    """

    min_cost: float
    temperature: float
    effective_samples: float
    lost: int


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
    """Computes the softmin weights of the costs, which sum to one; launched with one block (on the CPU: one thread).

    ``omega_k = exp(-(S_k - S_min) / lambda) / sum_j exp(-(S_j - S_min) / lambda)`` (equation 12), with the costs S, the
    smallest of them S_min and the temperature lambda.

    If ``most`` is above zero, the temperature is adjusted until the effective sample size lies in [fewest, most].
    A sample whose cost is not finite is lost; if all are lost, all weights are zero. Shapes: ``costs`` and
    ``weights`` [sample], ``stats`` [1].
    """
    i = wp.tid()
    count = costs.shape[0]
    stride = wp.block_dim()
    low = float(LOST)
    lost = int(0)
    for k in range(i, count, stride):
        c = costs[k]
        if wp.isfinite(c) and c < LOST:
            low = wp.min(low, c)
        else:
            lost += 1
    low = wp.tile_min(wp.tile(low))[0]
    lost = wp.tile_sum(wp.tile(lost))[0]

    heat = stats[0].temperature
    if most <= 0.0 or heat <= 0.0:
        heat = temperature
    tries = int(1)
    if most > 0.0 and low < LOST:
        tries = 13
    total = float(0.0)
    effective = float(0.0)
    for t in range(tries):
        part = wp.vec2()  # this thread's share of the sums of the weights and of their squares
        for k in range(i, count, stride):
            c = costs[k]
            w = float(0.0)
            if wp.isfinite(c) and c < LOST:
                w = wp.exp((low - c) / heat)
            weights[k] = w
            part = part + wp.vec2(w, w * w)
        sums = wp.tile_reduce(wp.add, wp.tile(part, preserve_type=True))[0]
        total = sums[0]
        if sums[1] > 0.0:
            effective = sums[0] * sums[0] / sums[1]
        if t + 1 < tries:
            # Equal costs would drive the temperature to zero.
            if effective < fewest:
                heat = wp.clamp(heat * 1.3, 1.0e-4, 1.0e6)
            elif effective > most:
                heat = wp.clamp(heat / 1.3, 1.0e-4, 1.0e6)
            else:
                break
    if total > 0.0:
        for k in range(i, count, stride):
            weights[k] = weights[k] / total

    if i == 0:
        out = WeightStats()
        out.min_cost = low
        out.temperature = heat
        out.lost = lost
        out.effective_samples = effective
        stats[0] = out


@lru_cache
def make_update_nominal(size: int) -> wp.Kernel:
    """Returns the kernel that updates a nominal of controls of ``size`` numbers."""
    vec = wp.types.vector(length=size, dtype=float)

    @wp.kernel(module=f"oimppi_warp.kernels.update_nominal_{size}", enable_backward=False)
    def update_nominal(
        # in:
        controls: wp.array2d[vec],
        weights: wp.array[float],
        # out:
        nominal: wp.array[vec],
    ):
        """Sets the nominal to the weighted mean of the samples' controls, or to zero if every sample was lost.

        Equation 11 is ``u_nominal <- u_nominal + sum_k omega_k eps_k``. As the weights sum to one, this is the mean
        ``sum_k omega_k u_k`` of the samples ``u_k = u_nominal + eps_k``, apart from clipping. One block per step.
        Shapes: ``controls`` [sample, horizon], ``weights`` [sample], ``nominal`` [horizon].
        """
        h, i = wp.tid()
        mean = vec()
        for k in range(i, weights.shape[0], wp.block_dim()):
            w = weights[k]
            if w > 1.0e-9:
                mean = mean + w * controls[k, h]
        total = wp.tile_reduce(wp.add, wp.tile(mean, preserve_type=True))
        if i == 0:
            nominal[h] = total[0]

    return update_nominal


@lru_cache
def make_shift_nominal(size: int) -> wp.Kernel:
    """Returns the kernel that shifts a nominal of controls of ``size`` numbers by one step."""
    vec = wp.types.vector(length=size, dtype=float)

    @wp.kernel(module=f"oimppi_warp.kernels.shift_nominal_{size}", enable_backward=False)
    def shift_nominal(
        # in:
        repeat_last: int,
        # out:
        nominal: wp.array[vec],
        counter: wp.array[int],
        taken: wp.array[vec],
    ):
        """Removes the first control and repeats the last (or appends zero); launched with one thread.

        This is ``U <- shift(U)`` of Algorithm 2, line 7, and of Algorithm 3, lines 6 and 13.
        """
        taken[0] = nominal[0]
        last = nominal.shape[0] - 1
        for h in range(last):
            nominal[h] = nominal[h + 1]
        if repeat_last == 0:
            nominal[last] = vec()
        counter[0] = counter[0] + 1

    return shift_nominal
