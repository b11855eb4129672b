"""Scenes that other programs wrote: converted into the same task and the same physics, or refused with a reason."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdUtils
from support.foreign_scenes import differences, flat, measured_in, reframed, with_y_up, written
from support.physics import assert_shapes_agree, link_transforms
from support.scene_edits import TURNS, Y_TO_Z, box_mesh, corner_mesh, frames_turned, odd_obstacles, scaled_cube

from oimppi_warp.authoring.checks.check import check_scene
from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.feasibility import object_outline
from oimppi_warp.geometry.fields import to_center
from oimppi_warp.geometry.footprint import footprint, limit_surface, outline
from oimppi_warp.geometry.kinematics import tip_frame, tip_jacobian
from oimppi_warp.geometry.reach import inverse_kinematics
from oimppi_warp.observation import planar_transform
from oimppi_warp.physics.newton_model import ROLES
from oimppi_warp.physics.world import World
from oimppi_warp.plants.plant import SimulatedPlant
from oimppi_warp.scene import Scene
from oimppi_warp.usd import load_scene, scene_content, shipped_scenes
from oimppi_warp.usd.editing import save_scene

SAME = 1e-3
"""Contact makes more of the rounding of single precision: how far two pushes may be apart after 1.5 s [m]."""

NAMES = ("task02", "task05", "lab02", "point01", "arm7_01")


def converted(folder: Path, name: str, *, metres: float = 1.0, kilograms: float = 1.0, y_up: bool = False) -> Scene:
    """A shipped scene after it was written in other units."""
    stage = flat(name)
    measured_in(stage, metres, kilograms)
    if y_up:
        with_y_up(stage)
    return load_scene(written(stage, folder / f"{name}.usda"))


def pushed(scene: Scene, seconds: float = 1.5) -> tuple[np.ndarray, np.ndarray]:
    """Joint positions and object transforms while the first joint pushes the object, shapes [step, dof], [step, 7]."""
    plant, robot = SimulatedPlant(World(scene)), scene.robot
    tip = np.array([*tip_frame(robot, robot.start)[1][:2], 0.012])
    joints = inverse_kinematics(robot, robot.start, tip)
    joints = robot.start if joints is None else joints  # a robot that cannot lower its tool has it low already
    velocity = -0.5 * np.eye(robot.dof)[0]
    away = (tip_jacobian(robot, joints)[:2] @ velocity) / np.linalg.norm(tip_jacobian(robot, joints)[:2] @ velocity)
    at = tip[:2] + 0.14 * away
    plant.place(joints, planar_transform((float(at[0]), float(at[1]), 0.3), scene.object.rest_height))
    seen = []
    for _ in range(int(seconds / plant.control_period)):
        plant.apply(velocity)
        seen.append(plant.observe())
    return np.array([each.joint_position for each in seen]), np.array([each.object_transform for each in seen])


def test_two_tasks_that_differ_are_told_apart():
    found = differences(load_scene("task02"), load_scene("task04"), tolerance=1e-6)
    assert any(".obstacles" in each for each in found)
    assert differences(load_scene("task02").robot, load_scene("arm7_01").robot, tolerance=1e-6)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    ("metres", "kilograms", "y_up"),
    [(0.01, 1.0, False), (0.001, 0.001, False), (1.0, 1.0, True), (0.0254, 0.4536, True)],
)
def test_a_scene_in_other_units_is_the_same_task(tmp_path, name, metres, kilograms, y_up):
    scene = converted(tmp_path, name, metres=metres, kilograms=kilograms, y_up=y_up)
    assert differences(load_scene(name), scene, tolerance=1e-6) == []


@pytest.mark.parametrize("name", ["task01", "task05", "point01"])
def test_a_scene_in_other_units_moves_the_same(tmp_path, name):
    joints, poses = pushed(load_scene(name))
    other_joints, other_poses = pushed(converted(tmp_path, name, metres=0.01, kilograms=0.001, y_up=True))
    assert np.linalg.norm(poses[-1, :2] - poses[0, :2]) > 0.01
    np.testing.assert_allclose(other_joints, joints, atol=1e-5)
    np.testing.assert_allclose(other_poses, poses, atol=SAME)


def test_a_file_in_other_units_is_left_as_it_is(tmp_path):
    scene = converted(tmp_path, "task02", metres=0.01, y_up=True)
    before = scene.file.read_text()
    saved = save_scene(scene.with_goal((0.4, 0.3, 0.0)), tmp_path / "saved.usda")
    assert scene.file.read_text() == before
    assert "metersPerUnit = 1\n" in saved.read_text()
    assert differences(scene.with_goal((0.4, 0.3, 0.0)), load_scene(saved), tolerance=1e-6) == []
    assert Usd.Stage.Open(str(scene.file)).GetMetadata("upAxis") == "Y"


@pytest.mark.parametrize("name", ["task02", "task05", "lab02"])
@pytest.mark.parametrize("drawn", TURNS)
def test_an_object_drawn_with_another_axis_up_is_given_a_frame_with_z_up(tmp_path, name, drawn):
    stage = flat(name)
    reframed(stage, "/World/Object", TURNS[drawn])
    scene, expected = load_scene(written(stage, tmp_path / f"{name}.usda")), load_scene(name)
    assert scene.object.rest_height == pytest.approx(expected.object.rest_height, abs=1e-6)
    here, there = (object_outline(each, each.start) for each in (scene, expected))
    assert shapely.area(shapely.symmetric_difference(here, there)) < 1e-6
    assert to_center(limit_surface(scene.object), np.array(scene.start))[:2] == pytest.approx(
        to_center(limit_surface(expected.object), np.array(expected.start))[:2], abs=1e-6
    )


def test_an_object_drawn_with_y_up_moves_as_the_same_object(tmp_path):
    stage = flat("task05")
    reframed(stage, "/World/Object", TURNS["y up"])
    scene = load_scene(written(stage, tmp_path / "task05.usda"))
    assert differences(load_scene("task05"), scene, tolerance=1e-6) == []
    np.testing.assert_allclose(pushed(scene)[1], pushed(load_scene("task05"))[1], atol=SAME)


def test_an_instance_drawn_with_y_up_is_stood_up_with_all_that_is_in_it(tmp_path):
    stage = flat("task05")
    reframed(stage, "/World/Object", TURNS["y up"])
    written(stage, tmp_path / "library.usda")
    body = stage.GetPrimAtPath("/World/Object")
    for part in body.GetChildren():
        stage.RemovePrim(part.GetPath())
    body.GetReferences().AddReference("./library.usda", "/World/Object")
    body.SetInstanceable(True)
    scene = load_scene(written(stage, tmp_path / "task05.usda"))
    assert differences(load_scene("task05"), scene, tolerance=1e-6) == []
    assert_shapes_agree(scene)


def test_moments_of_inertia_without_axes_are_about_those_that_the_object_was_drawn_with(tmp_path):
    stage = flat("task05")
    reframed(stage, "/World/Object", TURNS["y up"])
    body = stage.GetPrimAtPath("/World/Object")
    body.RemoveProperty("physics:principalAxes")
    UsdPhysics.MassAPI(body).GetDiagonalInertiaAttr().Set(Gf.Vec3f(0.001, 0.002, 0.0025))
    built = World(load_scene(written(stage, tmp_path / "task05.usda"))).newton
    inertia = built.model.body_inertia.numpy()[built.object_body]
    np.testing.assert_allclose(inertia, np.diag([0.001, 0.0025, 0.002]), atol=1e-8)


def test_a_robot_and_an_object_drawn_with_y_up_on_a_stage_with_y_up_are_the_same_task(tmp_path):
    stage = flat("task02")
    with_y_up(stage)
    reframed(stage, "/World/Object", TURNS["y up"])
    reframed(stage, "/World/Robot/base", Y_TO_Z, ("/World/Robot/joints/joint1",))
    mount = UsdPhysics.Joint(stage.GetPrimAtPath("/World/Robot/joints/mount"))
    mount.GetLocalRot0Attr().Set(Gf.Quatf(1.0))
    base = stage.GetPrimAtPath("/World/Robot/base")
    world = UsdGeom.Xformable(base).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
    np.testing.assert_allclose(np.array(world), np.eye(4), atol=1e-9)

    scene = load_scene(written(stage, tmp_path / "task02.usda"))
    assert differences(load_scene("task02"), scene, tolerance=1e-6) == []
    joints = np.array([0.3, -0.4, -0.2, 0.1, 0.5, -0.3])
    links = (link_transforms(World(each), joints) for each in (scene, load_scene("task02")))
    np.testing.assert_allclose(*(np.abs(each) for each in links), atol=1e-5)


def test_a_base_held_elsewhere_than_it_stands_is_a_mistake(tmp_path):
    stage = flat("task02")
    UsdPhysics.Joint(stage.GetPrimAtPath("/World/Robot/joints/mount")).CreateLocalPos0Attr(Gf.Vec3f(0.0, 0.0, 0.3))
    with pytest.raises(SceneError, match=r"fixes the base at \(0, 0, 0\.3\) m, rotated by \S+ deg"):
        load_scene(written(stage, tmp_path / "task02.usda"))


def test_a_table_turned_by_a_quarter_is_as_broad_as_it_looks(tmp_path):
    stage = flat("task02")
    table = stage.GetPrimAtPath("/World/Table")
    table.GetAttribute("xformOp:scale").Set(Gf.Vec3d(1.6, 1.25, 0.04))
    _, scale = UsdGeom.Xformable(table).GetOrderedXformOps()
    turn = UsdGeom.Xformable(table).AddRotateZOp()
    turn.Set(90.0)
    UsdGeom.Xformable(table).SetXformOpOrder([UsdGeom.Xformable(table).GetOrderedXformOps()[0], turn, scale])
    scene = load_scene(written(stage, tmp_path / "task02.usda"))
    assert scene.table.lower == pytest.approx((-0.25, -0.8))
    assert scene.table.upper == pytest.approx((1.0, 0.8))


@pytest.mark.parametrize(
    ("approximation", "kind", "radius"),
    [
        (None, "mesh", 0.05),
        ("none", "mesh", 0.05),
        ("convexHull", "mesh", 0.05),
        ("boundingCube", "box", 0.05),
        ("boundingSphere", "sphere", 0.05 * 3**0.5),
    ],
)
def test_a_mesh_collides_as_the_convex_shape_that_stands_for_it(tmp_path, approximation, kind, radius):
    stage = flat("task02")
    box_mesh(stage, "/World/Obstacles/Mesh", approximation)
    scene = load_scene(written(stage, tmp_path / "task02.usda"))
    ((collider,),) = [obstacle.colliders for obstacle in scene.obstacles]
    assert collider.kind == kind
    x0, y0, x1, y1 = outline(footprint([collider])).bounds
    assert (x0, y0, x1, y1) == pytest.approx((0.5 - radius, 0.05 - radius, 0.5 + radius, 0.05 + radius), abs=1e-3)
    model = World(scene).newton
    assert list(model.roles).count(ROLES.index("obstacle")) == 1
    assert 0 not in model.roles


def test_meshes_in_instances_are_simplified_too(tmp_path):
    library = Usd.Stage.CreateNew(str(tmp_path / "library.usda"))
    UsdGeom.SetStageMetersPerUnit(library, 1.0)
    UsdGeom.SetStageUpAxis(library, "Z")
    source = flat("task02")
    box_mesh(source, "/World/Obstacles/Mesh", "boundingCube")
    library.SetDefaultPrim(UsdGeom.Xform.Define(library, "/Block").GetPrim())
    Sdf.CopySpec(source.GetRootLayer(), "/World/Obstacles/Mesh", library.GetRootLayer(), "/Block/Mesh")
    library.GetPrimAtPath("/Block/Mesh").RemoveAppliedSchema("OimppiObstacleAPI")
    library.GetPrimAtPath("/Block/Mesh").RemoveProperty("material:binding:physics")
    library.Save()
    stage = flat("task01")
    for i, x in enumerate((0.0, 0.2)):
        block = UsdGeom.Xform.Define(stage, f"/World/Obstacles/Block{i}")
        block.GetPrim().GetReferences().AddReference(str(tmp_path / "library.usda"))
        block.GetPrim().SetInstanceable(True)
        block.GetPrim().AddAppliedSchema("OimppiObstacleAPI")
        block.AddTranslateOp().Set(Gf.Vec3d(x, 0.0, 0.0))
    scene = load_scene(written(stage, tmp_path / "task01.usda"))
    centers = [collider.transform[0] for obstacle in scene.obstacles for collider in obstacle.colliders]
    assert centers == pytest.approx([0.5, 0.7])
    assert list(World(scene).newton.roles).count(ROLES.index("obstacle")) == 2


def packed(folder: Path) -> Path:
    """task02 with all that it refers to as one USDZ file."""
    (shipped,) = [scene.path for scene in shipped_scenes() if scene.name == "task02"]
    assert UsdUtils.CreateNewUsdzPackage(str(shipped), str(folder / "task02.usdz"))
    return folder / "task02.usdz"


def test_a_packed_scene_is_the_same_task(tmp_path):
    file = packed(tmp_path)
    scene = load_scene(file)
    assert differences(load_scene("task02"), scene, tolerance=1e-9) == []
    assert scene_content(file) == scene_content(file)
    assert [problem for problem in check_scene(file) if problem.severity == "error"] == []
    assert World(scene).newton.model.body_count == World(load_scene("task02")).newton.model.body_count


def test_a_scene_with_variants_is_read_with_those_that_are_selected(tmp_path):
    stage = flat("task02")
    variants = stage.GetPrimAtPath("/World").GetVariantSets().AddVariantSet("goal")
    for name, x in (("near", 0.4), ("far", 0.5)):
        variants.AddVariant(name)
        variants.SetVariantSelection(name)
        with variants.GetVariantEditContext():
            goal = stage.OverridePrim("/World").GetAttribute("oimppi:spread")
            goal.Set(Gf.Vec2d(x, 0.1))
    stage.GetRootLayer().GetPrimAtPath("/World").properties["oimppi:spread"].ClearDefaultValue()
    for name, x in (("near", 0.4), ("far", 0.5)):
        variants.SetVariantSelection(name)
        assert load_scene(written(stage, tmp_path / f"{name}.usda")).spread[0] == x


def test_payloads_and_references_of_references_are_followed(tmp_path):
    (shipped,) = [scene.path for scene in shipped_scenes() if scene.name == "task02"]
    for name, source in (("inner", str(shipped)), ("middle", "./inner.usda"), ("outer", "./middle.usda")):
        stage = Usd.Stage.CreateNew(str(tmp_path / f"{name}.usda"))
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        UsdGeom.SetStageUpAxis(stage, "Z")
        world = stage.DefinePrim("/World")
        stage.SetDefaultPrim(world)
        if name == "middle":
            world.GetPayloads().AddPayload(source)
        else:
            world.GetReferences().AddReference(source)
        stage.Save()
    assert differences(load_scene("task02"), load_scene(tmp_path / "outer.usda"), tolerance=1e-9) == []


def test_an_obstacle_below_scaled_and_mirrored_frames_is_read_or_refused(tmp_path):
    def nested(scale: Gf.Vec3f) -> Path:
        stage = flat("task02")
        outer = UsdGeom.Xform.Define(stage, "/World/Obstacles/Outer")
        outer.AddScaleOp().Set(scale)
        cube = UsdGeom.Cube.Define(stage, "/World/Obstacles/Outer/Block")
        cube.CreateSizeAttr(0.1)
        cube.AddTranslateOp().Set(Gf.Vec3d(0.3, 0.0, 0.05))
        UsdPhysics.CollisionAPI.Apply(cube.GetPrim())
        outer.GetPrim().AddAppliedSchema("OimppiObstacleAPI")
        return written(stage, tmp_path / "nested.usda")

    (block,) = load_scene(nested(Gf.Vec3f(2.0, 2.0, 1.0))).obstacles[-1].colliders
    assert block.transform[:3] == pytest.approx((0.6, 0.0, 0.05))
    assert block.size == pytest.approx((0.1, 0.1, 0.05))
    with pytest.raises(SceneError, match="zero or negative"):
        load_scene(nested(Gf.Vec3f(1.0, 1.0, -1.0)))


def in_centimetres(stage: Usd.Stage) -> None:
    odd_obstacles(stage)
    measured_in(stage, 0.01, 0.001)
    with_y_up(stage)


@pytest.mark.parametrize("change", [odd_obstacles, frames_turned, in_centimetres])
def test_planner_and_physics_have_the_same_shapes(tmp_path, change):
    stage = flat("task02")
    change(stage)
    assert_shapes_agree(load_scene(written(stage, tmp_path / "task02.usda")))


def test_a_scaled_cube_may_be_the_object_itself(tmp_path):
    stage = flat("task01")
    scaled_cube(stage)
    scene = load_scene(written(stage, tmp_path / "task01.usda"))
    assert_shapes_agree(scene)
    built = World(scene).newton
    assert scene.object.center_of_mass == pytest.approx((0.02, 0.0, 0.0), abs=1e-7)
    assert built.model.body_com.numpy()[built.object_body] == pytest.approx((0.02, 0.0, 0.0), abs=1e-7)
    assert scene.start == pytest.approx((0.3, -0.45, np.pi / 6))
    again = load_scene(save_scene(scene.with_start((0.3, -0.4, 0.1)), tmp_path / "saved.usda"))
    assert differences(scene.with_start((0.3, -0.4, 0.1)).object, again.object, tolerance=1e-6) == []
    assert again.start == pytest.approx((0.3, -0.4, 0.1))


def test_a_mesh_with_a_hollow_weighs_what_its_faces_enclose_to_all_who_read_it(tmp_path):
    stage = flat("task01")
    corner_mesh(stage)
    scene = load_scene(written(stage, tmp_path / "task01.usda"))
    built = World(scene).newton
    middle = (0.05 * 0.003 + 0.015 * 0.0021) / 0.0051  # of both bars, their areas as weights; the hull's is 0.041
    assert scene.object.center_of_mass == pytest.approx((middle, middle, 0.0), abs=1e-7)
    assert built.model.body_com.numpy()[built.object_body] == pytest.approx((middle, middle, 0.0), abs=1e-7)
    (light,) = [problem.what for problem in check_scene(scene.file) if "litres" in problem.what]
    assert light == "a mass of 0.001 kg in a volume of 0.255 litres is 3.92 kg/m^3"
