"""The viewer's page without a browser: what is on it, and what its controls do."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support import small_tasks
from support.device import DEVICE
from support.drawn import Drawn

from oimppi_warp.cli.view import View
from oimppi_warp.config.presets import best
from oimppi_warp.config.run_spec import RunSpec
from oimppi_warp.errors import SceneError
from oimppi_warp.observation import planar_transform
from oimppi_warp.runtime.setup import Setup
from oimppi_warp.scene import Collider, Obstacle, Scene
from oimppi_warp.view import session as session_module
from oimppi_warp.view.browser import Page
from oimppi_warp.view.canvas import Canvas
from oimppi_warp.view.controls import Handle, Plots
from oimppi_warp.view.live import LiveView
from oimppi_warp.view.picture import Picture
from oimppi_warp.view.session import Session
from oimppi_warp.view.shapes import body_frames, visible_shapes

CUBE = "/World/Obstacles/Cube"


@pytest.fixture(scope="module")
def scene() -> Scene:
    return small_tasks.shipped("task02")


@pytest.fixture
def page(scene: Scene) -> Iterator[Page]:
    made = Page(scene.table, port=8540)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # viser warns of what is removed twice
        yield made
    made.close()


def handles(page: Page) -> dict[str, object]:
    """The nodes of the page's scene by their names."""
    return dict(page.server.scene._handle_from_node_name)


def meshes(page: Page, kind: str) -> list:
    return [handle for name, handle in handles(page).items() if name.rpartition("/")[2].startswith(kind)]


def test_bodies_are_where_the_joints_put_them_and_each_shape_is_once_on_the_page(page, scene):
    joints = scene.robot.start + 0.2
    at = planar_transform((0.3, -0.1, 0.5), scene.object.rest_height)
    canvas = Canvas(page)
    for each in (scene, scene.with_obstacle_moved(CUBE, (0.0, 0.1, 0.2)), scene.without_obstacle(CUBE)):
        canvas.show(Picture(each, 0.0, joints, at))
        assert len(meshes(page, "visible")) == len(visible_shapes(each))
        for path, frame in body_frames(each, joints, at).items():
            body = page._bodies[path]
            assert handles(page)[body.name] is body, "a body of the scene before"
            np.testing.assert_allclose(body.position, frame[:3], atol=1e-9)
            np.testing.assert_allclose(np.roll(body.wxyz, -1), frame[3:], atol=1e-9)


def test_colliders_are_shown_when_they_are_wanted_also_those_of_a_new_scene(page, scene):
    at = planar_transform(scene.start, scene.object.rest_height)
    piece = small_tasks.box(0.1, 0.4, (0.1, 0.1, 0.1))
    twice = scene.with_obstacle(Obstacle("/World/Twice", (piece, piece)))  # both of the same path
    count = sum(len(link.colliders) for link in (scene.robot.base, *scene.robot.links))
    count += len(scene.object.colliders) + 1
    canvas = Canvas(page)
    canvas.show(Picture(scene, 0.0, scene.robot.start, at))
    assert not meshes(page, "collider")
    page.show_shapes(visible=False, colliders=True)
    assert len(meshes(page, "collider")) == count
    assert not any(handle.visible for handle in meshes(page, "visible"))
    canvas.show(Picture(twice, 0.0, scene.robot.start, at))
    assert len(meshes(page, "collider")) == count + 2
    assert all(handle.visible for handle in meshes(page, "collider"))
    assert not any(handle.visible for handle in meshes(page, "visible"))
    page.show_shapes(visible=True, colliders=False)
    assert all(handle.visible for handle in meshes(page, "visible"))
    assert not any(handle.visible for handle in meshes(page, "collider"))


def test_lines_of_another_number_replace_those_before(page):
    for count in (2, 2, 5, 3):
        segments = np.random.default_rng(count).random((count, 2, 3))
        page.lines("way", segments, np.ones((count, 3)), 2.0)
        page.points("dots", segments[:, 0], 0.01, (1.0, 0.0, 0.0))
        np.testing.assert_allclose(handles(page)["/lines/way"].points, segments, atol=1e-6)
        np.testing.assert_allclose(handles(page)["/points/dots"].points, segments[:, 0], atol=1e-3)
    assert len([name for name in handles(page) if name.startswith(("/lines/", "/points/"))]) == 2


def event(phase: str, place: np.ndarray) -> SimpleNamespace:
    return SimpleNamespace(phase=phase, target=SimpleNamespace(position=place[:3], wxyz=np.roll(place[3:], 1)))


def test_a_handle_stays_where_it_is_dragged_until_its_drop_was_taken(page):
    first, dragged, dropped = (planar_transform((x, 0.1, 0.2 * x), 0.06) for x in (0.1, 0.2, 0.3))
    handle = Handle(page.server, "0", first)
    handle._update(event("start", first))
    handle._update(event("update", dragged))
    handle.move_to(first)
    np.testing.assert_array_equal(handle.place, dragged)
    assert not handle.take_drop()
    handle._update(event("end", dropped))
    handle.move_to(first)
    np.testing.assert_array_equal(handle.place, dropped)
    assert handle.take_drop() and not handle.take_drop()
    handle.move_to(first)
    np.testing.assert_array_equal(handle.place, first)
    handle.remove()
    assert not [name for name in handles(page) if name.startswith("/handles/")]


def test_plots_keep_the_latest_values_and_begin_anew_with_a_new_episode(page):
    plots = Plots(page.server)
    plots.add(-1.0, {"error": 2.0})
    assert not plots._plots, "the arm should be moving first"
    plots.shown = True
    for step in range(300):
        plots.add(0.05 * step, {"error": 1.0 / (step + 1), "clearance": np.nan})
    assert plots._plots.keys() == {"error"}, "nothing is known of the other one"
    times, values = plots._plots["error"].data
    assert (len(times), times[-1], values[-1]) == (250, pytest.approx(0.05 * 299), pytest.approx(1.0 / 300))
    plots.add(0.05, {"error": 0.5})
    assert [part.tolist() for part in plots._plots["error"].data] == [[0.05], [0.5]]


class Unreadable(Drawn):
    """A display that has lost the scene's file."""

    def load(self, scene: Scene) -> None:
        super().load(scene)
        if len(self.scenes) > 1:
            raise SceneError("the scene can no longer be read")


def test_a_scene_whose_file_is_gone_is_reported_once_and_drawn_with_the_old_shapes(scene):
    display = Unreadable()
    canvas = Canvas(display)
    at = planar_transform(scene.start, scene.object.rest_height)
    canvas.show(Picture(scene, 0.0, scene.robot.start, at))
    other = Picture(scene.without_obstacle(CUBE), 0.0, scene.robot.start, at)
    with pytest.raises(SceneError):
        canvas.show(other)
    display.segments.clear()
    canvas.show(other)
    assert len(display.scenes) == 2 and "goal" in display.segments


def test_a_view_that_begins_paused_lets_no_step_through(page, scene):
    session = Session(Setup(scene, best("cloi"), RunSpec(engine="quasistatic", device=DEVICE, threads=1)))
    try:
        LiveView(page, Canvas(page), session, paused=True)
        session.start()  # as when a browser is there already
        assert session.paused
    finally:
        session.close()
    assert len(session.running.log) == 0


def test_a_real_arm_is_stopped_before_the_page_is_closed(monkeypatch):
    """Closing the page takes seconds if a browser no longer reads."""
    order: list[str] = []
    session = SimpleNamespace(latest=None, close=lambda: order.append("session"))
    monkeypatch.setattr(session_module, "Session", lambda _setup: session)
    prepared = SimpleNamespace(scene=SimpleNamespace(table=None)), None
    monkeypatch.setattr(View, "prepare", lambda _self: prepared)
    monkeypatch.setattr("oimppi_warp.cli.view.busy", lambda *_: ExitStack())
    monkeypatch.setattr(View, "_open", lambda _self, _table, stack: stack.callback(order.append, "page"))
    monkeypatch.setattr(View, "_draw", lambda *_: None)
    monkeypatch.setattr(View, "_show", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError), ExitStack() as stack:
        View(scene="lab01")._real(stack)
    assert order[:2] == ["session", "page"]


def test_colliders_of_every_kind_are_drawn(page, scene):
    at = planar_transform(scene.start, scene.object.rest_height)
    place = np.array([0.2, 0.3, 0.1, 0.0, 0.0, 0.0, 1.0])
    corners = np.random.default_rng(3).random((8, 3)) * 0.1
    pieces = (
        Collider("/a", "box", place, (0.1, 0.1, 0.1)),
        Collider("/b", "sphere", place, (0.1,)),
        Collider("/c", "cylinder", place, (0.1, 0.2)),
        Collider("/d", "capsule", place, (0.1, 0.2)),
        Collider("/e", "mesh", place, (), corners),
    )
    edited = replace(scene, obstacles=(*scene.obstacles, Obstacle("/World/All", pieces)))
    Canvas(page).show(Picture(edited, 0.0, scene.robot.start, at))
    added = meshes(page, "visible")[-len(pieces) :]
    spans = [np.ptp(handle.vertices, axis=0) for handle in added]
    np.testing.assert_allclose(spans[0], 0.2, rtol=1e-6)
    np.testing.assert_allclose(spans[1], 0.2, rtol=1e-2)
    np.testing.assert_allclose(spans[2], [0.2, 0.2, 0.4], rtol=1e-2)
    np.testing.assert_allclose(spans[3], [0.2, 0.2, 0.6], rtol=1e-2)
    np.testing.assert_allclose(spans[4], np.ptp(corners, axis=0), rtol=1e-6)
