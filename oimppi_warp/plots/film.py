"""A film of an episode from above, drawn from its log: object, tool, goal and the tracked plan."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from PIL import Image

from oimppi_warp.geometry.footprint import footprint
from oimppi_warp.plots.episode import draw_scene, draw_shape, poses_of, title_of
from oimppi_warp.plots.style import GOAL, INK, START, STYLE
from oimppi_warp.record.log import EpisodeLog, write_atomically
from oimppi_warp.scene import Scene

FPS = 10
"""Frames per second."""


def film(log: EpisodeLog, scene: Scene, file: str | Path, *, speed: float = 2.0) -> int:
    """Writes an animated GIF.

    Args:
        log: The episode, with at least one step.
        scene: The scene of the episode.
        file: File to write.
        speed: Simulated seconds per second of film.

    Returns:
        Number of frames.
    """
    time = log["time"]
    rows = np.searchsorted(time, np.arange(time[0], time[-1] + 1e-9, speed / FPS))
    rows = np.minimum(np.append(rows, len(time) - 1), len(time) - 1)
    first, *others = [frame.quantize(64) for frame in frames(log, scene, rows.tolist())]
    packed = io.BytesIO()
    durations = [1000 // FPS] * len(others) + [2000]
    first.save(packed, format="GIF", save_all=True, append_images=others, duration=durations, loop=0, optimize=True)
    write_atomically(file, packed.getvalue())
    return len(rows)


def frames(log: EpisodeLog, scene: Scene, rows: Iterable[int]) -> Iterator[Image.Image]:
    """Yields an image of the scene from above after each of the given control steps."""
    for row in rows:
        height = 1e3 * log["tool_position"][row, 2]
        title = f"{title_of(log)}\n{log['time'][row]:.1f} s, tip height {height:.0f} mm"
        yield picture_from_above(scene, title=title, **state_of(log, row))


def state_of(log: EpisodeLog, row: int) -> dict[str, Any]:
    """Returns the arguments of :func:`draw_state` after a control step of a log."""
    plans = [path for step, path in log.references if step <= row]
    return {
        "pose": log["object_pose"][row],
        "tips": log["tool_position"][max(row - 20, 0) : row + 1],
        "goal": np.asarray(log.header["goal"], float),
        "tolerance": float(log.header["tolerance"]["position"]),
        "in_view": poses_of(log),
        "plan": plans[-1] if plans else np.zeros((0, 3)),
    }


def picture_from_above(scene: Scene, *, title: str, **state: Any) -> Image.Image:
    """Draws a state of a task from above, as :func:`draw_state`, with some text above the picture."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(3.6, 4.8), dpi=100, layout="constrained")
        canvas = FigureCanvasAgg(figure)
        axes = figure.add_subplot()
        draw_state(axes, scene, **state)
        axes.set_title(title, fontsize=8)
        canvas.draw()
        return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")


def draw_state(
    axes: Axes,
    scene: Scene,
    *,
    pose: np.ndarray,
    tips: np.ndarray,
    goal: np.ndarray,
    tolerance: float,
    in_view: np.ndarray,
    plan: np.ndarray,
) -> None:
    """Draws a state of a task from above.

    Args:
        axes: Axes to draw in.
        scene: The task.
        pose: Planar pose of the object, shape [3] [m, m, rad].
        tips: Latest positions of the tip, of which the last is the present one, shape [n, 3] [m].
        goal: Planar pose of the goal, shape [3] [m, m, rad].
        tolerance: Radius of the circle around the goal [m].
        in_view: Planar poses of the object that are to be in view, shape [n, 3] [m, m, rad].
        plan: Planned poses of the object, shape [n, 3] [m, m, rad].
    """
    draw_scene(axes, scene, in_view, tolerance)
    pieces = footprint(scene.object.colliders)
    draw_shape(axes, pieces, goal, fc="none", ec=GOAL, lw=1.4, ls=(0, (4, 2)), zorder=6)
    axes.add_patch(Circle((goal[0], goal[1]), tolerance, fill=False, ec=GOAL, lw=0.8, ls=":", zorder=2))
    axes.plot(plan[:, 0], plan[:, 1], color=INK, lw=0.8, ls=(0, (1, 1.5)), zorder=4)
    draw_shape(axes, pieces, pose, fc=(*to_rgb(START), 0.25), ec=START, zorder=5)
    axes.plot(tips[:, 0], tips[:, 1], color="#8b98a1", lw=1.0, zorder=7)
    axes.add_patch(Circle((tips[-1, 0], tips[-1, 1]), scene.robot.tool_radius, fc=INK, ec="none", zorder=8))
    axes.set_aspect("equal")
