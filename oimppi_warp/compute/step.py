"""Execution of control steps: a device, the threads that it may use, and the memory that it shares with the host.

A step is a fixed list of launches over fixed arrays. Data that change from step to step go in through *inputs*,
results that the host needs come out through *outputs*. On CUDA the step is one graph with one copy at either end; on
the CPU inputs and outputs are in the host's memory, and launches over samples are distributed among threads.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp

from oimppi_warp.compute.device import EMULATED_GPU, core_count, pick_device, warp_device
from oimppi_warp.compute.loading import await_loaded

Launch = Callable[[], None]
"""A prepared launch: kernel and arguments are fixed, and a call runs it."""

_SLICES_PER_THREAD = 4
"""Number of slices of the samples per thread, large enough that no thread waits long for the others."""
BLOCK = 256
"""Threads per block on a GPU that cooperate."""
_MOST_BLOCKS = 400
"""Number of blocks, about three for each multiprocessor of a large GPU, beyond which blocks get more threads."""
_CHUNK = 1 << 20
"""Size of a planner's buffer of inputs, and of its buffer of outputs, on CUDA [B]."""
_ALIGNMENT = 64
"""Alignment of arrays in these buffers [B]."""

# While a graph is captured, everything that any thread launches or allocates on that device is captured with it, or is
# an error. Capturing therefore holds both locks; who holds them both takes them in this order.
making_planner = threading.RLock()
"""Held while a planner is made: its arrays must not be allocated while another thread captures a graph."""
using_gpu = threading.RLock()
"""Held while a thread launches work on a GPU or waits for it."""


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

    The emulated GPU (:data:`oimppi_warp.compute.device.EMULATED_GPU`) computes on the CPU, but as a GPU would: inputs
    and outputs are copied, a step is a captured graph, and blocks have as many threads. For the last, it switches on
    ``wp.config.enable_cpu_blocks`` for the whole process.

    Args:
        device: Warp device; ``"auto"`` takes the first GPU, or the CPU if there is none.
        threads: Number of threads on the CPU; ``None``: the number of cores that the process may use.

    Attributes:
        name: Name of the device, as it appears in records.
        device: Warp's name of the device.
        on_gpu: Whether the device is a GPU or the emulated GPU.
        threads: Number of threads among which launches over samples are distributed.

    Raises:
        DeviceError: The device does not exist.
    """

    def __init__(self, device: str = "auto", *, threads: int | None = None) -> None:
        self.name = pick_device(device)
        self.device = warp_device(self.name)
        self.on_gpu = self.name == EMULATED_GPU or wp.get_device(self.device).is_cuda
        self.threads = core_count() if threads is None else threads
        if self.name == EMULATED_GPU:
            wp.config.enable_cpu_blocks = True
        self._block = BLOCK if self.on_gpu else 1
        self._samples_blocks: dict[Any, int] = {}
        self._inputs = _Shared(self.device, separate=self.on_gpu)
        self._outputs = _Shared(self.device, separate=self.on_gpu)

    def input(self, shape: int | tuple[int, ...], dtype: Any) -> Slot:
        """Makes a new array of zeros that the host writes before a step."""
        return self._inputs.slot(shape, dtype)

    def output(self, shape: int | tuple[int, ...], dtype: Any) -> Slot:
        """Makes a new array of zeros that the host reads after a step."""
        return self._outputs.slot(shape, dtype)

    def launch(self, kernel: Any, dim: int, inputs: Sequence[Any], outputs: Sequence[Any]) -> Launch:
        """Prepares a launch of a kernel with ``dim`` threads."""
        return _Prepared(kernel, (dim,), inputs, outputs, self.device, self._block)

    def launch_blocks(self, kernel: Any, blocks: int | None, inputs: Sequence[Any], outputs: Sequence[Any]) -> Launch:
        """Prepares a launch whose threads cooperate in blocks (of one thread on the CPU).

        Args:
            kernel: Kernel whose thread index is (block, thread), or the thread alone if there is only one block.
            blocks: Number of blocks; ``None`` for a single one.
            inputs: The kernel's inputs.
            outputs: The kernel's outputs.
        """
        dim = (self._block,) if blocks is None else (blocks, self._block)
        return _Prepared(kernel, dim, inputs, outputs, self.device, self._block)

    def launch_samples(self, kernel: Any, count: int, inputs: Sequence[Any], outputs: Sequence[Any]) -> Launch:
        """Prepares a launch over samples; on the CPU, slices of them are distributed among threads.

        Args:
            kernel: Kernel whose first argument is the index of the slice's first sample. Samples must be independent:
                of what another launch over samples has just written, one may read its own entry only.
            count: Number of samples.
            inputs: The kernel's other inputs.
            outputs: The kernel's outputs.
        """
        # One size of blocks for all launches of a kernel, by the first: it is compiled for each size.
        block = self._samples_blocks.setdefault(kernel, samples_block(count)) if self.on_gpu else 1
        slices = 1 if self.on_gpu or self.threads == 1 else min(self.threads * _SLICES_PER_THREAD, count)
        edges = np.linspace(0, count, slices + 1).astype(int)
        launches = [
            _Prepared(kernel, (end - begin,), [begin, *inputs], outputs, self.device, block)
            for begin, end in pairwise(edges.tolist())
        ]
        return launches[0] if slices == 1 else _Shares(edges, launches, self.threads)

    def load(self, launches: Sequence[Launch]) -> None:
        """Compiles and loads the kernels of launches, on the CPU several at a time.

        Without it they are loaded one after another, each when its first step is prepared or when it runs.
        """
        if not self.on_gpu:  # all kernels have blocks of one thread
            modules = dict.fromkeys(launch.kernel.module for launch in _kernel_launches(launches))
            await_loaded(modules)
            wp.force_load(self.device, list(modules), max_workers=self.threads)

    def run(self, launch: Launch) -> None:
        """Loads the kernels of a launch and runs it once, outside of a step."""
        self.load([launch])
        for each in _kernel_launches([launch]):
            each.prepare()  # here, since threads that load a module at the same time would each compile it
        launch()

    def step(self, launches: Sequence[Launch], *, one_graph: bool = True, upload: bool = True) -> Step:
        """Prepares a step.

        It uploads all inputs, runs ``launches`` in order and downloads all outputs. On the CPU, a thread runs
        consecutive launches over the same number of samples one after another for its samples.

        Args:
            launches: Launches of the step.
            one_graph: Whether the step can be captured as one CUDA graph; if not, its launches run one by one.
            upload: Whether the inputs are uploaded. A step that goes on from another one finds them as that left them:
                its launches may have written some.
        """
        for launch in _kernel_launches(launches):
            launch.prepare()
        everything = in_order(_joined(launches))

        def enqueue() -> None:
            if upload:
                self._inputs.upload()
            everything()
            self._outputs.download()

        if not self.on_gpu:
            return Step(enqueue)
        return _Graph(enqueue, self.device) if one_graph else _Eager(enqueue, self.device)


class Step:
    """A prepared step; a call runs it and waits for its end.

    Steps run in the order in which they begin. On the CPU they end before :meth:`begin` returns.

    Args:
        enqueue: Runs the launches, or enqueues them on a GPU.
    """

    def __init__(self, enqueue: Launch) -> None:
        self._enqueue = enqueue

    def begin(self) -> None:
        """Begins the step: on a GPU, the host can do other work before it calls :meth:`wait`."""
        self._enqueue()

    def wait(self) -> None:
        """Waits until everything that has begun has ended; the outputs are then on the host."""

    def __call__(self) -> None:
        """Runs the step and waits for its end."""
        self.begin()
        self.wait()


def samples_block(count: int) -> int:
    """Returns the number of threads per block on a GPU for a number of samples, one thread for each: 4 to 32.

    A warp takes as long as all of its threads together, where they branch or wait for memory. The fewer it has, the
    faster it is, as long as there are multiprocessors for all blocks.
    """
    return next((block for block in (4, 8, 16) if count <= _MOST_BLOCKS * block), 32)


def in_order(launches: Sequence[Launch]) -> Launch:
    """Returns a launch that runs launches one after another."""
    return launches[0] if len(launches) == 1 else _InOrder(launches)


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
        """Returns the ``time.perf_counter`` of the latest run; NaN if there was none since the last call."""
        at, self._at = self._at, math.nan
        return at


class _Prepared:
    """A launch of a kernel, whose arguments are packed when it is prepared, at the latest when it runs.

    Attributes:
        kernel: The kernel.
    """

    def __init__(
        self,
        kernel: Any,
        dim: tuple[int, ...],
        inputs: Sequence[Any],
        outputs: Sequence[Any],
        device: str,
        block: int,
    ) -> None:
        self._device = wp.get_device(device)
        self._arguments = {
            "dim": dim,
            "inputs": list(inputs),
            "outputs": list(outputs),
            "device": device,
            "block_dim": block,
        }
        self.kernel = kernel
        self._command: Any = None

    def prepare(self) -> None:
        """Loads the kernel and packs the arguments."""
        if self._command is None:
            self._command = wp.launch(self.kernel, **self._arguments, record_cmd=True)

    def __call__(self) -> None:
        if self._device.is_cpu and self._device.is_capturing:
            wp.launch(self.kernel, **self._arguments)  # a recorded command would run instead of being captured
        else:
            self.prepare()
            self._command.launch()


class _InOrder:
    """Launches that run one after another."""

    def __init__(self, launches: Sequence[Launch]) -> None:
        self.launches = launches

    def __call__(self) -> None:
        for launch in self.launches:
            launch()


class _Shares:
    """Launches over slices of the samples, distributed among threads: each thread takes the next when it is done.

    Args:
        edges: First sample of each slice, and the number of samples.
        launches: The launch over each slice.
        threads: Number of threads.
    """

    def __init__(self, edges: np.ndarray, launches: Sequence[Launch], threads: int) -> None:
        self._edges = edges
        self.launches = launches
        self._threads = threads

    def then(self, other: Launch) -> _Shares | None:
        """Returns these launches, each followed by that over the same samples; ``None`` if the slices differ."""
        if not isinstance(other, _Shares) or not np.array_equal(self._edges, other._edges):
            return None
        both = [in_order(pair) for pair in zip(self.launches, other.launches, strict=True)]
        return _Shares(self._edges, both, self._threads)

    def __call__(self) -> None:
        if wp.get_device("cpu").is_capturing:
            for launch in self.launches:
                launch()
            return
        helpers = self._threads - 1
        left = iter(range(len(self.launches)))  # stepping it is atomic under the interpreter's lock
        waiting = [_pool(helpers).submit(self._work, left) for _ in range(helpers)]
        self._work(left)
        for helper in waiting:
            if not helper.cancel():  # a helper that has not started yet has nothing left to do
                helper.result()

    def _work(self, left: Any) -> None:
        for index in left:
            self.launches[index]()


def _kernel_launches(launches: Sequence[Launch]) -> Iterator[_Prepared]:
    """Yields the launches of kernels among launches, and in those that are made of several."""
    for launch in launches:
        if isinstance(launch, _Prepared):
            yield launch
        elif isinstance(launch, _InOrder | _Shares):
            yield from _kernel_launches(launch.launches)


def _joined(launches: Sequence[Launch]) -> list[Launch]:
    """Returns the launches of a step, with neighbours over the same slices of the samples joined."""
    joined: list[Launch] = []
    for launch in launches:
        for part in launch.launches if isinstance(launch, _InOrder) else [launch]:
            before = joined[-1] if joined else None
            both = before.then(part) if isinstance(before, _Shares) else None
            if both is None:
                joined.append(part)
            else:
                joined[-1] = both
    return joined


@lru_cache(maxsize=1)
def _pool(helpers: int) -> ThreadPoolExecutor:
    """Returns the process's pool of helper threads."""
    return ThreadPoolExecutor(helpers, thread_name_prefix="oimppi")


class _Shared:
    """Arrays that are copied to the device, or from it, together; without separate memories, they are the host's."""

    def __init__(self, device: str, *, separate: bool) -> None:
        self._separate = separate
        self._used = 0
        size = _CHUNK if separate else 0
        self._host = wp.zeros(size, dtype=wp.uint8, device="cpu", pinned=wp.get_device(device).is_cuda)
        self._chunk = wp.zeros(size, dtype=wp.uint8, device=device)

    def slot(self, shape: int | tuple[int, ...], dtype: Any) -> Slot:
        """Makes a new array of zeros."""
        if not self._separate:
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


class _OnGpu(Step):
    """A step on a GPU.

    Args:
        enqueue: Enqueues the launches.
        device: Warp's name of the device.
    """

    def __init__(self, enqueue: Launch, device: str) -> None:
        super().__init__(enqueue)
        self._device = wp.get_device(device)

    def wait(self) -> None:
        with using_gpu:
            wp.synchronize_device(self._device)


class _Graph(_OnGpu):
    """Launches captured as one graph when the step begins for the first time, and replayed then and later."""

    def __init__(self, enqueue: Launch, device: str) -> None:
        super().__init__(enqueue, device)
        self._graph: Any = None

    def begin(self) -> None:
        if self._graph is None:
            with making_planner, using_gpu, wp.ScopedCapture(device=self._device) as capture:
                self._enqueue()
            self._graph = capture.graph
        with using_gpu:
            wp.capture_launch(self._graph)


class _Eager(_OnGpu):
    """Launches that cannot be captured."""

    def begin(self) -> None:
        with using_gpu:
            self._enqueue()
