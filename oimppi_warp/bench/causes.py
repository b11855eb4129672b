"""Infers the likely cause of a failure from a trial's log, with a list of rules of which the first match applies.

The rules examine the last :data:`END_SECONDS` seconds of the episode. The cause is reported with its evidence; it is a
heuristic guess, not a proof.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from oimppi_warp.record.log import EpisodeLog
from oimppi_warp.record.metrics import within

END_SECONDS = 5.0
"""Time span at the end of an episode that is examined [s]."""
STANDSTILL = 0.02
"""Motion of the object below which it counts as stationary [m]; a radian counts as 0.1 m."""
CONTACT_FORCE = 0.5
"""Minimum contact force for two bodies to count as touching [N]."""
BLOCKING_FORCE = 20.0
"""Minimum force between the arm and obstacles or table for the arm to count as blocked [N]."""
NEAR_CLEARANCE = 0.005
"""Clearance below which the object counts as touching an obstacle [m]."""


@dataclass(frozen=True)
class Cause:
    """A likely cause of a failure.

    Attributes:
        name: A short name, identical in every trial with this cause.
        evidence: The evidence for it in the log.
    """

    name: str
    evidence: str


RAISED = "an error was raised"


def likely_cause(log: EpisodeLog, *, reach: float = math.inf) -> Cause:
    """Returns the likely cause of a failure.

    Args:
        log: Log of an episode that did not succeed.
        reach: Reach of the arm from its base [m].
    """
    ended = log.header.get("ended", "interrupted")
    if ended == "object fell":
        return _fell(log)
    if ended == "diverged":
        return Cause("the simulation diverged", f"after {_seconds(log)}")
    if not len(log):
        return Cause("no steps were run", "the log is empty")
    cause = _out_of_reach(log, reach)
    for rule in (_not_reached, _left_again, _yaw_only, _jammed, _arm_blocked, _wrong_side, _still_moving):
        cause = cause or rule(log)
    return cause or Cause("object stopped moving", f"{_remaining(log)} from the goal, no blocking contact")


def _fell(log: EpisodeLog) -> Cause:
    x, y = log["object_pose"][-1, :2] if len(log) else log.header["start"][:2]
    return Cause("the object fell or tipped over", f"at ({x:.2f}, {y:.2f}) m after {_seconds(log)}")


def _out_of_reach(log: EpisodeLog, reach: float) -> Cause | None:
    away = math.hypot(*log["object_pose"][-1, :2])
    if away <= reach:
        return None
    return Cause("out of reach", f"object {away:.2f} m from the base at the end, reach of the tool {reach:.2f} m")


def _not_reached(log: EpisodeLog) -> Cause | None:
    forces = log["contact_tool_object"]
    if np.isnan(forces).all() or (np.nan_to_num(forces) > CONTACT_FORCE).any():
        return None
    nearest = np.linalg.norm(log["tool_position"][:, :2] - log["object_pose"][:, :2], axis=1).min()
    return Cause("never touched the object", f"the tool's closest distance to the object's origin was {nearest:.2f} m")


def _left_again(log: EpisodeLog) -> Cause | None:
    inside = within(log, log.header["tolerance"])
    if not inside.any():
        return None
    if inside[-1]:
        return Cause(
            "time limit while at the goal",
            f"within tolerance, but not for the hold time; {_remaining(log)} from the goal",
        )
    last = float(log["time"][np.flatnonzero(inside)[-1]])
    return Cause(
        "left the goal again", f"last within tolerance at {last:.1f} s, {_remaining(log)} from the goal at the end"
    )


def _yaw_only(log: EpisodeLog) -> Cause | None:
    tolerance = log.header["tolerance"]
    if tolerance["yaw"] is None or log["position_error"][-1] > tolerance["position"]:
        return None
    return Cause("wrong yaw", f"position within tolerance, yaw error {log['yaw_error'][-1]:.2f} rad")


def _jammed(log: EpisodeLog) -> Cause | None:
    last = _end_rows(log)
    pressed = np.nan_to_num(log["contact_object_obstacle"][last]) > CONTACT_FORCE
    close = log["clearance"][last] < NEAR_CLEARANCE
    share = float(np.mean(pressed | close))
    if _motion_extent(log, last) > 2 * STANDSTILL or share < 0.5:
        return None
    force = float(np.nanmax(log["contact_object_obstacle"][last], initial=0.0))
    return Cause(
        "jammed against an obstacle",
        f"in contact or within 5 mm for {100 * share:.0f} % of the last {END_SECONDS:g} s with up to {force:.0f} N, "
        f"{_remaining(log)} from the goal",
    )


def _arm_blocked(log: EpisodeLog) -> Cause | None:
    last = _end_rows(log)
    pressed = np.nan_to_num(log["contact_robot_obstacle"][last]) > BLOCKING_FORCE
    if _motion_extent(log, last) > STANDSTILL or pressed.mean() < 0.5:
        return None
    force = float(np.nanmax(log["contact_robot_obstacle"][last]))
    return Cause(
        "arm pressed against an obstacle or the table", f"with up to {force:.0f} N, {_remaining(log)} from the goal"
    )


def _wrong_side(log: EpisodeLog) -> Cause | None:
    """Returns a cause if the tool is between the object and its goal, from where it cannot push it to the goal."""
    last = _end_rows(log)
    if _progress(log, last) > STANDSTILL:
        return None
    to_goal = np.asarray(log.header["goal"], float)[:2] - log["object_pose"][last, :2]
    to_tool = log["tool_position"][last, :2] - log["object_pose"][last, :2]
    share = float(np.mean(np.sum(to_goal * to_tool, axis=1) > 0.0))
    if share < 0.6 or np.linalg.norm(to_goal[-1]) < STANDSTILL:
        return None
    text = (
        f"between object and goal for {100 * share:.0f} % of the last {END_SECONDS:g} s, "
        f"{_remaining(log)} from the goal"
    )
    return Cause("tool on the wrong side of the object", text)


def _still_moving(log: EpisodeLog) -> Cause | None:
    last = _end_rows(log)
    if _progress(log, last) > STANDSTILL:
        return Cause(
            "time limit while still approaching",
            f"{_remaining(log)} from the goal, {_progress(log, last):.2f} m closer in the last {END_SECONDS:g} s",
        )
    if _motion_extent(log, last) > 2 * STANDSTILL:
        moved = f"moved {_motion_extent(log, last):.2f} m in the last {END_SECONDS:g} s"
        text = f"{moved} without getting closer, {_remaining(log)} from the goal"
        return Cause("moved back and forth", text)
    return None


def _end_rows(log: EpisodeLog) -> slice:
    """Returns the rows of the episode's last :data:`END_SECONDS` seconds."""
    return slice(int(np.searchsorted(log["time"], log["time"][-1] - END_SECONDS)), None)


def _motion_extent(log: EpisodeLog, rows: slice) -> float:
    """Returns the extent of the object's motion [m]; a radian counts as 0.1 m."""
    poses = log["object_pose"][rows].copy()
    poses[:, 2] = 0.1 * np.unwrap(poses[:, 2])
    return float(np.linalg.norm(np.ptp(poses, axis=0)))


def _progress(log: EpisodeLog, rows: slice) -> float:
    """Returns the reduction of the object's pose error [m]; a radian counts as 0.1 m, if yaw counts."""
    error = log["position_error"][rows].copy()
    if log.header["tolerance"]["yaw"] is not None:
        error += 0.1 * log["yaw_error"][rows]
    return float(error[0] - error[-1])


def _remaining(log: EpisodeLog) -> str:
    text = f"{log['position_error'][-1]:.2f} m"
    return text if log.header["tolerance"]["yaw"] is None else f"{text} and {log['yaw_error'][-1]:.2f} rad"


def _seconds(log: EpisodeLog) -> str:
    return f"{log['time'][-1]:.1f} s" if len(log) else "0 s"
