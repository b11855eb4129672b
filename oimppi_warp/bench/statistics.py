"""Statistics over the trials of a task and a method, with confidence intervals of the success rates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from oimppi_warp.bench.results import Result

DEEP = -0.005
"""Value of phi_2 below which the object counts as pressed into something [m]; soft contacts allow about this much."""


@dataclass(frozen=True)
class Rate:
    """A success rate with its confidence interval (95 % by default; see :func:`wilson`).

    Attributes:
        count, total: Number of successes, and number of trials.
        low, high: Bounds of Wilson's interval, from 0 to 1; 0 and 1 without trials.
    """

    count: int
    total: int
    low: float
    high: float

    @property
    def share(self) -> float:
        """Returns the number of successes divided by that of trials; NaN without trials."""
        return self.count / self.total if self.total else math.nan


def wilson(count: int, total: int, *, confidence: float = 0.95) -> Rate:
    """Computes a success rate with Wilson's score interval (E. B. Wilson, J. Am. Stat. Assoc. 22, 1927).

    Args:
        count, total: Number of successes, and number of trials.
        confidence: Confidence level of the interval, between 0 and 1.
    """
    if not total:
        return Rate(0, 0, 0.0, 1.0)
    from scipy.stats import binomtest

    found = binomtest(count, total).proportion_ci(confidence, method="wilson")
    return Rate(count, total, float(found.low), float(found.high))


@dataclass(frozen=True)
class Statistics:
    """Statistics over some trials. A trial that raised an error counts as a failure and is otherwise ignored.

    A statistic without values is NaN.

    Attributes:
        success, tight: Rates at the task's tolerance and at the tight one.
        tight_counts: Whether all trials continued to the tight tolerance.
        exact, exact_counts: The same for the exact tolerance.
        error, error_success: Mean position error over the whole episode, averaged over all trials, over successes [m].
        final_error, final_yaw_error: Errors at the end, median over all trials [m, rad].
        error_until, error_until_success: As ``error`` and ``error_success``, but the mean of each trial ends at its
            success (the paper's epsilon_d) [m].
        steps, time: Control steps, and simulated time [s], to success, medians over successes.
        total_time: The paper's T, mean over successes [s]: planning and moving until success.
        preplan_time: The part of the total time spent planning before the first step, mean over successes [s].
        plan_ms, plan_ms_p95: Medians over the trials of their median and 95th percentile plan times [ms].
        control_hz: Mean of the trials' control frequencies [Hz].
        samples, object_samples: Effective sample sizes of the robot level and the object level, means over the trials
            of each trial's mean.
        clearance: Smallest phi_2 over all trials [m], including failures.
        clear: Rate of the successes whose phi_2 never fell below :data:`DEEP`.
        object_force: Largest force between the object and an obstacle or the robot's base, over all trials [N].
        robot_force: Largest force between arm or tool and an obstacle or the table, over all trials [N].
        raised: Number of trials that raised an error.
        scores: For each figure of merit that the plant gives, the mean over the trials of the largest value.
    """

    success: Rate
    tight: Rate
    tight_counts: bool
    exact: Rate
    exact_counts: bool
    error: float
    error_success: float
    final_error: float
    final_yaw_error: float
    error_until: float
    error_until_success: float
    steps: float
    time: float
    total_time: float
    preplan_time: float
    plan_ms: float
    plan_ms_p95: float
    control_hz: float
    samples: float
    object_samples: float
    clearance: float
    clear: Rate
    object_force: float
    robot_force: float
    raised: int
    scores: dict[str, float]


def summarize_results(results: Sequence[Result]) -> Statistics:
    """Computes the statistics of the given trials."""
    good = [result for result in results if result.success]
    clear = sum(result.value("min_clearance_m") >= DEEP for result in good)
    return Statistics(
        success=wilson(len(good), len(results)),
        tight=wilson(sum(result.success_tight for result in results), len(results)),
        tight_counts=all(result.tight_counts for result in results),
        exact=wilson(sum(result.success_exact for result in results), len(results)),
        exact_counts=all(result.exact_counts for result in results),
        error=_mean(results, "mean_position_error_m"),
        error_success=_mean(good, "mean_position_error_m"),
        final_error=_median(results, "position_error_m"),
        final_yaw_error=_median(results, "yaw_error_rad"),
        error_until=_mean(results, "error_until_success_m"),
        error_until_success=_mean(good, "error_until_success_m"),
        steps=_median(good, "success_steps"),
        time=_median(good, "success_time_s"),
        total_time=_mean(good, "total_time_s"),
        preplan_time=_mean(good, "preplan_time_s"),
        plan_ms=_median(results, "plan_ms_median"),
        plan_ms_p95=_median(results, "plan_ms_p95"),
        control_hz=_mean(results, "control_hz"),
        samples=_mean(results, "mean_effective_samples"),
        object_samples=_mean(results, "mean_object_effective_samples"),
        clearance=-_largest(results, "min_clearance_m", -1.0),
        clear=wilson(clear, len(good)),
        object_force=_largest(results, "max_contact_object_obstacle_n"),
        robot_force=_largest(results, "max_contact_robot_obstacle_n"),
        raised=sum(bool(result.error) for result in results),
        scores=_scores(results),
    )


def _scores(results: Sequence[Result]) -> dict[str, float]:
    """Returns the mean of each largest score; a trial that raised an error counts as zero."""
    found = [result.metrics.get("best_scores") or {} for result in results]
    names = dict.fromkeys(name for scores in found for name in scores)
    return {name: float(np.mean([scores.get(name) or 0.0 for scores in found])) for name in names}


def finite(results: Sequence[Result], name: str) -> np.ndarray:
    """Returns the finite values of a metric (:meth:`Result.value`), shape [n]."""
    values = np.array([result.value(name) for result in results], dtype=float)
    return values[np.isfinite(values)]


def _mean(results: Sequence[Result], name: str) -> float:
    values = finite(results, name)
    return float(values.mean()) if len(values) else math.nan


def _median(results: Sequence[Result], name: str) -> float:
    values = finite(results, name)
    return float(np.median(values)) if len(values) else math.nan


def _largest(results: Sequence[Result], name: str, sign: float = 1.0) -> float:
    values = sign * finite(results, name)
    return float(values.max()) if len(values) else math.nan
