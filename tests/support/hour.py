"""Pushes an object to its goal and back, again and again, on an emulated lab in a process of its own."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from support import small_tasks
from support.emulated_lab import COMMAND_PORT, POSE_PORT

from oimppi_warp.config.presets import lab
from oimppi_warp.runtime.episode import Episode


def hour(host: str, seconds: float) -> None:
    """Pushes for so long and prints what happened, as JSON in the last line."""
    scene, config = small_tasks.shipped("lab01"), lab()
    ports = ("--host", host, "--port", str(COMMAND_PORT), "--pose-port", str(POSE_PORT), "--start", "0")
    command = [sys.executable, "-m", "oimppi_warp", "lab-emulator", "lab01", *ports]
    emulator = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert emulator.stdout is not None
    assert "listens" in emulator.stdout.readline()
    options = (f"robot_address={host}:{COMMAND_PORT}", f"pose_address={host}:{POSE_PORT}", "yes=true", "resume=true")
    ends, missing, steps, memory, jitter = [scene.goal, scene.start], 0, 0, [], []
    outcomes: dict[str, int] = {}
    began = time.monotonic()
    try:
        while time.monotonic() < began + seconds:
            task = scene.with_goal(ends[len(memory) % 2])
            log = Episode(task, config, plant="xarm", plant_options=options, threads=1, seed=len(memory)).run()
            outcomes[log.header["ended"]] = outcomes.get(log.header["ended"], 0) + 1
            gaps = np.diff(log["sent"])
            missing += int(np.maximum(np.round(gaps / config.control_period) - 1, 0).sum())
            jitter += np.abs(gaps - config.control_period).tolist()
            steps += len(log)
            memory.append(_memory())
            late = np.flatnonzero(gaps > 1.5 * config.control_period).tolist()
            said = f"{len(memory)} {log.header['ended']} {len(log)} {memory[-1]:.0f} MB, late {late},"
            print(said, log.header["problems"], flush=True)
    finally:
        emulator.terminate()
        printed = emulator.communicate(timeout=30.0)[0]
    taken, refused, expired = map(int, re.findall(r"(\d+) commands, (\d+) refused, (\d+) expired", printed)[0])
    settled = memory[min(3, len(memory) - 1)]
    found = {
        "episodes": len(memory),
        "outcomes": outcomes,
        "steps": steps,
        "rows_missing": missing,
        "jitter_p99_ms": 1e3 * float(np.percentile(jitter, 99)),
        "grown_mb": memory[-1] - settled,
        "commands": taken,
        "refused": refused,
        "expired": expired,
    }
    print(json.dumps(found), flush=True)


def _memory() -> float:
    """Memory of this process [MB]."""
    status = Path("/proc/self/status").read_text()
    return int(re.findall(r"VmRSS:\s+(\d+) kB", status)[0]) / 1e3
