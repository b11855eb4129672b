"""The loader reads what USD means: nested frames, scales, axes, instances, welds, defaults."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import shapely
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade
from support.bad_scenes import put
from support.variants import variant

from oimppi_warp.geometry.footprint import core_points, footprint, height_range, outline
from oimppi_warp.scene import Collider
from oimppi_warp.usd import load_scene
from oimppi_warp.usd.stage import SCHEMA, schema_default

ROOT = Path(__file__).resolve().parents[2]


def obstacle(scene, name: str) -> Collider:
    """The only collider of an obstacle."""
    (collider,) = next(o.colliders for o in scene.obstacles if o.path.endswith(name))
    return collider


def make_obstacle(stage: Usd.Stage, gprim: UsdGeom.Gprim) -> Usd.Prim:
    UsdPhysics.CollisionAPI.Apply(gprim.GetPrim())
    gprim.GetPrim().AddAppliedSchema("OimppiObstacleAPI")
    return gprim.GetPrim()


def test_a_scene_is_found_by_name_and_by_path_from_any_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    by_name = load_scene("task02")
    by_path = load_scene(by_name.file)
    assert by_name.name == by_path.name == "task02"
    assert by_name.title == by_path.title == "Push the T around a cube and turn it round"


def test_a_file_in_the_working_folder_can_be_named_relative_to_it(tmp_path, monkeypatch):
    variant(tmp_path, lambda stage: None)
    monkeypatch.chdir(tmp_path)
    assert load_scene("variant.usda").file == (tmp_path / "variant.usda").resolve()


def test_a_box_in_nested_frames_stands_where_they_put_it(tmp_path):
    def change(stage: Usd.Stage) -> None:
        outer = UsdGeom.Xform.Define(stage, "/World/Obstacles/Outer")
        outer.AddTranslateOp().Set(Gf.Vec3d(0.6, -0.1, 0.0))
        outer.AddRotateZOp().Set(90.0)
        outer.AddScaleOp().Set(Gf.Vec3f(2.0))
        inner = UsdGeom.Xform.Define(stage, "/World/Obstacles/Outer/Inner")
        inner.AddTranslateOp().Set(Gf.Vec3d(0.05, 0.0, 0.05))
        cube = UsdGeom.Cube.Define(stage, "/World/Obstacles/Outer/Inner/Block")
        cube.CreateSizeAttr(0.1)
        cube.AddScaleOp().Set(Gf.Vec3f(1.0, 0.5, 1.0))
        make_obstacle(stage, cube)

    block = obstacle(load_scene(variant(tmp_path, change)), "Block")
    assert block.kind == "box"
    assert block.transform[:3] == pytest.approx((0.6, 0.0, 0.1), abs=1e-6)
    assert block.size == pytest.approx((0.1, 0.05, 0.1), abs=1e-6)
    assert tuple(shapely.bounds(outline(footprint([block])))) == pytest.approx((0.55, -0.1, 0.65, 0.1), abs=1e-6)


@pytest.mark.parametrize(("axis", "low", "high"), [("X", (-2, -1, -1), (2, 1, 1)), ("Y", (-1, -2, -1), (1, 2, 1))])
def test_a_capsule_lies_along_its_axis(tmp_path, axis, low, high):
    def change(stage: Usd.Stage) -> None:
        capsule = UsdGeom.Capsule.Define(stage, "/World/Obstacles/Pill")
        capsule.CreateRadiusAttr(1.0)
        capsule.CreateHeightAttr(2.0)
        capsule.CreateAxisAttr(axis)
        make_obstacle(stage, capsule)

    pill = obstacle(load_scene(variant(tmp_path, change)), "Pill")
    points, radius = core_points(pill)
    np.testing.assert_allclose(points.min(axis=0) - radius, low, atol=1e-9)
    np.testing.assert_allclose(points.max(axis=0) + radius, high, atol=1e-9)


def test_a_cylinder_and_a_sphere_keep_their_radii_under_scale(tmp_path):
    def change(stage: Usd.Stage) -> None:
        cylinder = UsdGeom.Cylinder.Define(stage, "/World/Obstacles/Post")
        cylinder.CreateRadiusAttr(1.0)
        cylinder.CreateHeightAttr(2.0)
        cylinder.AddScaleOp().Set(Gf.Vec3f(0.1, 0.1, 0.3))
        make_obstacle(stage, cylinder)
        sphere = UsdGeom.Sphere.Define(stage, "/World/Obstacles/Ball")
        sphere.CreateRadiusAttr(0.5)
        sphere.AddScaleOp().Set(Gf.Vec3f(0.2))
        make_obstacle(stage, sphere)

    scene = load_scene(variant(tmp_path, change))
    assert obstacle(scene, "Post").size == pytest.approx((0.1, 0.3), abs=1e-6)
    assert obstacle(scene, "Ball").size == pytest.approx((0.1,), abs=1e-6)


def test_a_shape_that_does_not_collide_is_no_obstacle(tmp_path):
    def change(stage: Usd.Stage) -> None:
        cube = stage.GetPrimAtPath("/World/Obstacles/Cube")
        second = UsdGeom.Cube.Define(stage, "/World/Obstacles/Cube/Ghost")
        UsdPhysics.CollisionAPI.Apply(second.GetPrim()).CreateCollisionEnabledAttr(False)
        assert cube

    assert [c.path for c in load_scene(variant(tmp_path, change)).obstacles[0].colliders] == ["/World/Obstacles/Cube"]


def test_instances_of_an_obstacle_are_all_there(tmp_path):
    def change(stage: Usd.Stage) -> None:
        for i, x in enumerate((0.2, 0.6)):
            copy = stage.DefinePrim(f"/World/Obstacles/Letter{i}")
            copy.GetReferences().AddReference(str(ROOT / "scenes/objects/letter_o.usda"))
            copy.SetInstanceable(True)
            UsdGeom.Xformable(copy).AddTranslateOp().Set(Gf.Vec3d(x, 0.4, 0.025))
            copy.AddAppliedSchema("OimppiObstacleAPI")

    scene = load_scene(variant(tmp_path, change))
    shapes = [outline(footprint(o.colliders)) for o in scene.obstacles if "Letter" in o.path]
    centers = [shapely.get_coordinates(shapely.centroid(shape))[0] for shape in shapes]
    assert [tuple(c) for c in centers] == [pytest.approx((0.2, 0.4), abs=1e-6), pytest.approx((0.6, 0.4), abs=1e-6)]


def test_a_turned_object_starts_turned(tmp_path):
    def change(stage: Usd.Stage) -> None:
        stage.GetPrimAtPath("/World/Object").GetAttribute("xformOp:rotateZ").Set(-170.0)

    assert load_scene(variant(tmp_path, change)).start == pytest.approx((0.3, -0.45, math.radians(-170.0)), abs=1e-9)


def test_a_centre_of_mass_that_is_not_given_is_that_of_the_shapes(tmp_path):
    def block(stage: Usd.Stage) -> None:
        stage.GetPrimAtPath("/World/Object").GetAttribute("physics:centerOfMass").Block()

    for base in ("task02", "task05"):
        given = load_scene(base).object.center_of_mass
        np.testing.assert_allclose(load_scene(variant(tmp_path, block, base)).object.center_of_mass, given, atol=1e-6)
        (tmp_path / "variant.usda").unlink()


def test_the_centre_of_mass_of_round_shapes_is_weighed_by_their_volumes(tmp_path):
    def change(stage: Usd.Stage) -> None:
        stage.GetPrimAtPath("/World/Object").GetAttribute("physics:centerOfMass").Block()
        stage.GetPrimAtPath("/World/Object/shape").SetActive(False)
        for name, x, kind in (("A", -0.1, UsdGeom.Cylinder), ("B", 0.1, UsdGeom.Cylinder)):
            shape = kind.Define(stage, f"/World/Object/{name}")
            shape.CreateRadiusAttr(0.02 if name == "A" else 0.04)
            shape.CreateHeightAttr(0.05)
            shape.AddTranslateOp().Set(Gf.Vec3d(x, 0.0, 0.0))
            UsdPhysics.CollisionAPI.Apply(shape.GetPrim())
            material = UsdShade.Material(stage.GetPrimAtPath("/World/Object/Material"))
            UsdShade.MaterialBindingAPI.Apply(shape.GetPrim()).Bind(material, materialPurpose="physics")

    assert load_scene(variant(tmp_path, change)).object.center_of_mass == pytest.approx((0.06, 0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize(("table", "tool", "expected"), [(0.1, 0.3, (0.4, 0.4)), (0.6, 0.5, (0.6, 0.5))])
def test_the_larger_friction_of_a_pair_counts(tmp_path, table, tool, expected):
    def change(stage: Usd.Stage) -> None:
        for path, value in (("/World/Materials/Table", table), ("/World/Robot/ToolMaterial", tool)):
            UsdPhysics.MaterialAPI(stage.GetPrimAtPath(path)).GetDynamicFrictionAttr().Set(value)

    pushed = load_scene(variant(tmp_path, change)).object
    assert (pushed.friction, pushed.tool_friction) == pytest.approx(expected)


def test_the_tool_may_be_without_friction_if_the_materials_say_so(tmp_path):
    def change(stage: Usd.Stage) -> None:
        for path in ("/World/Object/Material", "/World/Robot/ToolMaterial"):
            UsdPhysics.MaterialAPI(stage.GetPrimAtPath(path)).GetDynamicFrictionAttr().Set(0.0)

    pushed = load_scene(variant(tmp_path, change)).object
    assert (pushed.friction, pushed.tool_friction) == pytest.approx((0.1, 0.0))


def test_a_limit_surface_is_read_from_the_object(tmp_path):
    assert load_scene("task02").object.limit_surface_radius is None
    file = variant(tmp_path, put("/World/Object", "oimppi:limitSurfaceRadius", 0.07))
    assert load_scene(file).object.limit_surface_radius == 0.07


def test_friction_is_inherited_by_the_shapes_below_a_binding(tmp_path):
    def change(stage: Usd.Stage) -> None:
        body = stage.GetPrimAtPath("/World/Object")
        material = UsdShade.Material.Define(stage, "/World/Materials/Sticky")
        UsdPhysics.MaterialAPI.Apply(material.GetPrim()).CreateDynamicFrictionAttr(0.9)
        binding = UsdShade.MaterialBindingAPI.Apply(body)
        binding.Bind(material, UsdShade.Tokens.strongerThanDescendants, "physics")

    assert load_scene(variant(tmp_path, change)).object.friction == 0.9


def test_a_tool_welded_askew_is_read_askew(tmp_path):
    def change(stage: Usd.Stage) -> None:
        joint = UsdPhysics.Joint(stage.GetPrimAtPath("/World/Robot/joints/weld"))
        joint.CreateLocalPos0Attr(Gf.Vec3f(0.01, 0.0, 0.02))
        joint.CreateLocalRot0Attr(Gf.Quatf(math.cos(0.1), 0.0, math.sin(0.1), 0.0))  # 0.2 rad about y

    robot = load_scene(variant(tmp_path, change)).robot
    tip = (0.01 + 0.175 * math.sin(0.2), 0.0, 0.02 + 0.175 * math.cos(0.2))
    assert robot.tip[:3] == pytest.approx(tip, abs=1e-6)
    (stick,) = [collider for collider in robot.links[-1].colliders if collider.path.startswith("/World/Robot/tool/")]
    middle = (0.01 + 0.0875 * math.sin(0.2), 0.0, 0.02 + 0.0875 * math.cos(0.2))
    assert stick.transform[:3] == pytest.approx(middle, abs=1e-6)


def test_the_stick_ends_at_the_tip():
    robot = load_scene("task01").robot
    (stick,) = [collider for collider in robot.links[-1].colliders if "/tool/" in collider.path]
    assert height_range([stick]) == pytest.approx((0.0, robot.tip[2]), abs=1e-9)
    assert stick.size[0] == robot.tool_radius


def test_what_is_left_out_takes_the_default_of_the_schema(tmp_path):
    def change(stage: Usd.Stage) -> None:
        for name in ("title", "starts", "spread", "tolerance", "tightTolerance"):
            stage.GetPrimAtPath("/World").GetAttribute(f"oimppi:{name}").Block()

    scene = load_scene(variant(tmp_path, change))
    assert scene.title == ""
    assert scene.starts == pytest.approx(np.array([scene.start]))
    assert scene.spread == (0.0, 0.0)
    assert (scene.tolerance.position, scene.tolerance.yaw) == (0.2, 0.5)
    assert (scene.tight_tolerance.position, scene.tight_tolerance.yaw) == (0.05, 0.1)


def test_joints_without_drives_have_no_limits_of_effort_and_velocity(tmp_path):
    def change(stage: Usd.Stage) -> None:
        joint = stage.GetPrimAtPath("/World/Robot/joints/joint1")
        joint.RemoveAppliedSchema("PhysicsDriveAPI:angular")
        joint.GetAttribute("newton:velocityLimit").Block()

    joint = load_scene(variant(tmp_path, change)).robot.joints[0]
    assert (joint.effort_limit, joint.velocity_limit) == (math.inf, math.inf)


def test_usd_knows_our_schemas_once_the_loader_is_imported():
    program = (
        "from oimppi_warp.usd import load_scene\n"
        "from pxr import Usd\n"
        "stage = Usd.Stage.Open(str(load_scene('task02').file))\n"
        "assert stage.GetPrimAtPath('/World').HasAPI('OimppiTaskAPI')\n"
        "assert stage.GetPrimAtPath('/World/Object').HasAPI('OimppiObjectAPI')\n"
        "other = Usd.Stage.CreateInMemory()\n"
        "world = other.DefinePrim('/World')\n"
        "world.ApplyAPI('OimppiTaskAPI')\n"
        "assert tuple(world.GetAttribute('oimppi:tolerance').Get()) == (0.2, 0.5)\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True, cwd=ROOT)


def test_a_stage_opened_before_the_loader_does_not_matter():
    program = (
        "from pxr import Usd\n"
        "stage = Usd.Stage.CreateInMemory()\n"
        "stage.DefinePrim('/World', 'Xform').GetPrimDefinition()\n"
        "from oimppi_warp.usd import load_scene\n"
        "assert load_scene('task02').tolerance.position == 0.2\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True, cwd=ROOT)


def test_the_manual_has_every_attribute_of_the_schema():
    manual = (ROOT / "docs" / "schema.md").read_text()
    layer = Sdf.Layer.FindOrOpen(str(SCHEMA / "generatedSchema.usda"))
    for schema in layer.rootPrims:
        assert f"## {schema.name}" in manual
        for attribute in schema.attributes:
            assert f"| `{attribute.name}` |" in manual


def test_the_smallest_scene_of_the_manual_can_be_read(tmp_path):
    text = (ROOT / "docs" / "schema.md").read_text().split("```usda\n")[1].split("```")[0]
    (tmp_path / "mine.usda").write_text(text.replace("@scenes/", f"@{ROOT}/scenes/"))
    scene = load_scene(tmp_path / "mine.usda")
    assert scene.goal == pytest.approx((0.5, 0.3, 3.14159))
    assert scene.obstacles == ()


def test_an_attribute_that_no_schema_has_is_a_mistake_of_ours():
    with pytest.raises(KeyError):
        schema_default("oimppi:nothing")
