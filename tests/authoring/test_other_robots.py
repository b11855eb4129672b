"""Robots other than the xArm6: a point that slides, an arm of seven joints, the xArm6 on a rail."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import shapely
from scipy.spatial.transform import Rotation
from support import reference
from support.engines import ends, make, plant_at, roll
from support.reference import ANGLE_TOLERANCE, LENGTH_TOLERANCE
from support.small_tasks import DT, Pushing, block, box, joints_at, observe, shipped, straight

from oimppi_warp.config.overrides import set_option
from oimppi_warp.config.presets import best, lab
from oimppi_warp.config.settings import Reposition
from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.feasibility import check_task
from oimppi_warp.geometry.fields import build_geometry, from_center
from oimppi_warp.geometry.kinematics import link_frames, tip_frame, tip_jacobian
from oimppi_warp.geometry.reach import can_lift, inverse_kinematics, object_bounds, reach_of
from oimppi_warp.kernels.costs.stage_costs import TERMS
from oimppi_warp.physics.world import World
from oimppi_warp.planning.engines.newton_threads import NewtonThreads
from oimppi_warp.planning.engines.newton_worlds import NewtonWorlds
from oimppi_warp.planning.factory import make_planner
from oimppi_warp.planning.object_level import distance
from oimppi_warp.planning.planner import Planner
from oimppi_warp.planning.reposition import Repositioner
from oimppi_warp.plants.plant import SimulatedPlant
from oimppi_warp.record.metrics import summarize
from oimppi_warp.runtime.episode import Episode
from oimppi_warp.scene import Joint, Link, Obstacle, Robot, Scene

NAMES = ("point01", "arm7_01")
RANDOM = np.random.default_rng(5)
T_POSE = np.array([0.42, -0.20, 0.3])


def on_a_rail(scene: Scene) -> Scene:
    """The scene with its arm on a rail along y, 0.3 m to either side."""
    turn = Rotation.from_euler("x", -90.0, degrees=True)
    rail = Joint("/rail", np.array([0, 0, 0, *turn.as_quat()]), -0.3, 0.3, 0.5, 500.0, "prismatic")
    first = scene.robot.joints[0]
    back = turn.inv()
    pose = np.array([*back.apply(np.array(first.parent_transform[:3])), *back.as_quat()])
    joints = (rail, replace(first, parent_transform=pose), *scene.robot.joints[1:])
    links = (Link("/carriage", 1.0, ()), *scene.robot.links)
    robot = replace(scene.robot, joints=joints, links=links, start=np.array([0.05, *scene.robot.start]))
    return replace(scene, robot=robot)


def scene_of(name: str) -> Scene:
    return on_a_rail(shipped("task01")) if name == "rail" else shipped(name)


def random_joints(robot: Robot) -> np.ndarray:
    return RANDOM.uniform([joint.lower for joint in robot.joints], [joint.upper for joint in robot.joints])


# Kinematics


def test_a_chain_has_a_letter_for_each_joint():
    chains = {name: scene_of(name).robot.chain for name in ("task01", *NAMES, "rail")}
    assert chains == {"task01": "RRRRRR", "point01": "PP", "arm7_01": "RRRRRRR", "rail": "PRRRRRR"}


@pytest.mark.parametrize("name", NAMES)
def test_links_and_tip_are_where_mujoco_has_them(name):
    scene = shipped(name)
    mapped = World(scene).mujoco
    model, data = mapped.model, mujoco.MjData(mapped.model)
    for _ in range(10):
        joints = random_joints(scene.robot)
        data.qpos[mapped.joint_qpos] = joints
        mujoco.mj_forward(model, data)
        rotations, positions = link_frames(scene.robot, joints)
        np.testing.assert_allclose(data.xpos[mapped.link_bodies], positions, atol=1e-6)
        np.testing.assert_allclose(data.xmat[mapped.link_bodies].reshape(-1, 3, 3), rotations, atol=1e-6)
        linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        tip = tip_frame(scene.robot, joints)[1]
        mujoco.mj_jac(model, data, linear, angular, tip, mapped.link_bodies[-1])
        expected = np.vstack([linear, angular])[:, mapped.joint_qvel]
        np.testing.assert_allclose(tip_jacobian(scene.robot, joints), expected, atol=1e-6)


@pytest.mark.parametrize("name", [*NAMES, "rail"])
def test_the_tips_jacobian_is_its_finite_difference(name):
    robot = scene_of(name).robot
    joints = random_joints(robot)
    jacobian = tip_jacobian(robot, joints)
    for j, step in enumerate(1e-6 * np.eye(robot.dof)):
        after, before = (reference.tip_frame(robot, joints + sign * step) for sign in (1.0, -1.0))
        linear = (after[:3, 3] - before[:3, 3]) / 2e-6
        angular = Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).as_rotvec() / 2e-6
        np.testing.assert_allclose(jacobian[:, j], [*linear, *angular], atol=1e-7)


# Reach


def test_a_point_reaches_a_rectangle():
    robot = shipped("point01").robot
    reach = reach_of(robot)
    np.testing.assert_allclose(reach.bounds, [[-0.22, -0.77], [0.97, 0.77]], atol=1e-6)
    room = reach.margin(np.array([[0.3, 0.0], [0.9, 0.7], [1.0, 0.0], [-0.3, -0.8]]))
    np.testing.assert_allclose(room, [0.52, 0.07, -0.03, -np.hypot(0.08, 0.03)], atol=1e-6)
    assert not can_lift(robot)


def test_the_object_of_a_point_is_kept_to_where_the_stick_gets_behind_it(device: str):
    scene = shipped("point01")
    lower, upper = object_bounds(scene)
    np.testing.assert_allclose([lower, upper], [[-0.204, -0.754], [0.954, 0.754]], atol=1e-9)
    geometry = build_geometry(scene, device)
    assert geometry.clearance_at(np.array([0.954 - geometry.size - 0.02, 0.0, 0.3])) > 0.0
    assert geometry.clearance_at(np.array([0.954, 0.0, 0.3])) < 0.0
    table = shipped("task01")
    np.testing.assert_array_equal(object_bounds(table), [table.table.lower, table.table.upper])


def test_an_arm_reaches_a_disc_and_can_lift():
    robot = shipped("arm7_01").robot
    assert reach_of(robot).border is None
    assert reach_of(robot).radius == pytest.approx(0.759, abs=2e-3)
    assert can_lift(robot)
    assert can_lift(shipped("task01").robot)


def test_an_arm_on_a_rail_reaches_further_along_it():
    alone, robot = shipped("task01").robot, scene_of("rail").robot
    far = reach_of(alone).radius
    lower, upper = reach_of(robot).bounds
    # A disc is carried along, drawn as a polygon around it.
    np.testing.assert_allclose(upper, [far, far + 0.3], atol=0.005)
    np.testing.assert_allclose(lower, [-far, -far - 0.3], atol=0.005)
    assert reach_of(robot).margin(np.array([[0.0, 0.95], [0.6, 0.5], [0.6, 0.9]])) == pytest.approx(
        [far + 0.3 - 0.95, far - np.hypot(0.6, 0.2), far - np.hypot(0.6, 0.6)], abs=0.006
    )


@pytest.mark.parametrize("name", ["task01", "arm7_01", "rail"])
def test_joint_positions_are_found_that_put_the_tip_somewhere(name):
    robot = scene_of(name).robot
    for point in ((0.4, 0.2, 0.05), (0.3, -0.3, 0.02)):
        joints = inverse_kinematics(robot, robot.start, np.array(point))
        assert joints is not None
        rotation, tip = tip_frame(robot, joints)
        np.testing.assert_allclose(tip, point, atol=2e-5)
        np.testing.assert_allclose(rotation[:, 2], [0, 0, -1], atol=2e-5)
    assert inverse_kinematics(robot, robot.start, np.array([1.5, 0.0, 0.05])) is None


@pytest.mark.parametrize(
    ("name", "x", "words"), [("point01", 1.05, "within x from -0.22 to 0.97 m"), ("arm7_01", 0.78, "up to 0.76 m")]
)
def test_a_goal_out_of_reach_is_refused(name, x, words):
    scene = shipped(name)
    wide = replace(scene.table, upper=(2.0, 2.0))
    scene = replace(scene, table=wide).with_goal((x, 0.0, np.pi / 2))
    with pytest.raises(SceneError, match="out of reach") as error:
        check_task(scene)
    assert words in str(error.value)


def test_a_point_that_passes_over_the_object_is_refused():
    scene = shipped("point01")
    flat = replace(scene, object=block((0.1, 0.1, 0.01)))
    with pytest.raises(SceneError, match="passes over the object"):
        check_task(flat)


@pytest.mark.parametrize(("name", "scale"), [("task01", 1.0), ("arm7_01", 1.06), ("point01", 0.0)])
def test_the_ring_in_which_an_arm_pushes_grows_with_its_reach(name, scale, device):
    config = set_option(best("cloi"), "robot.optimizer.samples=16")
    planner: Planner = make_planner(shipped(name), config, method="mppi", device=device, engine="quasistatic")
    for given, found in ((config.cost, planner.config.cost), (config.object_cost, planner.config.object_cost)):
        expected = (scale * given.push_ring[0], scale * given.push_ring[1]) if scale else (0.0, 1e3)
        assert found.push_ring == pytest.approx(expected)


# The quasi-static engine


@pytest.mark.parametrize("name", [*NAMES, "rail"])
def test_a_robot_rollout_is_its_twins(name):
    pushing = Pushing.on(scene_of(name), w_control=0.1)
    robot = pushing.scene.robot
    joints = joints_at(robot, (0.40, -0.33, 0.012)).astype(np.float32).astype(float)
    goal = np.array([0.5, 0.3, 3.0])
    path = np.linspace(T_POSE, goal, len(pushing.dynamics.reference.host))
    controls = straight(robot, joints, (0.05, 0.20, 0.0), 20) + RANDOM.normal(scale=0.05, size=(12, 20, robot.dof))
    rolled = pushing.roll(joints, T_POSE, controls, goal=goal, reference=path)
    world = pushing.twin()
    agree = 0
    for k, sequence in enumerate(controls.astype(np.float32).astype(float)):
        twin = reference.robot_rollout(world, joints, T_POSE, goal, path, sequence)
        if np.abs(rolled.tips[k] - twin.tips).max() > 1e-3:  # a stall that hangs on the last bit
            continue
        agree += 1
        np.testing.assert_allclose(rolled.tips[k], twin.tips, atol=3 * LENGTH_TOLERANCE)
        np.testing.assert_allclose(rolled.poses[k], twin.poses, atol=10 * ANGLE_TOLERANCE)
        expected = np.array([twin.terms[term] for term in TERMS])
        np.testing.assert_allclose(rolled.terms[k], expected, rtol=0.01, atol=1e-3, err_msg=str(TERMS))
        assert np.abs(twin.poses[-1] - T_POSE).max() > 0.02, "the object was not pushed"
    assert agree >= 11


# Plant and Newton engine


def test_a_point_goes_as_fast_and_as_far_as_it_may():
    scene = shipped("point01")
    plant = SimulatedPlant(World(scene))
    begin = plant.observe().joint_position.copy()
    for _ in range(20):
        plant.apply(np.array([0.2, -1.0]))  # the second more than its 0.3 m/s
    np.testing.assert_allclose(plant.observe().joint_position - begin, [0.2, -0.3], atol=0.004)
    for _ in range(60):
        plant.apply(np.array([-1.0, -1.0]))
    np.testing.assert_allclose(plant.observe().joint_position, [-0.22, -0.77], atol=0.002)


@pytest.mark.parametrize("name", NAMES)
def test_the_newton_engine_ends_a_push_where_the_plant_does(name, device):
    scene = shipped(name)
    geometry = build_geometry(scene, device)
    pose = from_center(geometry.surface, np.array([0.42, -0.10, 0.0]))
    joints = joints_at(scene.robot, (0.42, -0.25, 0.012))
    controls = straight(scene.robot, joints, (0.0, 0.15, 0.0), 20)
    seen = observe(scene, joints=joints, pose=pose)
    engine = make(NewtonThreads, scene, 2, steps=20)
    costs = roll(engine, seen, np.stack([controls, 0.0 * controls]))
    plant = plant_at(scene, seen)
    for control in controls:
        plant.apply(control)
    found, still = ends(engine)
    assert np.isfinite(costs).all()
    assert np.linalg.norm(found[:2] - pose[:2]) > 0.02
    np.testing.assert_allclose(found, plant.observe().object_pose, atol=0.01)
    np.testing.assert_allclose(still, pose, atol=1e-3)


@pytest.mark.slow  # its kernels are MuJoCo Warp's, compiled for each robot's joints
@pytest.mark.parametrize("name", NAMES)
def test_the_batched_worlds_do_what_the_threads_do(name, device):
    scene = shipped(name)
    joints = joints_at(scene.robot, (0.42, -0.212, 0.012))
    pose = from_center(build_geometry(scene, device).surface, np.array([0.42, -0.10, 0.0]))
    controls = straight(scene.robot, joints, (0.0, 0.15, 0.0), 8)
    seen = observe(scene, joints=joints, pose=pose)
    found = []
    for kind in (NewtonThreads, NewtonWorlds):
        engine = make(kind, scene, 2, steps=8)
        roll(engine, seen, np.stack([controls, 0.0 * controls]))
        found.append(ends(engine))
    assert found[0][0, 1] - pose[1] > 0.04
    np.testing.assert_allclose(found[0], found[1], atol=5e-4)


# Repositioning


def test_a_point_goes_around_the_object_where_an_arm_goes_over_it(device: str):
    settings = Reposition(stall_seconds=0.1, headway=0.01, w_waypoint=50.0, longest_seconds=9.0)
    pose, tip = np.array([0.40, 0.0, 0.0]), np.array([0.40, 0.06, 0.012])
    goal = pose + np.array([0.0, 0.05, 0.0])
    highest = {}
    for name in ("task01", "point01"):
        scene = replace(shipped(name), object=block((0.16, 0.04, 0.05)))
        watching = Repositioner(scene, build_geometry(scene, device), settings, w_theta=0.0225, height=0.012, period=DT)
        at, stops = tip, []
        for _ in range(400):
            waypoint = watching.waypoint(at, pose, lambda it: distance(it, goal, 0.15))
            if waypoint[3] > 0.0:
                stops.append(waypoint[:3])
                at = waypoint[:3]
            elif stops:
                break
        way = shapely.LineString(np.array([tip, *stops])[:, :2])
        body = shapely.box(0.32, -0.02, 0.48, 0.02)
        highest[name] = max(stop[2] for stop in stops)
        assert stops[-1][1] < -0.02, "it came to the side from which it pushes on"
        if name == "point01":
            assert shapely.distance(way, body) > scene.robot.tool_radius
    assert highest["task01"] > 0.05
    assert highest["point01"] == 0.012


def test_a_point_takes_the_free_way_around(device: str):
    scene = replace(shipped("point01"), object=block((0.16, 0.04, 0.05)))
    wall = box(0.55, 0.0, (0.06, 0.3, 0.1))
    scene = replace(scene, obstacles=(Obstacle("/wall", (wall,)),))
    watching = Repositioner(scene, build_geometry(scene, device), Reposition(), w_theta=0.0225, height=0.012, period=DT)
    body = shapely.box(0.32, -0.02, 0.48, 0.02)
    for begin in (0.36, 0.44):  # the shorter way from the second is past the wall
        way = watching._around(np.array([begin, 0.05]), np.array([begin, -0.05]), body)
        assert way[:, 0].min() < 0.31
        assert way[:, 0].max() < 0.49


# Whole tasks


@pytest.mark.parametrize("name", NAMES)
def test_the_object_is_brought_to_its_goal(name, device):
    scene = shipped(name)
    log = Episode(scene, best("cloi"), method="cloi", device=device, seed=0, engine="quasistatic").run()
    metrics = summarize(log)
    assert metrics.success, (metrics.position_error_m, metrics.yaw_error_rad)
    assert metrics.success_tight
    assert np.linalg.norm(log["object_pose"][-1, :2] - scene.start[:2]) > 0.6


def test_a_point_is_followed_in_the_lab(device: str):
    config = set_option(lab("cloi"), "episode.max_sim_seconds=6")
    log = Episode(shipped("point01"), config, method="cloi", device=device, seed=0, plant="lab").run()
    assert np.linalg.norm(log["object_pose"][-1, :2] - log["object_pose"][0, :2]) > 0.1
    assert np.nanmedian(summarize(log).mean_estimate_error_m) < 0.03
