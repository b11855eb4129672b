"""The model that is built from a scene against Newton's own USD import of the same file: two readings of one file."""

from __future__ import annotations

import newton
import numpy as np
import pytest
import warp as wp
from newton.solvers import SolverMuJoCo
from pxr import Gf, Sdf, Usd, UsdPhysics
from support import small_tasks
from support.foreign_scenes import flat, measured_in, with_y_up, written
from support.scene_edits import corner_mesh, frames_turned, odd_obstacles, scaled_cube

from oimppi_warp.geometry.footprint import rotation_matrix, transform_points
from oimppi_warp.physics.newton_model import ROLES, build_model
from oimppi_warp.scene import Scene
from oimppi_warp.usd import load_scene, shipped_scenes
from oimppi_warp.usd.stage import SceneStage

FLOAT32 = 2e-6
"""Tolerance of places that went through single precision in another order: metres, or parts of a rotation matrix."""


def imported(scene: Scene) -> newton.Model:
    """The model that Newton makes of a scene's file."""
    builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
    builder.rigid_gap = 0.0
    SolverMuJoCo.register_custom_attributes(builder)
    builder.add_usd(SceneStage(scene.file).stage, load_visual_shapes=False, enable_self_collisions=False)
    return builder.finalize(device="cpu")


def posed(model: newton.Model, scene: Scene) -> dict[str, np.ndarray]:
    """Transform of each body [7] by its path, at joint positions where every joint is off its zero."""
    coords = model.joint_q.numpy().copy()
    starts = dict(zip(model.joint_label, model.joint_q_start.numpy().tolist(), strict=False))
    for number, joint in enumerate(scene.robot.joints):
        coords[starts[joint.path]] = 0.1 + 0.07 * number
    child = model.joint_child.numpy().tolist()
    object_start = model.joint_q_start.numpy()[child.index(model.body_label.index(scene.object.path))]
    coords[object_start : object_start + 7] = (0.3, -0.4, scene.object.rest_height, 0.0, 0.0, 0.0, 1.0)
    state, still = model.state(), wp.zeros(model.joint_dof_count, dtype=float, device="cpu")
    newton.eval_fk(model, wp.array(coords, dtype=float, device="cpu"), still, state)
    return dict(zip(model.body_label, state.body_q.numpy().astype(float), strict=True))


def weights(model: newton.Model, poses: dict[str, np.ndarray]) -> dict[str, tuple[float, np.ndarray, np.ndarray]]:
    """Mass, centre of mass in the world [3] and inertia in the world's axes [3, 3] of each body by its path."""
    numbers = zip(model.body_mass.numpy(), model.body_com.numpy(), model.body_inertia.numpy(), strict=True)
    found = {}
    for path, (mass, center, inertia) in zip(model.body_label, numbers, strict=True):
        turn = rotation_matrix(poses[path][3:])
        found[path] = (float(mass), transform_points(poses[path], center.astype(float))[0], turn @ inertia @ turn.T)
    return found


def shapes(model: newton.Model, poses: dict[str, np.ndarray]) -> dict[str, tuple[str, int, np.ndarray]]:
    """Body, kind, and points in the world that show size and place of each shape by its path, in a fixed order."""
    found = {}
    for i, path in enumerate(model.shape_label):
        body = int(model.shape_body.numpy()[i])
        owner = model.body_label[body] if body >= 0 else ""
        source = model.shape_source[i]
        if source is None:
            points = np.vstack([np.eye(3), np.ones((1, 3))]) * model.shape_scale.numpy()[i]
        else:
            points = np.asarray(source.vertices) * model.shape_scale.numpy()[i]
        points = transform_points(model.shape_transform.numpy()[i].astype(float), points)
        points = transform_points(poses[owner], points) if owner else points
        order = np.lexsort(points.round(4).T) if source is not None else np.arange(len(points))
        found[path] = (owner, int(model.shape_type.numpy()[i]), points[order])
    return found


def assert_agrees(scene: Scene, *, rtol: float = 1e-5) -> None:
    """Bodies, joints and shapes of both readings are the same."""
    built, read = build_model(scene).model, imported(scene)
    assert built.body_label == read.body_label
    np.testing.assert_allclose(built.gravity.numpy(), read.gravity.numpy(), atol=1e-6)
    poses, read_poses = posed(built, scene), posed(read, scene)

    known = weights(read, read_poses)
    for path, (mass, center, inertia) in weights(built, poses).items():
        assert mass == pytest.approx(known[path][0], rel=1e-6), path
        np.testing.assert_allclose(center, known[path][1], atol=FLOAT32, err_msg=path)
        np.testing.assert_allclose(inertia, known[path][2], atol=rtol * np.abs(inertia).max(), err_msg=path)

    numbers = {name: getattr(read, name).numpy() for name in JOINT_NUMBERS}
    for joint in scene.robot.joints:
        here, there = (
            int(model.joint_qd_start.numpy()[model.joint_label.index(joint.path)]) for model in (built, read)
        )
        for name, values in numbers.items():
            np.testing.assert_allclose(getattr(built, name).numpy()[here], values[there], rtol=1e-6, err_msg=joint.path)

    same = shapes(read, read_poses)
    for path, (owner, kind, points) in shapes(built, poses).items():
        assert (owner, kind) == same[path][:2], path
        np.testing.assert_allclose(points, same[path][2], atol=FLOAT32, err_msg=path)
    assert len(same) == built.shape_count
    for name in ("shape_margin", "shape_gap", "shape_collision_group"):
        assert set(getattr(built, name).numpy().tolist()) == set(getattr(read, name).numpy().tolist())


JOINT_NUMBERS = (
    "joint_axis",
    "joint_limit_lower",
    "joint_limit_upper",
    "joint_limit_ke",
    "joint_limit_kd",
    "joint_effort_limit",
    "joint_velocity_limit",
    "joint_friction",
    "joint_damping",
)
"""What both readings take from the file; drives and armatures are the package's own."""


@pytest.mark.parametrize("name", [shipped.name for shipped in shipped_scenes()])
def test_a_shipped_scene_is_the_model_that_newton_reads_from_its_file(name):
    assert_agrees(small_tasks.shipped(name))


@pytest.mark.parametrize("name", ["task01", "task02", "task05", "lab01", "lab02", "point01"])
def test_bodies_and_shapes_are_in_the_order_of_the_import_and_weigh_the_same_to_the_bit(name):
    scene = small_tasks.shipped(name)
    built, read = build_model(scene).model, imported(scene)
    assert built.shape_label == read.shape_label
    np.testing.assert_array_equal(built.joint_type.numpy(), read.joint_type.numpy())
    for array in ("body_mass", "body_com", "body_inertia", "joint_parent", "joint_child", "shape_type", "shape_scale"):
        np.testing.assert_array_equal(getattr(built, array).numpy(), getattr(read, array).numpy(), err_msg=array)


def in_other_units(stage: Usd.Stage) -> None:
    odd_obstacles(stage)
    measured_in(stage, 0.01, 0.001)
    with_y_up(stage)


def without_inertia(stage: Usd.Stage) -> None:
    """The shapes decide, of the object, of a link and of the tool."""
    for path in ("/World/Object", "/World/Robot/link3", "/World/Robot/tool"):
        for name in ("diagonalInertia", "principalAxes"):
            stage.GetPrimAtPath(path).RemoveProperty(f"physics:{name}")


def without_center(stage: Usd.Stage) -> None:
    without_inertia(stage)
    for path in ("/World/Object", "/World/Robot/link3", "/World/Robot/tool"):
        stage.GetPrimAtPath(path).RemoveProperty("physics:centerOfMass")


def rubbing(stage: Usd.Stage) -> None:
    """Friction in two joints, damping per degree, and another gravity."""
    for name, friction, damping in (("joint1", 1.5, 0.02), ("joint4", 0.3, 0.0)):
        joint = stage.GetPrimAtPath(f"/World/Robot/joints/{name}")
        joint.CreateAttribute("newton:friction", Sdf.ValueTypeNames.Float).Set(friction)
        joint.CreateAttribute("newton:damping", Sdf.ValueTypeNames.Float).Set(damping)
    next(
        UsdPhysics.Scene(prim) for prim in stage.Traverse() if prim.IsA(UsdPhysics.Scene)
    ).GetGravityMagnitudeAttr().Set(1.62)


def with_tensor(stage: Usd.Stage) -> None:
    """Inertia as Newton's own attribute, which counts before principal moments."""
    body = stage.GetPrimAtPath("/World/Object")
    body.AddAppliedSchema("NewtonMassAPI")
    body.CreateAttribute("newton:inertia", Sdf.ValueTypeNames.FloatArray).Set(
        [0.001, 0.0012, 0.002, 0.0001, 0.0, 0.0002]
    )


@pytest.mark.parametrize(
    "change",
    [in_other_units, odd_obstacles, frames_turned, scaled_cube, corner_mesh, without_inertia, without_center, rubbing],
)
def test_a_scene_from_elsewhere_is_the_model_that_newton_reads_from_its_file(tmp_path, change):
    stage = flat("task02")
    change(stage)
    assert_agrees(load_scene(written(stage, tmp_path / "task02.usda")), rtol=2e-5)


def test_an_inertia_tensor_of_newtons_counts_before_principal_moments(tmp_path):
    stage = flat("task02")
    with_tensor(stage)
    scene = load_scene(written(stage, tmp_path / "task02.usda"))
    wanted = np.array([[0.001, 0.0001, 0.0], [0.0001, 0.0012, 0.0002], [0.0, 0.0002, 0.002]])
    np.testing.assert_allclose(scene.object.mass * scene.object.unit_inertia, wanted, rtol=1e-6)
    assert_agrees(scene)


def test_legs_of_a_table_are_in_the_way_though_the_planner_does_not_know_of_them(tmp_path):
    stage = flat("task02")
    top = stage.GetPrimAtPath("/World/Table")
    scale = Gf.Vec3d(top.GetAttribute("xformOp:scale").Get())
    legs = stage.DefinePrim("/World/Table/Leg", "Cube")
    UsdPhysics.CollisionAPI.Apply(legs)
    legs.CreateAttribute("size", legs.GetAttribute("size").GetTypeName()).Set(1.0)
    legs.CreateAttribute("xformOp:translate", top.GetAttribute("xformOp:translate").GetTypeName()).Set(
        Gf.Vec3d(0.0, 0.0, -5.0)
    )
    legs.CreateAttribute("xformOpOrder", top.GetAttribute("xformOpOrder").GetTypeName()).Set(["xformOp:translate"])
    scene = load_scene(written(stage, tmp_path / "task02.usda"))
    assert [leg.size for leg in scene.table.others] == [pytest.approx(tuple(scale / 2.0))]
    assert scene.table.thickness == pytest.approx(0.04)
    assert_agrees(scene)
    assert list(build_model(scene).roles).count(ROLES.index("table")) == 2
