"""Compilation of kernels for the CPU in another process, which leaves them in Warp's cache.

Within a process, Warp compiles nothing else at the same time as a module whose flags set options of LLVM, such as the
rollout of the robot level, which takes longest of all.
"""

from __future__ import annotations

import os
import pickle
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from enum import Enum
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import warp as wp

from oimppi_warp.compute.device import start_warp

ModuleSource = Callable[[], Sequence[wp.Module]]
"""A function that returns modules of kernels. If it can be pickled, another process can call it, too."""


class BuildProcess:
    """Another process that compiles modules of kernels.

    If it cannot be started or fails, the remaining modules are compiled by whoever loads them.

    Args:
        source: Returns the modules, also in the other process. If they have other names there, which happens if they
            depend on something that only this process has registered, none are compiled.
    """

    def __init__(self, source: ModuleSource) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._stopped = False
        self._temporary = ""
        if not Path(sys.executable or "").name.lower().startswith("python"):
            return  # Python is embedded in another program
        try:
            task = pickle.dumps(_settings()) + pickle.dumps((source, [module.name for module in source()]))
        except Exception:  # pickling calls code of any class
            return
        with suppress(OSError):
            self._temporary = mkdtemp(prefix="oimppi-build-")
            paths = os.pathsep.join(path or os.getcwd() for path in sys.path)
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", __name__],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={**os.environ, "PYTHONPATH": paths, "TMPDIR": self._temporary},
                # Ctrl-C is for this process, which stops the other one. A session of its own would get as much of the
                # cores as this process with all its threads.
                process_group=0,
            )
            assert self._process.stdin is not None
            # It stays open: when this process ends, however it does, so does the other one.
            self._process.stdin.write(task)
            self._process.stdin.flush()

    def wait(self) -> bool:
        """Waits for the end of the process, and passes on Warp's messages. Returns ``False`` if it was stopped."""
        if self._process is not None and self._process.returncode is None:
            assert self._process.stdout is not None
            with self._process.stdout as lines:
                for line in lines:
                    if wp.config.log_level <= wp.LOG_INFO:
                        wp.get_logger().info(line.decode(errors="replace").rstrip())
            self._process.wait()
        return not self._stopped

    def stop(self) -> None:
        """Ends the process if it still runs, and removes what it has not finished."""
        self._stopped = True
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            with suppress(OSError):  # it may have ended before it had read everything
                self._process.stdin.close()  # pyright: ignore[reportOptionalMemberAccess]
            for folder in Path(wp.config.kernel_cache_dir or "").glob(f"wp_*_p{self._process.pid}_t*"):
                shutil.rmtree(folder, ignore_errors=True)
        if self._temporary:
            shutil.rmtree(self._temporary, ignore_errors=True)


def _settings() -> dict[str, Any]:
    """Returns Warp's settings, as far as they are plain values: flags, folders and so on."""
    plain = (bool, int, float, str, os.PathLike, Enum, type(None))
    return {name: value for name, value in vars(wp.config).items() if name[0] != "_" and isinstance(value, plain)}


def _end_with_parent() -> None:
    """Ends this process when the one that has started it closes the standard input, or ends."""
    os.read(0, 1)  # nothing more is written to it
    os._exit(1)


def main() -> None:
    """Compiles the modules that are described on the standard input, and prints Warp's messages about them."""
    start_warp()
    for name, value in pickle.load(sys.stdin.buffer).items():
        setattr(wp.config, name, value)
    wp.config.log_level = wp.LOG_INFO
    source, names = pickle.load(sys.stdin.buffer)  # this imports the kernels, which read the settings
    threading.Thread(target=_end_with_parent, daemon=True).start()
    modules = list(source())
    if [module.name for module in modules] == names:
        wp.force_load("cpu", modules)


if __name__ == "__main__":
    main()
