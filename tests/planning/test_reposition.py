"""Repositioning: when, to which side of the object, and along which waypoints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.device import DEVICE
from support.small_tasks import DT, block, box, task

from oimppi_warp.config.settings import Reposition
from oimppi_warp.geometry.fields import build_geometry
from oimppi_warp.geometry.reach import reach_of
from oimppi_warp.planning.reposition import Repositioner
from oimppi_warp.scene import Scene

SETTINGS = Reposition(stall_seconds=1.0, headway=0.01, w_waypoint=50.0, longest_seconds=2.0)
HEIGHT = 0.012
POSE = np.array([0.40, 0.0, 0.0])
LONG = (0.16, 0.04, 0.05)
"""A block, long in x."""


def watch(scene: Scene, settings: Reposition = SETTINGS, *, w_theta: float = 0.0225) -> Repositioner:
    return Repositioner(scene, build_geometry(scene, DEVICE), settings, w_theta=w_theta, height=HEIGHT, period=DT)


def led(*move: float) -> np.ndarray:
    """A reference that leads the object by (x, y, yaw) within 15 steps, and on."""
    return POSE + np.linspace(0.0, 2.0, 31)[:, None] * np.array(move)


def stalled(watching: Repositioner, tip: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """The first waypoint, once the object has made no headway for long."""
    for _ in range(100):
        waypoint = watching.waypoint(tip, POSE, reference, 0.5)
        if waypoint[3] > 0.0:
            return waypoint
    raise AssertionError("never repositioned")


def last_stop(watching: Repositioner) -> np.ndarray:
    return watching._waypoints[-1]


def test_an_object_that_gets_on_is_not_let_go():
    watching = watch(task(pushed=block()))
    for step in range(200):
        waypoint = watching.waypoint(np.array([0.4, -0.1, 0.012]), POSE, led(0.0, 0.05, 0.0), 1.0 - 0.002 * step)
        assert not waypoint.any()


def test_an_object_that_stands_still_is_let_go_after_the_time_set():
    watching = watch(task(pushed=block()))
    weights = [watching.waypoint(np.array([0.4, -0.1, 0.012]), POSE, led(0.0, 0.05, 0.0), 0.5)[3] for _ in range(25)]
    assert np.argmax(np.array(weights) > 0.0) == pytest.approx(SETTINGS.stall_seconds / DT + 1, abs=1)
    assert max(weights) == SETTINGS.w_waypoint


def test_the_reference_slows_down_for_an_object_that_stands_still_and_headway_speeds_it_up():
    watching = watch(task(pushed=block()), replace(SETTINGS, stall_seconds=3.0, least_pace=0.2))
    tip, reference = np.array([0.4, -0.1, 0.012]), led(0.0, 0.05, 0.0)

    def paces(to_go: float, steps: int) -> np.ndarray:
        found = []
        for _ in range(steps):
            watching.waypoint(tip, POSE, reference, to_go)
            found.append(watching.pace)
        return np.array(found)

    assert (paces(0.5, 50) == 1.0).all(), "the arm is still on its way to the object"
    assert paces(0.48, 1) == 1.0
    waiting = paces(0.48, 58)
    assert (waiting[: round(0.9 / DT)] == 1.0).all(), "a change of sides takes a moment"
    assert (np.diff(waiting[round(1.1 / DT) : round(2.5 / DT)]) < 0.0).all()
    assert waiting[-1] == pytest.approx(0.2)
    assert paces(0.46, 1) == pytest.approx(0.4)
    assert [paces(0.46 - 0.02 * i, 1)[0] for i in range(1, 4)][-1] == 1.0


def test_a_least_pace_of_one_keeps_the_pace():
    for least in (1.0, 0.5):
        watching = watch(task(pushed=block()), replace(SETTINGS, stall_seconds=3.0, least_pace=least))
        for to_go in (0.6, *[0.5] * 58):
            watching.waypoint(np.array([0.4, -0.1, 0.012]), POSE, led(0.0, 0.05, 0.0), to_go)
        assert watching.pace == least


def test_a_stall_time_of_zero_turns_it_off():
    watching = watch(task(pushed=block()), replace(SETTINGS, stall_seconds=0.0))
    for _ in range(200):
        assert not watching.waypoint(np.array([0.4, -0.1, 0.012]), POSE, led(0.0, 0.05, 0.0), 0.5).any()


@pytest.mark.parametrize(
    ("move", "side"),
    [
        ((0.05, 0.0, 0.0), (-1, 0)),
        ((-0.05, 0.0, 0.0), (1, 0)),
        ((0.0, 0.05, 0.0), (0, -1)),
        ((0.0, -0.05, 0.0), (0, 1)),
    ],
)
def test_a_block_is_pushed_on_from_behind(move, side):
    watching = watch(task(pushed=block(LONG)))
    stalled(watching, np.append(POSE[:2] - 0.2 * np.array(side), 0.012), led(*move))
    offset = last_stop(watching)[:2] - POSE[:2]
    along = offset @ np.array(side)
    across = offset @ np.array([side[1], side[0]])
    half = LONG[0] / 2 if side[0] else LONG[1] / 2
    assert half < along < half + 0.04, "beside the outline, on the side that pushes"
    assert abs(across) < 0.03, "a push through the middle does not turn it"


def test_a_block_is_turned_from_one_of_its_ends():
    watching = watch(task(pushed=block(LONG)))
    stalled(watching, np.array([0.55, 0.1, 0.012]), led(0.0, 0.0, 0.8))
    x, y = last_stop(watching)[:2] - POSE[:2]
    assert abs(x) > 0.05 and x * y < 0.0, "below the right end or above the left one turns it to the left"


def test_where_no_yaw_is_asked_for_the_reference_s_does_not_count():
    watching = watch(task(pushed=block(LONG)), w_theta=0.0)
    stalled(watching, np.array([POSE[0], 0.2, 0.012]), led(0.0, 0.05, 3.0))
    x, y = last_stop(watching)[:2] - POSE[:2]
    assert abs(x) < 0.03 and y < 0.0


def test_a_side_where_the_tool_has_no_room_is_not_chosen():
    wall = box(POSE[0], -0.055, (0.3, 0.05, 0.1))  # a centimetre behind the block, all along it
    watching = watch(task(wall, pushed=block(LONG)))
    stalled(watching, np.array([0.40, 0.1, 0.012]), led(0.0, 0.05, 0.0))
    assert last_stop(watching)[1] > -0.02


def test_the_side_that_did_not_work_is_not_tried_again():
    watching = watch(task(pushed=block(LONG)))
    behind = np.array([POSE[0], -0.05, 0.012])
    stalled(watching, behind, led(0.0, 0.05, 0.0))
    first = last_stop(watching).copy()
    assert np.linalg.norm(first[:2] - behind[:2]) > 0.04
    while watching.waypoint(behind, POSE, led(0.0, 0.05, 0.0), 0.5).any():
        pass
    stalled(watching, behind, led(0.0, 0.05, 0.0))
    assert np.linalg.norm(last_stop(watching)[:2] - first[:2]) > 0.04


def test_the_tip_goes_over_an_object_that_is_in_its_way_and_straight_where_none_is(device: str):
    scene = task(pushed=block(LONG))
    top = build_geometry(scene, device).top
    watching = watch(scene)
    tip = np.array([POSE[0], 0.09, 0.012])
    waypoint = stalled(watching, tip, led(0.0, 0.05, 0.0))
    up, over, down = watching._waypoints
    np.testing.assert_array_equal(up, waypoint[:3])
    np.testing.assert_allclose(up[:2], tip[:2], atol=1e-9)
    assert up[2] == over[2] > top + 0.02 and down[2] == HEIGHT
    np.testing.assert_allclose(over[:2], down[:2])
    for stop in (up, over):
        np.testing.assert_array_equal(watching._waypoints[0], stop)
        watching.waypoint(stop, POSE, led(0.0, 0.05, 0.0), 0.5)
    assert len(watching._waypoints) == 1
    assert not watching.waypoint(down, POSE, led(0.0, 0.05, 0.0), 0.5).any(), "there: no waypoint is left"

    free = watch(scene)
    stalled(free, np.array([POSE[0] - 0.12, -0.06, 0.012]), led(0.0, 0.05, 0.0))
    assert len(free._waypoints) == 1 and free._waypoints[0][2] == HEIGHT


def test_a_tool_that_touches_the_object_steps_aside_as_it_rises():
    scene = task(pushed=block(LONG))
    watching = watch(scene)
    touching = np.array([POSE[0], 0.5 * LONG[1] + scene.robot.tool_radius, 0.012])
    stalled(watching, touching, led(0.0, 0.05, 0.0))
    up = watching._waypoints[0]
    assert up[2] > touching[2] and up[1] > touching[1] + 0.02


def test_a_tip_that_is_over_the_object_goes_out_past_its_rim_as_it_rises():
    watching = watch(task(pushed=block(LONG)))
    stalled(watching, np.array([POSE[0], 0.5 * LONG[1] - 0.005, 0.06]), led(0.0, 0.05, 0.0))
    assert watching._waypoints[0][1] > 0.5 * LONG[1] + 0.02


def test_a_tool_at_the_edge_of_its_reach_steps_aside_within_it():
    scene = task(pushed=block(LONG))
    watching = watch(scene)
    reach = reach_of(scene.robot)
    far = np.array([reach.radius - 0.5 * LONG[0] - scene.robot.tool_radius - 0.012, 0.0, 0.0])
    tip = np.array([reach.radius - 0.012, 0.0, 0.012])
    waypoint = np.zeros(4)
    for _ in range(100):
        waypoint = watching.waypoint(tip, far, far + np.array([-0.1, 0.0, 0.0]) * np.ones((30, 1)), 0.5)
        if waypoint[3] > 0.0:
            break
    assert waypoint[2] > tip[2] and reach.margin(waypoint[None, :2])[0] >= 0.01


def test_what_is_not_known_calls_nowhere_and_leaves_no_trace():
    watching = watch(task(pushed=block(LONG)))
    tip, lost = np.array([POSE[0], 0.09, 0.012]), np.full(3, np.nan)
    for _ in range(100):
        assert not watching.waypoint(tip, lost, led(0.0, 0.05, 0.0), np.nan).any()
    weights = [watching.waypoint(tip, POSE, led(0.0, 0.05, 0.0), 0.5)[3] for _ in range(25)]
    assert np.isfinite(weights).all() and not any(weights[:18]) and any(weights)


def test_a_call_is_given_up_in_time():
    watching = watch(task(pushed=block(LONG)))
    tip = np.array([POSE[0], 0.06, 0.012])
    stalled(watching, tip, led(0.0, 0.05, 0.0))
    weights = [watching.waypoint(tip, POSE, led(0.0, 0.05, 0.0), 0.5).any() for _ in range(60)]
    assert sum(weights) == pytest.approx(SETTINGS.longest_seconds / DT, abs=2)
