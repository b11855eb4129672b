"""Makes a top-view film of a recorded episode, as an animated GIF.

Usage: ``python tools/film.py RECORD FILE.gif [--speed 2]``, where RECORD is a folder written by ``--record`` or
``oimppi bench``.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from oimppi_warp.plots.film import film
from oimppi_warp.record.log import EpisodeLog
from oimppi_warp.usd import load_scene


def main() -> int:
    """Make the film, and return exit status 0."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("record", type=Path)
    parser.add_argument("file", type=Path)
    parser.add_argument("--speed", type=float, default=2.0, help="Simulated seconds per second of film.")
    options = parser.parse_args()
    log = EpisodeLog.load(options.record)
    frames = film(log, load_scene(log.header["scene"]), options.file, speed=options.speed)
    print(f"{options.file}: {frames} frames, {options.file.stat().st_size / 1e6:.1f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
