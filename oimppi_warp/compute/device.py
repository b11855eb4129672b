"""Selection of the compute device, and messages about the compilation of kernels for it."""

from __future__ import annotations

import os
import re
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from functools import cache
from pathlib import Path

import warp as wp

from oimppi_warp.errors import DeviceError

EMULATED_GPU = "emulated-gpu"
"""Name of a GPU emulated on the CPU: a slow device for tests and rehearsals, which no option lists.

Host and device memory are separate, a control step is captured as one graph and replayed, and launches use blocks of
the size that a GPU would use; see :class:`oimppi_warp.compute.step.Compute`.
"""


_NO_DRIVER = b"Could not find or load the NVIDIA CUDA driver"
"""Part of the line that Warp's native library prints if there is no NVIDIA driver."""


@cache
def start_warp() -> None:
    """Initialises Warp without its banner and its messages about loaded modules; warnings and errors are still shown.

    Only the first call has an effect. To see these messages, set a logger (``wp.set_logger``) or lower
    ``wp.config.log_level`` to ``wp.LOG_DEBUG`` before it, or set the level to ``wp.LOG_INFO`` after it. On a machine
    without an NVIDIA device, Warp's line about the missing driver is dropped here.
    """
    if wp.config.cuda_output is None:
        # `oimppi warmup --arch` compiles these; with a driver as new as its CUDA toolkit, Warp would look for PTX.
        wp.config.cuda_output = "cubin"
    own = type(wp.get_logger()).__module__.partition(".")[0] == "warp"
    if own and wp.config.log_level == wp.LOG_INFO:
        wp.config.log_level = wp.LOG_WARNING
    with nullcontext() if has_nvidia_device() else _without_line(_NO_DRIVER):
        wp.init()


@contextmanager
def _without_line(dropped: bytes) -> Iterator[None]:
    """Drops the lines that contain some text from what is written to file descriptor 2, also by native code."""
    with ExitStack() as stack:
        try:
            before = os.dup(2)
            stack.callback(os.close, before)
            said = stack.enter_context(tempfile.TemporaryFile())
        except OSError:  # it is closed, or there is no folder for temporary files
            yield
            return
        if sys.stderr is not None:
            sys.stderr.flush()
        os.dup2(said.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(before, 2)
            said.seek(0)
            with suppress(OSError):  # nobody reads it any more
                for line in said:
                    if dropped not in line:
                        os.write(2, line)


def tell_compilation(say: Callable[[str], None]) -> None:
    """Initialises Warp and reports each module compiled from now on by ``say(line)``, for the command line."""
    wp.set_logger(CompileNotice(say))
    start_warp()
    wp.config.log_level = min(wp.config.log_level, wp.LOG_INFO)


def pick_device(name: str = "auto") -> str:
    """Returns the device to compute on; ``auto`` is the first CUDA device, or the CPU if there is none.

    Raises:
        DeviceError: The device does not exist; the message lists those that do.
    """
    start_warp()
    present = [device.alias for device in wp.get_devices()]
    if name == EMULATED_GPU:
        return name
    if name == "auto":
        return "cuda:0" if "cuda:0" in present else "cpu"
    if name not in present:
        reason = f"\n  reason:  {unused}" if (unused := unused_gpu()) else ""
        raise DeviceError(
            f"--device {name}: no such device on this machine\n  allowed: auto, {', '.join(present)}{reason}"
        )
    return name


def has_nvidia_device() -> bool:
    """Returns whether the machine has an NVIDIA device, usable or not."""
    return Path("/dev/nvidiactl").exists() or Path("/proc/driver/nvidia").exists()


def unused_gpu() -> str:
    """Returns the reason why Warp uses no GPU although the machine has an NVIDIA device; empty if that is not so."""
    start_warp()
    if wp.get_cuda_devices() or not has_nvidia_device():
        return ""
    old = old_driver(wp.get_cuda_driver_version(), wp.get_cuda_toolkit_version())
    return old or "an NVIDIA device is present, but Warp cannot use it"


def old_driver(driver: tuple[int, int] | None, toolkit: tuple[int, int] | None) -> str:
    """Returns a sentence if a driver is too old for Warp, which then lists no GPU; empty otherwise.

    Args:
        driver: CUDA version that the driver supports; ``None`` without a driver.
        toolkit: CUDA version that Warp was built with; it needs a driver of at least the same major version.
    """
    if driver is None or toolkit is None or driver >= (toolkit[0], 0):
        return ""
    return f"the NVIDIA driver supports CUDA {driver[0]}.{driver[1]}, and Warp {wp.config.version} needs {toolkit[0]}.0"


@cache
def core_count() -> int:
    """Returns the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def free_memory(device: str) -> int:
    """Returns the free memory of a Warp device [B]."""
    found = wp.get_device(device)
    return found.free_memory if found.is_cuda else os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_AVPHYS_PAGES")


def warp_device(name: str) -> str:
    """Returns the Warp device on which a device picked by :func:`pick_device` computes."""
    return "cpu" if name == EMULATED_GPU else name


def kernels_are_cached() -> bool:
    """Returns whether Warp's cache contains kernels of this package, compiled in an earlier run."""
    start_warp()
    folder = wp.config.kernel_cache_dir
    return folder is not None and any(Path(folder).glob("wp_oimppi_warp.kernels.*"))


class CompileNotice:
    """A Warp logger that only reports compiled modules and their compile times, by ``say(line)``."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say

    def debug(self, message: str) -> None:
        """Ignores the message."""

    def info(self, message: str) -> None:
        """Reports a compiled module in our format; ignores all other messages."""
        found = re.match(r"Module (\S+) \S+ load on device '(\S+)' took ([\d.]+) ms\s+\(compiled\)", message)
        if found:
            module, device, ms = found.groups()
            name = re.sub("_[0-9a-f]{8}$", "", module)  # Warp adds a hash to kernels that it makes at run time
            self._say(f"compiled {name} for {device} in {float(ms) / 1000:.1f} s")

    def warning(self, message: str, category: type[Warning] | None = None, stacklevel: int = 1) -> None:
        """Passes the message on to Python's warnings."""
        warnings.warn(message, category, stacklevel=stacklevel)

    def error(self, message: str) -> None:
        """Passes the message on."""
        self._say(f"Warp: {message}")
