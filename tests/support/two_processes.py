"""Planner and laboratory in two processes, as on a table with a real arm, whatever is spoken between them."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from support.pushing import forces

FORCE = 20.0
"""Largest force between tool and object of a gentle push [N]."""


def command(*words: str) -> list[str]:
    return [sys.executable, "-m", "oimppi_warp", *words]


@contextmanager
def serving(*words: str, sign: str, log: Path) -> Iterator[None]:
    """A command that serves until it is ended, from when it has printed ``sign``; what it prints ends up in ``log``."""
    with log.open("w") as said:
        process = subprocess.Popen(command(*words), stdout=said, stderr=subprocess.STDOUT)
        try:
            until = time.monotonic() + 120.0
            while sign not in log.read_text():
                assert process.poll() is None, log.read_text()
                assert time.monotonic() < until
                time.sleep(0.1)
            yield
        finally:
            process.terminate()
            process.wait(timeout=30.0)


def push(folder: Path, *options: str, seed: int = 0) -> dict:
    """Runs `oimppi run lab01` with its record in ``folder``; the metrics, and what it printed as ``said``."""
    results = ("--record", str(folder), "--json", str(folder / "metrics.json"), "--seed", str(seed))
    run = command("run", "lab01", "--device", "cpu", "--yes", "--resume", *results, *options)
    done = subprocess.run(run, capture_output=True, text=True, timeout=250, check=False)
    assert (folder / "metrics.json").exists(), done.stderr
    return json.loads((folder / "metrics.json").read_text()) | {"said": done.stdout + done.stderr}


def assert_gentle_success(found: dict, log: Path) -> None:
    """A push reached its goal in real time, by what a camera saw once a second, and touched nothing but the object."""
    assert found["success"], found["said"]
    assert found["mode"] == "realtime"
    assert found["detections"] >= 0.5 * found["sim_time_s"], "the camera sees the object about once a second"
    assert found["command_jitter_ms"] < 50.0
    tool, obstacles, arm = forces(log)
    assert 0.1 < tool < FORCE
    assert obstacles == arm == 0.0


def assert_19_of_20(one: Callable[[int, Path], tuple[AbstractContextManager[None], Callable[[], dict]]], folder: Path):
    """Pushes by the seeds 0 to 19; ``one`` gives the laboratory and the push of a seed, with the laboratory's log."""
    rows = []
    for seed in range(20):
        log = folder / f"lab{seed}.txt"
        made, pushed = one(seed, log)
        with made:
            found = pushed()
        rows.append((found["success"], found["stops"], found["command_jitter_ms"], *forces(log)))
        print(seed, *rows[-1], flush=True)
    assert sum(row[0] for row in rows) >= 19
    assert max(row[3] for row in rows) < FORCE
    assert max(max(row[4:]) for row in rows) == 0.0
