"""Metrics of an episode, computed from its log: the paper's metrics, and others that help to explain them."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from oimppi_warp.config.run_spec import RunSpec
from oimppi_warp.record.log import EVENTS, EpisodeLog, flatten, to_json
from oimppi_warp.scene import EXACT


@dataclass(frozen=True)
class Metrics:
    """Metrics of one episode. Numbers that are not available are NaN (``null`` in JSON).

    Attributes:
        scene, preset: Names of the scene and the preset.
        run: The options of the run, with engine, device and threads resolved. In JSON its fields are inlined.
        start, goal: Planar poses of the object (x, y [m], yaw [rad]).
        ended: Reason for the end of the episode, see :mod:`oimppi_warp.record.log`.
        success: Whether the object stayed within tolerance for the hold time or, with a plant that judges the task
            itself, whether the plant says that the task is done.
        success_tight, success_exact: The same for the tight and for the exact tolerance.
        position_error_m, yaw_error_rad: Errors at the end of the episode [m, rad].
        mean_position_error_m: Position error averaged over time (the paper's epsilon_d) [m].
        min_clearance_m: Smallest phi_2 [m]; negative where the object overlapped an obstacle.
        steps: Number of control steps.
        sim_time_s: Simulated time of the episode [s].
        success_time_s: Simulated time at which the object came within tolerance and stayed [s]; NaN without success.
        preplan_time_s: Wall time of SOI's object plan [s].
        total_time_s: The paper's T: pre-planning, then each step as long as its planning or the control period,
            whichever is longer, until success (without success: to the end).
        plan_ms_median, plan_ms_p95: Median and 95th percentile of the wall times of the plans, until their commands are
            known [ms]; on a GPU, the trace of the nominal follows.
        object_plan_ms_median: Median for the object level alone [ms].
        control_hz: Inverse of the mean plan time (the paper's f) [Hz].
        max_contact_tool_object_n, max_contact_object_obstacle_n, max_contact_robot_obstacle_n: Largest forces
            in the episode, each summed over the contact points [N].
        mean_effective_samples, mean_object_effective_samples: Effective sample sizes of the two levels.
        lost_samples: Total number of samples whose cost was not finite.
        missed_deadlines: Number of control steps in which a plan was due but not ready.
        stops: Number of control steps in which the arm was stopped, because the last plan had expired, no plan could
            be made, or no command kept all bounds of the safety filter.
        max_joint_acceleration, max_joint_jerk: Largest commanded acceleration [rad/s^2] and jerk [rad/s^3] of a joint.
        filtered_commands: Number of control steps in which the safety filter changed the command.
        limited_commands: Number of control steps in which the change of the command was reduced to the limits.
        max_lag_ms: Largest delay of the control loop behind the wall clock [ms].
        command_jitter_ms: 99th percentile of the deviation of the time between two commands from the control period
            [ms]; NaN in lock step.
        detections, rejected_detections, recoveries: Number of detections that arrived, that were rejected, and that
            replaced the prediction.
        mean_estimate_error_m, max_estimate_error_m: Distance between the object's estimated and true positions.
        mean_cost_terms: Mean of each cost term over time.
        best_scores: Largest value of each figure of merit that the plant gives, by name; empty if it gives none.
        versions: Versions of Python and of the packages used.
    """

    scene: str
    run: RunSpec
    preset: str
    start: tuple[float, float, float]
    goal: tuple[float, float, float]
    ended: str
    success: bool
    success_tight: bool
    success_exact: bool
    position_error_m: float
    yaw_error_rad: float
    mean_position_error_m: float
    min_clearance_m: float
    steps: int
    sim_time_s: float
    success_time_s: float
    preplan_time_s: float
    total_time_s: float
    plan_ms_median: float
    plan_ms_p95: float
    object_plan_ms_median: float
    control_hz: float
    max_contact_tool_object_n: float
    max_contact_object_obstacle_n: float
    max_contact_robot_obstacle_n: float
    mean_effective_samples: float
    mean_object_effective_samples: float
    lost_samples: int
    missed_deadlines: int
    stops: int
    max_joint_acceleration: float
    max_joint_jerk: float
    filtered_commands: int
    limited_commands: int
    max_lag_ms: float
    command_jitter_ms: float
    detections: int
    rejected_detections: int
    recoveries: int
    mean_estimate_error_m: float
    max_estimate_error_m: float
    mean_cost_terms: dict[str, float]
    best_scores: dict[str, float]
    versions: dict[str, str]

    def json(self) -> str:
        """Returns a JSON object with these fields, ``null`` for NaN."""
        return json.dumps(self.row(), indent=2, allow_nan=False) + "\n"

    def row(self) -> dict[str, Any]:
        """Returns the fields in JSON types."""
        return to_json(flatten(self))


def summarize(log: EpisodeLog) -> Metrics:
    """Computes the metrics of a log, which may have been interrupted before its first step."""
    header = log.header
    period = float(header["control_period"])
    need = hold_steps(header["hold_seconds"], period)
    arrived = first_success(log)
    arrived_tight = first_hold(within(log, header["tight_tolerance"]), need)
    arrived_exact = first_hold(within(log, header.get("exact_tolerance") or _exact(header["tolerance"])), need)
    start, goal = tuple(header["start"]), tuple(header["goal"])
    position_error, yaw_error = pose_error(start, goal)
    if len(log):
        position_error, yaw_error = float(log["position_error"][-1]), float(log["yaw_error"][-1])
    preplan = float(header.get("preplan_time_s") or 0.0)
    mean_plan_ms = _of_finite(np.mean, log["plan_ms"])
    until = len(log) if arrived is None else arrived + 1
    off = np.linalg.norm(log["estimated_pose"][:, :2] - log["object_pose"][:, :2], axis=1)
    wall = np.maximum(np.nan_to_num(log["plan_ms"][:until]) / 1000, period)
    return Metrics(
        scene=header["scene"],
        run=log.run,
        preset=header["preset"],
        start=start,
        goal=goal,
        ended=header.get("ended", "interrupted"),
        success=arrived is not None,
        success_tight=arrived_tight is not None,
        success_exact=arrived_exact is not None,
        position_error_m=position_error,
        yaw_error_rad=yaw_error,
        mean_position_error_m=_of_finite(np.mean, log["position_error"]),
        min_clearance_m=_of_finite(np.min, log["clearance"]),
        steps=len(log),
        sim_time_s=float(log["time"][-1]) if len(log) else 0.0,
        success_time_s=math.nan if arrived is None else float(log["time"][arrived]),
        preplan_time_s=preplan,
        total_time_s=preplan + float(wall.sum()),
        plan_ms_median=_of_finite(np.median, log["plan_ms"]),
        plan_ms_p95=_of_finite(_p95, log["plan_ms"]),
        object_plan_ms_median=_of_finite(np.median, log["object_plan_ms"]),
        control_hz=1000 / mean_plan_ms if mean_plan_ms > 0 else math.nan,
        max_contact_tool_object_n=_of_finite(np.max, log["contact_tool_object"]),
        max_contact_object_obstacle_n=_of_finite(np.max, log["contact_object_obstacle"]),
        max_contact_robot_obstacle_n=_of_finite(np.max, log["contact_robot_obstacle"]),
        mean_effective_samples=_of_finite(np.mean, log["effective_samples"]),
        mean_object_effective_samples=_of_finite(np.mean, log["object_effective_samples"]),
        lost_samples=int(np.nansum(log["lost_samples"])),
        missed_deadlines=int(np.nansum(log["missed_deadline"])),
        stops=int(np.nansum(log["stopped"])),
        max_joint_acceleration=_of_finite(np.max, log["joint_acceleration"]),
        max_joint_jerk=_of_finite(np.max, log["joint_jerk"]),
        filtered_commands=int(np.nansum(log["filtered"])),
        limited_commands=int(np.nansum(log["limited"])),
        max_lag_ms=_of_finite(np.max, log["lag_ms"]),
        command_jitter_ms=1e3 * _of_finite(_p99, np.abs(np.diff(log["sent"]) - period)),
        detections=int((log["detection"] > 0).sum()),
        rejected_detections=int((log["detection"] == EVENTS.index("rejected")).sum()),
        recoveries=int((log["detection"] == EVENTS.index("recovered")).sum()),
        mean_estimate_error_m=_of_finite(np.mean, off),
        max_estimate_error_m=_of_finite(np.max, off),
        mean_cost_terms=_of_columns(np.mean, log, "cost_terms"),
        best_scores=_of_columns(np.max, log, "scores"),
        versions=dict(header.get("versions", {})),
    )


def pose_error(pose: Any, goal: Any) -> tuple[float, float]:
    """Returns distance [m] and absolute angle [rad], from 0 to pi, between two planar poses."""
    turn = (float(pose[2]) - float(goal[2]) + math.pi) % (2 * math.pi) - math.pi
    return math.hypot(float(pose[0]) - float(goal[0]), float(pose[1]) - float(goal[1])), abs(turn)


def first_success(log: EpisodeLog) -> int | None:
    """Returns the step at which the object came within tolerance and stayed, or which the plant says was the last.

    ``None`` if the task was not done.
    """
    if log.header.get("scores"):
        return first_hold(log["done"] == 1.0, 1)
    need = hold_steps(log.header["hold_seconds"], float(log.header["control_period"]))
    return first_hold(within(log, log.header["tolerance"]), need)


def within(log: EpisodeLog, tolerance: Mapping[str, float | None]) -> np.ndarray:
    """Returns whether the object is within a tolerance, shape [steps]; a yaw of ``None`` allows any yaw."""
    yaw = tolerance["yaw"]
    near = log["position_error"] <= tolerance["position"]
    return near if yaw is None else near & (log["yaw_error"] <= yaw)


def _exact(tolerance: Mapping[str, float | None]) -> dict[str, float | None]:
    """Returns the exact tolerance for a record of an earlier version, given the task's."""
    return {"position": EXACT.position, "yaw": None if tolerance["yaw"] is None else EXACT.yaw}


def hold_steps(hold_seconds: float, control_period: float) -> int:
    """Returns the number of consecutive control steps in ``hold_seconds``, at least one."""
    return max(1, math.ceil(hold_seconds / control_period - 1e-6))


def first_hold(inside: np.ndarray, steps: int) -> int | None:
    """Returns the index at which the first run of ``steps`` true entries begins; ``None`` if there is none."""
    runs = np.convolve(inside, np.ones(steps, dtype=int), mode="valid") if len(inside) >= steps else np.zeros(0)
    starts = np.flatnonzero(runs == steps)
    return int(starts[0]) if len(starts) else None


def _p95(values: np.ndarray) -> float:
    return float(np.percentile(values, 95))


def _p99(values: np.ndarray) -> float:
    return float(np.percentile(values, 99))


def _of_finite(reduce: Callable[[np.ndarray], Any], values: np.ndarray) -> float:
    """Applies ``reduce`` to the finite values; NaN if there are none."""
    finite = values[np.isfinite(values)]
    return float(reduce(finite)) if len(finite) else math.nan


def _of_columns(reduce: Callable[[np.ndarray], Any], log: EpisodeLog, column: str) -> dict[str, float]:
    """Reduces each entry of a column whose names are in the header, over time."""
    names, values = log.header.get(column, []), log[column]
    return {name: _of_finite(reduce, values[:, index]) for index, name in enumerate(names) if index < values.shape[1]}
