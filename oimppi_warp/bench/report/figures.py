"""Draws the report's figures from results alone, with one colour per method throughout."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Rectangle
from matplotlib.ticker import FixedLocator, NullLocator, PercentFormatter, StrMethodFormatter

from oimppi_warp.bench.footprints import transformed
from oimppi_warp.bench.paper import REPORTED
from oimppi_warp.bench.report.tables import shown_methods
from oimppi_warp.bench.results import PLAN_BINS, Result, ResultSet
from oimppi_warp.bench.statistics import summarize_results
from oimppi_warp.plots.style import FAINT, GOAL, INK, STYLE, WALL, add_rings, method_colors

FAILED = "#b91c1c"
"""Colour of failures."""


def every_figure(results: ResultSet) -> dict[str, tuple[str, Figure]]:
    """Draws the figures of a report, and returns the caption and the figure of each, by file name without extension."""
    with matplotlib.rc_context(STYLE):
        reported = any(results.of(task, method) for task, method in REPORTED)
        found = {
            "success": (
                "Success rates with Wilson's 95 % intervals. Light bars: the task's tolerance; solid bars, in front: "
                f"the tight tolerance{'; diamonds: the rates reported in the paper' * reported}.",
                success_figure(results),
            ),
            "errors": (
                "Distance to the goal over simulated time: mean and quartiles over trials; after an episode ends, its "
                "last error is kept. The dotted line is the tolerance.",
                errors_figure(results),
            ),
            "plan_times": (
                "Distribution of the wall time per plan, for each method over all its tasks. The line is the median.",
                plan_figure(results),
            ),
        }
        for task in results.tasks:
            title = results.places[task]["title"].rstrip(".")
            found[f"ways_{task}"] = (
                f"{task}. {title}. Paths of the object seen from above, with a dot at the start and the object drawn "
                "at its final pose; failed trials in red. Dashed: the goal; dotted: its tolerance.",
                paths_figure(results, task),
            )
    return found


def success_figure(results: ResultSet) -> Figure:
    """Draws a bar chart of the success rates with confidence intervals, by task and method."""
    tasks, colors = results.tasks, _colors(results)
    methods = list(colors)
    figure = Figure(figsize=(max(5.0, 1.6 + 1.5 * len(tasks)), 3.6), layout="constrained")
    axes = figure.add_subplot()
    width = 0.8 / len(methods)
    beside = False
    for index, method in enumerate(methods):
        color = colors[method]
        for place, task in enumerate(tasks):
            if not (found := results.of(task, method)):
                continue
            stats, x = summarize_results(found), place + (index - (len(methods) - 1) / 2) * width
            rate = stats.success
            axes.bar(x, rate.share, 0.88 * width, color=(*to_rgb(color), 0.35))
            if stats.tight_counts:
                axes.bar(x, stats.tight.share, 0.88 * width, color=color)
            spread = [[rate.share - rate.low], [rate.high - rate.share]]
            axes.errorbar(x, rate.share, spread, color=INK, lw=1.1, capsize=3, capthick=1.1, zorder=4)
            axes.annotate(
                f"{rate.count}/{rate.total}",
                (x, 0.0),
                (0, -9),
                textcoords="offset points",
                ha="center",
                va="center",
                fontsize=7,
            )
            if (task, method) in REPORTED:
                beside = True
                paper = REPORTED[task, method].success
                axes.plot(x, paper, marker="D", ms=5, mfc="white", mec=INK, mew=1.1, ls="", zorder=5, clip_on=False)
    axes.set(ylim=(0, 1.04), ylabel="success rate", xlim=(-0.6, len(tasks) - 0.4))
    axes.set_xticks(range(len(tasks)), tasks)
    axes.tick_params(axis="x", length=0, pad=14)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.grid(visible=False, axis="x")
    handles: list[Any] = [Patch(color=color, label=method.upper()) for method, color in colors.items()]
    if beside:
        handles.append(Line2D([], [], marker="D", ms=5, mfc="white", mec=INK, ls="", label="paper"))
    axes.legend(handles=handles, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(handles))
    return figure


def errors_figure(results: ResultSet) -> Figure:
    """Plots the position error over time, by task."""
    figure, panels = _panels(len(results.tasks), each=(3.4, 2.4))
    colors = _colors(results)
    for axes, task in zip(panels, results.tasks, strict=False):
        end = max((result.time[-1] for result in results.of(task) if result.time), default=1.0)
        grid = np.linspace(0.0, end, 120)
        for method, color in colors.items():
            runs = [result for result in results.of(task, method) if result.time]
            if not runs:
                continue
            curves = np.array([np.interp(grid, run.time, run.position_error) for run in runs])
            low, high = np.percentile(curves, (25, 75), axis=0)
            axes.fill_between(grid, low, high, color=color, alpha=0.18, lw=0)
            axes.plot(grid, curves.mean(axis=0), color=color, lw=1.8, label=method.upper())
        axes.axhline(results.places[task]["tolerance"], color=GOAL, lw=1.0, ls=":")
        axes.set(title=task, xlim=(0, end), ylim=(0, None))
    figure.supxlabel("simulated time [s]", fontsize=9)
    figure.supylabel("distance to the goal [m]", fontsize=9)
    handles = [Line2D([], [], color=color, lw=2, label=method.upper()) for method, color in colors.items()]
    figure.legend(handles=handles, loc="outside upper right", ncols=len(handles))
    return figure


def plan_figure(results: ResultSet) -> Figure:
    """Plots histograms of the plan times, one panel per method."""
    colors = _colors(results)
    figure = Figure(figsize=(6.4, 0.7 + 1.15 * len(colors)), layout="constrained")
    panels = figure.subplots(len(colors), 1, sharex=True, squeeze=False)[:, 0]
    shown: list[float] = []
    for axes, (method, color) in zip(panels, colors.items(), strict=True):
        counts = [result.plan_counts for result in results.of(method=method) if result.plan_counts]
        share = np.sum(counts, axis=0) if counts else np.zeros(len(PLAN_BINS) - 1)
        axes.set_title(method.upper(), color=color)
        axes.grid(visible=False, axis="y")
        axes.set_yticks([])
        axes.spines["left"].set_visible(False)
        if not share.sum():
            continue
        axes.stairs(share / share.sum(), PLAN_BINS, fill=True, color=color, alpha=0.8)
        middle = int(np.searchsorted(np.cumsum(share), share.sum() / 2))
        at = math.sqrt(PLAN_BINS[middle] * PLAN_BINS[middle + 1])
        axes.axvline(at, color=INK, lw=1.2)
        text = f"median {at:.0f} ms" if at >= 10 else f"median {at:.1f} ms"
        axes.set_title(text, loc="right", fontsize=8, fontweight="normal")
        used = np.flatnonzero(share > 0.001 * share.sum())
        shown += [float(PLAN_BINS[used[0]]), float(PLAN_BINS[used[-1] + 1])]
    panels[-1].set(xscale="log", xlabel="wall time per plan [ms]")
    if shown:
        panels[-1].set_xlim(0.7 * min(shown), 1.4 * max(shown))
    ticks = [0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000]
    panels[-1].xaxis.set_major_locator(FixedLocator(ticks))
    panels[-1].xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    panels[-1].xaxis.set_minor_locator(NullLocator())
    return figure


def paths_figure(results: ResultSet, task: str) -> Figure:
    """Plots the object's paths seen from above, one panel per method."""
    footprints = results.places[task]
    colors = {method: color for method, color in _colors(results).items() if results.of(task, method)}
    low, high = shown_region(footprints, results.of(task))
    width, height = high - low
    size = 3.0
    figure = Figure(figsize=(0.5 + size * len(colors), 0.6 + min(size * height / width, 5.0)), layout="constrained")
    panels = figure.subplots(1, len(colors), sharex=True, sharey=True, squeeze=False)[0]
    for axes, (method, color) in zip(panels, colors.items(), strict=True):
        runs = results.of(task, method)
        draw_footprints(axes, footprints)
        for run in sorted(runs, key=lambda result: not result.success):
            if run.pose:
                _draw_run(axes, footprints, run, color if run.success else FAILED)
        axes.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]")
        rate = summarize_results(runs).success
        axes.set_title(f"{method.upper()}  {rate.count}/{rate.total}", color=color)
    panels[0].set_ylabel("y [m]")
    return figure


def _colors(results: ResultSet) -> dict[str, str]:
    """Returns a colour for each method, in display order."""
    return method_colors(shown_methods(results))


def draw_footprints(axes: Axes, footprints: dict[str, Any]) -> None:
    """Draws table, base, obstacles and goal."""
    lower, upper = np.asarray(footprints["table"])
    axes.add_patch(Rectangle(tuple(lower), *(upper - lower), fc="#fafbfc", ec=FAINT, lw=1.0, zorder=0))
    add_rings(axes, [np.asarray(ring) for ring in footprints["base"]], fc="#dfe5e9", ec=WALL, lw=0.8, zorder=2)
    for rings in footprints["obstacles"]:
        add_rings(axes, [np.asarray(ring) for ring in rings], fc=WALL, ec="none", zorder=2)
    goal = footprints["goal"]
    add_rings(axes, transformed(footprints["object"], goal), fc="none", ec=GOAL, lw=1.6, ls=(0, (4, 2)), zorder=6)
    axes.add_patch(Circle((goal[0], goal[1]), footprints["tolerance"], fill=False, ec=GOAL, lw=0.9, ls=":", zorder=1))


def _draw_run(axes: Axes, footprints: dict[str, Any], run: Result, color: str) -> None:
    path = np.vstack([run.start, *run.pose])
    axes.plot(path[:, 0], path[:, 1], color=color, lw=1.1, alpha=0.8, zorder=4)
    axes.plot(*path[0, :2], marker="o", ms=2.5, color=color, zorder=4)
    rings = transformed(footprints["object"], path[-1])
    add_rings(axes, rings, fc=(*to_rgb(color), 0.05), ec=(*to_rgb(color), 0.75), lw=0.8, zorder=3)


def shown_region(footprints: dict[str, Any], runs: Sequence[Result]) -> tuple[np.ndarray, np.ndarray]:
    """Returns the lower and upper corner of the displayed region, shape [2] [m] each."""
    size = max(np.abs(np.asarray(ring)).max() for ring in footprints["object"])
    reach = 0.02 + max(size, footprints["tolerance"])
    goal = np.asarray(footprints["goal"][:2])
    points = [goal - reach, goal + reach, np.array([-0.12, -0.12])]
    points += [np.asarray(ring) for rings in footprints["obstacles"] for ring in rings]
    for run in runs:
        paths = np.vstack([run.start, *run.pose])[:, :2]
        points += [paths - size, paths + size]
    stacked = np.vstack(points)
    lower, upper = np.asarray(footprints["table"])
    return np.maximum(stacked.min(axis=0), lower - 0.15), np.minimum(stacked.max(axis=0), upper + 0.15)


def _panels(count: int, *, each: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    """Creates a grid of up to three panels per row, hiding the unused ones."""
    columns = min(3, count)
    rows = math.ceil(count / columns)
    figure = Figure(figsize=(max(4.5, each[0] * columns), 0.5 + each[1] * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for axes in panels[count:]:
        axes.set_visible(False)
    return figure, panels
