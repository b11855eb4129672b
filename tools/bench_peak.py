"""Operation counts of the rollout kernel of an upright arm, and the measured peak performance of a core."""

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


def operations_per_step() -> dict[str, int]:
    """Return the minimum number of floating-point operations in a step of an upright arm's rollout, by part of it.

    Counted by hand in the source, for plain MPPI with a cost-to-go and two contact steps; a sine, cosine, root or
    division counts as one. Excluded is what a step without contact does not do: pushing, settling, and keeping off.
    """
    turn, length, plane, space, pose, pose_gradient, angle = 10, 4, 23, 30, 32, 55, 24  # with their look-ups
    return {
        "tip": (space + 4) + 3 + (length + 14) + 11,
        "clearance": space + 4,
        "approach": turn + plane + 3 + length + 10,
        "contact, looked for": 12 + 2 * (turn + 3 + plane + 1),
        "stance": 8 + pose_gradient + 14 + 2 * (turn - 2) + (4 + 2 * angle + length + 8 + 15 * 3),
        "costs": pose + 11 + 6 + 11 + 12 + 9 + 14 + 3 + 3 + 1 + 20 + 6 + 8 + 2 + 12 + 17,
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
