"""Operation counts of the fused rollout kernel, and the measured peak performance of a core."""

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
    """Computes independent chains of multiply-adds, enough of them to hide the latency of an operation."""
    i = wp.tid()
    a = offset * float(i)  # pyright: ignore
    for _ in range(1000):
        a = wp.cw_mul(a, factor) + offset
    out[i] = wp.dot(a, factor)  # pyright: ignore


def operations_per_step(joints: int) -> dict[str, int]:
    """Return the minimum number of floating-point operations in one simulated step, by part of the kernel.

    Counted by hand in the source; a sine, cosine, root, arc tangent or division counts as one. Pose-dependent work is
    excluded: spheres of links near the table or obstacles, look-ups, contact and settling.
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
    """Measure operations per second of one core in a Warp kernel, with chains of multiply-adds [1/s]."""
    out = wp.zeros(200, dtype=float, device="cpu")
    found = []
    for _ in range(7):
        began = time.perf_counter()
        wp.launch(chains, dim=200, inputs=[_Chains(0.999), _Chains(0.5)], outputs=[out], device="cpu")
        found.append(200 * _CHAINS * _LENGTH * 2 / (time.perf_counter() - began))
    return statistics.median(found[2:])


def vector_peak() -> float:
    """Measure operations per second of one core with its vector units, by a single-precision matrix product [1/s]."""
    a = np.random.default_rng(0).random((768, 768), dtype=np.float32)
    found = []
    for _ in range(9):
        began = time.perf_counter()
        np.dot(a, a)
        found.append(2 * 768**3 / (time.perf_counter() - began))
    return statistics.median(found[2:])
