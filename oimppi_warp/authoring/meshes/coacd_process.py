"""Cuts solids into convex pieces with CoACD, in a process of its own, which can be stopped when it takes too long.

    python -m oimppi_warp.authoring.meshes.coacd_process SOLIDS.npz PIECES.npz OPTIONS

``OPTIONS`` is a JSON list with CoACD's options for each solid.
"""

from __future__ import annotations

import json
import sys

import coacd
import numpy as np


def main() -> None:
    """Reads solids and writes their pieces: arrays ``piece_SOLID_NUMBER``, shape [n, 3] [m]."""
    source, target, options = sys.argv[1:]
    coacd.set_log_level("error")
    found = {}
    with np.load(source) as solids:
        for number, each in enumerate(json.loads(options)):
            pieces = coacd.run_coacd(coacd.Mesh(solids[f"vertices_{number}"], solids[f"faces_{number}"]), **each)
            found |= {f"piece_{number}_{i}": np.asarray(corners) for i, (corners, _) in enumerate(pieces)}
    np.savez(target, **found)


if __name__ == "__main__":
    main()
