"""Which device computes, and a word about kernels while they are compiled for it."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path

import warp as wp

from oimppi_warp.errors import DeviceError


@cache
def start_warp() -> None:
    """Initialise Warp without its banner and its line for each module; warnings and errors are still told.

    Only the first call does anything. To read those lines, set a logger (``wp.set_logger``) or lower
    ``wp.config.log_level`` to ``wp.LOG_DEBUG`` before it, or set that to ``wp.LOG_INFO`` after it. Where there is no
    NVIDIA driver, Warp's native library says so in one line on stderr, for which it has no switch.
    """
    own = type(wp.get_logger()).__module__.partition(".")[0] == "warp"
    if own and wp.config.log_level == wp.LOG_INFO:
        wp.config.log_level = wp.LOG_WARNING
    wp.init()


def tell_compilation(say: Callable[[str], None]) -> None:
    """Initialise Warp, and tell by ``say(line)`` each kernel that is compiled from now on, for the command line."""
    wp.set_logger(CompileNotice(say))
    start_warp()
    wp.config.log_level = min(wp.config.log_level, wp.LOG_INFO)


def pick_device(name: str = "auto") -> str:
    """The device to compute on: ``auto`` is the first CUDA device, or the CPU where there is none.

    Raises:
        DeviceError: There is no such device here; the message lists those that are.
    """
    start_warp()
    present = [device.alias for device in wp.get_devices()]
    if name == "auto":
        return "cuda:0" if "cuda:0" in present else "cpu"
    if name not in present:
        raise DeviceError(f"--device {name}: no such device here\n  allowed: auto, {', '.join(present)}")
    return name


def kernels_are_cached() -> bool:
    """Whether an earlier run left compiled kernels of ours in Warp's cache."""
    start_warp()
    folder = wp.config.kernel_cache_dir
    return folder is not None and any(Path(folder).glob("wp_oimppi_warp.kernels.*"))


class CompileNotice:
    """A Warp logger that only tells what was compiled and how long that took, by ``say(line)``."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say

    def debug(self, message: str) -> None:
        """Drop it."""

    def info(self, message: str) -> None:
        """Pass on that a module was compiled, in words of ours; drop the rest."""
        found = re.match(r"Module (\S+) \S+ load on device '(\S+)' took ([\d.]+) ms\s+\(compiled\)", message)
        if found:
            module, device, ms = found.groups()
            name = re.sub("_[0-9a-f]{8}$", "", module)  # Warp adds a hash to kernels that it makes at run time
            self._say(f"compiled {name} for {device} in {float(ms) / 1000:.1f} s")

    def warning(self, message: str, category: type[Warning] | None = None, stacklevel: int = 1) -> None:
        """Pass it on to Python's warnings."""
        warnings.warn(message, category, stacklevel=stacklevel)

    def error(self, message: str) -> None:
        """Pass it on."""
        self._say(f"Warp: {message}")
