"""Likely causes of failures, on logs in which only one thing is wrong."""

from __future__ import annotations

import numpy as np
import pytest
from support.synthetic_episode import GOAL, make_log

from oimppi_warp.bench.causes import likely_cause
from oimppi_warp.record.log import EpisodeLog


def stuck(steps: int = 200) -> EpisodeLog:
    """An object that stands still half way, the tool behind it."""
    log = make_log(steps=steps, arrive=0.6)
    pose = np.array([0.40, -0.10, 1.0])
    log["object_pose"][:] = pose
    log["position_error"][:] = np.hypot(*(np.array(GOAL[:2]) - pose[:2]))
    log["yaw_error"][:] = GOAL[2] - pose[2]
    log["tool_position"][:] = [0.38, -0.25, 0.02]
    log["contact_tool_object"][:] = 3.0
    log["clearance"][:] = 0.1
    return log


def cause(log: EpisodeLog, **options: float) -> str:
    found = likely_cause(log, **options)
    assert found.evidence
    return found.name


def test_an_object_in_the_middle_of_nothing_stood_still():
    assert cause(stuck()) == "object stopped moving"


@pytest.mark.parametrize(
    ("ended", "name"), [("object fell", "the object fell or tipped over"), ("diverged", "the simulation diverged")]
)
def test_how_the_episode_ended_comes_first(ended: str, name: str):
    log = stuck()
    log.header["ended"] = ended
    assert cause(log) == name


def test_an_episode_without_steps_has_a_cause():
    assert cause(make_log(steps=0, arrive=0.5)) == "no steps were run"


def test_an_object_beyond_the_reach_of_the_arm():
    assert cause(stuck(), reach=0.3) == "out of reach"


def test_a_tool_that_never_touched():
    log = stuck()
    log["contact_tool_object"][:] = 0.0
    assert cause(log) == "never touched the object"


def test_an_object_that_was_at_its_goal_and_left_it():
    log = stuck()
    log["position_error"][50:53] = 0.1
    log["yaw_error"][50:53] = 0.1
    assert cause(log) == "left the goal again"


def test_time_that_was_up_when_the_object_had_just_arrived():
    log = stuck()
    log["position_error"][-3:] = 0.1
    log["yaw_error"][-3:] = 0.1
    assert cause(log) == "time limit while at the goal"


def test_an_object_that_is_there_but_turned_wrong():
    log = stuck()
    log["position_error"][:] = 0.1
    assert cause(log) == "wrong yaw"


@pytest.mark.parametrize(("column", "value"), [("contact_object_obstacle", 12.0), ("clearance", 0.001)])
def test_an_object_at_an_obstacle_is_jammed(column: str, value: float):
    log = stuck()
    log[column][-60:] = value
    assert cause(log) == "jammed against an obstacle"


def test_an_object_that_slides_along_an_obstacle_is_not_jammed():
    log = stuck()
    log["clearance"][:] = 0.0
    log["object_pose"][:, 0] += np.linspace(0.0, 0.4, len(log))
    assert cause(log) == "moved back and forth"


def test_an_arm_that_presses_on_something():
    log = stuck()
    log["contact_robot_obstacle"][:] = 150.0
    assert cause(log) == "arm pressed against an obstacle or the table"


def test_a_tool_between_object_and_goal():
    log = stuck()
    log["tool_position"][:] = [0.43, 0.05, 0.02]
    assert cause(log) == "tool on the wrong side of the object"


def test_an_object_that_was_still_coming_nearer():
    log = make_log(steps=200, arrive=0.6)
    assert cause(log) == "time limit while still approaching"


def test_yaw_is_not_spoken_of_where_it_does_not_count():
    log = stuck()
    log.header["tolerance"] = {"position": 0.1, "yaw": None}
    assert "rad" not in likely_cause(log).evidence
