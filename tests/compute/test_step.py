"""Steps: launches over the same samples run in the same thread, one after another."""

from __future__ import annotations

import threading

import numpy as np
import pytest
import warp as wp

from oimppi_warp.compute.step import Compute, in_order, samples_block

COUNT = 1001


@wp.kernel
def square(first: int, numbers: wp.array[float], squares: wp.array[float]):
    """Writes the squares of numbers."""
    k = first + wp.tid()
    squares[k] = numbers[k] * numbers[k]


@wp.kernel
def add_one(first: int, squares: wp.array[float], sums: wp.array[float]):
    """Adds one."""
    k = first + wp.tid()
    sums[k] = squares[k] + 1.0


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("nested", [False, True])
def test_launches_over_samples_see_what_those_before_them_wrote(threads: int, nested: bool):
    compute = Compute("cpu", threads=threads)
    numbers = wp.array(np.arange(COUNT), dtype=float, device="cpu")
    squares, sums, again = (wp.zeros(COUNT, dtype=float, device="cpu") for _ in range(3))
    launches = [
        compute.launch_samples(square, COUNT, [numbers], [squares]),
        compute.launch_samples(add_one, COUNT, [squares], [sums]),
        compute.launch(add_one, COUNT, [0, sums], [again]),
    ]
    compute.step([in_order(launches[:2]), launches[2]] if nested else launches)()
    np.testing.assert_array_equal(again.numpy(), np.arange(COUNT, dtype=np.float32) ** 2 + 2.0)


def test_a_kernel_that_threads_run_at_once_is_compiled_once(tmp_path, monkeypatch):
    from warp._src import build

    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    compiled, build_cpu = [], build.build_cpu
    monkeypatch.setattr(build, "build_cpu", lambda *given, **also: compiled.append(given) or build_cpu(*given, **also))
    square.module.unload()
    compute = Compute("cpu", threads=4)
    numbers = wp.array(np.arange(COUNT), dtype=float, device="cpu")
    squares = wp.zeros(COUNT, dtype=float, device="cpu")
    compute.run(compute.launch_samples(square, COUNT, [numbers], [squares]))
    np.testing.assert_array_equal(squares.numpy(), np.arange(COUNT, dtype=np.float32) ** 2)
    assert len(compiled) == 1


def test_threads_meet_once_for_launches_over_the_same_samples(monkeypatch):
    compute = Compute("cpu", threads=2)
    numbers = wp.array(np.arange(COUNT), dtype=float, device="cpu")
    first, second = (wp.zeros(COUNT, dtype=float, device="cpu") for _ in range(2))
    few = wp.zeros(7, dtype=float, device="cpu")
    launches = [
        compute.launch_samples(square, COUNT, [numbers], [first]),
        compute.launch_samples(add_one, COUNT, [first], [second]),
        compute.launch_samples(square, 7, [numbers], [few]),
    ]
    shares = type(launches[0])
    meetings: list[str] = []
    run = shares.__call__
    monkeypatch.setattr(shares, "__call__", lambda self: (meetings.append(threading.current_thread().name), run(self)))
    compute.step(launches)()
    assert len(meetings) == 2  # one for the two launches over all samples, one for the few
    np.testing.assert_array_equal(second.numpy(), np.arange(COUNT, dtype=np.float32) ** 2 + 1.0)
    np.testing.assert_array_equal(few.numpy(), np.arange(7) ** 2)


def test_few_samples_spread_over_many_blocks_and_many_fill_them():
    sizes = [samples_block(count) for count in (1, 1200, 2000, 5000, 20000)]
    assert sizes == [4, 4, 8, 16, 32]
