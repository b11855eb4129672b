"""The report's tables as text cells; the page and the Markdown format them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from oimppi_warp.bench.comparison import Comparison, compare_labels, compare_methods
from oimppi_warp.bench.paper import MEANS, METHODS, REPORTED, TABLES, Reported
from oimppi_warp.bench.results import Result, ResultSet
from oimppi_warp.bench.statistics import Rate, Statistics, summarize_results

PLANNED_AHEAD = 0.5
"""Minimum mean wall time of planning in advance that is reported [s]; computing cost fields takes a tenth of it."""

_NOT_REPORTED = Reported("", math.nan)


@dataclass(frozen=True)
class Table:
    """A table of text cells.

    Attributes:
        title: Its heading.
        note: Explanation of the table.
        header: One heading per column; the first two columns are text, the others numbers.
        rows: Cells of each row.
    """

    title: str
    note: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def shown_methods(results: ResultSet) -> list[str]:
    """Returns the methods of a result set in display order: the paper's methods first, then all others."""
    others = [method for method in results.methods if method not in METHODS]
    return [*(method for method in METHODS if method in results.methods), *others]


def every_table(results: ResultSet) -> list[Table]:
    """Builds the tables of a report, without empty ones."""
    tables = [
        success_table(results),
        score_table(results),
        exact_table(results),
        *(paper_table(results, table) for table in TABLES),
        time_table(results),
        safety_table(results),
        comparison_table(compare_methods(results), title="Comparison of methods", sides=("first", "second")),
        comparison_table(compare_labels(results), title="Comparison with the first entry", sides=("first", "second")),
    ]
    return [table for table in tables if table.rows]


def brief_table(results: ResultSet) -> Table:
    """Builds a table narrow enough for a terminal."""
    rows = []
    for task, method, s in _groups(results):
        stricter = (rate(s.tight) if s.tight_counts else "-", rate(s.exact) if s.exact_counts else "-")
        numbers = (number(s.time, 1), number(s.error_until, 2), number(s.plan_ms, 1))
        rows.append((task, method.upper(), rate(s.success), interval(s.success), *stricter, *numbers))
    header = ("task", "method", "success", "95 %", "tight", "exact", "time [s]", "ε_d [m]", "plan [ms]")
    return Table(
        results.title,
        "95 %: confidence interval of success. tight: success within the scene's tight tolerance. exact: success "
        "within 5 mm and 0.02 rad. time: simulated, to success, median. ε_d: distance to the goal, mean until success. "
        "plan: wall time, median.",
        header,
        tuple(rows),
    )


def success_table(results: ResultSet) -> Table:
    """Builds the table of success rates and position errors.

    Success is given at the task's tolerance and at the tight one.
    """
    rows = []
    for task, method, stats in _groups(results):
        errors = [stats.error_until, stats.error_until_success, stats.error, stats.error_success]
        cells = [rate(stats.success), interval(stats.success)]
        cells += [rate(stats.tight), interval(stats.tight)] if stats.tight_counts else ["not tested", "-"]
        rows.append((task, method.upper(), *cells, *(number(error, 3) for error in errors)))
    return Table(
        "Success and position error",
        "Trials in which the object stayed within the task's tolerance, and within the tight one, for the hold time, "
        "with Wilson's 95 % intervals. Errors are the object's distance to its goal in metres, averaged over time and "
        "then over trials: until success (the paper's ε_d, as its episodes end there), and over the whole episode.",
        (
            *("task", "method", "success", "95 %", "tight", "95 %"),
            *("ε_d", "ε_d of successes", "error, whole episode", "error of successes, whole episode"),
        ),
        tuple(rows),
    )


def score_table(results: ResultSet) -> Table:
    """Builds the table of the scores that a plant gives, with those that others published below ours.

    It has no rows if the plants of the suite give none.
    """
    groups = [group for group in _groups(results) if group[2].scores]
    names = list(dict.fromkeys(name for _, _, stats in groups for name in stats.scores))
    rows = []
    for task, method, stats in groups:
        cells = [f"{rate(stats.success)}", interval(stats.success)]
        cells += [number(stats.scores.get(name, math.nan), 3) for name in names]
        rows.append((task, method.upper(), *cells, number(stats.steps, 0), number(stats.plan_ms, 1)))
    for other in results.published if rows else ():
        share = f"{100 * other.success:.1f} %" if math.isfinite(other.success) else "-"
        scores = [number(other.scores.get(name, math.nan), 3) for name in names]
        rows.append((other.source, other.name, share, "-", *scores, "-", "-"))
    return Table(
        "Scores",
        " ".join(
            filter(
                None,
                (
                    "Success as the plant itself judges it, with Wilson's 95 % intervals, and means over the trials of "
                    "the largest score in each. Steps to success are medians over the successes, plan times medians.",
                    "The rows below ours were published by others." if results.published else "",
                    results.note,
                ),
            )
        ),
        ("task", "method", "success", "95 %", *(f"largest {name}, mean" for name in names), "steps", "plan [ms]"),
        tuple(rows),
    )


def exact_table(results: ResultSet) -> Table:
    """Builds the table of success rates at the exact tolerance and of final errors.

    It has a row for each task and method whose trials all continued to that tolerance.
    """
    rows = []
    for task, method, stats in _groups(results):
        if stats.exact_counts:
            cells = (rate(stats.exact), interval(stats.exact), number(1e3 * stats.final_error, 1))
            rows.append((task, method.upper(), *cells, number(stats.final_yaw_error, 3)))
    return Table(
        "Exactness",
        "Trials in which the object stayed within 5 mm and 0.02 rad of its goal for the hold time, with Wilson's 95 % "
        "intervals, and errors at the end of the episode, medians over all trials.",
        ("task", "method", "exact", "95 %", "final error [mm]", "final yaw error [rad]"),
        tuple(rows),
    )


def paper_table(results: ResultSet, table: str) -> Table:
    """Builds the paper's table ``I`` or ``II`` with our results next to the paper's."""
    rows = []
    tasks = [task for task in TABLES[table] if task in results.tasks]
    methods = shown_methods(results)
    for task in tasks:
        for method in methods:
            if found := results.of(task, method):
                reported = REPORTED.get((task, method), _NOT_REPORTED)
                rows.append((task, method.upper(), *_paper_pairs(reported, summarize_results(found))))
    if len(tasks) == len(TABLES[table]):
        for method in methods:
            groups = [summarize_results(results.of(task, method)) for task in tasks]
            if all(group.success.total for group in groups):
                reported = MEANS.get((table, method), _NOT_REPORTED)
                rows.append(("mean", method.upper(), *_paper_pairs(reported, *groups)))
    where = "from simulation" if table == "I" else "from the real arm; ours are from simulation"
    return Table(
        f"The paper's Table {table}",
        f"The paper's figures are {where}. ε_d is the position error averaged over time, ε_d^s the same for successful "
        "trials alone, f the control frequency, and T the total time to success including planning, with the time SOI "
        "plans in advance in brackets. Our T is the mean over successful trials; in the paper's, a failed trial counts "
        "with the longest time allowed. T and f depend on the computer; the paper's were measured on a different one. "
        "Means are over tasks, that of ε_d^s over successful trials.",
        (
            "task",
            "method",
            "success, paper",
            "ours",
            "ε_d [m], paper",
            "ours",
            "ε_d^s [m], paper",
            "ours",
            "f [Hz], paper",
            "ours",
            "T [s], paper",
            "ours",
        ),
        tuple(rows),
    )


def time_table(results: ResultSet) -> Table:
    """Builds the table of times to success and plan times."""
    rows = []
    for task, method, s in _groups(results):
        cells = (number(s.steps, 0), number(s.time, 1), _total([s]), number(s.plan_ms, 1), number(s.plan_ms_p95, 1))
        samples = (number(s.samples, 1), number(s.object_samples, 1))
        rows.append((task, method.upper(), *cells, number(s.control_hz, 1), *samples))
    return Table(
        "Time and planning",
        "Steps and simulated time to success are medians over successful trials; T is the mean of their total times "
        "including planning (in brackets the part spent planning in advance, as SOI does). Plan times are medians over "
        "trials of each trial's median and 95th percentile. Effective sample sizes are means.",
        (
            *("task", "method", "steps", "time [s]", "T [s]", "plan [ms]", "p95 [ms]", "f [Hz]"),
            *("effective samples", "effective samples, object level"),
        ),
        tuple(rows),
    )


def safety_table(results: ResultSet) -> Table:
    """Builds the table of clearances and contact forces."""
    rows = []
    for task, method, s in _groups(results):
        clear = f"{rate(s.clear)}" if s.clear.total else "-"
        forces = (number(s.object_force, 0), number(s.robot_force, 0))
        rows.append((task, method.upper(), number(1000 * s.clearance, 1), clear, *forces))
    return Table(
        "Clearance and forces",
        "The smallest clearance of the object to obstacles, the robot's base and the table's edge (negative: they "
        "overlapped), the number of successful trials in which it never fell below -5 mm, and the largest contact "
        "forces between the object and an obstacle or the base, and between the robot and an obstacle or the table. "
        "The smallest clearance and the largest forces are over all trials.",
        ("task", "method", "min. clearance [mm]", "never below -5 mm", "max. object force [N]", "max. robot force [N]"),
        tuple(rows),
    )


def comparison_table(found: Sequence[Comparison], *, title: str, sides: tuple[str, str]) -> Table:
    """Builds a table of paired comparisons, one per row; ``sides`` are the names of the two results in its headings."""
    rows = []
    for each in found:
        cells = [f"{each.successes[0]}", f"{each.successes[1]}", f"{len(each.only_first)}", f"{len(each.only_second)}"]
        cells.append(p_value(each.p))
        for item in each.numbers:
            cells.append(
                f"{number(item.first, 2)} → {number(item.second, 2)} ({p_value(item.p)})" if item.count else "-"
            )
        rows.append((each.name, f"{each.pairs}", *cells))
    names = [item.name for item in found[0].numbers] if found else []
    return Table(
        title,
        "Pairs of trials with the same start. p is the p value of McNemar's exact test on the pairs that succeed on "
        "one side only. The columns after it show the medians of both sides, with the p value of the Wilcoxon "
        "signed-rank test in brackets; times to success use only pairs that succeed on both sides. The p values are "
        "not corrected for multiple comparisons.",
        ("compared", "pairs", *sides, f"only {sides[0]}", f"only {sides[1]}", "p", *names),
        tuple(rows),
    )


def differing_pairs(found: Comparison) -> Table:
    """Builds the table of pairs that succeeded on one side only, with the command that reruns the failed trial."""
    rows = []
    for pairs, side in ((found.only_first, "A"), (found.only_second, "B")):
        for a, b in pairs:
            failed = b if side == "A" else a
            rows.append((f"{a.task}, {a.run.method.upper()}", f"{a.number}", side, failed.cause, failed.command))
    return Table(
        "Pairs that differ",
        "The side that succeeded, the likely cause of the other side's failure, and the command that reruns the failed "
        "trial.",
        ("trial", "start", "succeeded", "cause of the other's failure", "command to rerun the failed trial"),
        tuple(rows),
    )


def failures(results: ResultSet) -> list[Result]:
    """Returns the trials that did not succeed, in the order of the suite."""
    return [result for result in results.results if not result.success]


def rate(found: Rate) -> str:
    """Formats a rate as count and total: ``8/10``."""
    return f"{found.count}/{found.total}"


def interval(found: Rate) -> str:
    """Formats a rate's confidence interval in percent: ``49 to 94 %``."""
    return f"{100 * found.low:.0f} to {100 * found.high:.0f} %"


def number(value: float, digits: int) -> str:
    """Formats a number with ``digits`` decimals; NaN and infinity become a dash."""
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def p_value(p: float) -> str:
    """Formats a p value with a sensible number of digits."""
    if not math.isfinite(p):
        return "-"
    return "< 0.001" if p < 0.001 else f"{p:.3f}" if p < 0.1 else f"{p:.2f}"


def _groups(results: ResultSet) -> list[tuple[str, str, Statistics]]:
    return [
        (task, method, summarize_results(found))
        for task in results.tasks
        for method in shown_methods(results)
        if (found := results.of(task, method))
    ]


def _paper_pairs(reported: Reported, *groups: Statistics) -> tuple[str, ...]:
    """Pairs the paper's numbers with the means of ours."""
    total = _reported(reported.total_time_s, 0)
    if reported.preplan_time_s is not None:
        total += f" ({reported.preplan_time_s:.0f})"
    success = f"{_mean([group.success.share for group in groups]):.2f}"
    if len(groups) == 1:
        success += f" ({interval(groups[0].success)})"
    return (
        *(number(reported.success, 2 if len(groups) > 1 else 1), success),
        *(_reported(reported.error_m, 2), number(_mean([group.error_until for group in groups]), 2)),
        *(_reported(reported.error_success_m, 2), number(_error_of_successes(groups), 2)),
        *(_reported(reported.control_hz, 2), number(_mean([group.control_hz for group in groups]), 1)),
        *(total, _total(groups)),
    )


def _total(groups: Sequence[Statistics]) -> str:
    """Returns the mean total time to success of some groups, with the time spent planning in advance in brackets."""
    ahead = _mean([group.preplan_time for group in groups])
    text = number(_mean([group.total_time for group in groups]), 1)
    return f"{text} ({number(ahead, 1)})" if ahead >= PLANNED_AHEAD else text


def _error_of_successes(groups: Sequence[Statistics]) -> float:
    """Returns the mean epsilon_d^s of some groups, weighted by their successes, as the paper's means are [m]."""
    good = [group for group in groups if group.success.count]
    total = sum(group.success.count * group.error_until_success for group in good)
    return total / sum(group.success.count for group in good) if good else math.nan


def _mean(values: Sequence[float]) -> float:
    """Returns the mean of the finite values."""
    known = [value for value in values if math.isfinite(value)]
    return sum(known) / len(known) if known else math.nan


def _reported(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
