"""Repositioning: when, for which push, along which waypoints, and how the push is followed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from support.device import DEVICE
from support.small_tasks import DT, block, box, task

from oimppi_warp.config.settings import Reposition
from oimppi_warp.geometry.fields import build_geometry
from oimppi_warp.geometry.reach import reach_of
from oimppi_warp.planning.object_level import distance
from oimppi_warp.planning.pushes import Push
from oimppi_warp.planning.reposition import Repositioner
from oimppi_warp.scene import Scene

SETTINGS = Reposition(stall_seconds=1.0, headway=0.01, w_waypoint=50.0, longest_seconds=2.0)
HEIGHT = 0.012
POSE = np.array([0.40, 0.0, 0.0])
LONG = (0.16, 0.04, 0.05)
"""A block, long in x."""
YAW_LENGTH = 0.15
WALLS = [(0.0, 0.031), (0.0, -0.031), (0.091, 0.0), (-0.091, 0.0)]
"""Places from the block of four walls that touch it, almost."""

ToGo = Callable[[np.ndarray], float]


def watch(scene: Scene, settings: Reposition = SETTINGS, *, w_theta: float = 0.0225) -> Repositioner:
    return Repositioner(scene, build_geometry(scene, DEVICE), settings, w_theta=w_theta, height=HEIGHT, period=DT)


def way_to(*move: float, pose: np.ndarray = POSE, yaw_length: float = YAW_LENGTH) -> ToGo:
    """The distance to go if the goal is at (x, y, yaw) from a pose."""
    return lambda at: distance(at, pose + np.array(move), yaw_length)


def left(to_go: float) -> ToGo:
    """The same distance to go everywhere."""
    return lambda _pose: to_go


def stalled(watching: Repositioner, tip: np.ndarray, to_go_from: ToGo) -> np.ndarray:
    """The first waypoint, once the object has made no headway for long."""
    for _ in range(500):
        waypoint = watching.waypoint(tip, POSE, to_go_from)
        if waypoint[3] > 0.0:
            return waypoint
    raise AssertionError("never repositioned")


def last_stop(watching: Repositioner) -> np.ndarray:
    return watching._waypoints[-1]


ONWARDS = way_to(0.0, 0.05, 0.0)


def arrive(watching: Repositioner) -> np.ndarray:
    """Leads the tip from waypoint to waypoint; returns where it is in the end."""
    tip = watching._waypoints[0]
    while watching._waypoints:
        tip = watching._waypoints[0]
        watching.waypoint(tip, POSE, ONWARDS)
    return tip


def test_an_object_that_gets_on_is_not_let_go():
    watching = watch(task(pushed=block()))
    for step in range(200):
        waypoint = watching.waypoint(np.array([0.4, -0.1, 0.012]), POSE, left(1.0 - 0.002 * step))
        assert not waypoint.any()


def test_an_object_that_stands_still_is_let_go_after_the_time_set():
    watching = watch(task(pushed=block()))
    weights = [watching.waypoint(np.array([0.4, -0.1, 0.012]), POSE, ONWARDS)[3] for _ in range(25)]
    assert np.argmax(np.array(weights) > 0.0) == pytest.approx(SETTINGS.stall_seconds / DT + 1, abs=1)
    assert max(weights) == SETTINGS.w_waypoint


def test_the_reference_slows_down_for_an_object_that_stands_still_and_headway_speeds_it_up():
    watching = watch(task(pushed=block()), replace(SETTINGS, stall_seconds=3.0, least_pace=0.2))
    tip = np.array([0.4, -0.1, 0.012])

    def paces(to_go: float, steps: int) -> np.ndarray:
        found = []
        for _ in range(steps):
            watching.waypoint(tip, POSE, left(to_go))
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
            watching.waypoint(np.array([0.4, -0.1, 0.012]), POSE, left(to_go))
        assert watching.pace == least


def test_a_stall_time_of_zero_turns_it_off():
    watching = watch(task(pushed=block()), replace(SETTINGS, stall_seconds=0.0))
    for _ in range(200):
        assert not watching.waypoint(np.array([0.4, -0.1, 0.012]), POSE, ONWARDS).any()


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
    stalled(watching, np.append(POSE[:2] - 0.2 * np.array(side), 0.012), way_to(*move))
    offset = last_stop(watching)[:2] - POSE[:2]
    along = offset @ np.array(side)
    across = offset @ np.array([side[1], side[0]])
    half = LONG[0] / 2 if side[0] else LONG[1] / 2
    assert half < along < half + 0.04, "beside the outline, on the side that pushes"
    assert abs(across) < 0.03, "a push through the middle does not turn it"


def test_a_block_is_turned_from_one_of_its_ends():
    watching = watch(task(pushed=block(LONG)))
    stalled(watching, np.array([0.55, 0.1, 0.012]), way_to(0.0, 0.0, 0.8))
    x, y = last_stop(watching)[:2] - POSE[:2]
    assert abs(x) > 0.05 and x * y < 0.0, "below the right end or above the left one turns it to the left"


def test_where_no_yaw_is_asked_for_only_the_place_counts():
    watching = watch(task(pushed=block(LONG)), w_theta=0.0)
    stalled(watching, np.array([POSE[0], 0.2, 0.012]), way_to(0.0, 0.05, 3.0, yaw_length=1e-4))
    assert last_stop(watching)[1] < POSE[1]


def test_a_side_where_the_tool_has_no_room_is_not_chosen():
    wall = box(POSE[0], -0.055, (0.3, 0.05, 0.1))  # a centimetre behind the block, all along it
    watching = watch(task(wall, pushed=block(LONG)))
    stalled(watching, np.array([0.40, 0.1, 0.012]), ONWARDS)
    assert last_stop(watching)[1] > -0.02


def test_places_that_did_not_work_are_not_tried_again_until_there_is_headway():
    watching = watch(task(pushed=block(LONG)))
    tip = np.array([POSE[0], -0.05, 0.012])
    stops: list[np.ndarray] = []
    for _ in range(4):
        stalled(watching, tip, ONWARDS)
        stops.append(last_stop(watching)[:2])
        while watching.waypoint(tip, POSE, ONWARDS).any():
            pass
    assert min(np.linalg.norm(a - b) for i, a in enumerate(stops) for b in stops[:i]) > 0.03
    watching.waypoint(tip, POSE, left(0.02))
    stalled(watching, tip, ONWARDS)
    np.testing.assert_array_equal(last_stop(watching)[:2], stops[0])


def test_after_a_push_in_vain_the_next_is_chosen_without_regard_to_the_plan():
    watching = watch(task(pushed=block(LONG)))
    tip, backwards = np.array([POSE[0] - 0.2, 0.0, 0.012]), way_to(0.0, -0.05, 0.0)
    stops = []
    for _ in range(2):
        while not watching.waypoint(tip, POSE, ONWARDS, backwards).any():
            pass
        stops.append(last_stop(watching)[1])
        while watching.waypoint(tip, POSE, ONWARDS, backwards).any():
            pass
    assert stops[0] < -0.02, "along the plan, from behind"
    assert stops[1] > 0.02, "to the goal"


def test_a_push_is_followed_from_where_the_object_is_until_it_is_over():
    watching = watch(task(pushed=block(LONG)))
    far = np.append(POSE[:2] - np.array([0.0, 0.2]), 0.012)
    assert watching.detour(10) is None
    stalled(watching, far, ONWARDS)
    assert watching.detour(10) is None, "the tool is on its way"
    at = arrive(watching)
    ahead = watching.detour(200)
    np.testing.assert_allclose(ahead[0], POSE, atol=1e-9)
    speed = np.linalg.norm(np.diff(ahead, axis=0) * [1.0, 1.0, YAW_LENGTH], axis=1) / DT
    assert speed[0] == pytest.approx(0.1, rel=0.01) and speed[-1] == 0.0, "it ends at the end of the push"
    assert distance(ahead[-1], POSE + np.array([0.0, 0.05, 0.0]), YAW_LENGTH) < 0.02
    moved = ahead[6]
    watching.waypoint(at, moved, ONWARDS)
    assert distance(watching.detour(1)[0], moved, YAW_LENGTH) <= 0.005 + 1e-9
    watching.waypoint(at, ahead[-1], ONWARDS)
    assert watching.detour(1) is None


def test_a_push_of_one_step_is_followed_to_its_end():
    watching = watch(task(pushed=block(LONG)))
    watching._push = Push(np.array([0.0, -0.04]), np.array([POSE, POSE + [0.0, 0.00999, 0.0]]))
    watching._time_left = 2.0
    tip = np.array([POSE[0], -0.05, 0.012])
    for share in (0.0, 0.2, 0.4):
        watching.waypoint(tip, POSE + [0.0, 0.01 * share, 0.0], ONWARDS)
        np.testing.assert_allclose(watching.detour(30)[-1], POSE + [0.0, 0.00999, 0.0])
    watching.waypoint(tip, POSE + [0.0, 0.008, 0.0], ONWARDS)
    assert watching.detour(1) is None


def test_getting_on_along_a_push_is_headway_though_it_leads_away_from_the_goal():
    watching = watch(task(pushed=block(LONG)), replace(SETTINGS, longest_seconds=9.0))
    away = POSE + np.linspace(0.0, 0.1, 11)[:, None] * [0.0, -1.0, 0.0]
    watching.waypoint(np.array([0.4, 0.05, 0.012]), POSE, ONWARDS)
    watching._push, watching._time_left = Push(np.array([0.0, 0.04]), away), 9.0
    for step in range(100):  # 2 cm/s: five seconds, with a stall time of one
        pose = POSE - [0.0, 0.001 * step, 0.0]
        assert not watching.waypoint(np.array([0.4, 0.05, 0.012]), pose, ONWARDS).any()
        assert watching.pace == 1.0
    assert watching.detour(1) is None, "it is over, and the reference is followed again"
    assert not watching.waypoint(np.array([0.4, 0.05, 0.012]), away[-1], ONWARDS).any()


def test_a_push_is_given_up_if_its_beginning_is_not_reached_or_the_object_is_elsewhere():
    watching = watch(task(pushed=block(LONG)))
    tip = np.array([POSE[0], -0.05, 0.012])
    stalled(watching, tip, ONWARDS)
    while watching.waypoint(tip, POSE, ONWARDS).any():
        pass
    assert watching.detour(1) is None, "the tip has stayed where it was"
    stalled(watching, tip, ONWARDS)
    at = arrive(watching)
    assert watching.detour(1) is not None
    watching.waypoint(at, POSE + [0.2, 0.0, 1.0], ONWARDS)
    assert watching.detour(1) is None


def test_a_push_that_gets_nowhere_is_given_up_in_time():
    watching = watch(task(pushed=block(LONG)), replace(SETTINGS, stall_seconds=20.0))
    tip = np.array([POSE[0], -0.2, 0.012])
    stalled(watching, tip, ONWARDS)
    at, steps = arrive(watching), 0
    for _ in range(200):
        steps += watching.detour(1) is not None
        watching.waypoint(at, POSE, ONWARDS)
    assert steps == pytest.approx(SETTINGS.longest_seconds / DT, abs=2)


def test_an_object_that_no_push_moves_stays():
    walls = [box(POSE[0] + x, y, (0.3 if x == 0.0 else 0.02, 0.3 if x else 0.02, 0.1)) for x, y in WALLS]
    watching = watch(task(*walls, pushed=block(LONG)))
    for _ in range(100):
        assert not watching.waypoint(np.array([0.2, 0.2, 0.012]), POSE, ONWARDS).any()
    assert watching.detour(1) is None


def test_the_tip_goes_over_an_object_that_is_in_its_way_and_straight_where_none_is(device: str):
    scene = task(pushed=block(LONG))
    top = build_geometry(scene, device).top
    watching = watch(scene)
    tip = np.array([POSE[0], 0.09, 0.012])
    waypoint = stalled(watching, tip, ONWARDS)
    up, over, down = watching._waypoints
    np.testing.assert_array_equal(up, waypoint[:3])
    np.testing.assert_allclose(up[:2], tip[:2], atol=1e-9)
    assert up[2] == over[2] > top + 0.02 and down[2] == HEIGHT
    np.testing.assert_allclose(over[:2], down[:2])
    for stop in (up, over):
        np.testing.assert_array_equal(watching._waypoints[0], stop)
        watching.waypoint(stop, POSE, ONWARDS)
    assert len(watching._waypoints) == 1
    assert not watching.waypoint(down, POSE, ONWARDS).any(), "there: no waypoint is left"

    free = watch(scene)
    stalled(free, np.array([POSE[0] - 0.12, -0.06, 0.012]), ONWARDS)
    assert len(free._waypoints) == 1 and free._waypoints[0][2] == HEIGHT


def test_a_tool_that_touches_the_object_steps_aside_as_it_rises():
    scene = task(pushed=block(LONG))
    watching = watch(scene)
    touching = np.array([POSE[0], 0.5 * LONG[1] + scene.robot.tool_radius, 0.012])
    stalled(watching, touching, ONWARDS)
    up = watching._waypoints[0]
    assert up[2] > touching[2] and up[1] > touching[1] + 0.02


def test_a_tip_that_is_over_the_object_goes_out_past_its_rim_as_it_rises():
    watching = watch(task(pushed=block(LONG)))
    stalled(watching, np.array([POSE[0], 0.5 * LONG[1] - 0.005, 0.06]), ONWARDS)
    assert watching._waypoints[0][1] > 0.5 * LONG[1] + 0.02


def test_a_tool_at_the_edge_of_its_reach_steps_aside_within_it():
    scene = task(pushed=block(LONG))
    watching = watch(scene)
    reach = reach_of(scene.robot)
    far = np.array([reach.radius - 0.5 * LONG[0] - scene.robot.tool_radius - 0.012, 0.0, 0.0])
    tip = np.array([reach.radius - 0.012, 0.0, 0.012])
    waypoint = np.zeros(4)
    for _ in range(100):
        waypoint = watching.waypoint(tip, far, way_to(-0.1, 0.0, 0.0, pose=far))
        if waypoint[3] > 0.0:
            break
    assert waypoint[2] > tip[2] and reach.margin(waypoint[None, :2])[0] >= 0.01


def test_what_is_not_known_calls_nowhere_and_leaves_no_trace():
    watching = watch(task(pushed=block(LONG)))
    tip, lost = np.array([POSE[0], 0.09, 0.012]), np.full(3, np.nan)
    for _ in range(100):
        assert not watching.waypoint(tip, lost, left(np.nan)).any()
    weights = [watching.waypoint(tip, POSE, ONWARDS)[3] for _ in range(25)]
    assert np.isfinite(weights).all() and not any(weights[:18]) and any(weights)


def test_a_call_is_given_up_in_time():
    watching = watch(task(pushed=block(LONG)))
    tip = np.array([POSE[0], 0.06, 0.012])
    stalled(watching, tip, ONWARDS)
    weights = [watching.waypoint(tip, POSE, ONWARDS).any() for _ in range(60)]
    assert sum(weights) == pytest.approx(SETTINGS.longest_seconds / DT, abs=2)
