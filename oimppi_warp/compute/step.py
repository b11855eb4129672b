"""Execution of control steps: a device, the threads that it may use, and the memory that it shares with the host.

A control step is a fixed list of launches over fixed arrays. Data that change from step to step go in through *inputs*,
results that the host needs come out through *outputs*. On CUDA the step is one graph with one copy at either end; on
the CPU inputs and outputs are in the host's memory, and launches over samples are distributed among threads.
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
"""A prepared launch: kernel and arguments are fixed, and a call runs it."""

_SLICES_PER_THREAD = 4
"""Number of slices of the samples per thread, large enough that no thread waits long for the others."""
_BLOCK = 256
"""Threads per block on CUDA."""
_CHUNK = 1 << 20
"""Size of a planner's buffer of inputs, and of its buffer of outputs, on CUDA [B]."""
_ALIGNMENT = 64
"""Alignment of arrays in these buffers [B]."""


@dataclass(frozen=True, eq=False)
class Slot:
    """An array that host and device share.

    Attributes:
        array: The array on the device, for kernels.
        host: The array on the host, for NumPy; its shape is that of ``array`` followed by the shape of one entry.
    """

    array: wp.array
    host: np.ndarray


class Compute:
    """A device with threads, inputs and outputs.

    Args:
        device: Warp device; ``"auto"`` takes the first GPU, or the CPU if there is none.
        threads: Number of threads on the CPU; default: the number of cores that the process may use.

    Attributes:
        device: The device's name.
        threads: Number of threads among which launches over samples are distributed.

    Raises:
        DeviceError: The device does not exist.
    """

    def __init__(self, device: str = "auto", *, threads: int | None = None) -> None:
        self.device = pick_device(device)
        self.threads = core_count() if threads is None else threads
        self._on_cpu = wp.get_device(self.device).is_cpu
        self._inputs = _Shared(self.device)
        self._outputs = _Shared(self.device)

    def input(self, shape: int | tuple[int, ...], dtype: Any) -> Slot:
        """Makes a new array of zeros that the host writes before a step."""
        return self._inputs.slot(shape, dtype)

    def output(self, shape: int | tuple[int, ...], dtype: Any) -> Slot:
        """Makes a new array of zeros that the host reads after a step."""
        return self._outputs.slot(shape, dtype)

    def launch(self, kernel: Any, dim: int, inputs: Sequence[Any], outputs: Sequence[Any]) -> Launch:
        """Prepares a launch of ``dim`` threads of a kernel."""
        return _Prepared(kernel, (dim,), inputs, outputs, self.device)

    def launch_blocks(self, kernel: Any, blocks: int | None, inputs: Sequence[Any], outputs: Sequence[Any]) -> Launch:
        """Prepares a launch whose threads cooperate in blocks (of one thread on the CPU).

        Args:
            kernel: Kernel whose thread index is (block, thread), or the thread alone if there is only one block.
            blocks: Number of blocks; ``None`` for a single one.
            inputs: The kernel's inputs.
            outputs: Its outputs.
        """
        size = 1 if self._on_cpu else _BLOCK
        dim = (size,) if blocks is None else (blocks, size)
        return _Prepared(kernel, dim, inputs, outputs, self.device)

    def launch_samples(self, kernel: Any, count: int, inputs: Sequence[Any], outputs: Sequence[Any]) -> Launch:
        """Prepares a launch over samples; on the CPU, slices of them are distributed among threads.

        Args:
            kernel: Kernel whose first argument is the index of the slice's first sample; samples must be independent.
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
        """Prepares a whole step: uploads inputs, runs all launches in order, downloads outputs, and waits for the end.

        Args:
            launches: Launches of the step.
            one_graph: Whether the whole step can be captured as one CUDA graph.
        """

        def enqueue() -> None:
            self._inputs.upload()
            for launch in launches:
                launch()
            self._outputs.download()

        return enqueue if self._on_cpu else _CudaStep(enqueue, self.device, one_graph)


class Stopwatch:
    """A launch that records the time when it runs; it does not run in a CUDA graph, nor during its capture."""

    def __init__(self, device: str) -> None:
        self._device = wp.get_device(device)
        self._at = math.nan

    def __call__(self) -> None:
        """Records the time."""
        if not self._device.is_capturing:
            self._at = time.perf_counter()

    def take(self) -> float:
        """Returns when it last ran, by ``time.perf_counter``; NaN if it has not run since the last call."""
        at, self._at = self._at, math.nan
        return at


@lru_cache
def core_count() -> int:
    """Returns the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class _Prepared:
    """A launch with packed arguments."""

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
            wp.launch(self._kernel, **self._arguments)  # a recorded command would run instead of being captured
        else:
            self._command.launch()


class _Shares:
    """Launches in any order, distributed among threads: each thread takes the next when it is done."""

    def __init__(self, launches: Sequence[_Prepared], threads: int) -> None:
        self._launches = launches
        self._helpers = threads - 1

    def __call__(self) -> None:
        if wp.get_device("cpu").is_capturing:
            for launch in self._launches:
                launch()
            return
        left = iter(range(len(self._launches)))  # stepping it is atomic under the interpreter's lock
        waiting = [_pool(self._helpers).submit(self._work, left) for _ in range(self._helpers)]
        self._work(left)
        for helper in waiting:
            if not helper.cancel():  # a helper that has not started yet has nothing left to do
                helper.result()

    def _work(self, left: Any) -> None:
        for index in left:
            self._launches[index]()


@lru_cache(maxsize=1)
def _pool(helpers: int) -> ThreadPoolExecutor:
    """Returns the process's pool of helper threads."""
    return ThreadPoolExecutor(helpers, thread_name_prefix="oimppi")


class _Shared:
    """Arrays that are copied to the device, or from it, together."""

    def __init__(self, device: str) -> None:
        self._device = wp.get_device(device)
        self._used = 0
        size = 0 if self._device.is_cpu else _CHUNK  # on the CPU, arrays are in the host's memory
        self._host = wp.zeros(size, dtype=wp.uint8, device="cpu", pinned=size > 0)
        self._chunk = wp.zeros(size, dtype=wp.uint8, device=device)

    def slot(self, shape: int | tuple[int, ...], dtype: Any) -> Slot:
        """Makes a new array of zeros."""
        if self._device.is_cpu:
            array = wp.zeros(shape, dtype=dtype, device="cpu")
            return Slot(array, array.numpy())
        begin = -(-self._used // _ALIGNMENT) * _ALIGNMENT
        self._used = begin + int(np.prod(shape)) * wp.types.type_size_in_bytes(dtype)
        if self._used > _CHUNK:
            raise MemoryError(f"the inputs or outputs of a step need more than {_CHUNK} bytes")
        array, host = (
            wp.array(ptr=whole.ptr + begin, dtype=dtype, shape=shape, device=whole.device)  # pyright: ignore
            for whole in (self._chunk, self._host)
        )
        return Slot(array, host.numpy())

    def upload(self) -> None:
        """Copies host to device."""
        if self._used:
            wp.copy(self._chunk, self._host, count=self._used)

    def download(self) -> None:
        """Copies device to host."""
        if self._used:
            wp.copy(self._host, self._chunk, count=self._used)


class _CudaStep:
    """A step on CUDA, captured as one graph on its first run and replayed afterwards."""

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
