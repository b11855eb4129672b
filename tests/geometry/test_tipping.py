"""Objects that a push tips over: which do, and how the planner keeps from it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from support import small_tasks

from oimppi_warp.config.settings import Config, RobotCost, RobotLevel
from oimppi_warp.geometry.fields import build_geometry
from oimppi_warp.geometry.footprint import GRAVITY
from oimppi_warp.geometry.tipping import can_tip, support_margin, tipping_height, tipping_speed
from oimppi_warp.physics.world import World
from oimppi_warp.planning.engines.packing import robot_weights
from oimppi_warp.plants.plant import SimulatedPlant


def test_a_can_tips_where_its_radius_over_friction_says():
    can = small_tasks.shipped("lab01").object
    assert support_margin(can) == pytest.approx(0.033, rel=0.01)
    assert tipping_height(can) == pytest.approx(0.033 / 0.4, rel=0.01)
    assert can_tip(can)
    assert not can_tip(replace(can, friction=0.3))  # 0.033 / 0.3 = 0.110 is above its rim


@pytest.mark.parametrize("name", ["task01", "task03", "task05"])
def test_flat_objects_never_tip_and_have_the_terms_off(name: str, device: str):
    scene = small_tasks.shipped(name)
    assert not can_tip(scene.object)
    weights = robot_weights(scene, build_geometry(scene, device), small_tasks.effective_cost(scene))
    assert weights.w_overhang == weights.w_rush == 0.0


def test_a_can_that_may_tip_has_them_on(device: str):
    scene = small_tasks.shipped("lab01")
    weights = robot_weights(scene, build_geometry(scene, device), small_tasks.effective_cost(scene))
    assert weights.w_overhang == RobotCost().w_overhang
    assert weights.topple_speed == pytest.approx(RobotCost().rush * tipping_speed(scene.object))


def test_the_tipping_speed_is_that_of_a_pendulum_over_the_edge():
    can = small_tasks.shipped("lab01").object
    lifted = math.hypot(0.033, 0.0505) - 0.0505
    assert tipping_speed(can) == pytest.approx(math.sqrt(2 * GRAVITY * lifted), rel=0.01)


@pytest.mark.parametrize(("height", "tips"), [(0.07, False), (0.095, True)])
def test_the_plant_tips_a_can_above_its_tipping_height_and_not_below(height: float, tips: bool):
    """A steady push a little stronger than friction, at one height, in the plant."""
    world = World(small_tasks.shipped("lab01"))
    plant = SimulatedPlant(world, start=(0.45, 0.0, 0.0))
    for _ in range(5):
        plant.apply(np.zeros(6))
    can = world.scene.object
    force = 1.05 * can.friction * can.mass * GRAVITY
    body = world.mujoco.object_body
    plant.data.xfrc_applied[body] = [0.0, force, 0.0, -force * (height - can.rest_height), 0.0, 0.0]
    highest = 0.0
    for _ in range(12):
        plant.apply(np.zeros(6))
        qx, qy = plant.observe().object_transform[3:5]
        highest = max(highest, 2 * math.asin(min(1.0, math.hypot(qx, qy))))
    assert (highest > 0.1) == tips


def test_a_stick_that_leans_over_a_can_costs_and_one_that_leans_away_does_not():
    scene = small_tasks.shipped("lab01")
    pushing = small_tasks.Pushing.on(scene)
    pose = np.array([0.45, 0.0, 0.0])
    tip = (0.45, 0.06, 0.02)
    costs = []
    for lean in (-0.2, 0.0, 0.2):
        joints = small_tasks.joints_at(scene.robot, tip)
        jacobian = small_tasks.tip_jacobian(scene.robot, joints)
        for _ in range(20):  # turned about x with the tip held where it is: the stick's other end goes to -y
            joints = joints + np.linalg.pinv(jacobian) @ [0.0, 0.0, 0.0, lean / 20, 0.0, 0.0]
            jacobian = small_tasks.tip_jacobian(scene.robot, joints)
        rolled = pushing.roll(joints, pose, np.zeros((1, 1, 6)))
        costs.append(rolled.term("topple")[0])
    assert costs[2] > 1.0
    assert costs[0] == pytest.approx(0.0, abs=1e-3)
    assert costs[1] == pytest.approx(0.0, abs=1e-2)


def test_coming_at_a_can_fast_costs_and_leaving_it_does_not():
    scene = small_tasks.shipped("lab01")
    fast = replace(Config(), robot=RobotLevel(joint_velocity_limit=1.0))
    pushing = small_tasks.Pushing.on(scene, fast)
    joints = small_tasks.joints_at(scene.robot, (0.45, 0.08, 0.02))
    controls = [small_tasks.straight(scene.robot, joints, (0.0, speed, 0.0), 1) for speed in (-0.4, -0.1, 0.4)]
    topple = pushing.roll(joints, np.array([0.45, 0.0, 0.0]), np.array(controls)).term("topple")
    assert topple[0] > 1.0
    assert topple[1:] == pytest.approx(0.0, abs=1e-2)
