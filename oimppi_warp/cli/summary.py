"""The summary of an episode, as ``oimppi run`` prints it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from oimppi_warp.cli.options import REAL
from oimppi_warp.cli.printing import print_rows

if TYPE_CHECKING:
    from collections.abc import Mapping

    from oimppi_warp.record.log import EpisodeLog
    from oimppi_warp.record.metrics import Metrics


_PACES = {"lockstep": "lock step", "realtime": "real time"}


def print_summary(log: EpisodeLog, metrics: Metrics, record: Path | None) -> None:
    """Prints a summary of the episode.

    Args:
        log: The episode.
        metrics: Its metrics.
        record: Folder of the record; ``None`` if none was written.
    """
    from rich.markup import escape

    from oimppi_warp.geometry.pose_grid import FURTHEST

    run, any_yaw = metrics.run, log.header["tolerance"]["yaw"] is None
    clearance = f"at least {1000 * metrics.min_clearance_m:.1f} mm"
    if metrics.min_clearance_m > FURTHEST - 1e-6:
        clearance = f"more than {1000 * FURTHEST:.0f} mm"  # larger clearances are not measured
    yaw = " (every yaw is allowed)" if any_yaw else f" and {metrics.yaw_error_rad:.3f} rad"
    rows = {
        "task": f"{metrics.scene}, {run.method.upper()}, preset {metrics.preset}, seed {run.seed}, "
        f"{run.plant} plant in {_PACES[run.mode]}, "
        f"{run.engine} on {run.device}",
        "result": _result(log, metrics),
        "error": f"{1000 * metrics.position_error_m:.1f} mm{yaw} at the end",
        "time": _time(metrics),
        "plans": f"median {metrics.plan_ms_median:.1f} ms, p95 {metrics.plan_ms_p95:.1f} ms, "
        f"for a control period of {1000 * log.header['control_period']:g} ms; "
        f"{metrics.mean_effective_samples:.1f} effective samples on average",
        "clearance": f"{clearance} between object and obstacles",
    }
    if metrics.best_scores:
        rows["scores"] = ", ".join(f"{name} {value:.3f}" for name, value in metrics.best_scores.items()) + " at best"
    if math.isfinite(metrics.max_contact_tool_object_n):
        rows["forces"] = (
            f"at most {metrics.max_contact_tool_object_n:.1f} N between tool and object, "
            f"{metrics.max_contact_object_obstacle_n:.1f} N between object and obstacles, "
            f"{metrics.max_contact_robot_obstacle_n:.1f} N between robot and obstacles or table"
        )
    if metrics.detections > 0:
        rows["perception"] = (
            f"{metrics.detections} detections, {metrics.rejected_detections} rejected, {metrics.recoveries} recoveries"
        )
        if metrics.max_estimate_error_m > 0.0:  # the true pose of a real object is not known
            rows["perception"] += (
                f"; error {1000 * metrics.mean_estimate_error_m:.0f} mm on average, "
                f"at most {1000 * metrics.max_estimate_error_m:.0f} mm"
            )
    if run.mode == "realtime":
        rows["deadlines"] = (
            f"{metrics.missed_deadlines} of {metrics.steps} missed, {metrics.stops} stops; "
            f"at most {metrics.max_lag_ms:.0f} ms behind the clock; "
            f"99 % of the commands within {metrics.command_jitter_ms:.1f} ms of their time"
        )
    if record is not None:
        rows["record"] = escape(str(record))
    print_rows(rows)


def _result(log: EpisodeLog, metrics: Metrics) -> str:
    """Returns whether the goal was reached, within which tolerances, and how the episode ended."""
    judged = bool(log.header.get("scores"))  # by the plant, whatever the tolerance
    allowed = log.header["tolerance"]
    within = "" if judged else f" within {_tolerance(allowed)}"
    ended = "" if metrics.ended == "success" else f" ({metrics.ended})"
    if not metrics.success:
        return f"[bold red]goal not reached[/]{within}{ended}"
    result = f"[bold green]goal reached[/]{within}"
    for name, reached in (("exact", metrics.success_exact), ("tight", metrics.success_tight)):
        stricter = log.header.get(f"{name}_tolerance")
        if reached and stricter and _is_stricter(stricter, allowed):
            return f"{result}, also within {_tolerance(stricter)}{ended}"
    return result + ended


def _is_stricter(tolerance: Mapping[str, float | None], than: Mapping[str, float | None]) -> bool:
    """Returns whether a tolerance is stricter than another one in some way, and no less strict in the other."""
    pairs = [(tolerance[key] or math.inf, than[key] or math.inf) for key in ("position", "yaw")]
    return all(one <= other for one, other in pairs) and any(one < other for one, other in pairs)


def _tolerance(tolerance: Mapping[str, float | None]) -> str:
    """Returns a tolerance of a record's header in words."""
    yaw = tolerance["yaw"]
    return f"{1000 * (tolerance['position'] or 0.0):.3g} mm" + ("" if yaw is None else f" and {yaw:.3g} rad")


def _time(metrics: Metrics) -> str:
    """Returns how long the episode was, when the goal was reached and, in lock step, when it is with planning."""
    time = f"{metrics.sim_time_s:.2f} s{'' if metrics.run.plant in REAL else ' simulated'} in {metrics.steps} steps"
    if not metrics.success:
        return time
    time = f"{time}; goal reached after {metrics.success_time_s:.2f} s"
    if metrics.run.mode == "realtime":
        return time
    first = metrics.preplan_time_s
    planned = f" ({first:.2f} s of that before the first step)" if first >= 0.01 else ""
    return f"{time}, or {metrics.total_time_s:.2f} s if the arm waits for planning{planned}"
