"""The arithmetic of the fused rollout kernel, and what a core can do at the most."""

from __future__ import annotations

import statistics
import time

import numpy as np
import warp as wp

_CHAINS = 64
_LENGTH = 1000
_Chains = wp.types.vector(length=_CHAINS, dtype=float)


@wp.kernel(enable_backward=False)
def chains(factor: _Chains, offset: _Chains, out: wp.array[float]):  # type: ignore
    """Independent chains of multiply-adds, enough of them to hide how long one takes."""
    i = wp.tid()
    a = offset * float(i)  # pyright: ignore
    for _ in range(1000):
        a = wp.cw_mul(a, factor) + offset
    out[i] = wp.dot(a, factor)  # pyright: ignore


def operations_per_step(joints: int) -> dict[str, int]:
    """Floating-point operations that one simulated step does at the least, by part of the kernel.

    Counted in the source; a sine, cosine, root, arc tangent or division counts as one. Left out is what depends on
    where things are: spheres of links near table or obstacles, look-ups, contact and settling.
    """
    rotation_times_vector, rotation_times_rotation = 15, 45
    return {
        "integration": 9 * joints,
        "kinematics": joints * (3 + rotation_times_vector + rotation_times_rotation + 18 + 2),
        "room of whole links": 8 * joints,
        "tip and tilt": 3 + rotation_times_vector + rotation_times_vector,
        "contact, looked for": 2 * (8 + 12 + 20),
        "costs": 30 + 30 + 12 + 22 + 12 + 20 + 13,
    }


def kernel_peak() -> float:
    """Operations a second of one core in a Warp kernel, by chains of multiply-adds [1/s]."""
    out = wp.zeros(200, dtype=float, device="cpu")
    found = []
    for _ in range(7):
        began = time.perf_counter()
        wp.launch(chains, dim=200, inputs=[_Chains(0.999), _Chains(0.5)], outputs=[out], device="cpu")
        found.append(200 * _CHAINS * _LENGTH * 2 / (time.perf_counter() - began))
    return statistics.median(found[2:])


def vector_peak() -> float:
    """Operations a second of one core with its vector units, by a product of matrices in single precision [1/s]."""
    a = np.random.default_rng(0).random((768, 768), dtype=np.float32)
    found = []
    for _ in range(9):
        began = time.perf_counter()
        np.dot(a, a)
        found.append(2 * 768**3 / (time.perf_counter() - began))
    return statistics.median(found[2:])
