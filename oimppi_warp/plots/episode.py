"""Plots of an episode, drawn from its log and its scene."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from oimppi_warp.geometry.footprint import Piece, footprint, outline
from oimppi_warp.plots.style import FAINT, GOAL, INK, START, STYLE, WALL, add_rings, rendered
from oimppi_warp.record.log import EpisodeLog, write_atomically
from oimppi_warp.record.metrics import hold_steps, within
from oimppi_warp.scene import Scene

_TIME = matplotlib.colormaps["viridis"]
_TERMS = ["#34558b", "#8fb4d8", "#d08c60", "#efc9a5", "#5f8a6b", "#b3cfa8", "#7d5a7f", "#c9b3cb"]


def draw(log: EpisodeLog, scene: Scene, folder: str | Path) -> tuple[Path, ...]:
    """Draws every plot of a log to ``folder``, which must exist.

    Args:
        log: The episode; without steps, only the scene with start and goal is drawn.
        scene: The scene of the episode.
        folder: Folder for the PNGs.

    Returns:
        The files written: ``way.png`` (the object's path from above), ``errors.png`` (errors, clearance and costs over
        time) and, if anything was planned, ``plan_times.png``.
    """
    files = []
    with matplotlib.rc_context(STYLE):
        figures = {"way": path_figure(log, scene), "errors": errors_figure(log)}
        if not len(log) or np.isfinite(log["plan_ms"]).any():
            figures["plan_times"] = plan_times_figure(log)
        for name, figure in figures.items():
            write_atomically(Path(folder) / f"{name}.png", rendered(figure))
            files.append(Path(folder) / f"{name}.png")
    return tuple(files)


def path_figure(log: EpisodeLog, scene: Scene) -> Figure:
    """Draws the object's path from above: its footprint at even intervals, coloured by time."""
    figure = Figure(layout="constrained")
    axes = figure.add_subplot()
    width, height = draw_scene(axes, scene, poses_of(log), float(log.header["tolerance"]["position"]))
    figure.set_size_inches(7.0, 1.2 + 5.6 * min(max(height / width, 0.5), 1.6))
    pieces = footprint(scene.object.colliders)
    start, goal = np.asarray(log.header["start"], float), np.asarray(log.header["goal"], float)
    if len(log):
        norm = Normalize(0.0, max(float(log["time"][-1]), 1e-6))
        _draw_path(axes, log, pieces, norm)
        bar = figure.colorbar(ScalarMappable(norm, _TIME), ax=axes, fraction=0.04, pad=0.02)
        bar.set_label("time [s]")
        bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue, reportAttributeAccessIssue]
    draw_shape(axes, pieces, start, fc="none", ec=START, lw=1.8, label="start", zorder=6)
    draw_shape(axes, pieces, goal, fc="none", ec=GOAL, lw=1.8, ls=(0, (4, 2)), label="goal", zorder=6)
    radius = log.header["tolerance"]["position"]
    circle = Circle((goal[0], goal[1]), radius, fill=False, ec=GOAL, lw=0.9, ls=":", label="tolerance", zorder=2)
    axes.add_patch(circle)
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title=title_of(log))
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.09), ncols=4)
    return figure


def errors_figure(log: EpisodeLog) -> Figure:
    """Draws errors to the goal, clearance and cost terms over time."""
    figure = Figure(figsize=(7.0, 8.0), layout="constrained")
    position, yaw, clearance, cost = figure.subplots(4, 1, sharex=True, height_ratios=[1, 1, 1, 1.6])
    time, tolerance, tight = log["time"], log.header["tolerance"], log.header["tight_tolerance"]
    inside = within(log, tolerance).tolist()
    for axes, name, key, label in (
        (position, "position_error", "position", "position error [m]"),
        (yaw, "yaw_error", "yaw", "yaw error [rad]"),
    ):
        axes.plot(time, log[name], color=INK, lw=1.4)
        for limit, style, text in ((tolerance[key], "--", "tolerance"), (tight[key], ":", "tight tolerance")):
            if limit is not None and np.isfinite(limit):
                axes.axhline(limit, color=GOAL, lw=1.0, ls=style, label=text)
        axes.fill_between(time, 0, 1, where=inside, transform=axes.get_xaxis_transform(), color=GOAL, alpha=0.07, lw=0)
        axes.set(ylabel=label, ylim=(0, None))
    position.set_title(title_of(log))
    _legend(position)
    clearance.plot(time, 1000 * log["clearance"], color=INK, lw=1.2)
    clearance.axhline(0.0, color=WALL, lw=1.0)
    clearance.set(ylabel="clearance [mm]")
    _draw_costs(cost, log)
    cost.set(xlabel="time [s]", ylabel="cost of nominal rollout")
    return figure


def plan_times_figure(log: EpisodeLog) -> Figure:
    """Draws the wall time of each plan and the effective sample sizes over time."""
    figure = Figure(figsize=(7.0, 4.8), layout="constrained")
    plan, samples = figure.subplots(2, 1, sharex=True)
    time = log["time"]
    for name, color, label in (("plan_ms", INK, "plan"), ("object_plan_ms", _TIME(0.55), "object level")):
        finite = log[name][np.isfinite(log[name])]
        if len(finite):
            median, p95 = np.percentile(finite, (50, 95))
            plan.plot(time, log[name], color=color, lw=0.9, label=f"{label} (median {median:.1f}, p95 {p95:.1f} ms)")
    plan.set(ylabel="wall time per plan [ms]", ylim=(0, None))
    for name, color, label in (
        ("effective_samples", INK, "robot level"),
        ("object_effective_samples", _TIME(0.55), "object level"),
    ):
        if np.isfinite(log[name]).any():
            samples.plot(time, log[name], color=color, lw=0.9, label=label)
    samples.set(xlabel="time [s]", ylabel="effective samples", ylim=(0, None))
    figure.suptitle(title_of(log), x=0.01, ha="left", fontsize=10, fontweight="bold")
    _legend(plan)
    _legend(samples)
    return figure


def title_of(log: EpisodeLog) -> str:
    """Returns a one-line title with the run's options and its outcome."""
    header = log.header
    return f"{header['scene']}, {header['method'].upper()}, seed {header['seed']}: {header.get('ended', 'running')}"


def _legend(axes: Axes) -> None:
    """Adds a legend above the axes, to the right of the title, if anything has a label."""
    if names := axes.get_legend_handles_labels()[1]:
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=min(5, len(names)), borderaxespad=0.2)


def poses_of(log: EpisodeLog) -> np.ndarray:
    """Returns all planar poses of the object in a log, with its start and its goal first, shape [n, 3]."""
    return np.vstack([np.asarray([log.header["start"], log.header["goal"]], float), log["object_pose"].reshape(-1, 3)])


def draw_scene(axes: Axes, scene: Scene, poses: np.ndarray, tolerance: float) -> tuple[float, float]:
    """Draws table, robot base and obstacles, and sets the view.

    Args:
        axes: Axes to draw in.
        scene: The task.
        poses: Planar poses of the object that are to be in view, shape [n, 3] [m, m, rad].
        tolerance: Radius of the circle around the goal [m].

    Returns:
        Width and height of the view [m].
    """
    lower, upper = np.asarray(scene.table.lower), np.asarray(scene.table.upper)
    axes.add_patch(Rectangle(tuple(lower), *(upper - lower), fc="#fafbfc", ec=FAINT, lw=1.0, zorder=0))
    base = footprint(scene.robot.base.colliders)
    draw_shape(axes, base, np.zeros(3), fc="#dfe5e9", ec=WALL, lw=1.0, label="robot base", zorder=3)
    obstacles = [footprint(obstacle.colliders) for obstacle in scene.obstacles]
    for index, pieces in enumerate(obstacles):
        draw_shape(axes, pieces, np.zeros(3), fc=WALL, ec="none", label="obstacle" if index == 0 else None, zorder=3)
    corners = [shapely.bounds(outline(pieces)) for pieces in obstacles]
    reach = 0.05 + max(0.15, tolerance)
    points = np.vstack([poses[:, :2] - reach, poses[:, :2] + reach, [[-0.12, -0.12]], *np.reshape(corners, (-1, 2, 2))])
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    return high[0] - low[0], high[1] - low[1]


def _draw_path(axes: Axes, log: EpisodeLog, pieces: tuple[Piece, ...], norm: Normalize) -> None:
    """Draws the tool path, the first object plan, the object's path, and its footprint at intervals."""
    time, poses, tool = log["time"], log["object_pose"], log["tool_position"]
    axes.plot(tool[:, 0], tool[:, 1], color="#8b98a1", lw=0.6, label="tool", zorder=1)
    if len(log.references) == 1:  # planned once in advance, and not again during the episode
        plan = log.references[0][1]
        axes.plot(plan[:, 0], plan[:, 1], color=INK, lw=1.0, ls=(0, (1, 1.5)), label="object plan", zorder=4)
    for row in _rows_along(poses, count=12):
        color = _TIME(norm(time[row]))
        draw_shape(axes, pieces, poses[row], fc=(*color[:3], 0.10), ec=color, lw=0.9, zorder=4)
    draw_shape(axes, pieces, poses[-1], fc=(*_TIME(1.0)[:3], 0.35), ec=_TIME(1.0), lw=1.4, zorder=5)
    segments = np.stack([poses[:-1, :2], poses[1:, :2]], axis=1)
    axes.add_collection(LineCollection(list(segments), array=time[1:], cmap=_TIME, norm=norm, lw=2.0, zorder=5))


def _rows_along(poses: np.ndarray, *, count: int) -> list[int]:
    """Returns up to ``count`` rows at even intervals along the path; a radian counts as 0.1 m."""
    moves = np.abs(np.diff(poses, axis=0))
    path = np.concatenate([[0.0], np.cumsum(np.hypot(moves[:, 0], moves[:, 1]) + 0.1 * np.minimum(moves[:, 2], 1.0))])
    return np.unique(np.searchsorted(path, np.linspace(0.0, path[-1], count + 1)[:-1])).tolist()


def draw_shape(axes: Axes, pieces: tuple[Piece, ...], pose: np.ndarray, **style: Any) -> None:
    """Draws the union of the pieces at a planar pose as one patch."""
    shape = outline(piece.moved(pose) for piece in pieces)
    rings = [np.asarray(part.exterior.coords) for part in shapely.get_parts(shape) if part.geom_type == "Polygon"]
    add_rings(axes, rings, **style)


def _draw_costs(axes: Axes, log: EpisodeLog) -> None:
    """Draws the largest cost terms, stacked, each smoothed over half a second."""
    names, terms = log.header.get("cost_terms", []), log["cost_terms"]
    if not len(log) or not terms.shape[1]:
        return
    width = min(len(log), hold_steps(0.5, log.header["control_period"]))
    window = np.ones(width) / width
    counts = np.convolve(np.ones(len(log)), window, mode="same")
    smooth = np.stack([np.convolve(np.nan_to_num(term), window, mode="same") / counts for term in terms.T])
    order = np.argsort(-smooth.mean(axis=1))
    shown = [index for index in order if smooth[index].mean() > 0.01 * smooth.mean(axis=1).sum()][:8]
    axes.stackplot(log["time"], smooth[shown], labels=[names[index] for index in shown], colors=_TERMS, lw=0)
    _legend(axes)
