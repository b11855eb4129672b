"""Runs CoACD in a process of its own until it is done or its time is over."""

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

from oimppi_warp.compute.step import core_count
from oimppi_warp.errors import SceneError

_EVERY = 0.1  # how often to look whether it is done [s]


def run_coacd(
    solids: Sequence[trimesh.Trimesh],
    options: Sequence[Mapping[str, Any]],
    ends: float,
    waiting: Callable[[float], None] = lambda _: None,
) -> list[list[np.ndarray]] | None:
    """Cuts solids into convex pieces, or returns ``None`` if that takes too long.

    Args:
        solids: Closed surfaces [m].
        options: CoACD's options for each.
        ends: Time by ``time.monotonic`` until which it may take [s].
        waiting: Called again and again with the time that is left [s].

    Returns:
        The corners of each solid's pieces, shape [n, 3] [m] each.

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
        settings = os.environ | {"OMP_NUM_THREADS": str(core_count()), "PYTHONPATH": path}
        process = subprocess.Popen(command, env=settings, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            while process.poll() is None:
                if time.monotonic() > ends:
                    return None
                waiting(ends - time.monotonic())
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
        return found
