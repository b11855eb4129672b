"""Compilation of kernels for the CPU in another process, which leaves them in Warp's cache.

Within a process, Warp compiles nothing else beside a module whose flags set options of LLVM, such as the rollout of the
robot level, which takes longest of all.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from enum import Enum
from pathlib import Path
from typing import Any

import warp as wp

from oimppi_warp.compute.device import start_warp

Modules = Callable[[], Sequence[wp.Module]]
"""A function that returns modules of kernels. It can be pickled, as can a ``functools.partial`` of one."""


class BuildProcess:
    """A process that compiles modules of kernels.

    Where it cannot be started or fails, nothing is compiled; whoever loads the modules compiles them then.

    Args:
        modules: Returns the modules, also in the other process.
    """

    def __init__(self, modules: Modules) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._stopped = False
        if not Path(sys.executable or "").name.startswith("python"):
            return  # Python is embedded in another program
        with suppress(OSError, pickle.PicklingError, AttributeError, TypeError):  # the last three: it cannot be pickled
            task = pickle.dumps(_settings()) + pickle.dumps(modules)
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", __name__],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path)},
                start_new_session=True,  # Ctrl-C is for this process, which stops the other one
            )
            assert self._process.stdin is not None
            with suppress(BrokenPipeError), self._process.stdin as pipe:
                pipe.write(task)

    def wait(self) -> bool:
        """Waits until the process has ended, and passes on Warp's messages; returns whether it was not stopped."""
        if self._process is None:
            return True
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if wp.config.log_level <= wp.LOG_INFO:
                wp.get_logger().info(line.decode(errors="replace").rstrip())
        self._process.wait()
        return not self._stopped

    def stop(self) -> None:
        """Ends the process if it still runs."""
        self._stopped = True
        if self._process is not None:
            self._process.kill()
            self._process.wait()


def _settings() -> dict[str, Any]:
    """Returns Warp's settings, as far as they are plain values: flags, folders and so on."""
    plain = (bool, int, float, str, Enum, type(None))
    return {name: value for name, value in vars(wp.config).items() if name[0] != "_" and isinstance(value, plain)}


def main() -> None:
    """Compiles what is described on the standard input, and prints Warp's messages about it."""
    start_warp()
    for name, value in pickle.load(sys.stdin.buffer).items():
        setattr(wp.config, name, value)
    wp.config.log_level = wp.LOG_INFO
    modules: Modules = pickle.load(sys.stdin.buffer)  # this imports the kernels, which read the settings
    wp.force_load("cpu", list(modules()))


if __name__ == "__main__":
    main()
