"""The device that tests compute on: one place for fixtures and helpers.

It is the CPU, or what the environment variable ``OIMPPI_TEST_DEVICE`` names: ``cuda:0``, or ``emulated-gpu`` to run
them as on a GPU, slowly, without one. Tests about the CPU itself (threads, MuJoCo's C engine, bits of a CPU plan, other
processes) name ``"cpu"`` and stay there.
"""

from __future__ import annotations

import os

import numpy as np
import pytest
import warp as wp
from warp._src import context

from oimppi_warp.compute.device import EMULATED_GPU, pick_device
from oimppi_warp.compute.step import BLOCK as GPU_BLOCK
from oimppi_warp.compute.step import Compute, Launch

_ASKED = os.environ.get("OIMPPI_TEST_DEVICE", "")
DEVICE = pick_device(_ASKED) if _ASKED else "cpu"
"""Warp's name of the device."""
ON_CPU = DEVICE == "cpu"
BLOCK = 1 if ON_CPU else GPU_BLOCK
"""Threads of a block, as a planner launches them on that device."""
if DEVICE == EMULATED_GPU:  # tests name one device for arrays and planners, so Warp has to know this name too
    context.runtime.device_map[EMULATED_GPU] = wp.get_device("cpu")
    wp.config.enable_cpu_blocks = True

to_the_bit = pytest.mark.skipif(not ON_CPU, reason="the same seed gives the same bits on the CPU only")


def run(compute: Compute, *launches: Launch) -> None:
    """Runs launches as a control step does: with the copy of what the host wrote before, and of what it reads after."""
    compute.step(launches, one_graph=False)()


def assert_same(found: np.ndarray, expected: np.ndarray, *, cuda: float) -> None:
    """Asserts that arrays are equal: to the bit on the CPU, within a relative and absolute tolerance on CUDA."""
    if ON_CPU:
        np.testing.assert_array_equal(found, expected)
    else:
        np.testing.assert_allclose(found, expected, rtol=cuda, atol=cuda)
