"""Objects in USD files of other people's: what a scene has of them is what was read, whatever the files look like."""

from __future__ import annotations

import math
import re
import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdUtils
from support.meshes import bracket, saved

from oimppi_warp.authoring import StaticObject, Task, box, import_mesh, read_object, write_object, write_task
from oimppi_warp.authoring import project as project_module
from oimppi_warp.authoring.object_spec import parse_object
from oimppi_warp.authoring.objects import preview
from oimppi_warp.authoring.objects.stored import read_body
from oimppi_warp.cli.main import main
from oimppi_warp.errors import SceneError
from oimppi_warp.scene import Scene
from oimppi_warp.usd import load_scene
from oimppi_warp.usd.lint import lint_stage
from oimppi_warp.usd.stage import SceneStage

START, GOAL = (0.3, -0.4, 0.0), (0.5, 0.2, 0.0)
HEAD = (
    '#usda 1.0\n(\n    defaultPrim = "Thing"\n    metersPerUnit = {}\n    kilogramsPerUnit = {}\n    upAxis = "{}"\n)\n'
)
THING = """
def Xform "Thing" (
    prepend apiSchemas = ["PhysicsMassAPI"]
    {above}
)
{{
    float physics:mass = {mass}
    {moved}
    def Cube "shape" (
        prepend apiSchemas = ["PhysicsCollisionAPI", "MaterialBindingAPI"]
    )
    {{
        rel material:binding:physics = </Thing/Material>
        double size = {size}
    }}
    def Material "Material" (
        prepend apiSchemas = ["PhysicsMaterialAPI"]
    )
    {{
        float physics:dynamicFriction = 0.3
    }}
}}
"""


def object_file(file: Path, *, metres=1.0, kilograms=1.0, up="Z", size=0.1, mass=0.2, above="", moved="") -> Path:
    """A cube as somebody else's file has it; lengths and masses in the file's units."""
    file.parent.mkdir(parents=True, exist_ok=True)
    text = HEAD.format(metres, kilograms, up) + THING.format(size=size, mass=mass, above=above, moved=moved)
    file.write_text(text)
    return file


def pushed(file: Path, folder: Path, name: str = "push", **more) -> Scene:
    return write_task(Task(name, "Push", read_object(file), START, GOAL, **more), folder).scene


def as_binary(file: Path) -> Path:
    binary = file.with_suffix(".usdc")
    Sdf.Layer.FindOrOpen(str(file)).Export(str(binary))
    return binary


def as_package(file: Path) -> Path:
    package = file.with_suffix(".usdz")
    UsdUtils.CreateNewUsdzPackage(str(file), str(package))
    return package


@pytest.mark.parametrize("units", [{"metres": 0.01, "size": 10.0}, {"kilograms": 0.001, "mass": 200.0}])
def test_an_object_in_other_units_is_written_in_metres_and_kilograms(tmp_path, units):
    scene = pushed(object_file(tmp_path / "a" / "thing.usda", **units), tmp_path)
    assert scene.object.mass == pytest.approx(0.2)
    assert scene.object.rest_height == pytest.approx(0.05)
    assert list(lint_stage(SceneStage(scene.file))) == []


def brick(file: Path, *, above: str = "", shape: str = "", material: str = "") -> Path:
    """A cube of 0.1 m without a mass; what is said of densities is put where it belongs."""
    text = object_file(file).read_text().replace("float physics:mass = 0.2", above)
    text = text.replace("double size = 0.1", f"double size = 0.1\n        {shape}")
    text = text.replace('["PhysicsCollisionAPI", ', '["PhysicsCollisionAPI", "PhysicsMassAPI", ')
    text = text.replace(
        "float physics:dynamicFriction = 0.3", f"float physics:dynamicFriction = 0.3\n        {material}"
    )
    file.write_text(text)
    return file


@pytest.mark.parametrize(
    ("densities", "mass"),
    [
        ({"above": 700}, 0.7),
        ({"material": 500}, 0.5),
        ({"above": 700, "material": 500}, 0.7),
        ({"above": 700, "shape": 900, "material": 500}, 0.9),
    ],
)
def test_a_mass_that_is_not_given_is_that_of_the_density(tmp_path, densities, mass):
    given = {place: f"float physics:density = {density}" for place, density in densities.items()}
    scene = pushed(brick(tmp_path / "a" / "brick.usda", **given), tmp_path)
    assert scene.object.mass == pytest.approx(mass)


@pytest.mark.parametrize(
    ("gprim", "volume"),
    [
        ('Sphere "shape"', 4 / 3 * math.pi * 0.05**3),
        ('Cylinder "shape"', math.pi * 0.05**2 * 0.2),
        ('Capsule "shape"', math.pi * 0.05**2 * 0.2 + 4 / 3 * math.pi * 0.05**3),
    ],
)
def test_a_density_weighs_round_shapes_by_their_true_volume(tmp_path, gprim, volume):
    file = brick(tmp_path / "a" / "round.usda", above="float physics:density = 800")
    sizes = "double radius = 0.05" + ("" if "Sphere" in gprim else "\n        double height = 0.2")
    file.write_text(file.read_text().replace('Cube "shape"', gprim).replace("double size = 0.1", sizes))
    assert pushed(file, tmp_path).object.mass == pytest.approx(800 * volume)


def test_a_mesh_with_a_density_weighs_what_its_faces_enclose(tmp_path):
    made = import_mesh(saved(bracket(), tmp_path, "bracket.stl"), mass=1.0)
    file = write_object(made, tmp_path / "a")
    file.write_text(re.sub(r"float physics:mass = 1\b", "float physics:density = 500", file.read_text()))
    volume = sum(float(trimesh.Trimesh(*hull).volume) for hull in made.hulls)
    assert pushed(file, tmp_path / "out").object.mass == pytest.approx(500 * volume, rel=1e-4)


def mesh_file(file: Path, faces: list[list[int]], *, at: float = 0.0, given: str = "physics:density = 500") -> Path:
    """A box of 0.1 x 0.06 x 0.05 m as a mesh with these faces, its centre at x = ``at``; it collides as its hull."""
    corners = [(at + x, y, z) for x in (-0.05, 0.05) for y in (-0.03, 0.03) for z in (-0.025, 0.025)]
    mesh = f"""
    def Mesh "shape" (
        prepend apiSchemas = ["PhysicsCollisionAPI", "PhysicsMeshCollisionAPI"]
    )
    {{
        point3f[] points = {corners}
        int[] faceVertexCounts = {[4] * len(faces)}
        int[] faceVertexIndices = {[corner for face in faces for corner in face]}
        uniform token physics:approximation = "convexHull"
    }}"""
    above = f'def Xform "Thing" (\n    prepend apiSchemas = ["PhysicsMassAPI"]\n)\n{{\n    float {given}'
    file.write_text(f"{HEAD.format(1.0, 1.0, 'Z')}{above}{mesh}\n}}\n")
    return file


SIDES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]


@pytest.mark.parametrize("turned", range(6))
@pytest.mark.parametrize("given", ["physics:density = 500", "physics:mass = 0.15"])
def test_a_face_that_is_wound_the_wrong_way_changes_no_mass(tmp_path, turned, given):
    faces = [side[::-1] if number == turned else side for number, side in enumerate(SIDES)]
    body = read_body(mesh_file(tmp_path / "box.usda", faces, given=given))
    assert body.mass == pytest.approx(0.15)
    assert body.center_of_mass == pytest.approx(np.zeros(3), abs=1e-8)


@pytest.mark.parametrize("missing", range(6))
@pytest.mark.parametrize("at", [0.0, 0.3])
def test_an_open_mesh_weighs_what_its_hull_does_wherever_it_is(tmp_path, missing, at):
    faces = [side for number, side in enumerate(SIDES) if number != missing]
    body = read_body(mesh_file(tmp_path / "box.usda", faces, at=at))
    assert body.mass == pytest.approx(0.15)
    assert body.center_of_mass == pytest.approx((at, 0.0, 0.0), abs=1e-7)


def test_a_mass_that_no_file_gives_is_asked_for_and_taken(tmp_path, capsys):
    file = brick(tmp_path / "a" / "brick.usda")
    command = ["scene", "new", "mine", "--out", str(tmp_path), "--object", str(file)]
    assert main(command) == 2
    message = capsys.readouterr().err
    assert "the body has no mass" in message
    assert "--mass" in message
    assert main([*command, "--mass", "0.15"]) == 0
    assert load_scene(tmp_path / "mine.usda").object.mass == pytest.approx(0.15)
    dense = brick(tmp_path / "b" / "dense.usda", above="float physics:density = 700")
    assert main([*command[:-1], str(dense), "--mass", "0.2", "--force"]) == 0
    assert load_scene(tmp_path / "mine.usda").object.mass == pytest.approx(0.2), "a mass counts before a density"
    heavy = object_file(tmp_path / "c" / "c.usda")
    assert main([*command[:-1], str(heavy), "--mass", "0.15", "--friction", "0.02", "--force"]) == 0
    body = load_scene(tmp_path / "mine.usda").object
    assert (body.mass, body.friction) == (pytest.approx(0.15), pytest.approx(0.02)), "what was asked for counts first"


def test_a_mass_that_is_asked_for_scales_the_inertia_of_the_file(tmp_path):
    file = object_file(tmp_path / "thing.usda", mass=0.2)
    given = "float physics:mass = 0.2\n    float3 physics:diagonalInertia = (0.001, 0.002, 0.003)"
    file.write_text(file.read_text().replace("float physics:mass = 0.2", given))
    task = Task("push", "Push", read_object(file, mass=0.1), START, GOAL)
    body = write_task(task, tmp_path / "out").scene.object
    assert body.mass == pytest.approx(0.1)
    assert body.unit_inertia == pytest.approx(np.diag((0.005, 0.01, 0.015)))
    assert read_body(file).mass == pytest.approx(0.2)


def two_cubes(file: Path, first: str, second: str) -> Path:
    """Two cubes of 0.1 m side by side, with what is said of their masses."""
    file.parent.mkdir(parents=True, exist_ok=True)
    cube = """
    def Cube "{name}" (
        prepend apiSchemas = ["PhysicsCollisionAPI", "PhysicsMassAPI"]
    )
    {{
        double size = 0.1
        {said}
        double3 xformOp:translate = ({x}, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }}"""
    shapes = cube.format(name="left", said=first, x=-0.05) + cube.format(name="right", said=second, x=0.05)
    file.write_text(HEAD.format(1.0, 1.0, "Z") + f'def Xform "Thing"\n{{{shapes}\n}}\n')
    return file


@pytest.mark.parametrize("heavy", ["float physics:density = 900", "float physics:mass = 0.9"])
def test_shapes_of_different_densities_shift_the_centre_of_mass_and_add_up_to_the_inertia(tmp_path, heavy):
    body = read_body(two_cubes(tmp_path / "pair.usda", heavy, "float physics:density = 300"))
    assert body.mass == pytest.approx(1.2)
    # masses of 0.9 and 0.3 kg at -0.05 and 0.05 m: x = (0.3 - 0.9) 0.05 / 1.2
    assert body.center_of_mass == pytest.approx((-0.025, 0.0, 0.0), abs=1e-7)
    # a cube has m a^2 / 6 about each axis, and the two are 0.025 and 0.075 m from the common centre
    own, away = 1.2 * 0.1**2 / 6.0, 0.9 * 0.025**2 + 0.3 * 0.075**2
    assert body.unit_inertia is not None
    assert 1.2 * body.unit_inertia == pytest.approx(np.diag((own, own + away, own + away)), abs=1e-8)


@pytest.mark.parametrize(
    ("said", "reason"),
    [
        ("", "the body has no mass, and </Thing/right> has no density"),
        ("float physics:density = -3", "physics:density is -3"),
        ("float physics:mass = nan", "physics:mass is nan"),
    ],
)
def test_a_shape_whose_mass_cannot_be_told_is_named(tmp_path, said, reason):
    with pytest.raises(SceneError, match=re.escape(reason)):
        read_object(two_cubes(tmp_path / "pair.usda", "float physics:density = 900", said))


def test_a_scene_may_give_the_objects_density_too(tmp_path):
    written = write_task(Task("push", "Push", box(0.1, 0.06, 0.05), START, GOAL), tmp_path)
    stage = Usd.Stage.Open(str(written.file))
    api = UsdPhysics.MassAPI(stage.GetPrimAtPath("/World/Object"))
    api.CreateMassAttr(0.0)
    api.CreateDensityAttr(500.0)
    stage.Save()
    assert load_scene(written.file).object.mass == pytest.approx(500 * 0.1 * 0.06 * 0.05)


def test_an_object_in_the_folder_that_gives_a_density_only_is_written_with_its_mass(tmp_path):
    file = brick(tmp_path / "objects" / "brick.usda", above="float physics:density = 700")
    before = file.read_bytes()
    assert main(["scene", "new", "mine", "--out", str(tmp_path), "--object", "brick"]) == 0
    assert load_scene(tmp_path / "mine.usda").object.mass == pytest.approx(0.7)
    assert file.read_bytes() == before


def test_the_table_has_no_more_friction_than_the_object_of_a_file(tmp_path):
    file = object_file(tmp_path / "a" / "thing.usda")
    file.write_text(file.read_text().replace("dynamicFriction = 0.3", "dynamicFriction = 0.04"))
    assert pushed(file, tmp_path).object.friction == pytest.approx(0.04)
    bare = object_file(tmp_path / "b" / "bare.usda")
    bare.write_text(bare.read_text().replace("rel material:binding:physics = </Thing/Material>", ""))
    assert pushed(bare, tmp_path, "other").object.friction == pytest.approx(0.1), "it has none of its own"


def test_an_object_drawn_with_y_up_stands_as_it_was_drawn(tmp_path):
    moved = 'double3 xformOp:translate = (1, 2, 3)\n    uniform token[] xformOpOrder = ["xformOp:translate"]'
    file = object_file(tmp_path / "thing.usda", up="Y", moved=moved)
    stage = Usd.Stage.Open(str(file))
    UsdGeom.Xformable(stage.GetPrimAtPath("/Thing/shape")).AddScaleOp().Set(Gf.Vec3f(1.0, 3.0, 1.0))
    stage.Save()
    body = pushed(file, tmp_path / "out").object
    assert body.rest_height == pytest.approx(0.15)
    assert [read_body(file).rest_height] == pytest.approx([body.rest_height])


@pytest.mark.parametrize(("kind", "turned"), [("Cylinder", 90.0), ("Xform", 30.0)])
def test_an_object_that_would_be_laid_down_otherwise_is_refused(tmp_path, kind, turned):
    moved = f'float xformOp:rotateX = {turned}\n    uniform token[] xformOpOrder = ["xformOp:rotateX"]'
    file = object_file(tmp_path / "thing.usda", moved=moved)
    file.write_text(file.read_text().replace('Xform "Thing"', f'{kind} "Thing"'))
    with pytest.raises(SceneError, match="does not lie flat"):
        read_object(file)


def test_a_material_that_a_reference_would_leave_behind_is_refused(tmp_path):
    file = object_file(tmp_path / "thing.usda")
    text = file.read_text().replace("</Thing/Material>", "</Material>")
    file.write_text(text + 'def Material "Material" (\n    prepend apiSchemas = ["PhysicsMaterialAPI"]\n)\n{\n}\n')
    with pytest.raises(SceneError, match="not below the default prim"):
        read_object(file)


@pytest.mark.parametrize("packed", [as_binary, as_package])
def test_a_binary_file_and_a_package_are_objects_as_well(tmp_path, packed):
    file = packed(object_file(tmp_path / "a" / "thing.usda"))
    assert pushed(file, tmp_path / "out").object.mass == pytest.approx(0.2)
    assert (tmp_path / "out" / "objects" / "thing.usda").read_text().startswith("#usda")
    (tmp_path / "mine" / "objects").mkdir(parents=True)
    shutil.copy(file, tmp_path / "mine" / "objects")
    assert parse_object("thing", folder=tmp_path / "mine").doc == "the object thing"


@pytest.mark.parametrize("packed", [as_binary, as_package])
def test_a_robot_may_be_in_a_binary_file_or_a_package(tmp_path, packed):
    assert main(["scene", "new", "first", "--robot", "point", "--out", str(tmp_path)]) == 0
    file = packed(tmp_path / "robots" / "point.usda")
    out = tmp_path / "out"
    assert main(["scene", "new", "second", "--robot", str(file), "--out", str(out)]) == 0
    assert main(["scene", "new", "third", "--robot", "point", "--out", str(out)]) == 0
    robots = {load_scene(place).robot.tool_radius for place in (tmp_path / "first.usda", *out.glob("*.usda"))}
    assert len(robots) == 1
    assert (out / "robots" / file.name).is_file()


def test_files_of_one_name_that_two_objects_need_are_not_mixed_up(tmp_path):
    for folder, size in (("a", 0.1), ("b", 0.24)):
        object_file(tmp_path / folder / "shape.usda", size=size)
        head = HEAD.format(1, 1, "Z")
        above = 'def "Thing" (\n    prepend references = @./shape.usda@\n)\n{\n}\n'
        (tmp_path / folder / f"{folder}.usda").write_text(head + above)
    small, large = (read_object(tmp_path / folder / f"{folder}.usda") for folder in "ab")
    task = Task("push", "Push", small, START, GOAL, obstacles=(StaticObject("Other", large, (0.5, -0.1, 0.0)),))
    scene = write_task(task, tmp_path / "out").scene
    assert scene.object.colliders[0].size == pytest.approx((0.05, 0.05, 0.05))
    assert scene.obstacles[0].colliders[0].size == pytest.approx((0.12, 0.12, 0.12))


def test_textures_come_along_and_are_not_mixed_up(tmp_path):
    for folder in "ab":
        place = tmp_path / folder / "thing"
        place.mkdir(parents=True)
        (place / "wood.png").write_bytes(folder.encode())
        object_file(tmp_path / folder / f"{folder}.usda", moved="asset inputs:file = @./thing/wood.png@")
    first, second = (read_object(as_package(tmp_path / folder / f"{folder}.usda")) for folder in "ab")
    task = Task("push", "Push", first, START, GOAL, obstacles=(StaticObject("Other", second, (0.5, -0.1, 0.0)),))
    written = write_task(task, tmp_path / "out")
    stage = Usd.Stage.Open(str(written.file))
    paths = [f"/World/{place}" for place in ("Object", "Obstacles/Other")]
    assets = [stage.GetPrimAtPath(path).GetAttribute("inputs:file").Get() for path in paths]
    assert [Path(asset.resolvedPath).read_bytes() for asset in assets] == [b"a", b"b"]
    assert all(asset.path.startswith("./textures/wood_") for asset in assets)
    again = read_object(tmp_path / "out" / "objects" / "a.usda")
    again.write(tmp_path / "again" / "a.usda")
    assert (tmp_path / "again" / "a.usda").read_bytes() == again.file.read_bytes()
    (tmp_path / "b" / "thing" / "wood.png").unlink()
    with pytest.raises(SceneError, match=r"the file depends on thing/wood.png, which does not exist"):
        pushed(tmp_path / "b" / "b.usda", tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_an_object_that_is_a_body_already_may_stand_fast(tmp_path):
    file = object_file(tmp_path / "thing.usda")
    stage = Usd.Stage.Open(str(file))
    UsdPhysics.RigidBodyAPI.Apply(stage.GetDefaultPrim())
    stage.Save()
    obstacle = StaticObject("Post", read_object(file), (0.5, -0.1, 0.0))
    assert len(pushed(file, tmp_path / "out", obstacles=(obstacle,)).obstacles) == 1


def test_an_object_of_the_folder_is_used_as_it_is(tmp_path):
    file = object_file(tmp_path / "objects" / "thing.usda")
    file.write_text(file.read_text() + "# a remark\n")
    pushed(file, tmp_path)
    assert [path.name for path in (tmp_path / "objects").iterdir()] == ["thing.usda"]


def test_where_no_centre_of_mass_is_given_it_is_that_of_the_shapes(tmp_path):
    file = object_file(tmp_path / "thing.usda")
    body = read_body(file)
    assert body.center_of_mass == pytest.approx(np.zeros(3))
    assert body.friction == pytest.approx(0.3)
    assert main(["scene", "import", str(file), "--out", str(tmp_path)]) == 0
    assert (tmp_path / "objects" / "thing.png").is_file()


def test_what_a_scene_refers_to_in_other_units_is_warned_of(tmp_path):
    scene = pushed(object_file(tmp_path / "thing.usda"), tmp_path / "out")
    object_file(tmp_path / "out" / "objects" / "thing.usda", metres=1.0, kilograms=0.001, up="Y")
    said = {warning.what.partition(" in ")[0] for warning in lint_stage(SceneStage(scene.file))}
    assert {"kilogramsPerUnit is 0.001", "upAxis is Y"} <= said


# What is there already -----------------------------------------------------------------------------------------------


def test_a_new_task_changes_no_object_of_an_old_one(tmp_path):
    objects = tmp_path / "objects"
    for name, size in (("thing", 0.10), ("thing_push", 0.12)):
        object_file(objects / f"{name}.usda", size=size)
    before = {path: path.read_bytes() for path in objects.iterdir()}
    scene = pushed(object_file(tmp_path / "b" / "thing.usda", size=0.14), tmp_path)
    assert scene.object.rest_height == pytest.approx(0.07)
    assert {path: path.read_bytes() for path in before} == before
    assert (objects / "thing_push_2.usda").is_file()


def test_force_overwrites_the_tasks_own_objects_unless_another_scene_has_them(tmp_path):
    write_object(box(0.1, 0.06, 0.05, mass=0.1), tmp_path)
    for mass in (0.2, 0.3):
        task = Task("push", "Push", box(0.1, 0.06, 0.05, mass=mass), START, GOAL)
        written = write_task(task, tmp_path, force=True)
    assert written.scene.object.mass == pytest.approx(0.3)
    assert len(list((tmp_path / "objects").iterdir())) == 2
    shutil.copy(written.file, tmp_path / "mine.usda")
    task = Task("push", "Push", box(0.1, 0.06, 0.05, mass=0.4), START, GOAL)
    assert write_task(task, tmp_path, force=True).scene.object.mass == pytest.approx(0.4)
    assert load_scene(tmp_path / "mine.usda").object.mass == pytest.approx(0.3)


def test_an_object_of_the_folder_comes_before_a_shipped_one_of_its_name(tmp_path):
    object_file(tmp_path / "objects" / "t_block.usda", size=0.14)
    assert parse_object("t-block", folder=tmp_path).rest_height == pytest.approx(0.07)
    for folder, mass in (("a", "0.3"), ("b", "0.4")):  # one that a task left there is still the shipped one
        arguments = ["scene", "new", folder, "--out", str(tmp_path / "out"), "--mass", mass]
        assert main(arguments) == 0
        assert load_scene(tmp_path / "out" / f"{folder}.usda").object.mass == pytest.approx(float(mass))


def test_a_failure_leaves_the_object_that_was_there(tmp_path, monkeypatch, capsys):
    solid = import_mesh(saved(bracket(), tmp_path, "l.stl"))
    file = write_object(solid, tmp_path)
    before = file.read_bytes()

    def fail(*_):
        raise SceneError("no", file=tmp_path)

    for module, name in ((project_module, "write_attribute_docs"), (preview, "draw_preview")):
        with monkeypatch.context() as patch:
            patch.setattr(module, name, fail)
            assert main(["scene", "import", str(tmp_path / "l.stl"), "--out", str(tmp_path), "--force"]) == 2
            assert main(["scene", "import", "letter:S", "--out", str(tmp_path / "new")]) == 2
    assert file.read_bytes() == before
    assert [path.name for path in file.parent.iterdir()] == ["l.usda"]
    assert not (tmp_path / "new").exists()


def test_a_body_below_another_is_no_part_of_it_and_is_refused(tmp_path):
    file = object_file(tmp_path / "thing.usda")
    stage = Usd.Stage.Open(str(file))
    lid = UsdGeom.Cube.Define(stage, "/Thing/lid").GetPrim()
    UsdPhysics.CollisionAPI.Apply(lid)
    UsdPhysics.RigidBodyAPI.Apply(lid)
    stage.Save()
    with pytest.raises(SceneError, match=r"</Thing/lid>: the object contains another rigid body\n.*\n  to do: "):
        read_object(file)


def test_a_body_that_is_not_the_default_prim_is_named(tmp_path):
    file = object_file(tmp_path / "thing.usda")
    text = file.read_text().replace("</Thing/", "</Above/Thing/").replace('"Thing"\n    meters', '"Above"\n    meters')
    head, _, body = text.partition('def Xform "Thing"')
    file.write_text(f'{head}def Xform "Above"\n{{\ndef Xform "Thing"{body}\n}}\n')
    stage = Usd.Stage.Open(str(file))
    UsdPhysics.RigidBodyAPI.Apply(stage.GetPrimAtPath("/Above/Thing"))
    stage.Save()
    with pytest.raises(SceneError, match="the rigid body is </Above/Thing>, not the default prim"):
        read_object(file)


@pytest.mark.parametrize("friction", ["dynamicFriction = 0", "dynamicFriction = 50", "staticFriction = 0.6"])
def test_a_friction_that_cannot_be_used_is_not_replaced_in_silence(tmp_path, capsys, friction):
    file = object_file(tmp_path / "a" / "thing.usda")
    file.write_text(file.read_text().replace("dynamicFriction = 0.3", friction))
    command = ["scene", "new", "mine", "--out", str(tmp_path), "--object", str(file)]
    assert main(command) == 2
    message = capsys.readouterr().err
    assert "physics:dynamicFriction of its materials is" in message
    assert "or use --friction" in message
    assert main([*command, "--friction", "0.2"]) == 0
    assert load_scene(tmp_path / "mine.usda").object.friction == pytest.approx(0.2)
    assert read_object(file, static=True).rest_height == pytest.approx(0.05), "an obstacle has no friction to speak of"


@pytest.mark.parametrize("said", ["float physics:mass = 0.3", "float physics:density = 1000"])
def test_a_scaled_cube_is_an_object_of_its_scaled_size(tmp_path, said):
    file = tmp_path / "cube.usda"
    text = """def Cube "Thing" (
    prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI", "PhysicsCollisionAPI"]
)
{
    double size = 1
    SAID
    point3f physics:centerOfMass = (0.1, 0, 0)
    float3 xformOp:scale = (0.1, 0.06, 0.05)
    uniform token[] xformOpOrder = ["xformOp:scale"]
}
"""
    file.write_text(HEAD.format(1.0, 1.0, "Z") + text.replace("SAID", said))
    obstacle = StaticObject("Post", read_object(file), (0.5, -0.1, 0.0))
    scene = pushed(file, tmp_path / "out", obstacles=(obstacle,))
    body = scene.object
    assert body.mass == pytest.approx(0.3)
    assert body.center_of_mass == pytest.approx((0.01, 0.0, 0.0), abs=1e-7)
    assert body.rest_height == pytest.approx(0.025)
    for shape in (body.colliders[0], scene.obstacles[0].colliders[0]):
        assert shape.size == pytest.approx((0.05, 0.03, 0.025))
    assert scene.start == pytest.approx(START)
    written = tmp_path / "out" / "objects" / "cube.usda"
    before = written.read_bytes()
    assert pushed(written, tmp_path / "out", "again").object.mass == pytest.approx(0.3)
    assert written.read_bytes() == before


@pytest.mark.parametrize(
    ("size", "reason"),
    [
        ((0.1, 0.1, 0.003), "too flat for the stick: 3.0 mm high"),
        ((2.0, 0.1, 0.1), "too large"),
        ((0.01, 0.01, 0.01), "too small"),
    ],
)
def test_an_object_that_cannot_be_pushed_for_its_size_is_refused_and_may_be_an_obstacle(tmp_path, size, reason):
    file = object_file(tmp_path / "thing.usda", size=1.0)
    stage = Usd.Stage.Open(str(file))
    UsdGeom.Xformable(stage.GetPrimAtPath("/Thing/shape")).AddScaleOp().Set(Gf.Vec3f(*size))
    stage.Save()
    with pytest.raises(SceneError, match=reason):
        read_object(file)
    assert len(read_object(file, static=True).colliders) == 1


def test_a_centre_of_mass_outside_the_object_is_named(tmp_path):
    moved = "point3f physics:centerOfMass = (2, 1, 0)"
    with pytest.raises(SceneError, match=r"its centre of mass \(2, 1, 0\) is outside the object"):
        read_object(object_file(tmp_path / "thing.usda", moved=moved))


def test_an_object_without_a_friction_is_drawn_with_that_of_the_table(tmp_path, capsys):
    file = object_file(tmp_path / "a" / "thing.usda")
    file.write_text(file.read_text().replace("rel material:binding:physics = </Thing/Material>", ""))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert main(["scene", "import", str(file), "--out", str(tmp_path)]) == 0
    assert "0.2 kg, friction 0.1 (the table's), one" in capsys.readouterr().out
