"""A film of a recorded episode from above, as an animated GIF.

Usage: ``python tools/film.py RECORD FILE.gif [--speed 2]``, RECORD a folder that ``--record`` or ``oimppi bench`` left.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from oimppi_warp.plots.film import film
from oimppi_warp.record.log import EpisodeLog
from oimppi_warp.usd import load_scene


def main() -> int:
    """Make the film; returns exit status 0."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("record", type=Path)
    parser.add_argument("file", type=Path)
    parser.add_argument("--speed", type=float, default=2.0, help="simulated seconds a second")
    options = parser.parse_args()
    log = EpisodeLog.load(options.record)
    frames = film(log, load_scene(log.header["scene"]), options.file, speed=options.speed)
    print(f"{options.file}: {frames} frames, {options.file.stat().st_size / 1e6:.1f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
