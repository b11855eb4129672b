"""Renamed settings: the names of earlier versions and the current ones.

This is the only such table. Through it, ``--set``, :func:`oimppi_warp.set_option`, suites and records accept old names;
everything is written with the current ones, so that a command from an old record or report still runs.

To rename a setting, change the field and add an entry here with its old and its current dotted name. An entry covers
everything below it too: ``"robot.mppi"`` covers ``robot.mppi.samples``. Entries are never removed; if a current name
changes again, the entries that lead to it are changed with it. ``tests/config/test_renamed.py`` loads every old name.
"""

from __future__ import annotations

from collections.abc import Mapping

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
"""Renamed settings and groups of settings: the current dotted name by the old one."""


def present_name(name: str, table: Mapping[str, str] = SETTINGS) -> str:
    """Returns the current name for a dotted name, old or current; names that were not replaced are unchanged.

    Args:
        name: The name.
        table: Entries to use; the longest match counts.
    """
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        head = ".".join(parts[:length])
        if head in table:
            return ".".join([table[head], *parts[length:]])
    return name
