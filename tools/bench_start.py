"""Measures the time of a run of one control step in a new process, with cold and with warm caches."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory


def start_seconds(engine: str, *, repeats: int = 3) -> dict[str, float]:
    """Time a run of one control step in a new process [s]: once with cold caches, and the median with warm ones."""
    with TemporaryDirectory() as folder:
        found = [_run(engine, Path(folder)) for _ in range(1 + repeats)]
    return {"cold_s": round(found[0], 2), "warm_s": round(sorted(found[1:])[repeats // 2], 2)}


def _run(engine: str, caches: Path) -> float:
    # Without byte code of the modules, which a run otherwise leaves, every run compiles them again.
    usual = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    environment = usual | {"WARP_CACHE_PATH": str(caches / "warp"), "OIMPPI_CACHE": str(caches / "fields")}
    command = [sys.executable, "-m", "oimppi_warp", "run", "task02", "--engine", engine, "--max-sim-seconds", "0.05"]
    command += ["--device", "cpu", "--set", "robot.optimizer.samples=64"]
    began = time.perf_counter()
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 1):
        raise RuntimeError(f"{' '.join(command)} failed:\n{done.stderr}")
    return time.perf_counter() - began
