"""Which arms were moved before: the first run with a new one is slow."""

from __future__ import annotations

import json
import os
import sys
from contextlib import suppress
from pathlib import Path

from oimppi_warp.plants.real.arm import Arm

FIRST_SPEED = 0.1
"""Share of the usual speed with which an arm is moved for the first time."""


def allowed_speed(arm: Arm, wanted: float) -> float:
    """Returns the share of the usual speed for an arm: a small one if it is new and not simulated.

    Args:
        arm: The arm.
        wanted: Share that was asked for; 0 for the usual speed.
    """
    if arm.simulated or arm.place in _known():
        return wanted or 1.0
    if wanted > FIRST_SPEED or not wanted:
        print(
            f"{arm.place} is new here: the first run is at {100 * FIRST_SPEED:.0f} % of the usual speed",
            file=sys.stderr,
        )
    return min(wanted or FIRST_SPEED, FIRST_SPEED)


def remember(arm: Arm) -> None:
    """Notes that an arm was moved, unless it is simulated."""
    known = _known()
    if not arm.simulated and arm.place not in known:
        with suppress(OSError):
            _file().parent.mkdir(parents=True, exist_ok=True)
            _file().write_text(json.dumps([*known, arm.place]) + "\n")


def _file() -> Path:
    state = os.environ.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
    return Path(state) / "oimppi-warp" / "arms.json"


def _known() -> list[str]:
    try:
        return list(json.loads(_file().read_text()))
    except (OSError, ValueError):
        return []
