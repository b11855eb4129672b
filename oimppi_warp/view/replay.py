"""Shows a recorded episode as pictures, in a view that can play and scrub through them."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from oimppi_warp.errors import SceneError
from oimppi_warp.observation import planar_transform
from oimppi_warp.record.bag_record import load_record
from oimppi_warp.record.log import EpisodeLog, LogError
from oimppi_warp.record.metrics import summarize
from oimppi_warp.scene import Scene
from oimppi_warp.signals import check_interrupted
from oimppi_warp.usd import load_scene
from oimppi_warp.view.browser import Page
from oimppi_warp.view.canvas import Canvas
from oimppi_warp.view.controls import FPS, Playback, add_legend, add_plot
from oimppi_warp.view.picture import Picture

FIGURES = {
    "position error [m]": ("position_error", 1.0),
    "yaw error [rad]": ("yaw_error", 1.0),
    "clearance [mm]": ("clearance", 1e3),
    "cost": ("min_cost", 1.0),
    "effective samples": ("effective_samples", 1.0),
    "plan time [ms]": ("plan_ms", 1.0),
}
"""Plotted values: the log's column, and the factor to the displayed unit."""


class Replay:
    """A record as a sequence of pictures, one for each control step.

    Args:
        path: A record's folder, as written by ``--record``, or a bag that was exported from one.

    Raises:
        LogError: There is no complete record, or the record has no control steps.
        ConfigError: The path is that of a bag, and the package rosbags is not installed.
        SceneError: The record's scene is neither at its original location nor a shipped one.
    """

    def __init__(self, path: str | Path) -> None:
        self.log = load_record(path)
        if not len(self.log):
            raise LogError(f"{path}: the record has no control steps\n  allowed: a record with at least one")
        self.scene = _scene_of(self.log)

    def __len__(self) -> int:
        return len(self.log)

    def picture(self, row: int) -> Picture:
        """Returns the picture after a control step."""
        log = self.log
        x, y, yaw = (float(value) for value in log["object_pose"][row])
        paths = [path for step, path in log.references if step <= row]
        terms = dict(zip(log.header["cost_terms"], log["cost_terms"][row].tolist(), strict=False))
        return Picture(
            scene=self.scene,
            time=float(log["time"][row]),
            joints=log["joint_position"][row],
            object_transform=planar_transform((x, y, yaw), self.scene.object.rest_height),
            reference=paths[-1] if paths else np.zeros((0, 3)),
            tips=log["tool_position"][max(row - 40, 0) : row + 1] if row else np.zeros((0, 3)),
            terms={name: value for name, value in terms.items() if np.isfinite(value)},
            figures={name: factor * float(log[column][row]) for name, (column, factor) in FIGURES.items()},
            status=log.header["ended"] if row == len(log) - 1 else "recorded",
        )


class ReplayView:
    """Plays, scrubs and steps through a record in the browser.

    Args:
        page: The page to show it on.
        canvas: Draws on the page.
        replay: The record to show.
        paused: Whether it is paused at first.
    """

    def __init__(self, page: Page, canvas: Canvas, replay: Replay, *, paused: bool = False) -> None:
        self._page, self._canvas = page, canvas
        self._replay = replay
        self._row = 0.0
        self._drawn = -1
        self._period = float(replay.log.header["control_period"])
        self._playback = Playback(page.server, paused=paused)
        gui: Any = page.server.gui
        metrics = summarize(replay.log)
        result = "goal reached" if metrics.success else "goal not reached"
        with gui.add_folder("Record", order=-10.0):
            gui.add_markdown(f"**{metrics.scene}, {metrics.run.method.upper()}, seed {metrics.run.seed}**: {result}")
            self._state = gui.add_markdown("")
            self._slider = gui.add_slider("Step", min=0, max=max(len(replay) - 1, 1), step=1, initial_value=0)
            self._speed = gui.add_slider("Speed", min=0.25, max=8.0, step=0.25, initial_value=1.0)
        self._slider.on_update(lambda event: event.client_id is not None and self._jump(int(event.target.value)))
        self._add_plots()
        add_legend(gui)

    @property
    def row(self) -> int:
        """Returns the number of the control step shown."""
        return int(self._row)

    def run(self) -> None:
        """Plays until the viewer is closed."""
        while self._page.open:
            check_interrupted()
            began = time.perf_counter()
            self.tick(1.0 / FPS)
            time.sleep(max(1.0 / FPS - (time.perf_counter() - began), 0.002))

    def tick(self, seconds: float = 0.0) -> None:
        """Advances playback and draws the new picture.

        Args:
            seconds: Wall time that has passed [s]; while paused, each step request advances one control step instead.
        """
        last = len(self._replay) - 1
        if self._playback.take_reset():
            self._row = 0.0
        if not self._playback.paused:
            self._row = min(self._row + seconds * self._speed.value / self._period, last)
        elif self._playback.take_step():
            self._row = min(self._row + 1.0, last)
        if self.row == self._drawn:
            return
        picture = self._replay.picture(self.row)
        self._canvas.show(picture)
        self._slider.value = self.row
        errors = (
            f"{picture.figures['position error [m]']:.3f} m and "
            f"{picture.figures['yaw error [rad]']:.2f} rad from the goal"
        )
        self._state.content = f"{picture.time:.2f} s; {errors}; {picture.status}"
        self._drawn = self.row

    def _jump(self, row: int) -> None:
        self._row = float(row)

    def _add_plots(self) -> None:
        """Plots all values over the whole episode."""
        log, gui = self._replay.log, self._page.server.gui
        with gui.add_folder("Plots", order=10.0):
            for name, (column, factor) in FIGURES.items():
                known = np.isfinite(log[column])
                if known.any():
                    add_plot(gui, name, log["time"][known].astype(float), factor * log[column][known].astype(float))


def _scene_of(log: EpisodeLog) -> Scene:
    """Loads the scene of a record, with the record's start and goal."""
    file = Path(log.header["file"])
    try:
        scene = load_scene(file if file.exists() else log.header["scene"])
    except SceneError as error:
        raise SceneError(
            f"the scene of this record, {log.header['scene']}, was not found",
            file=file,
            allowed="the original file, or a shipped scene with that name",
        ) from error
    (x0, y0, yaw0), (x1, y1, yaw1) = log.header["start"], log.header["goal"]
    return scene.with_start((x0, y0, yaw0)).with_goal((x1, y1, yaw1))
