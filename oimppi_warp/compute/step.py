"""Where a planner computes: a device, the threads that it may use, and the memory that it shares with the host.

A control step is a fixed list of launches over fixed arrays. What changes from step to step goes in through *inputs*,
what the host wants to know comes out through *outputs*: on CUDA the step is one graph with one copy at either end, on
the CPU inputs and outputs are the host's own memory, and launches over samples are shared out among threads.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp

from oimppi_warp.compute.device import pick_device

Launch = Callable[[], None]
"""A prepared launch: the kernel and its arguments are fixed, calling it runs it."""

_SLICES_PER_THREAD = 4
"""Slices of the samples for each thread: enough that none waits long for the others."""
_BLOCK = 256
"""Threads of a block on CUDA."""
_CHUNK = 1 << 20
"""Bytes for all inputs, and for all outputs, of one planner on CUDA."""
_ALIGNMENT = 64
"""Alignment of an array in them [B]."""


@dataclass(frozen=True, eq=False)
class Slot:
    """An array that host and device share.

    Attributes:
        array: The device's, for kernels.
        host: The host's, for NumPy: its shape is the array's, followed by that of one entry.
    """

    array: wp.array
    host: np.ndarray


class Compute:
    """A device with threads, inputs and outputs.

    Args:
        device: Warp device; ``"auto"`` takes the first GPU, or the CPU where there is none.
        threads: Threads on the CPU; default: as many as the cores that the process may use.

    Attributes:
        device: The device's name.
        threads: Threads that launches over samples are shared among.

    Raises:
        DeviceError: The device is not there.
    """

    def __init__(self, device: str = "auto", *, threads: int | None = None) -> None:
        self.device = pick_device(device)
        self.threads = core_count() if threads is None else threads
        self._on_cpu = wp.get_device(self.device).is_cpu
        self._inputs = _Shared(self.device)
        self._outputs = _Shared(self.device)

    def input(self, shape: int | tuple[int, ...], dtype: Any) -> Slot:
        """A new array of zeros that the host writes before a step."""
        return self._inputs.slot(shape, dtype)

    def output(self, shape: int | tuple[int, ...], dtype: Any) -> Slot:
        """A new array of zeros that the host reads after a step."""
        return self._outputs.slot(shape, dtype)

    def launch(self, kernel: Any, dim: int, inputs: Sequence[Any], outputs: Sequence[Any]) -> Launch:
        """A launch of ``dim`` threads of the kernel, prepared."""
        return _Prepared(kernel, (dim,), inputs, outputs, self.device)

    def launch_blocks(self, kernel: Any, blocks: int | None, inputs: Sequence[Any], outputs: Sequence[Any]) -> Launch:
        """A launch whose threads work together in blocks (of one on the CPU), prepared.

        Args:
            kernel: Its thread index is (block, thread), or the thread alone where there is but one block.
            blocks: Number of blocks; ``None`` for the one.
            inputs: The kernel's inputs.
            outputs: Its outputs.
        """
        size = 1 if self._on_cpu else _BLOCK
        dim = (size,) if blocks is None else (blocks, size)
        return _Prepared(kernel, dim, inputs, outputs, self.device)

    def launch_samples(self, kernel: Any, count: int, inputs: Sequence[Any], outputs: Sequence[Any]) -> Launch:
        """A launch over samples, prepared: on the CPU in slices, shared out among threads.

        Args:
            kernel: Its first argument is the index of the slice's first sample; samples do not depend on each other.
            count: Number of samples.
            inputs: The kernel's other inputs.
            outputs: Its outputs.
        """
        slices = min(self.threads * _SLICES_PER_THREAD, count) if self._on_cpu and self.threads > 1 else 1
        edges = np.linspace(0, count, slices + 1).astype(int)
        launches = [
            _Prepared(kernel, (end - begin,), [begin, *inputs], outputs, self.device)
            for begin, end in pairwise(edges.tolist())
        ]
        return launches[0] if slices == 1 else _Shares(launches, self.threads)

    def step(self, launches: Sequence[Launch], *, one_graph: bool = True) -> Launch:
        """A whole step: inputs up, all launches in order, outputs down; the host waits for the end.

        Args:
            launches: The step.
            one_graph: Whether all of it can be captured as one CUDA graph.
        """

        def enqueue() -> None:
            self._inputs.upload()
            for launch in launches:
                launch()
            self._outputs.download()

        return enqueue if self._on_cpu else _CudaStep(enqueue, self.device, one_graph)


class Stopwatch:
    """A launch that notes when it ran; in a CUDA graph it never runs, nor while one is captured."""

    def __init__(self, device: str) -> None:
        self._device = wp.get_device(device)
        self._at = math.nan

    def __call__(self) -> None:
        """Note the time."""
        if not self._device.is_capturing:
            self._at = time.perf_counter()

    def take(self) -> float:
        """When it last ran, by ``time.perf_counter``; NaN if it did not since it was last asked."""
        at, self._at = self._at, math.nan
        return at


@lru_cache
def core_count() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class _Prepared:
    """One launch with its arguments packed."""

    def __init__(
        self,
        kernel: Any,
        dim: tuple[int, ...],
        inputs: Sequence[Any],
        outputs: Sequence[Any],
        device: str,
    ) -> None:
        self._device = wp.get_device(device)
        self._arguments = {
            "dim": dim,
            "inputs": list(inputs),
            "outputs": list(outputs),
            "device": device,
            "block_dim": 1 if self._device.is_cpu else _BLOCK,
        }
        self._kernel = kernel
        self._command = wp.launch(kernel, **self._arguments, record_cmd=True)

    def __call__(self) -> None:
        if self._device.is_cpu and self._device.is_capturing:
            wp.launch(self._kernel, **self._arguments)  # a recorded command would run, and not be captured
        else:
            self._command.launch()


class _Shares:
    """Launches in any order, shared out among threads: who is done takes the next."""

    def __init__(self, launches: Sequence[_Prepared], threads: int) -> None:
        self._launches = launches
        self._helpers = threads - 1

    def __call__(self) -> None:
        if wp.get_device("cpu").is_capturing:
            for launch in self._launches:
                launch()
            return
        left = iter(range(len(self._launches)))  # its steps are atomic under the interpreter's lock
        waiting = [_pool(self._helpers).submit(self._work, left) for _ in range(self._helpers)]
        self._work(left)
        for helper in waiting:
            if not helper.cancel():  # one that has not even woken up has nothing left to do
                helper.result()

    def _work(self, left: Any) -> None:
        for index in left:
            self._launches[index]()


@lru_cache(maxsize=1)
def _pool(helpers: int) -> ThreadPoolExecutor:
    """The process's helping threads."""
    return ThreadPoolExecutor(helpers, thread_name_prefix="oimppi")


class _Shared:
    """Arrays that go to the device, or come from it, together."""

    def __init__(self, device: str) -> None:
        self._device = wp.get_device(device)
        self._used = 0
        size = 0 if self._device.is_cpu else _CHUNK  # on the CPU, the host's own memory serves
        self._host = wp.zeros(size, dtype=wp.uint8, device="cpu", pinned=size > 0)
        self._chunk = wp.zeros(size, dtype=wp.uint8, device=device)

    def slot(self, shape: int | tuple[int, ...], dtype: Any) -> Slot:
        """A new array of zeros."""
        if self._device.is_cpu:
            array = wp.zeros(shape, dtype=dtype, device="cpu")
            return Slot(array, array.numpy())
        begin = -(-self._used // _ALIGNMENT) * _ALIGNMENT
        self._used = begin + int(np.prod(shape)) * wp.types.type_size_in_bytes(dtype)
        if self._used > _CHUNK:
            raise MemoryError(f"inputs or outputs of a step need more than {_CHUNK} bytes")
        array, host = (
            wp.array(ptr=whole.ptr + begin, dtype=dtype, shape=shape, device=whole.device)  # pyright: ignore
            for whole in (self._chunk, self._host)
        )
        return Slot(array, host.numpy())

    def upload(self) -> None:
        """Host to device."""
        if self._used:
            wp.copy(self._chunk, self._host, count=self._used)

    def download(self) -> None:
        """Device to host."""
        if self._used:
            wp.copy(self._host, self._chunk, count=self._used)


class _CudaStep:
    """A step on CUDA: captured as one graph when it first runs, replayed from then on."""

    def __init__(self, enqueue: Launch, device: str, one_graph: bool) -> None:
        self._enqueue = enqueue
        self._device = wp.get_device(device)
        self._one_graph = one_graph
        self._graph: Any = None

    def __call__(self) -> None:
        if not self._one_graph:
            self._enqueue()
        else:
            if self._graph is None:
                with wp.ScopedCapture(device=self._device) as capture:
                    self._enqueue()
                self._graph = capture.graph
            wp.capture_launch(self._graph)
        wp.synchronize_device(self._device)
