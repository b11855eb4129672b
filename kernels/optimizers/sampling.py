"""Sampling of perturbed control sequences around a nominal one."""

from functools import lru_cache

import warp as wp

from oimppi_warp.kernels.options import fast_module

wp.set_module_options({"enable_backward": False})


@lru_cache
def make_sample_controls(size: int, knots: int) -> wp.Kernel:
    """Returns the kernel that samples controls around a nominal.

    Args:
        size: Number of entries of a control.
        knots: Number of knots of the noise; 0 draws the noise of every step independently.
    """
    vec = wp.types.vector(length=size, dtype=float)
    mat = wp.types.matrix(shape=(size, size), dtype=float)
    share_of_knots = wp.types.vector(length=max(knots, 1), dtype=float)
    rows = wp.types.matrix(shape=(max(knots, 1), size), dtype=float)

    @wp.kernel(module=fast_module(f"sample_controls_{size}_{knots}"), enable_backward=False)
    def sample_controls(
        # in:
        first: int,
        nominal: wp.array[vec],
        noise_map: wp.array[mat],
        basis: wp.array2d[float],
        bound: wp.array[vec],
        counter: wp.array[int],
        seed: int,
        special: int,
        least_noise: float,
        # out:
        controls: wp.array2d[vec],
    ):
        """Draws samples around the nominal: ``u = u_nominal + eps`` with ``eps ~ N(0, Sigma_u)`` (equation 9).

        ``eps = scale basis noise_map z`` with standard normal ``z`` for every knot, and ``u`` is clipped to ``bound``.
        The samples' ``scale`` falls from 1 to ``least_noise`` in geometric progression. If ``special`` is 1, the first
        two samples are the nominal and zero. Shapes: ``nominal`` [horizon], ``noise_map``
        [1] (a square root of Sigma_u), ``basis`` [horizon, knot] (not read without knots), ``bound`` [1],
        ``counter`` [1] (plans made so far: each draws its own noise), ``controls`` [sample, horizon].
        """
        k = first + wp.tid()
        horizon = controls.shape[1]
        if special == 1 and k < 2:
            for h in range(horizon):
                if k == 0:
                    controls[k, h] = nominal[h]
                else:
                    controls[k, h] = vec()
        else:
            state = wp.rand_init(seed + 7919 * counter[0], k)
            limit = bound[0]
            root = noise_map[0]
            scale = wp.pow(least_noise, float(k) / float(controls.shape[0]))
            shifts = rows()
            for j in range(wp.static(knots)):
                z = vec()
                for i in range(size):
                    z[i] = wp.randn(state)
                shift = scale * (root * z)
                for i in range(size):
                    shifts[j, i] = shift[i]
            mean = nominal[0]
            share = share_of_knots()
            for j in range(wp.static(knots)):
                share[j] = basis[0, j]
            for h in range(horizon):
                u = mean
                for j in range(wp.static(knots)):
                    for i in range(size):
                        u[i] = u[i] + share[j] * shifts[j, i]
                after = wp.min(h + 1, horizon - 1)  # read a step early, since a GPU waits for memory
                mean = nominal[after]
                for j in range(wp.static(knots)):
                    share[j] = basis[after, j]
                if wp.static(knots == 0):
                    z = vec()
                    for i in range(size):
                        z[i] = wp.randn(state)
                    u = u + scale * (root * z)
                for i in range(size):
                    u[i] = wp.clamp(u[i], -limit[i], limit[i])
                controls[k, h] = u

    return sample_controls
