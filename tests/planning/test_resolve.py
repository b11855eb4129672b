"""Settings as they take effect: on every shipped scene, what a record would hold is what the planner uses."""

from __future__ import annotations

import math
from dataclasses import asdict, replace

import numpy as np
import pytest
from support import small_tasks

from oimppi_warp.config.overrides import from_record, options, set_option
from oimppi_warp.config.presets import PRESETS, best, lab
from oimppi_warp.config.settings import RobotCost
from oimppi_warp.errors import ConfigError
from oimppi_warp.geometry.tipping import can_tip
from oimppi_warp.kernels.costs.stage_costs import ObjectWeights, RobotWeights
from oimppi_warp.planning.cloi import ClosedLoopPlanner
from oimppi_warp.planning.factory import make_planner
from oimppi_warp.planning.resolve import resolve
from oimppi_warp.record.log import to_json
from oimppi_warp.usd import shipped_scenes

SCENES = [scene.name for scene in shipped_scenes()]
SMALL = ("robot.optimizer.samples=8", "object.optimizer.samples=8")


def few(preset: str):
    """A preset with few samples, so that a planner is made in a moment."""
    config = PRESETS[preset]("cloi")
    for option in SMALL:
        config = set_option(config, option)
    return config


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("name", SCENES)
def test_the_settings_that_are_recorded_are_those_that_the_kernels_get(name: str, preset: str, device: str):
    scene = small_tasks.shipped(name)
    resolved = resolve(few(preset), scene)
    recorded = from_record(to_json(asdict(resolved.config)))
    assert recorded == resolved.config
    planner = make_planner(scene, resolved.config, method="cloi", engine="quasistatic", device=device, threads=1)
    assert isinstance(planner, ClosedLoopPlanner)
    assert planner.config == recorded
    for weights, cost in (
        (planner.dynamics._packed.weights, recorded.cost),  # pyright: ignore[reportAttributeAccessIssue]
        (planner._object._dynamics._weights, recorded.object_cost),
    ):
        packed = RobotWeights if cost is recorded.cost else ObjectWeights
        shared = vars(cost).keys() & packed.vars.keys() - {"extra"}  # pyright: ignore[reportAttributeAccessIssue]
        assert shared >= {"w_d", "w_theta", "w_f", "w_push_ring", "margin"}
        for weight in shared:
            found = np.float32(getattr(weights, weight))
            np.testing.assert_array_equal(found, np.float32(getattr(cost, weight)), weight)
    yaw_counts = bool(np.isfinite(scene.tolerance.yaw))
    assert recorded.object.turn == (planner._object._dynamics.bound[2] > 0.0) == yaw_counts
    if not can_tip(scene.object):
        assert recorded.cost.w_overhang == recorded.cost.w_rush == 0.0


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("name", SCENES)
def test_each_change_is_told_with_what_was_asked_for_and_why(name: str, preset: str):
    scene, config = small_tasks.shipped(name), PRESETS[preset]("cloi")
    resolved = resolve(config, scene)
    asked, used = options(config), options(resolved.config)
    assert resolved.changes.keys() == {name for name in asked if asked[name] != used[name]}
    for changed, change in resolved.changes.items():
        assert change.asked == asked[changed]
        assert len(change.reason) > 10


def test_a_can_is_not_turned_and_the_record_says_so():
    resolved = resolve(lab("cloi"), small_tasks.shipped("lab01"))
    assert resolved.config.object.turn is False
    assert resolved.config.cost.w_theta == resolved.config.object_cost.w_theta == 0.0
    assert resolved.changes["object.turn"].asked is True
    assert resolved.changes["cost.w_theta"].asked == RobotCost().w_theta
    assert "yaw" in resolved.changes["cost.w_theta"].reason


def test_the_ring_of_reach_goes_with_the_robot():
    asked = best("cloi").cost.push_ring
    assert resolve(best("cloi"), small_tasks.shipped("task01")).config.cost.push_ring == asked
    point = resolve(best("cloi"), small_tasks.shipped("point01"))
    assert point.config.cost.push_ring[0] == 0.0 and point.config.cost.push_ring[1] > 100.0
    assert point.changes["cost.push_ring"].asked == asked
    arm7 = resolve(best("cloi"), small_tasks.shipped("arm7_01")).config.cost.push_ring
    assert arm7[0] / asked[0] == pytest.approx(arm7[1] / asked[1])


def test_resolving_twice_changes_nothing_the_second_time():
    for name in SCENES:
        once = resolve(best("cloi"), small_tasks.shipped(name)).config
        again = resolve(once, small_tasks.shipped(name))
        assert again.config is once
        assert again.changes == {}
        moved = small_tasks.shipped(name).with_goal(small_tasks.shipped(name).start)
        assert resolve(once, moved).config is once


def test_settings_resolved_for_one_robot_are_not_used_with_another():
    once = resolve(best("cloi"), small_tasks.shipped("point01")).config
    with pytest.raises(ConfigError, match="resolved for another task"):
        resolve(once, small_tasks.shipped("task01"))


def test_a_change_made_after_resolving_takes_effect_as_it_is():
    scene = small_tasks.shipped("point01")
    once = resolve(best("cloi"), scene).config
    again = resolve(replace(once, cost=replace(once.cost, push_ring=(0.1, 2.0))), scene)
    assert again.config.cost.push_ring == (0.1, 2.0)


def test_a_plants_own_control_period_takes_the_place_of_the_setting():
    scene = small_tasks.shipped("task01")
    resolved = resolve(best("cloi"), scene, control_period=0.04)
    assert resolved.config.control_period == 0.04
    assert resolved.changes["control_period"].asked == 0.05
    assert "plant" in resolved.changes["control_period"].reason
    assert "control_period" not in resolve(best("cloi"), scene, control_period=0.05).changes
    assert resolve(resolved.config, scene, control_period=0.04).changes == {}


@pytest.mark.parametrize(("period", "horizon"), [(0.05, 60), (0.1, 30), (0.02, 150), (3.0, 5)])
def test_the_object_level_plans_as_far_ahead_with_any_control_period(period, horizon):
    resolved = resolve(best("cloi"), small_tasks.shipped("task01"), control_period=period)
    assert resolved.config.object.optimizer.horizon == horizon  # 5: the number of knots
    assert ("object.optimizer.horizon" in resolved.changes) == (horizon != 60)


@pytest.mark.parametrize(
    ("period", "speed", "radius", "steps"),
    [(0.05, 0.3, 0.008, 2), (0.1, 0.3, 0.008, 4), (0.1, 0.3, 0.015, 3), (0.05, 0.3, 0.002, 8), (0.05, 0.01, 0.008, 2)],
)
def test_the_contact_model_does_not_lead_the_tool_through_thin_objects(period, speed, radius, steps):
    scene = small_tasks.shipped("task01")
    scene = replace(scene, robot=replace(scene.robot, tool_radius=radius))
    config = set_option(best("cloi"), f"robot.tip_speed_limit={speed}")
    resolved = resolve(config, scene, control_period=period)
    assert resolved.config.robot.contact_steps == steps
    assert math.hypot(speed, speed) * period / steps <= 1.35 * radius


@pytest.mark.parametrize("thickness", [0.012, 0.03, 0.1])
def test_an_object_that_a_push_could_tip_over_is_pushed_and_touched_low_enough(thickness: float, device: str):
    """At friction 0.4 a push tips it from half of its thickness, divided by 0.4: 15 mm, 37.5 mm and 125 mm."""
    scene = small_tasks.task(pushed=small_tasks.block((0.10, thickness, 0.05)))
    resolved = resolve(few("best"), scene)
    tips_from, height = thickness / 2 / 0.4, resolved.config.cost.height
    assert height == pytest.approx(min(best().cost.height, 0.6 * tips_from))
    assert ("cost.height" in resolved.changes) == (thickness < 0.02)
    planner = make_planner(scene, resolved.config, method="cloi", engine="quasistatic", device=device, threads=1)
    upright = planner.dynamics.task.upright
    assert upright is not None
    assert upright.packed.height == pytest.approx(height)
    assert height < upright.packed.highest <= min(height + 0.008, 0.9 * tips_from) + 1e-6
    if thickness > 0.02:
        assert upright.packed.highest == pytest.approx(height + 0.008)
    other = 0.012 if thickness > 0.02 else 0.03
    with pytest.raises(ConfigError, match="resolved for another task"):
        resolve(resolved.config, small_tasks.task(pushed=small_tasks.block((0.10, other, 0.05))))
