"""Parts of the viewer's page: pause and step, plots over time, and handles to drag things across the table."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from oimppi_warp.view.canvas import LEGEND

FPS = 20.0
"""Maximum frame rate [1/s]."""
_PLOTTED = 250
"""Number of values that a plot shows."""
_HANDLE_SIZE = 56.0
"""Size of a handle [pixels]."""


class Playback:
    """Controls to pause, to go one step, and to start again.

    Args:
        server: A viser server.
        paused: Whether it is paused at first.

    Attributes:
        paused: Whether it is paused.
    """

    def __init__(self, server: Any, *, paused: bool = False) -> None:
        self.paused = paused
        self._steps, self._reset = 0, False
        with server.gui.add_folder("Simulation", order=0.0):
            pause = server.gui.add_checkbox("Pause", initial_value=paused)
            step = server.gui.add_button("Step", disabled=not paused)
            reset = server.gui.add_button("Reset")

        # Callbacks that are not coroutines run in threads, and may overtake each other.
        @pause.on_update
        async def pause_or_go_on(event: Any) -> None:
            self.paused, self._steps = event.target.value, 0
            step.disabled = not self.paused

        @step.on_click
        async def one_step(_event: Any) -> None:
            if self.paused:
                self._steps += 1

        @reset.on_click
        async def start_again(_event: Any) -> None:
            self._reset = True

    def take_step(self) -> bool:
        """Returns whether a step was asked for while paused; each is returned once."""
        if self._steps == 0:
            return False
        self._steps -= 1
        return True

    def take_reset(self) -> bool:
        """Returns whether a new start was asked for since the last call."""
        asked, self._reset = self._reset, False
        return asked


def add_legend(gui: Any) -> None:
    """Adds a closed folder that names what is drawn, by its colour."""
    with gui.add_folder("Legend", order=7.0, expand_by_default=False):
        gui.add_html("".join(_legend_row(color, meaning) for color, meaning in LEGEND))


def _legend_row(color: Sequence[float], meaning: str) -> str:
    shade = ",".join(f"{100 * part ** (1 / 2.2):.0f}%" for part in color)  # of the page, which has sRGB
    swatch = f'<span style="color:rgb({shade})">&#9632;</span>'
    return f'<div style="font-size:0.85em;padding:0 0.8em">{swatch} {meaning}</div>'


class Plots:
    """Values over time, each in a plot of its own.

    Args:
        server: A viser server.

    Attributes:
        shown: Whether plots are on the page; they are added one at a time, since each takes a browser a while.
    """

    def __init__(self, server: Any) -> None:
        self.shown = False
        self._gui = server.gui
        self._folder: Any = None
        self._values: dict[str, deque[tuple[float, float]]] = {}
        self._plots: dict[str, Any] = {}
        self._time = -np.inf

    def add(self, time: float, values: Mapping[str, float]) -> None:
        """Adds values at a time [s]; once the time goes back, the plots begin anew."""
        if time < self._time:
            self._values.clear()
        self._time = time
        for name, value in values.items():
            if np.isfinite(value):
                self._values.setdefault(name, deque(maxlen=_PLOTTED)).append((time, float(value)))
        if not self.shown:
            return
        for name, plot in self._plots.items():
            plot.data = tuple(np.array(self._values.get(name, ())).reshape(-1, 2).T)
        if missing := [name for name in self._values if name not in self._plots]:
            if self._folder is None:
                self._folder = self._gui.add_folder("Plots", order=10.0)
            with self._folder:
                self._plots[missing[0]] = add_plot(self._gui, missing[0], *np.array(self._values[missing[0]]).T)


def add_plot(gui: Any, name: str, times: np.ndarray, values: np.ndarray) -> Any:
    """Adds a plot of values over time [s] to a page, and returns viser's handle."""
    from viser import uplot

    return gui.add_uplot(
        data=(times, values),
        series=(uplot.Series(label="s"), uplot.Series(label=name, stroke="#3b82f6", width=2)),
        scales={"x": uplot.Scale(time=False)},
        aspect=2.5,
    )


class Handle:
    """Arrows and a ring with which something is dragged across the table and turned about the vertical.

    Args:
        server: A viser server.
        name: Name of the handle.
        place: Position [m] and quaternion xyzw, shape [7].

    Attributes:
        place: Where it is.
        dragged: Whether somebody is dragging it.
    """

    def __init__(self, server: Any, name: str, place: np.ndarray) -> None:
        self.place, self.dragged = np.asarray(place, dtype=float), False
        self._dropped = False
        self._control = server.scene.add_transform_controls(
            f"/handles/{name}",
            scale=_HANDLE_SIZE,
            fixed=True,
            depth_test=False,
            active_axes=(True, True, False),  # and the ring about the third one
        )
        self._send()

        @self._control.on_update
        async def update(event: Any) -> None:  # as a coroutine, like those above
            self._update(event)

    def remove(self) -> None:
        """Removes the handle from the page."""
        self._control.remove()

    def move_to(self, place: np.ndarray) -> None:
        """Moves the handle, unless somebody is dragging it."""
        if not self.dragged and not self._dropped:
            self.place = np.asarray(place, dtype=float)
            self._send()

    def take_drop(self) -> bool:
        """Returns whether a drag has ended, at :attr:`place`; each end is returned once."""
        dropped, self._dropped = self._dropped, False
        return dropped

    def _update(self, event: Any) -> None:
        self.place = np.concatenate([event.target.position, np.roll(event.target.wxyz, -1)])
        if event.phase == "end":
            self._dropped = True
        self.dragged = event.phase != "end"  # last, as from then on it may be moved away

    def _send(self) -> None:
        self._control.position, self._control.wxyz = self.place[:3], np.roll(self.place[3:], 1)
