"""Renamed and added settings: the names of earlier versions, and what they did where a setting did not exist yet.

This is the only such table. With it, ``--set``, :func:`oimppi_warp.set_option`, suites and records accept old names, so
that a command from an old record or report still runs. Output always has the current names.

To rename a setting, change the field and add an entry here with its old and its current dotted name. An entry also
covers the names that begin with it: ``"robot.mppi"`` covers ``robot.mppi.samples``. Entries are never removed. If a
current name changes again, change the entries that lead to it too. ``tests/config/test_renamed.py`` loads every old
name.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

SETTINGS: Mapping[str, str] = {
    "robot.mppi": "robot.optimizer",
    "object.mppi": "object.optimizer",
    "cost.clearance": "cost.arm_clearance",
    "cost.w_clearance": "cost.w_arm_clearance",
    "cost.reach": "cost.push_ring",
    "cost.w_reach": "cost.w_push_ring",
    "object_cost.reach": "object_cost.push_ring",
    "object_cost.w_reach": "object_cost.w_push_ring",
    "regrasp": "reposition",
    "regrasp.w_guide": "reposition.w_waypoint",
}
"""Current dotted name of each renamed setting or group of settings, by its old dotted name."""

ADDED: Mapping[str, Any] = {
    "robot.controls": "joint",
    "robot.optimizer.least_noise": 1.0,
    "object.optimizer.least_noise": 1.0,
    "object.plans": 1,
    "object.ends_at_goal": False,
    "cost.w_track": 0.0,
    "cost.w_stance": 0.0,
    "reposition.least_pace": 1.0,
    "episode.exact": False,
}
"""Value that has the effect of an earlier version without the setting, where that is not the present default. Records
without the setting are read with it."""


def present_name(name: str, table: Mapping[str, str] = SETTINGS) -> str:
    """Returns the current name of a setting or group; a name that is not in the table is returned unchanged.

    Args:
        name: Dotted name, old or current.
        table: Current names by old ones; the longest entry that ``name`` begins with is used.
    """
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        head = ".".join(parts[:length])
        if head in table:
            return ".".join([table[head], *parts[length:]])
    return name
