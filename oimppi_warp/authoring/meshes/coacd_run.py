"""Runs CoACD in a process of its own until it is done or its computing time is over."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from oimppi_warp.errors import SceneError

_EVERY = 0.1  # how often to look whether it is done [s]
_LONGEST = 20.0  # a process that waits longer than this many times its computing time is stuck


def run_coacd(
    solids: Sequence[trimesh.Trimesh],
    options: Sequence[Mapping[str, Any]],
    seconds: float,
    waiting: Callable[[float], None] = lambda _: None,
) -> tuple[list[list[np.ndarray]] | None, float]:
    """Cuts solids into convex pieces, unless that takes too long.

    Computing time is limited, not time on the clock, so that a busy machine gives the same pieces.

    Args:
        solids: Closed surfaces [m].
        options: CoACD's options for each.
        seconds: Computing time that it may take [s].
        waiting: Called again and again with the computing time that it took so far [s].

    Returns:
        The corners of each solid's pieces, shape [n, 3] [m] each, or ``None`` if it took too long; and the computing
        time [s].

    Raises:
        SceneError: CoACD failed.
    """
    with tempfile.TemporaryDirectory(prefix="oimppi-") as folder:
        source, target = (Path(folder) / name for name in ("solids.npz", "pieces.npz"))
        arrays = {f"vertices_{i}": np.asarray(solid.vertices, dtype=float) for i, solid in enumerate(solids)}
        arrays |= {f"faces_{i}": np.asarray(solid.faces, dtype=np.int32) for i, solid in enumerate(solids)}
        np.savez(source, allow_pickle=False, **arrays)
        module = "oimppi_warp.authoring.meshes.coacd_process"
        command = [sys.executable, "-m", module, str(source), str(target), json.dumps([dict(o) for o in options])]
        root = str(Path(__file__).resolve().parents[3])
        path = os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH"))))
        settings = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": path}  # more would wait in vain, and count
        process = subprocess.Popen(command, env=settings, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        began, used = time.monotonic(), 0.0
        try:
            while process.poll() is None:
                used = max(used, _computed(process.pid))
                if used > seconds or time.monotonic() - began > _LONGEST * seconds:
                    return None, used
                waiting(used)
                time.sleep(_EVERY)
        finally:
            if process.poll() is None:
                process.kill()
            process.wait()
        if process.returncode != 0 or not target.is_file():
            raise SceneError(
                f"the mesh could not be cut into convex pieces: CoACD ended with status {process.returncode}",
                allowed="a closed surface that does not cut through itself",
                fix="remesh it in your modelling program: in Blender, with the modifier Remesh",
            )
        found: list[list[np.ndarray]] = []
        with np.load(target) as pieces:
            for number in range(len(solids)):
                names = sorted(
                    (name for name in pieces.files if name.startswith(f"piece_{number}_")),
                    key=lambda name: int(name.rpartition("_")[2]),
                )
                found.append([pieces[name] for name in names])
        return found, used


def _computed(process: int) -> float:
    """Returns the computing time of a running process [s]; 0 once it has ended."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")  # in user and in system mode
