"""The cross-entropy method: sampling with a deviation per step and axis, choosing the elites, and refitting to them."""

from functools import lru_cache

import warp as wp

from oimppi_warp.kernels.optimizers.update import LOST, WeightStats

wp.set_module_options({"enable_backward": False})

LOST_RANK = wp.constant(wp.uint32(0xFFFFFFFF))
"""Rank of a lost sample: above all others."""
HIGHEST_BIT = wp.constant(wp.uint32(0x80000000))


@wp.func
def rank_of(cost: float) -> wp.uint32:
    """Maps a cost of either sign to an unsigned number of the same order; a lost sample gets the largest."""
    if not wp.isfinite(cost) or cost >= LOST:
        return LOST_RANK
    bits = wp.cast(cost, wp.uint32)
    if bits >= HIGHEST_BIT:
        return ~bits
    return bits | HIGHEST_BIT


@wp.kernel
def select_elites(
    # in:
    costs: wp.array[float],
    elites: int,
    # out:
    weights: wp.array[float],
    stats: wp.array[WeightStats],
):
    """Gives the cheapest samples equal weights that sum to one; launched with one block (on the CPU: one thread).

    Lost samples are never chosen; if fewer than wanted remain, all of those are chosen. Samples that tie with the last
    of the chosen share the remaining weight, so that their order does not matter. Shapes: ``costs`` and ``weights``
    [sample], ``stats`` [1].
    """
    i = wp.tid()
    count = costs.shape[0]
    stride = wp.block_dim()
    low = float(LOST)
    kept = int(0)
    for k in range(i, count, stride):
        c = costs[k]
        if wp.isfinite(c) and c < LOST:
            low = wp.min(low, c)
            kept += 1
    low = wp.tile_min(wp.tile(low))[0]
    kept = wp.tile_sum(wp.tile(kept))[0]
    wanted = wp.min(elites, kept)

    # The rank of the last elite, found bit by bit: the largest with fewer than ``wanted`` ranks below it.
    last = wp.uint32(0)
    bit = wp.uint32(HIGHEST_BIT)
    for _ in range(32):
        tried = last | bit
        part = int(0)
        for k in range(i, count, stride):
            if rank_of(costs[k]) < tried:
                part += 1
        if wp.tile_sum(wp.tile(part))[0] < wanted:
            last = tried
        bit = bit >> wp.uint32(1)

    ends = wp.vec2i()  # number of samples below the last elite's rank, and at it
    for k in range(i, count, stride):
        rank = rank_of(costs[k])
        if rank < last:
            ends = ends + wp.vec2i(1, 0)
        elif rank == last:
            ends = ends + wp.vec2i(0, 1)
    found = wp.tile_reduce(wp.add, wp.tile(ends, preserve_type=True))[0]
    each = float(0.0)
    shared = float(0.0)
    if wanted > 0:
        each = 1.0 / float(wanted)
        shared = each * float(wanted - found[0]) / float(found[1])
    for k in range(i, count, stride):
        rank = rank_of(costs[k])
        w = float(0.0)
        if rank < last:
            w = each
        elif rank == last:
            w = shared
        weights[k] = w

    if i == 0:
        out = WeightStats()
        out.min_cost = low
        out.temperature = 0.0
        out.lost = count - kept
        out.effective_samples = 0.0
        if wanted > 0:
            out.effective_samples = 1.0 / (float(found[0]) * each * each + float(found[1]) * shared * shared)
        stats[0] = out


@lru_cache
def make_sample_deviating(size: int) -> wp.Kernel:
    """Returns the kernel that samples controls of ``size`` numbers with a deviation for each step and axis."""
    vec = wp.types.vector(length=size, dtype=float)
    mat = wp.types.matrix(shape=(size, size), dtype=float)

    @wp.kernel(module=f"oimppi_warp.kernels.sample_deviating_{size}", enable_backward=False)
    def sample_deviating(
        # in:
        first: int,
        nominal: wp.array[vec],
        deviation: wp.array[vec],
        noise_map: wp.array[mat],
        basis: wp.array2d[float],
        bound: wp.array[vec],
        counter: wp.array[int],
        seed: int,
        special: int,
        least_noise: float,
        # out:
        controls: wp.array2d[vec],
        perturbations: wp.array2d[vec],
    ):
        """Samples ``u = clip(nominal + noise_map e)`` with ``e = scale deviation (basis z)`` and standard normal ``z``.

        The samples' ``scale`` falls from 1 to ``least_noise`` in geometric progression. If ``special`` is 1, the first
        two samples are the nominal and zero; they count as unperturbed. Shapes: ``nominal`` and ``deviation``
        [horizon], ``noise_map`` [1] (a square root of Sigma_u), ``basis`` [horizon, knot], ``bound`` [1], ``counter``
        [1] (plans made so far: each draws its own noise), ``controls`` and ``perturbations`` (e) [sample, horizon].
        """
        k = first + wp.tid()
        horizon = controls.shape[1]
        for h in range(horizon):
            perturbations[k, h] = vec()
        if special == 1 and k < 2:
            for h in range(horizon):
                if k == 0:
                    controls[k, h] = nominal[h]
                else:
                    controls[k, h] = vec()
        else:
            state = wp.rand_init(seed + 7919 * counter[0], k)
            limit = bound[0]
            scale = wp.pow(least_noise, float(k) / float(controls.shape[0]))
            for j in range(basis.shape[1]):
                z = vec()
                for i in range(size):
                    z[i] = wp.randn(state)
                if basis.shape[1] == horizon:  # white noise: one knot per step
                    perturbations[k, j] = z
                else:
                    for h in range(horizon):
                        perturbations[k, h] = perturbations[k, h] + basis[h, j] * z
            for h in range(horizon):
                e = scale * wp.cw_mul(deviation[h], perturbations[k, h])
                perturbations[k, h] = e
                u = nominal[h] + noise_map[0] * e
                for i in range(size):
                    u[i] = wp.clamp(u[i], -limit[i], limit[i])
                controls[k, h] = u

    return sample_deviating


@lru_cache
def make_refit(size: int) -> wp.Kernel:
    """Returns the kernel that fits mean and deviation to the elites, for controls of ``size`` numbers."""
    vec = wp.types.vector(length=size, dtype=float)

    @wp.kernel(module=f"oimppi_warp.kernels.refit_{size}", enable_backward=False)
    def refit(
        # in:
        controls: wp.array2d[vec],
        perturbations: wp.array2d[vec],
        weights: wp.array[float],
        smoothing: float,
        least: float,
        # out:
        nominal: wp.array[vec],
        deviation: wp.array[vec],
    ):
        """Moves nominal and deviation towards the elites' mean and standard deviation; one block per step.

        ``smoothing`` is the share of the old values that is kept; the deviation stays between ``least`` and one. If all
        samples were lost, the nominal becomes zero and the deviation one. Shapes: ``controls`` and ``perturbations``
        [sample, horizon], ``weights`` [sample], ``nominal`` and ``deviation`` [horizon].
        """
        h, i = wp.tid()
        mean = vec()
        shift = vec()
        total = float(0.0)
        for k in range(i, weights.shape[0], wp.block_dim()):
            w = weights[k]
            if w > 0.0:
                mean = mean + w * controls[k, h]
                shift = shift + w * perturbations[k, h]
                total += w
        mean = wp.tile_reduce(wp.add, wp.tile(mean, preserve_type=True))[0]
        shift = wp.tile_reduce(wp.add, wp.tile(shift, preserve_type=True))[0]
        total = wp.tile_sum(wp.tile(total))[0]
        spread = vec()
        for k in range(i, weights.shape[0], wp.block_dim()):
            w = weights[k]
            if w > 0.0:
                apart = perturbations[k, h] - shift
                spread = spread + w * wp.cw_mul(apart, apart)
        spread = wp.tile_reduce(wp.add, wp.tile(spread, preserve_type=True))[0]
        if i == 0:
            fitted = vec()
            for j in range(size):
                fitted[j] = 1.0
            if total > 0.0:
                nominal[h] = smoothing * nominal[h] + (1.0 - smoothing) * mean
                for j in range(size):
                    moved = smoothing * deviation[h][j] + (1.0 - smoothing) * wp.sqrt(spread[j])
                    fitted[j] = wp.clamp(moved, least, 1.0)
            else:
                nominal[h] = vec()
            deviation[h] = fitted

    return refit


@lru_cache
def make_shift_deviation(size: int) -> wp.Kernel:
    """Returns the kernel that shifts the deviations of controls of ``size`` numbers by one step."""
    vec = wp.types.vector(length=size, dtype=float)

    @wp.kernel(module=f"oimppi_warp.kernels.shift_deviation_{size}", enable_backward=False)
    def shift_deviation(
        # in:
        recovery: float,
        # out:
        deviation: wp.array[vec],
    ):
        """Drops the first deviation, sets the last to one and relaxes all towards one; launched with one thread.

        Shape: ``deviation`` [horizon].
        """
        one = vec()
        for j in range(size):
            one[j] = 1.0
        last = deviation.shape[0] - 1
        for h in range(last):
            deviation[h] = deviation[h + 1] + recovery * (one - deviation[h + 1])
        deviation[last] = one

    return shift_deviation
