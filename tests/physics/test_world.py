"""The world is the scene: kinematics, masses, limits, shapes and friction, in Newton's model and in MuJoCo's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.physics import assert_shapes_agree, link_transforms

from oimppi_warp.geometry.footprint import rotation_matrix
from oimppi_warp.geometry.kinematics import link_frames
from oimppi_warp.observation import planar_pose, planar_transform
from oimppi_warp.physics import mujoco_model as module
from oimppi_warp.physics.newton_model import DRIVE_GAIN, ROLES, build_model
from oimppi_warp.physics.world import World
from oimppi_warp.usd import load_scene

SCENES = (
    "task01",
    "task02",
    "task03",
    "task03_wide",
    "task04",
    "task05",
    "lab01",
    "lab02",
    "point01",
    "pusht",
    "arm7_01",
)

FLOAT32 = 1e-6
"""Tolerance of what went through single precision: metres, or parts of a unit quaternion."""


@pytest.fixture(scope="module")
def world() -> World:
    return World(load_scene("task02"))


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache of one's own."""
    monkeypatch.setenv("OIMPPI_CACHE", str(tmp_path))
    return tmp_path


def test_what_is_kept_does_not_depend_on_the_start(cache):
    scene = load_scene("task02")
    elsewhere = replace(scene.with_start((0.31, -0.4, 0.3)), robot=replace(scene.robot, start=np.full(6, -0.1)))
    models = [World(each).mujoco.model for each in (scene, elsewhere)]
    assert len(list(cache.glob("mujoco-*.npz"))) == 1
    np.testing.assert_array_equal(*(model.qpos0 for model in models))
    np.testing.assert_array_equal(models[0].qpos0[-7:-4], np.float32([0.0, 0.0, scene.object.rest_height]))


@pytest.mark.parametrize(
    ("joints", "position", "quaternion"),
    [
        ((0, 0, 0, 0, 0, 0), (0.207, 0, 0.112), (1, 0, 0, 0)),
        ((0, -0.5, -0.5, 0, 1, 0), (0.316631342, 0, 0.325481967), (1, 0, 0, 0)),
        (
            (0.3, -0.7, -0.9, 0.4, 1.2, -0.6),
            (0.28448602, 0.113628607, 0.551744586),
            (-0.879594496, -0.387392031, -0.221779591, 0.16448328),
        ),
    ],
)
def test_flange_is_where_the_vendor_has_it(world, joints, position, quaternion):
    flange = link_transforms(world, np.array(joints, dtype=float))[-1]
    np.testing.assert_allclose(flange[:3], position, atol=FLOAT32)
    assert abs(np.dot(flange[3:], quaternion)) == pytest.approx(1.0, abs=FLOAT32)


def test_newton_and_the_planner_agree_on_every_link(world):
    for joints in np.random.default_rng(0).uniform(-1.5, 1.5, (5, 6)):
        rotations, positions = link_frames(world.scene.robot, joints)
        transforms = link_transforms(world, joints)
        np.testing.assert_allclose(transforms[:, :3], positions, atol=FLOAT32)
        for transform, rotation in zip(transforms, rotations, strict=True):
            np.testing.assert_allclose(rotation_matrix(transform[3:]), rotation, atol=2 * FLOAT32)


@pytest.mark.parametrize("name", SCENES)
def test_masses_and_limits_are_those_of_the_scene(name):
    scene = load_scene(name)
    built = World(scene).newton
    mass, bodies = built.model.body_mass.numpy(), dict(zip(built.model.body_label, range(100), strict=False))
    assert mass[built.object_body] == pytest.approx(scene.object.mass)
    np.testing.assert_allclose(built.model.body_com.numpy()[built.object_body], scene.object.center_of_mass, atol=1e-7)
    assert mass[bodies[scene.robot.base.path]] == pytest.approx(scene.robot.base.mass)
    links = mass[built.link_bodies]
    links[-1] += mass[bodies[scene.robot.tool_path.rpartition("/")[0]]]
    np.testing.assert_allclose(links, [link.mass for link in scene.robot.links], rtol=1e-6)
    for values, wanted in (
        (built.model.joint_limit_lower, "lower"),
        (built.model.joint_limit_upper, "upper"),
        (built.model.joint_velocity_limit, "velocity_limit"),
        (built.model.joint_effort_limit, "effort_limit"),
    ):
        expected = [getattr(joint, wanted) for joint in scene.robot.joints]
        np.testing.assert_allclose(values.numpy()[built.joint_dofs], expected, rtol=1e-6)


@pytest.mark.parametrize("name", SCENES)
def test_shapes_stand_where_the_scene_has_them(name):
    assert_shapes_agree(load_scene(name))


def test_the_bodies_of_newtons_model_stand_where_they_start(world):
    built = world.newton
    poses = built.model.body_q.numpy()
    start = planar_transform(world.scene.start, world.scene.object.rest_height)
    assert poses[built.object_body][:3] == pytest.approx(start[:3], abs=FLOAT32)
    _, positions = link_frames(world.scene.robot, np.array(world.scene.robot.start))
    np.testing.assert_allclose(poses[built.link_bodies][:, :3], positions, atol=FLOAT32)


def test_one_world_and_batched_worlds_have_the_same_bodies(world):
    one, two = (build_model(world.scene, worlds=worlds).model for worlds in (None, 2))
    for name in ("body_mass", "body_com", "body_inertia", "body_inv_inertia"):
        single, batched = getattr(one, name).numpy(), getattr(two, name).numpy()
        np.testing.assert_array_equal(batched.reshape(2, *single.shape), np.stack([single, single]))


def test_every_pair_of_shapes_has_the_friction_of_the_scene(world):
    mapped, pushed = world.mujoco, world.scene.object
    friction = {role: mapped.model.geom_friction[mapped.roles == i, 0] for i, role in enumerate(ROLES)}
    for other in ("table", "obstacle", "base", "arm"):
        np.testing.assert_allclose(np.maximum(friction["object"][0], friction[other]), pushed.friction, rtol=1e-6)
    np.testing.assert_allclose(np.maximum(friction["object"][0], friction["tool"]), pushed.tool_friction, rtol=1e-6)


def test_joints_are_driven_by_velocity_and_the_arm_carries_its_weight(world):
    mapped = world.mujoco
    model = mapped.model
    np.testing.assert_allclose(model.actuator_gainprm[mapped.joint_drive, 0], DRIVE_GAIN, rtol=1e-6)
    np.testing.assert_allclose(model.actuator_biasprm[mapped.joint_drive, :3], [(0, 0, -DRIVE_GAIN)] * 6, rtol=1e-6)
    assert np.all(model.body_gravcomp[mapped.link_bodies] == 1.0)
    assert model.body_gravcomp[mapped.object_body] == 0.0


def test_robot_meets_objects_obstacles_and_table_but_not_itself(world):
    model, roles = world.mujoco.model, world.mujoco.roles
    bodies = model.geom_bodyid
    excluded = {tuple(sorted(((pair >> 16), pair & 0xFFFF))) for pair in model.exclude_signature.tolist()}

    def collide(a: int, b: int) -> bool:
        masks = (model.geom_contype[a] & model.geom_conaffinity[b]) | (
            model.geom_contype[b] & model.geom_conaffinity[a]
        )
        return bool(masks) and tuple(sorted((int(bodies[a]), int(bodies[b])))) not in excluded

    robot = np.flatnonzero(np.isin(roles, [ROLES.index(role) for role in ("arm", "tool")]))
    outside = np.flatnonzero(np.isin(roles, [ROLES.index(role) for role in ("object", "obstacle", "table")]))
    assert all(collide(a, b) for a in robot for b in outside)
    assert not any(collide(a, b) for a in robot for b in robot if bodies[a] != bodies[b])


def test_second_world_comes_from_the_cache(cache, monkeypatch):
    scene = load_scene("task01")
    made = World(scene).mujoco
    monkeypatch.setattr(module, "_translate", lambda built, sensing: pytest.fail("translated again"))
    read = World(scene).mujoco
    np.testing.assert_array_equal(read.roles, made.roles)
    np.testing.assert_array_equal(read.joint_qpos, made.joint_qpos)
    np.testing.assert_array_equal(read.model.body_mass, made.model.body_mass)
    np.testing.assert_array_equal(read.model.geom_pos, made.model.geom_pos)


def test_damaged_cache_is_made_again(cache):
    scene = load_scene("task01")
    made = World(scene).mujoco
    (file,) = cache.glob("mujoco-*.npz")
    file.write_bytes(file.read_bytes()[:5000])
    assert World(scene).mujoco.model.ngeom == made.model.ngeom


@pytest.mark.parametrize("pose", [(0.3, -0.45, 0.0), (0.1, 0.2, 3.1), (-0.4, 0.0, -2.0)])
def test_planar_pose_comes_back_from_its_transform(pose):
    np.testing.assert_allclose(planar_pose(planar_transform(pose, 0.025)), pose, atol=1e-12)
