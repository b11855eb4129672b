"""MPPI, SOI and CLOI: what they track, what they command, and that a plan depends on nothing but scene and seed."""

from __future__ import annotations

import gc
import math
import weakref
from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from support import reference
from support.device import DEVICE, to_the_bit
from support.small_tasks import (
    DT,
    Pushing,
    block,
    box,
    joints_at,
    object_level,
    observe,
    roll_wrenches,
    shipped,
    task,
    turned,
)

from oimppi_warp.config.presets import best
from oimppi_warp.config.settings import Config, ObjectLevel, RobotLevel
from oimppi_warp.config.settings import Mppi as MppiSettings
from oimppi_warp.errors import ConfigError, DeviceError, SceneError
from oimppi_warp.geometry.feasibility import sample_start
from oimppi_warp.geometry.fields import ExactClearance, from_center, pose_field_at, to_center
from oimppi_warp.geometry.footprint import wrap_angle
from oimppi_warp.geometry.kinematics import tip_jacobian
from oimppi_warp.kernels.rollouts.object import follow_path
from oimppi_warp.observation import Observation
from oimppi_warp.planning.cloi import ClosedLoopPlanner
from oimppi_warp.planning.cost_to_go import build_to_go
from oimppi_warp.planning.factory import make_planner
from oimppi_warp.planning.plan import Plan
from oimppi_warp.planning.planner import Planner
from oimppi_warp.planning.soi import SequentialPlanner
from oimppi_warp.registries import METHODS
from oimppi_warp.scene import Scene

SMALL = Config(
    robot=RobotLevel(optimizer=MppiSettings(samples=128, horizon=20)),
    object=ObjectLevel(optimizer=MppiSettings(samples=256, horizon=40, temperature=0.1, knots=5)),
)
"""Few samples, so that a test takes a moment."""
JOINT_CONTROLS = replace(SMALL, robot=replace(SMALL.robot, controls="joint"))


def make(scene: Scene, method: str = "cloi", config: Config = SMALL, *, seed: int = 0) -> Planner:
    return make_planner(scene, config, method=method, device=DEVICE, seed=seed)


def on_its_own_model(planner: Planner, scene: Scene, steps: int) -> tuple[list[Plan], Observation]:
    """Plans in closed loop on the planner's own prediction; the plans, and what is seen at the end."""
    seen = observe(scene)
    planner.start(seen)
    plans = []
    for _ in range(steps):
        plans.append(planner.plan(seen))
        joints = seen.joint_position + planner.config.control_period * plans[-1].command
        seen = observe(scene, joints=joints, pose=plans[-1].object_poses[1])
    return plans, seen


def near_goal(scene: Scene) -> Scene:
    """The scene with its object just before the tool and its goal a hand's breadth on."""
    joints = joints_at(scene.robot, (0.40, -0.20, 0.015))
    scene = replace(scene, robot=replace(scene.robot, start=joints))
    return scene.with_start((0.40, -0.05, 0.0)).with_goal((0.42, 0.12, 0.3))


# What a plan is


@pytest.mark.parametrize("method", METHODS)
def test_a_plan_has_a_command_within_its_bounds_and_all_that_it_led_to(method):
    scene = shipped("task02")
    planner = make(scene, method)
    for plan in on_its_own_model(planner, scene, 3)[0]:
        horizon = SMALL.robot.optimizer.horizon
        assert plan.command.shape == (scene.robot.dof,)
        assert (np.abs(plan.command) <= SMALL.robot.joint_velocity_limit + 1e-6).all()
        assert plan.tips.shape == plan.object_poses.shape == (horizon + 1, 3)
        assert np.isfinite(plan.terms).all()
        assert plan.update.effective_samples >= 1.0
        assert plan.update.lost == 0
        assert (plan.object_update is not None) == (method == "cloi")


@pytest.mark.parametrize("config", [SMALL, JOINT_CONTROLS], ids=["tool", "joint"])
def test_the_robots_own_velocity_limit_holds_where_it_is_lower(config: Config):
    scene = shipped("task01")
    slow = tuple(replace(joint, velocity_limit=0.1) for joint in scene.robot.joints)
    planner = make(replace(scene, robot=replace(scene.robot, joints=slow)), "mppi", config)
    if config is JOINT_CONTROLS:
        np.testing.assert_allclose(planner.dynamics.bound, 0.1)
    assert np.abs(on_its_own_model(planner, scene, 3)[0][-1].command).max() <= 0.1 + 1e-6


def test_a_plan_begins_where_the_observation_is():
    scene = shipped("task02")
    plan = on_its_own_model(make(scene), scene, 1)[0][0]
    np.testing.assert_allclose(plan.object_poses[0], scene.start, atol=1e-5)
    tip = reference.tip_frame(scene.robot, scene.robot.start)[:3, 3]
    np.testing.assert_allclose(plan.tips[0], tip, atol=1e-5)


@pytest.mark.parametrize("method", ["mppi", "cloi"])
def test_plans_lower_the_cost_of_doing_nothing(method):
    scene = near_goal(task())
    planner = make(scene, method)
    plans, _ = on_its_own_model(planner, scene, 4)
    still = Pushing.on(scene, SMALL).roll(
        scene.robot.start,
        to_center(planner.geometry.surface, np.array(scene.start)),
        np.zeros((1, SMALL.robot.optimizer.horizon, scene.robot.dof)),
        goal=planner.goal,
        reference=np.tile(planner.goal, (len(planner.dynamics.reference.host), 1)) if method == "mppi" else
        to_center(planner.geometry.surface, plans[0].reference)[: len(planner.dynamics.reference.host)],
    )  # fmt: skip
    assert plans[-1].terms.sum() < still.costs[0]


@pytest.mark.parametrize("method", METHODS)
def test_a_planner_brings_its_own_model_of_the_object_to_the_goal(method):
    scene = near_goal(task())
    planner = make(scene, method)
    _, seen = on_its_own_model(planner, scene, 100)
    start, end = np.array(scene.start), seen.object_pose
    goal = np.array(scene.goal)
    assert np.linalg.norm(end[:2] - goal[:2]) < 0.4 * np.linalg.norm(start[:2] - goal[:2])


# Determinism


@to_the_bit
@pytest.mark.parametrize("method", METHODS)
def test_the_same_seed_gives_the_same_bits_and_another_seed_others(method):
    scene = shipped("task01")
    quick = replace(SMALL, object=replace(SMALL.object, plan_steps=5))
    commands = {
        name: np.array([plan.command for plan in on_its_own_model(make(scene, method, quick, seed=seed), scene, 4)[0]])
        for name, seed in (("one", 7), ("same", 7), ("other", 8))
    }
    np.testing.assert_array_equal(commands["one"], commands["same"])
    assert np.abs(commands["one"] - commands["other"]).max() > 1e-3


def test_the_two_levels_draw_noise_of_their_own():
    planner = make(shipped("task01"))
    assert isinstance(planner, ClosedLoopPlanner)
    assert planner.optimizer.seed != planner._object.optimizer.seed
    assert len({make(shipped("task01"), seed=seed).optimizer.seed for seed in range(4)}) == 4


@pytest.mark.parametrize("seed", [2**31 - 1, 2**31, 2**32 - 1])
def test_every_seed_of_32_bits_plans(seed):
    scene = shipped("task01")
    commands = [on_its_own_model(make(scene, seed=s), scene, 1)[0][0].command for s in (seed, seed % 2**31)]
    assert np.isfinite(commands).all()
    assert (np.abs(commands[0] - commands[1]).max() > 1e-6) == (seed >= 2**31)


@pytest.mark.parametrize("part", ["object_pose", "joint_position"])
@pytest.mark.parametrize("method", METHODS)
def test_an_observation_that_is_not_a_number_stops_the_arm_for_as_long_as_it_lasts(method, part):
    scene = shipped("task02")
    planner = make(scene, method, replace(SMALL, object=replace(SMALL.object, plan_steps=5)))
    seen = observe(scene)
    planner.start(seen)
    planner.plan(seen)
    blind = planner.plan(replace(seen, **{part: np.full(len(getattr(seen, part)), np.nan)}))
    np.testing.assert_array_equal(blind.command, 0.0)
    assert "non-finite values" in blind.problem and np.isnan(blind.update.min_cost)
    again = planner.plan(seen)
    assert np.isfinite(again.command).all()
    assert again.update.lost == 0


# A turned scene

QUARTER = np.pi / 2


def turning_scene() -> Scene:
    """A scene whose table and grids are the same after a quarter turn."""
    scene = task(box(0.30, 0.30, (0.10, 0.06, 0.10)), box(0.42, -0.40, (0.06, 0.10, 0.10)), pushed=block(), table=0.6)
    joints = joints_at(scene.robot, (0.40, -0.14, 0.015))
    scene = replace(scene, robot=replace(scene.robot, start=joints))
    return scene.with_start((0.40, -0.08, 0.1)).with_goal((0.45, 0.20, 0.9))


@pytest.mark.parametrize("quarters", [1, 2])
def test_turned_wrenches_on_a_turned_scene_cost_the_same(quarters):
    scene = turning_scene()
    angle = quarters * QUARTER
    other = turned(scene, angle)
    turn = np.eye(3)
    turn[:2, :2] = reference.planar_rotation(angle)
    dynamics, _, _ = object_level(scene)
    turned_dynamics, _, _ = object_level(other)
    wrenches = np.random.default_rng(1).normal(size=(60, 30, 3)) * dynamics.bound + [0.0, 0.5 * dynamics.bound[1], 0.0]
    costs, poses = roll_wrenches(dynamics, np.array(scene.start), wrenches)
    turned_costs, turned_poses = roll_wrenches(turned_dynamics, np.array(other.start), wrenches @ turn.T)
    expected = poses @ turn.T + [0.0, 0.0, angle]
    off = np.abs(turned_poses - expected).max(axis=(1, 2))
    assert np.quantile(off, 0.9) < 1e-3
    same = off < 1e-3
    np.testing.assert_allclose(turned_costs[same], costs[same], rtol=5e-3)


@pytest.mark.parametrize("quarters", [1, 2])
def test_the_same_joint_velocities_on_a_turned_scene_cost_the_same(quarters):
    scene = turning_scene()
    other = turned(scene, quarters * QUARTER)
    controls = np.random.default_rng(2).normal(scale=0.3, size=(60, 20, scene.robot.dof)) + 0.3 * np.eye(6)[0]
    here, there = (
        Pushing.on(s).roll(s.robot.start, np.array(s.start), controls, goal=np.array(s.goal)) for s in (scene, other)
    )
    off = np.abs(here.costs - there.costs) / here.costs
    assert np.quantile(off, 0.9) < 5e-3
    assert (np.abs(here.poses[:, -1] - np.array(scene.start)).max(axis=1) > 0.01).sum() > 5, "nothing was pushed"


def test_a_turned_scene_gives_a_turned_plan():
    # Noise in joint space is the same for the turned arm; noise of the tip would have to be turned, too.
    config = replace(SMALL, robot=replace(JOINT_CONTROLS.robot, noise_space="joint", joint_noise=0.2))
    scene = turning_scene()
    other = turned(scene, QUARTER)
    here, there = (make(s, "mppi", config) for s in (scene, other))
    plans, turned_plans = on_its_own_model(here, scene, 3)[0], on_its_own_model(there, other, 3)[0]
    for plan, turned_plan in zip(plans, turned_plans, strict=True):
        np.testing.assert_allclose(turned_plan.command, plan.command, atol=0.01)
        expected = plan.tips @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        np.testing.assert_allclose(turned_plan.tips, expected, atol=0.002)


# Noise


def test_noise_in_tool_space_moves_the_tip_as_it_says():
    scene = shipped("task01")
    planner = make(scene, "mppi", JOINT_CONTROLS)
    joints = joints_at(scene.robot, (0.45, 0.1, 0.05))
    jacobian = tip_jacobian(scene.robot, joints)
    spread = jacobian @ planner._noise(joints)
    found = np.sqrt(np.diag(spread @ spread.T))
    # Damping keeps a little back, most where the arm moves least.
    wanted = np.array(SMALL.robot.tool_noise)
    assert (found <= wanted * 1.001).all()
    np.testing.assert_allclose(found[:3], wanted[:3], rtol=0.25)


def test_noise_in_tool_space_stays_finite_at_a_singular_arm():
    scene = shipped("task01")
    root = make(scene, "mppi", JOINT_CONTROLS)._noise(np.zeros(scene.robot.dof))
    assert np.isfinite(root).all()
    assert np.abs(root).max() < 10.0 * max(SMALL.robot.tool_noise) / 0.05


def test_noise_in_joint_space_is_the_same_for_every_joint():
    config = replace(SMALL, robot=replace(JOINT_CONTROLS.robot, noise_space="joint", joint_noise=0.2))
    scene = shipped("task01")
    np.testing.assert_array_equal(make(scene, "mppi", config)._noise(scene.robot.start), 0.2 * np.eye(6))


def test_noise_of_the_tip_is_vertical_only_while_it_is_lifted():
    planner = make(shipped("task01"), "mppi")
    here = planner.scene.robot.start
    spread = planner.config.robot.tip_noise
    np.testing.assert_array_equal(planner._noise(here), np.diag([spread, spread, 0.0]))
    np.testing.assert_array_equal(planner._noise(here, repositioning=True), spread * np.eye(3))


# What is tracked


def test_mppi_tracks_the_goal():
    scene = shipped("task02")
    plan = on_its_own_model(make(scene, "mppi"), scene, 1)[0][0]
    np.testing.assert_allclose(plan.reference, np.tile(scene.goal, (len(plan.reference), 1)), atol=1e-9)


def test_mppi_can_be_given_the_cost_to_go(device: str):
    scene = shipped("task02")
    cost = replace(SMALL.cost, w_d=0.0, w_to_go=2.0)
    planner = make(scene, "mppi", replace(SMALL, cost=cost))
    plan = on_its_own_model(planner, scene, 1)[0][0]
    clearance = planner.geometry.clearance
    level, ring = planner.config.object, planner.config.object_cost.push_ring
    to_go = build_to_go(clearance, planner.goal, yaw_length=level.yaw_length, push_ring=ring, device=device)
    poses = to_center(planner.geometry.surface, plan.object_poses[1:])
    expected = 2.0 * sum(pose_field_at(to_go, pose) for pose in poses)
    assert plan.terms[planner.dynamics.terms.index("goal")] == pytest.approx(expected, rel=1e-3)


def test_cloi_tracks_a_plan_that_starts_at_the_object_and_is_made_anew():
    scene = shipped("task02")
    plans, seen = on_its_own_model(make(scene), scene, 5)
    np.testing.assert_allclose(plans[0].reference[0], scene.start, atol=1e-5)
    assert np.abs(plans[-1].reference[5] - plans[0].reference[5]).max() > 1e-4
    moved = observe(scene, joints=seen.joint_position, pose=np.array([0.35, -0.3, 0.5]))
    planner = make(scene)
    planner.start(moved)
    np.testing.assert_allclose(planner.plan(moved).reference[0], [0.35, -0.3, 0.5], atol=1e-5)


@pytest.mark.parametrize("period", [0.05, 0.1, 0.2])
def test_the_reference_of_soi_gets_to_the_goal_from_every_pose_of_its_plan(period):
    scene = shipped("pusht")
    scene = scene.with_goal((scene.goal[0], scene.goal[1], 0.0))
    config = replace(SMALL, control_period=period)
    planner = make_planner(scene, config, method="soi", device=DEVICE, seed=0)
    assert isinstance(planner, SequentialPlanner)
    planner.start(observe(scene))
    step = config.object.speed_limit[0] * period
    # A half turn at the speed limit, on the spot.
    count = int(np.ceil(np.pi * config.object.yaw_length / step))
    path = np.tile(planner.goal, (count + 1, 1)) + np.outer(np.linspace(1.0, 0.0, count + 1), [0.0, 0.0, np.pi])
    follower = planner._follower
    assert follower is not None
    follower.set_plan(path, arrived=True, bound=None)
    for pose in path[:-1]:
        for aside in (-0.01, 0.0, 0.01):
            planner.set_reference(pose + [aside, aside, 0.0])
            planner.steps[0]()
            left = np.abs(planner.tracked()[:, 2] - planner.goal[2])
            assert left[0] - left[10] > 0.7 * min(10 * step / config.object.yaw_length, left[0]), (pose, aside)


@pytest.fixture(scope="module")
def sequential() -> tuple[SequentialPlanner, np.ndarray]:
    """SOI on task 02, started, and its path of the friction centre."""
    scene = shipped("task02")
    longer = replace(SMALL.object, optimizer=replace(SMALL.object.optimizer, horizon=60))
    planner = make(scene, "soi", replace(SMALL, object=longer))
    assert isinstance(planner, SequentialPlanner)
    assert planner.start(observe(scene)) > 0.0
    return planner, planner._path.copy()


def test_soi_plans_a_way_from_start_to_goal_around_the_obstacle(sequential):
    planner, path = sequential
    surface = planner.geometry.surface
    np.testing.assert_allclose(path[0], to_center(surface, np.array(planner.scene.start)), atol=1e-6)
    np.testing.assert_allclose(path[-1], planner.goal, atol=1e-9)
    assert np.linalg.norm(path[-2, :2] - planner.goal[:2]) < 0.05, "the object level did not come near the goal"
    assert min(planner.geometry.clearance_at(pose) for pose in path) > -0.003
    steps = np.abs(np.diff(path[:-1], axis=0)).max(axis=0)
    limit = DT * np.array(planner.config.object.speed_limit)
    assert (steps <= limit * 1.01 + 0.02).all(), "faster than the speed limit, more than an obstacle pushes back"


@pytest.mark.parametrize("pace", [1.0, 0.3])
def test_the_reference_advances_along_the_plan_at_the_pace_that_is_set(pace):
    path = np.array([[0.1 * i, 0.2, 3.0 + 0.1 * i] for i in range(5)])
    path[:, 2] = wrap_angle(path[:, 2])
    found = wp.zeros(8, dtype=wp.vec3, device=DEVICE)
    steps = wp.array([pace], dtype=float, device=DEVICE)
    wp.launch(follow_path, 8, inputs=[wp.array(path[None], dtype=wp.vec3, device=DEVICE), steps, found], device=DEVICE)
    at = np.minimum(pace * np.arange(8), 4.0)
    poses = found.numpy()
    np.testing.assert_allclose(poses[:, :2], np.column_stack([0.1 * at, 0.2 + 0.0 * at]), atol=1e-6)
    np.testing.assert_allclose(wrap_angle(poses[:, 2] - 3.0 - 0.1 * at), 0.0, atol=1e-6)


def with_plans(count: int) -> tuple[SequentialPlanner, Scene]:
    """SOI on task02, with so many object plans."""
    scene = shipped("task02")
    planner = make(scene, "soi", replace(SMALL, object=replace(SMALL.object, plans=count)))
    assert isinstance(planner, SequentialPlanner)
    return planner, scene


def test_soi_follows_the_plan_with_the_least_sum_of_the_cost_to_go(monkeypatch):
    planner, scene = with_plans(3)
    made: list[np.ndarray] = []
    plan_object = planner.plan_object

    def record(pose: np.ndarray) -> tuple[np.ndarray, bool]:
        path, arrived = plan_object(pose)
        made.append(path)
        return path, arrived

    monkeypatch.setattr(planner, "plan_object", record)
    planner.start(observe(scene))
    assert len(made) == 3
    to_go = [sum(planner._object.to_go_from(pose) for pose in path) for path in made]
    assert len(set(to_go)) == 3, "each plan is drawn anew"
    assert planner._path is made[int(np.argmin(to_go))]


@to_the_bit
def test_soi_s_plans_do_not_depend_on_the_episodes_before():
    planner, scene = with_plans(2)
    planner.start(observe(scene))
    first = planner._path.copy()
    planner.start(observe(scene))
    np.testing.assert_array_equal(planner._path, first)


def test_soi_prefers_a_plan_that_arrives(monkeypatch):
    planner, scene = with_plans(2)
    near, far = np.array([planner.goal] * 3), np.array([to_center(planner.geometry.surface, np.array(scene.start))] * 3)
    plans = iter([(near, False), (far, True)])
    monkeypatch.setattr(planner, "plan_object", lambda pose: next(plans))
    planner.start(observe(scene))
    assert planner._path is far


@pytest.mark.parametrize("seed", [100, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (101, 102))])
def test_soi_plans_through_a_gap_without_touching_its_sides_and_without_needless_turns(seed):
    scene = shipped("task03")
    scene = scene.with_start(sample_start(scene, seed))
    planner = make_planner(scene, best("soi"), method="soi", device="cpu", seed=seed)
    assert isinstance(planner, SequentialPlanner)
    planner.start(observe(scene))
    exact = ExactClearance(scene)
    assert min(exact.at(pose) for pose in planner.object_plan) > 0.004
    turned = np.abs(wrap_angle(np.diff(planner.object_plan[:, 2]))).sum()
    assert turned < 4.8, "half a turn is needed"


def test_soi_reads_its_plan_by_time_as_the_paper_does():
    scene = shipped("task01")
    planner = make(scene, "soi", replace(SMALL, reference="time"))
    assert isinstance(planner, SequentialPlanner)
    seen = observe(scene)
    planner.start(seen)
    path = planner._path
    surface = planner.geometry.surface
    for step in range(3):
        reference = to_center(surface, planner.plan(seen).reference)
        np.testing.assert_allclose(reference, path[step:], atol=1e-9)


def referenced(planner: SequentialPlanner, pose: np.ndarray) -> np.ndarray:
    """What SOI tracks for a pose of the friction centre."""
    surface = planner.geometry.surface
    plan = planner.plan(observe(planner.scene, pose=from_center(surface, pose)))
    return to_center(surface, plan.reference)


def apart(planner: SequentialPlanner, pose: np.ndarray, path: np.ndarray) -> float:
    """Distance of a pose to a path, turning counted [m]."""
    error = path - pose
    error[:, 2] = planner.config.object.yaw_length * reference.wrap_angle(error[:, 2])
    return float(np.linalg.norm(error, axis=1).min())


def test_soi_follows_its_plan_from_where_the_object_is_on_it(sequential):
    planner, path = sequential
    for at in (0, 12, 30):
        found = referenced(planner, path[at])
        np.testing.assert_allclose(found[0], path[at], atol=1e-4)
        assert max(apart(planner, pose, path) for pose in found) < 0.035
        ahead = np.linalg.norm(path[at:, :2] - found[-1, :2], axis=1).argmin()
        assert ahead > 15, "it gets on"


def test_a_plan_that_did_not_arrive_leads_nowhere():
    scene = shipped("task02")
    planner = make(scene, "soi", replace(SMALL, object=replace(SMALL.object, plan_steps=5)))
    assert isinstance(planner, SequentialPlanner)
    planner.start(observe(scene))
    found = referenced(planner, to_center(planner.geometry.surface, np.array([0.45, -0.12, 0.5])))
    assert min(planner.geometry.clearance_at(pose) for pose in found) > -0.003, "not straight through the cube"
    assert planner.to_go_from(found[-1]) < planner.to_go_from(found[0]) - 0.1


def test_a_turn_more_of_the_object_changes_nothing_of_soi_s_reference(sequential):
    planner, path = sequential
    once, more = referenced(planner, path[12]), referenced(planner, path[12] + [0.0, 0.0, 2.0 * np.pi])
    np.testing.assert_allclose(once[:, :2], more[:, :2], atol=1e-3)
    np.testing.assert_allclose(reference.wrap_angle(once[:, 2] - more[:, 2]), 0.0, atol=1e-2)


def test_soi_leads_an_object_that_is_off_the_plan_a_free_way_back(sequential):
    planner, _ = sequential
    # Beyond the cube of task 02, which stands between it and the plan's beginning.
    off = np.array([0.35, 0.05, 0.3])
    found = referenced(planner, off)
    np.testing.assert_allclose(found[0], off, atol=1e-6)
    assert min(planner.geometry.clearance_at(pose) for pose in found) > -0.003
    assert np.abs(np.diff(found, axis=0)).max() < 0.1, "no jumps, no turns around"
    to_go = [planner.to_go_from(pose) for pose in (found[0], found[-1])]
    assert to_go[1] < to_go[0] - 0.1


def test_an_object_that_does_not_get_on_is_let_go_and_the_tip_called_elsewhere():
    scene = near_goal(shipped("task01"))
    planner = make(scene, "cloi")
    seen = observe(scene)
    planner.start(seen)
    stall = round(planner.config.reposition.stall_seconds / DT)
    called = []
    for _ in range(stall + 5):  # nothing moves, whatever is commanded
        planner.plan(seen)
        called.append(planner.dynamics.waypoint.host[0][3])
    assert not any(called[: stall - 2]) and called[-1] == planner.config.reposition.w_waypoint
    planner.start(seen)
    planner.plan(seen)
    assert planner.dynamics.waypoint.host[0][3] == 0.0, "another episode begins anew"


def test_a_reference_that_is_set_by_a_method_advances_at_the_pace():
    planner = make(shipped("task01"), "mppi")
    path = np.array([[0.1 * i, 0.0, 0.0] for i in range(5)])
    planner.pace.host[0] = 0.5
    planner.track(path)
    np.testing.assert_allclose(planner.dynamics.reference.host[:4, 0], [0.0, 0.05, 0.1, 0.15], atol=1e-6)
    np.testing.assert_array_equal(planner.tracked(), path)


@pytest.mark.parametrize("method", ["mppi", "cloi", "soi"])
def test_a_push_takes_the_place_of_the_reference_while_it_lasts(method: str, device: str):
    scene = shipped("task02")
    planner = make_planner(scene, SMALL, method=method, device=device, seed=3)
    seen = observe(scene)
    planner.start(seen)
    own = planner.plan(seen).reference
    steps = len(planner.dynamics.reference.host)
    push = planner.goal + 0.001 * np.arange(steps)[:, None]
    planner._repositioner.detour = lambda count: push[:count]
    np.testing.assert_allclose(planner.plan(seen).reference, from_center(planner.geometry.surface, push))
    np.testing.assert_allclose(planner.dynamics.reference.array.numpy(), push, atol=1e-6)
    planner._repositioner.detour = lambda count: None
    np.testing.assert_allclose(planner.plan(seen).reference[0], own[0], atol=0.02)
    assert np.abs(planner.dynamics.reference.array.numpy()[5] - push[5]).max() > 0.002


def test_the_way_to_the_goal_is_that_without_the_plan():
    planner = make(shipped("task02"), "soi")
    planner.start(observe(planner.scene))
    ahead = planner._path[len(planner._path) // 2]
    assert planner.to_go_from(ahead) < 0.7 * planner.to_goal_from(ahead), "a metre along the plan counts as half"
    for method in ("cloi", "mppi"):
        other = make(shipped("task02"), method)
        assert other.to_goal_from(ahead) == other.to_go_from(ahead)


def test_a_reference_is_held_at_its_end():
    scene = shipped("task01")
    planner = make(scene, "mppi")
    seen = observe(scene)
    planner.start(seen)
    planner.plan(seen)
    held = planner.dynamics.reference.host
    assert len(held) == planner.config.robot.optimizer.horizon + 1 + planner.config.cost.align_ahead
    np.testing.assert_allclose(held, np.tile(planner.goal, (len(held), 1)), atol=1e-6)


@pytest.mark.parametrize("method", ["mppi", "cloi", "soi"])
def test_the_details_of_a_plan_stay_its_own_after_the_next_plan(method: str, device: str):
    scene = shipped("task02")
    here = observe(scene)
    found = []
    for patient in (True, False):
        planner = make_planner(scene, SMALL, method=method, device=device, seed=3)
        planner.start(here)
        plans = []
        for _ in range(3):
            plans.append(planner.plan(here))
            if not patient:
                plans[-1].details()
        found.append(plans)
    for late, early in zip(*found, strict=True):
        np.testing.assert_array_equal(late.command, early.command)
        for name in ("terms", "tips", "object_poses", "reference"):
            np.testing.assert_array_equal(getattr(late, name), getattr(early, name))
        assert late.update == early.update
    assert not np.array_equal(found[0][0].tips, found[0][1].tips)


def test_an_observation_of_lists_gives_the_same_plan(device: str):
    here = observe(shipped("task02"))
    names = ("joint_position", "joint_velocity", "object_pose", "object_transform")
    lists = replace(here, **{name: getattr(here, name).tolist() for name in names})
    first, second = (
        make_planner(shipped("task02"), SMALL, method="cloi", device=device, seed=3).plan(seen)
        for seen in (here, lists)
    )
    np.testing.assert_array_equal(first.command, second.command)
    assert (
        make_planner(shipped("task02"), SMALL, method="cloi", device=device, seed=3)
        .plan(replace(lists, object_pose=[math.nan, 0.0, 0.0]))
        .problem
    )


@pytest.mark.parametrize("method", ["mppi", "cloi", "soi"])
def test_the_details_of_a_plan_stay_its_own_after_a_new_start(method: str, device: str):
    here = observe(shipped("task02"))
    planner = make_planner(shipped("task02"), SMALL, method=method, device=device, seed=3)
    planner.start(here)
    plan = planner.plan(here)
    planner.start(here)
    assert plan.update.effective_samples >= 1.0 and plan.update.min_cost > 0.0


def test_rollouts_that_cannot_be_used_give_no_command(device: str, monkeypatch: pytest.MonkeyPatch):
    here = observe(shipped("task02"))
    planner = make_planner(shipped("task02"), SMALL, method="mppi", device=device, seed=3)

    def refuse() -> None:
        raise SceneError("too many contacts")

    with monkeypatch.context() as patch:
        patch.setattr(planner.dynamics, "check", refuse)
        with pytest.raises(SceneError, match="too many contacts"):
            planner.plan(here)
    assert np.isfinite(planner.plan(here).update.min_cost)


def test_a_plan_does_not_keep_its_planner_alive(device: str):
    planner = make_planner(shipped("task02"), SMALL, method="mppi", device=device, seed=3)
    plan = planner.plan(observe(shipped("task02")))
    plan.details()
    alive = weakref.ref(planner)
    del planner
    gc.collect()
    assert alive() is None and len(plan.tips)


# Bad input


def test_an_unknown_method_or_engine_is_named_with_what_is_allowed(device: str):
    with pytest.raises(ConfigError, match=r"ppo.*\n.*mppi, soi, cloi"):
        make_planner(shipped("task01"), SMALL, method="ppo", device=device)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match=r"bullet.*\n.*quasistatic"):
        make_planner(shipped("task01"), SMALL, engine="bullet", device=device)


def test_a_device_that_is_not_there_is_named_with_those_that_are():
    with pytest.raises(DeviceError, match=r"cuda:17.*\n.*cpu"):
        make_planner(shipped("task01"), SMALL, device="cuda:17")


def test_settings_that_contradict_each_other_make_no_planner(device: str):
    bad = replace(SMALL, robot=replace(SMALL.robot, optimizer=MppiSettings(horizon=4, knots=9)))
    with pytest.raises(ConfigError, match="knots"):
        make_planner(shipped("task01"), bad, device=device)
