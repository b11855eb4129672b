"""The live view: shows a session in the browser, with controls to change it while it runs."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import shapely

from oimppi_warp.config.presets import PRESETS
from oimppi_warp.config.run_spec import LARGEST_SEED
from oimppi_warp.errors import OimppiError
from oimppi_warp.geometry.feasibility import object_outline, sample_start
from oimppi_warp.observation import planar_pose, planar_transform
from oimppi_warp.registries import ENGINES, METHODS, PLANTS
from oimppi_warp.scene import PlanarPose
from oimppi_warp.signals import check_interrupted
from oimppi_warp.usd.editing import save_scene
from oimppi_warp.view.browser import Page
from oimppi_warp.view.canvas import Canvas
from oimppi_warp.view.controls import FPS, Handle, Playback, Plots, add_legend
from oimppi_warp.view.picture import Picture
from oimppi_warp.view.session import Session
from oimppi_warp.view.settings_panel import SettingsPanel

KNOCK = 0.4
"""Speed that a click imparts to the object [m/s]."""
_SPEEDS = {"0.25": 0.25, "0.5": 0.5, "1": 1.0, "2": 2.0, "4": 4.0, "unlimited": float("inf")}
_SHAPES = {
    "visible": {"visible": True, "colliders": False},
    "colliders": {"visible": False, "colliders": True},
    "both": {"visible": True, "colliders": True},
}
"""Arguments of :meth:`oimppi_warp.view.browser.Page.show_shapes` for each choice of the control "Shapes"."""
_UNWATCHED = 0.2
"""Time without a browser after which a real arm is stopped [s]."""
_SETTINGS_AFTER, _SETTINGS_EVERY = 3.0, 0.2
"""Time after the session's start at which plots and the first folder of settings appear, and time between two folders
[s]. A slow browser draws nothing while it creates them, so the arm should be moving first."""
_HANDLE_HEIGHT = 0.06
"""Height of the handles of goal and object above the table [m]."""
_BARS = 10
"""Maximum number of cost terms shown."""


class LiveView:
    """Draws a session and passes the user's changes to it.

    Args:
        page: The page to show it on.
        canvas: Draws on the page.
        session: The session to show.
        paused: Whether the session is paused at first.
    """

    def __init__(self, page: Page, canvas: Canvas, session: Session, *, paused: bool = False) -> None:
        self._page, self._canvas = page, canvas
        self._session = session
        self._gui = page.server.gui
        self._drawn: Picture | None = None
        self._plotted = -1.0
        self._handles: dict[str, Handle] = {}
        self._made = 0  # handles so far
        self._playback = Playback(page.server, paused=paused)
        session.paused = paused
        self._plots = Plots(page.server)
        self._add_controls()
        self._settings = SettingsPanel(page.server, session.wanted.config, lambda config: session.change(config=config))
        page.server.scene.on_click()(self._click)

    def run(self) -> None:
        """Draws until the viewer is closed; the session starts when the first browser connects.

        When the last browser is closed, a real arm is stopped for good.
        """
        begun, seen, due = False, 0.0, math.inf
        while self._page.open:
            check_interrupted()
            began = time.perf_counter()
            if self._page.watched:
                seen = began
                if not begun:
                    begun, due = True, began + _SETTINGS_AFTER
                    self._session.start()
            elif begun and self._session.real and began - seen > _UNWATCHED:
                self._session.close()
            self.tick()
            if began >= due:
                if not self._plots.shown:
                    self._plots.shown = True
                    add_legend(self._gui)
                due = began + _SETTINGS_EVERY if self._settings.add_folder() else math.inf
            time.sleep(max(1.0 / FPS - (time.perf_counter() - began), 0.002))

    def tick(self) -> None:
        """Sends pending commands to the session and draws its latest picture."""
        session = self._session
        session.paused = self._playback.paused
        if self._playback.take_step():
            session.step()
        if self._playback.take_reset():
            session.restart()
        session.watched = self._page.watched
        self._page.show_shapes(**_SHAPES[self._shapes.value])
        picture = session.latest
        if picture is self._drawn and not self._move.value and not self._handles:
            return
        with self._page.frame(picture.time):
            try:
                self._canvas.draw(picture)
            except OimppiError as error:  # the planner does not need the file
                session.problem = str(error)
            self._show_handles(picture)
            if picture.time != self._plotted:
                self._plots.add(picture.time, picture.figures)
                self._plotted = picture.time
        self._show_status(picture)
        self._drawn = picture

    def _add_controls(self) -> None:
        gui, session = self._gui, self._session
        with gui.add_folder("Status", order=-10.0):
            self._status = gui.add_markdown("")
            self._bars = gui.add_html("")
        with gui.add_folder("Task and planner", order=5.0):
            speed = gui.add_dropdown(
                "Speed", tuple(_SPEEDS), initial_value="1", hint="Maximum simulated seconds per second of wall time."
            )
            speed.on_update(lambda _event: setattr(session, "speed", _SPEEDS[speed.value]))
            gui.add_button("New seed and start").on_click(lambda _event: self._new_seed())
            offered = {"method": tuple(METHODS), "engine": ("auto", *ENGINES), "plant": tuple(PLANTS)}
            for name, choices in offered.items():
                chosen = getattr(session.wanted.spec, name)
                if chosen not in choices:  # a plant from a file
                    choices = (*choices, chosen)
                control = gui.add_dropdown(name.capitalize(), choices, initial_value=chosen)
                control.on_update(lambda event, name=name: self._choose(name, event))
            preset = gui.add_dropdown("Preset", tuple(PRESETS), initial_value=session.wanted.config.preset)
            preset.on_update(self._choose_preset)
            self._move = gui.add_checkbox(
                "Show handles",
                initial_value=False,
                hint="Shows handles for dragging the goal, the object and the obstacles across the table.",
            )
            self._knock = gui.add_checkbox(
                "Click to push",
                initial_value=False,
                hint="A click on the object gives it a push in the viewing direction.",
            )
            if session.real:
                gui.add_button("Go on", hint="After a stop of the arm.").on_click(lambda _event: session.go_on())
            self._shapes = gui.add_dropdown(
                "Shapes",
                tuple(_SHAPES),
                hint="Colliders are what planner and physics know of arm, object and obstacles.",
            )
            name = gui.add_text("Scene file", initial_value=f"my_{session.wanted.scene.name}.usda")
            gui.add_button("Save as scene").on_click(lambda event: self._save(event, name.value))

    def _choose(self, name: str, event: Any) -> None:
        if event.client_id is not None:
            self._session.change(**{name: event.target.value})

    def _choose_preset(self, event: Any) -> None:
        if event.client_id is not None:
            wanted = self._session.wanted
            config = PRESETS[event.target.value](wanted.spec.method)
            self._settings.replace(config)
            self._session.change(config=config)

    def _new_seed(self) -> None:
        wanted = self._session.wanted
        seed = (wanted.spec.seed + 1) % (LARGEST_SEED + 1)
        try:
            start = sample_start(wanted.scene, seed)
        except OimppiError as error:
            self._session.problem = str(error)
            return
        self._session.change(seed=seed, scene=wanted.scene.with_start(start), fresh=True)

    def _save(self, event: Any, name: str) -> None:
        picture = self._session.latest
        x, y, yaw = (float(value) for value in planar_pose(picture.object_transform))
        try:
            file = save_scene(picture.scene.with_start((x, y, yaw)), name)
        except OimppiError as error:
            event.client.add_notification("Scene not saved", str(error), color="red")
        else:
            event.client.add_notification("Scene saved", f"Run it with: oimppi run {file}", color="green")

    def _show_handles(self, picture: Picture) -> None:
        """Shows handles on what can be dragged, if they are wanted, and moves a thing when its handle is released."""
        scene = self._session.wanted.scene
        places = {}
        if self._move.value:
            places = {
                "goal": planar_transform(scene.goal, _HANDLE_HEIGHT),
                "object": np.concatenate(
                    [picture.object_transform[:2], [_HANDLE_HEIGHT], picture.object_transform[3:]]
                ),
            }
            for obstacle in scene.obstacles:
                x, y, z = obstacle.center
                places[obstacle.path] = planar_transform((x, y, 0.0), z)
        for name in self._handles.keys() - places.keys():
            self._handles.pop(name).remove()
        for name, place in places.items():
            if name not in self._handles:
                self._handles[name] = Handle(self._page.server, str(self._made), place)
                self._made += 1
            handle = self._handles[name]
            if handle.take_drop():
                self._dropped(name, planar_pose(handle.place), planar_pose(place))
            elif self._session.wanted.scene is scene:
                handle.move_to(place)

    def _dropped(self, name: str, to: np.ndarray, before: np.ndarray) -> None:
        """Handles the end of a drag from one planar pose to another, shape [3] [m, m, rad] each."""
        pose: PlanarPose = (float(to[0]), float(to[1]), float(to[2]))
        scene = self._session.wanted.scene
        if name == "goal":
            self._session.change(scene=scene.with_goal(pose))
        elif name == "object":
            self._session.move_object(pose)
        else:
            x, y, turn = (float(value) for value in to - before)
            try:
                self._session.change(scene=scene.with_obstacle_moved(name, (x, y, turn)))
            except OimppiError as error:  # the obstacle has been removed in the meantime
                self._session.problem = str(error)

    def _click(self, event: Any) -> None:
        """Applies an impulse to the object at the clicked point."""
        if not self._knock.value:
            return
        picture = self._session.latest
        origin, ray = np.array(event.ray_origin), np.array(event.ray_direction)
        if abs(ray[2]) < 1e-6:
            return
        hit = origin + ray * (picture.object_transform[2] - origin[2]) / ray[2]
        x, y, yaw = (float(value) for value in planar_pose(picture.object_transform))
        if shapely.distance(object_outline(picture.scene, (x, y, yaw)), shapely.Point(hit[:2])) < 0.03:
            along = ray[:2] / max(float(np.linalg.norm(ray[:2])), 1e-9)
            self._session.knock(KNOCK * picture.scene.object.mass * np.array([*along, 0.0]))

    def _show_status(self, picture: Picture) -> None:
        """Updates the status line, including any problem."""
        session = self._session
        figures = picture.figures
        errors = ""
        if figures:
            errors = f"; {figures['position error [m]']:.3f} m and {figures['yaw error [rad]']:.2f} rad from the goal; "
            errors += (
                f"plan time {figures['plan time [ms]']:.0f} ms, "
                f"control period {1e3 * session.wanted.config.control_period:.0f} ms"
            )
        problem = f"\n\n**{session.problem}**" if session.problem else ""
        rate = f"{session.rate:.0f} control steps per second" if session.rate else "waiting"
        self._status.content = f"**{picture.status}**{problem}\n\n{picture.time:.1f} s{errors}\n\n{rate}"
        if picture.terms:
            self._bars.content = _bars(picture.terms)


def _bars(terms: dict[str, float]) -> str:
    """Formats the cost terms of the cheapest sample as bars."""
    largest = sorted(((abs(value), name) for name, value in terms.items() if value), reverse=True)[:_BARS]
    most = largest[0][0] if largest else 1.0
    rows = "".join(
        f'<div style="display:flex;gap:4px;font-size:11px;line-height:15px"><span style="width:7em">{name}</span>'
        f'<span style="background:#7c5cc4;height:9px;margin-top:3px;width:{100 * value / most:.0f}px"></span>'
        f"<span>{value:.3g}</span></div>"
        for value, name in largest
    )
    return f'<div style="padding:0 8px">Cost terms of the best sample{rows}</div>'
