"""The visible shapes of scenes, drawn on the page and in bags: those of Newton's USD import, without Newton."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import newton
import numpy as np
import pytest
import trimesh
from PIL import Image
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade, UsdUtils
from support import small_tasks

from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.footprint import transform_points
from oimppi_warp.observation import planar_transform
from oimppi_warp.scene import Scene
from oimppi_warp.usd import load_scene, shipped_scenes
from oimppi_warp.view import shapes as module
from oimppi_warp.view.posed_scene import PosedScene
from oimppi_warp.view.shapes import FileShapes, Shape, body_frames, placed, visible_shapes

CUBE = "/World/Obstacles/Cube"


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("OIMPPI_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def edited(tmp_path: Path, change) -> Scene:
    """A copy of task02 in one file, changed by a function that is given its stage."""
    stage = Usd.Stage.Open(str(small_tasks.shipped("task02").file))
    layer = stage.Flatten(addSourceFileComment=False)
    file = tmp_path / "changed.usda"
    change(Usd.Stage.Open(layer))
    layer.Export(str(file))
    return load_scene(file)


def found(scene: Scene, path: str) -> list[Shape]:
    return [shape for shape in visible_shapes(scene) if shape.path.startswith(path)]


SOON = ("arm7_01", "lab01", "point01", "pusht", "task05")
"""Scenes with every robot, and with objects and obstacles of every kind; the others wait for the night."""


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(shipped.name, marks=[] if shipped.name in SOON else [pytest.mark.slow])
        for shipped in shipped_scenes()
    ],
)
def test_each_shape_is_what_and_where_newton_has_it(name, empty_cache):
    same_as_newton(small_tasks.shipped(name))


def nest_and_turn(stage: Usd.Stage) -> None:
    """Puts the second link below the first one, and turns the base's frame by a right angle without its shapes."""
    layer = stage.GetRootLayer()
    edit = Sdf.BatchNamespaceEdit()
    edit.Add("/World/Robot/link2", "/World/Robot/link1/link2")
    assert layer.Apply(edit)
    for joint in Usd.PrimRange(stage.GetPseudoRoot()):
        for name in ("physics:body0", "physics:body1"):
            if relationship := joint.GetRelationship(name):
                targets = [
                    str(target).replace("Robot/link2", "Robot/link1/link2") for target in relationship.GetTargets()
                ]
                relationship.SetTargets(targets)
    first = UsdGeom.Xformable(stage.GetPrimAtPath("/World/Robot/link1")).GetLocalTransformation()
    second = UsdGeom.Xformable(stage.GetPrimAtPath("/World/Robot/link1/link2"))
    place = second.GetLocalTransformation() * first.GetInverse()
    second.ClearXformOpOrder()
    second.AddTransformOp().Set(place)

    turn = Gf.Matrix4d(1.0).SetRotate(Gf.Rotation(Gf.Vec3d(0, 0, 1), 90.0))
    base = stage.GetPrimAtPath("/World/Robot/base")
    for part in base.GetChildren():
        part = UsdGeom.Xformable(part)
        place = part.GetLocalTransformation() * turn.GetInverse()
        part.ClearXformOpOrder()
        part.AddTransformOp(opSuffix="turned").Set(place)
    UsdGeom.Xformable(base).ClearXformOpOrder()
    UsdGeom.Xformable(base).AddTransformOp(opSuffix="turned").Set(turn)
    quarter = Gf.Quatf(float(np.sqrt(0.5)), 0.0, 0.0, float(np.sqrt(0.5)))
    for joint in map(UsdPhysics.Joint, (prim for prim in stage.Traverse() if prim.IsA(UsdPhysics.Joint))):
        if joint.GetBody1Rel().GetTargets() == [base.GetPath()]:
            joint.GetLocalRot0Attr().Set(quarter)
        elif joint.GetBody0Rel().GetTargets() == [base.GetPath()]:
            x, y, z = joint.GetLocalPos0Attr().Get()
            joint.GetLocalPos0Attr().Set(Gf.Vec3f(y, -x, z))
            joint.GetLocalRot0Attr().Set(quarter.GetInverse() * joint.GetLocalRot0Attr().Get())


def test_links_below_others_and_a_base_in_another_frame_are_where_newton_has_them(empty_cache, tmp_path):
    scene = edited(tmp_path, nest_and_turn)
    assert scene.robot.links[1].path == "/World/Robot/link1/link2"
    same_as_newton(scene)


def same_as_newton(scene: Scene) -> None:
    """Checks the shapes of a scene, and where they are in another posture, against Newton's model of its file."""
    rng = np.random.default_rng(5)
    joints = scene.robot.start + rng.uniform(-0.3, 0.3, scene.robot.dof)
    at = planar_transform((0.31, -0.12, 0.8), scene.object.rest_height)
    posed = PosedScene(scene)
    posed.pose(joints, at)
    model, frames = posed.model, body_frames(scene, joints, at)
    bodies, places = posed.state.body_q.numpy(), model.shape_transform.numpy()
    visible = np.flatnonzero(model.shape_flags.numpy() & newton.ShapeFlags.VISIBLE)
    shapes = visible_shapes(scene)
    assert [shape.path for shape in shapes] == [model.shape_label[i] for i in visible]
    for shape, i in zip(shapes, visible.tolist(), strict=True):
        body = model.shape_body.numpy()[i]
        other = places[i] if body < 0 else placed(bodies[body], places[i])
        place = placed(frames[shape.body], shape.transform) if shape.body else shape.transform
        corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        np.testing.assert_allclose(transform_points(place, corners), transform_points(other, corners), atol=2e-5)
        np.testing.assert_allclose(shape.color, model.shape_color.numpy()[i], atol=1e-6)
        scale, source = model.shape_scale.numpy()[i], model.shape_source[i]
        if isinstance(source, newton.Mesh):
            np.testing.assert_allclose(shape.vertices, source.vertices * scale, atol=1e-6)
            np.testing.assert_array_equal(shape.faces, np.reshape(source.indices, (-1, 3)))
        else:
            np.testing.assert_allclose(shape.size, scale[: len(shape.size)], rtol=1e-6)
            surface = trimesh.Trimesh(shape.vertices, shape.faces)
            assert surface.is_watertight
            half = {"box": shape.size, "sphere": 3 * shape.size, "cylinder": (*2 * shape.size[:1], shape.size[-1])}
            np.testing.assert_allclose(surface.extents / 2.0, half[shape.kind], rtol=6e-3)


def test_shapes_from_the_cache_are_the_same_and_newton_is_not_imported_for_them(empty_cache):
    scene = small_tasks.shipped("task05")
    first = visible_shapes(scene)
    for shape, again in zip(first, visible_shapes(scene), strict=True):
        assert (shape.path, shape.body, shape.kind, shape.size) == (again.path, again.body, again.kind, again.size)
        assert (shape.color, shape.opacity, shape.textured) == (again.color, again.opacity, again.textured)
        np.testing.assert_array_equal(shape.transform, again.transform)
        np.testing.assert_array_equal(shape.vertices, again.vertices)
        np.testing.assert_array_equal(shape.faces, again.faces)
    told = (
        "import sys; from oimppi_warp.usd import load_scene; from oimppi_warp.view.canvas import Canvas;"
        "from oimppi_warp.view.browser import Page; from oimppi_warp.view.picture import Picture;"
        "scene = load_scene('task05'); page = Page(scene.table, port=8520); Canvas(page).show(Picture.of_start(scene));"
        "edited = scene.with_obstacle_moved(scene.obstacles[0].path, (0.0, 0.1, 0.2));"
        "Canvas(page).show(Picture.of_start(edited)); page.close(); print('newton' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", told], capture_output=True, text=True)
    assert (run.stdout.strip(), run.stderr) == ("False", "")


def test_a_damaged_cache_is_replaced_and_a_changed_file_or_texture_is_read_again(empty_cache, tmp_path):
    image = paint(tmp_path / "paint.png", (200, 30, 30))
    scene = edited(tmp_path, lambda stage: textured(stage, image))
    (shape,) = found(scene, "/World/Object/Sheet")
    assert shape.textured.startswith(b"glTF") and b"OPAQUE" not in shape.textured.replace(b'"OPAQUE"', b"", 1)
    (stored,) = empty_cache.glob("shapes-*.npz")
    stored.write_bytes(stored.read_bytes()[:1000])
    assert found(scene, "/World/Object/Sheet")[0].textured == shape.textured
    paint(image, (30, 30, 200))
    assert found(scene, "/World/Object/Sheet")[0].textured != shape.textured
    for content in (b"", b"#usda 1.0\n(", b"\x00\x01", None):
        scene.file.unlink()
        if content is not None:
            scene.file.write_bytes(content)
        with pytest.raises(SceneError):
            visible_shapes(scene)


def test_what_is_drawn_of_a_file_stays_while_the_file_changes(empty_cache, tmp_path):
    scene = edited(tmp_path, lambda stage: None)
    kept = FileShapes(scene)
    scene.file.write_text("no longer a scene")
    (before,) = [shape for shape in kept.of(scene) if shape.path.startswith(CUBE)]
    moved = scene.with_obstacle_moved(CUBE, (0.1, 0.0, 0.0))
    (after,) = [shape for shape in kept.of(moved) if shape.path.startswith(CUBE)]
    np.testing.assert_allclose(after.transform[:3] - before.transform[:3], (0.1, 0.0, 0.0), atol=1e-9)


def test_a_file_that_is_open_in_this_process_is_not_stored_under_the_content_of_the_disk(empty_cache, tmp_path):
    scene = edited(tmp_path, lambda stage: None)
    stage = Usd.Stage.Open(str(scene.file))
    UsdGeom.Gprim(stage.GetPrimAtPath(CUBE)).CreateDisplayColorAttr([(0.0, 0.0, 1.0)])
    (shape,) = found(scene, CUBE)
    assert shape.color == pytest.approx((0.0, 0.0, 1.0), abs=1e-6), "as in the open stage"
    assert not list(empty_cache.glob("shapes-*"))


def paint(file: Path, color: tuple[int, ...]) -> Path:
    Image.new("RGB" if len(color) == 3 else "RGBA", (4, 4), color).save(file)
    return file


def blend(shape: Shape) -> bool:
    return b"BLEND" in shape.textured


def test_textures_that_are_clear_packed_missing_or_broken(empty_cache, tmp_path, capfd):
    image = paint(tmp_path / "paint.png", (200, 30, 30, 100))
    scene = edited(tmp_path, lambda stage: textured(stage, image))
    (clear,) = found(scene, "/World/Object/Sheet")
    assert blend(clear), "the texture has transparent parts"
    assert UsdUtils.CreateNewUsdzPackage(str(scene.file), str(tmp_path / "packed.usdz"))
    (packed,) = found(load_scene(tmp_path / "packed.usdz"), "/World/Object/Sheet")
    assert blend(packed)
    capfd.readouterr()
    image.write_bytes(b"no image")
    assert not found(scene, "/World/Object/Sheet")[0].textured
    image.unlink()
    assert not found(scene, "/World/Object/Sheet")[0].textured
    assert "EnqueueDependency" not in capfd.readouterr().err


def test_an_obstacle_below_another_one_is_drawn_once_and_moves_by_itself(empty_cache, tmp_path):
    def nest(stage: Usd.Stage) -> None:
        post = UsdGeom.Cylinder.Define(stage, f"{CUBE}/Post")
        post.CreateRadiusAttr(0.02)
        post.CreateHeightAttr(0.1)
        UsdPhysics.CollisionAPI.Apply(post.GetPrim())
        post.GetPrim().AddAppliedSchema("OimppiObstacleAPI")
        place = UsdGeom.Xformable(stage.GetPrimAtPath(CUBE)).ComputeLocalToWorldTransform(0.0)
        post.AddTransformOp().Set(Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(0.5, 0.4, 0.05)) * place.GetInverse())

    scene = edited(tmp_path, nest)
    assert {obstacle.path for obstacle in scene.obstacles} == {CUBE, f"{CUBE}/Post"}
    before = {shape.path: shape.transform for shape in visible_shapes(scene)}
    after = [shape for shape in visible_shapes(scene.with_obstacle_moved(CUBE, (0.0, 0.1, 0.0)))]
    assert len(after) == len(before), "none is drawn twice"
    still = next(shape for shape in after if shape.path == f"{CUBE}/Post")
    np.testing.assert_allclose(still.transform, before[still.path], atol=1e-9)


def textured(stage: Usd.Stage, image: Path) -> None:
    """Adds to the object a square sheet with a texture."""
    sheet = UsdGeom.Mesh.Define(stage, "/World/Object/Sheet")
    sheet.CreatePointsAttr([(0.0, 0.0, 0.03), (0.1, 0.0, 0.03), (0.1, 0.1, 0.03), (0.0, 0.1, 0.03)])
    sheet.CreateFaceVertexCountsAttr([4])
    sheet.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    st = UsdGeom.PrimvarsAPI(sheet).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex)
    st.Set([(0, 0), (1, 0), (1, 1), (0, 1)])
    material = UsdShade.Material.Define(stage, "/World/Paint")
    surface = UsdShade.Shader.Define(stage, "/World/Paint/Surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    file = UsdShade.Shader.Define(stage, "/World/Paint/File")
    file.CreateIdAttr("UsdUVTexture")
    file.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(str(image))
    file.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
    color = surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    color.ConnectToSource(file.ConnectableAPI(), "rgb")
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    UsdShade.MaterialBindingAPI.Apply(sheet.GetPrim()).Bind(material)


def test_kinds_that_scenes_may_have_for_display_only(empty_cache, tmp_path):
    def add(stage: Usd.Stage) -> None:
        cone = UsdGeom.Cone.Define(stage, "/World/Object/Extra/Cone")
        cone.CreateRadiusAttr(0.02)
        cone.CreateHeightAttr(0.06)
        cone.CreateDisplayColorAttr([(0.0, 1.0, 0.0)])
        cone.CreateDisplayOpacityAttr([0.25])
        plane = UsdGeom.Plane.Define(stage, "/World/Object/Extra/Plane")
        plane.CreateWidthAttr(0.3)
        plane.CreateLengthAttr(0.2)
        capsule = UsdGeom.Capsule.Define(stage, "/World/Object/Extra/Capsule")
        capsule.CreateRadiusAttr(0.01)
        capsule.CreateHeightAttr(0.04)
        hidden = UsdGeom.Sphere.Define(stage, "/World/Object/Extra/Hidden")
        hidden.MakeInvisible()
        guide = UsdGeom.Sphere.Define(stage, "/World/Object/Extra/Guide")
        guide.CreatePurposeAttr(UsdGeom.Tokens.guide)
        UsdGeom.Xformable(cone).AddTranslateOp().Set(Gf.Vec3d(0.0, 0.0, 0.1))

    shapes = {shape.path.rpartition("/")[2]: shape for shape in found(edited(tmp_path, add), "/World/Object/Extra")}
    assert shapes.keys() == {"Cone", "Plane", "Capsule"}
    extents = {name: np.ptp(shape.vertices, axis=0) for name, shape in shapes.items()}
    np.testing.assert_allclose(extents["Cone"], [0.04, 0.04, 0.06], rtol=1e-2)
    np.testing.assert_allclose(sorted(extents["Plane"]), [0.0, 0.2, 0.3], rtol=1e-6)
    np.testing.assert_allclose(extents["Capsule"], [0.02, 0.02, 0.06], rtol=1e-2)
    assert shapes["Cone"].color == pytest.approx((0.0, 1.0, 0.0), abs=1e-6) and shapes["Cone"].opacity == 0.25
    assert shapes["Cone"].transform[2] == pytest.approx(0.1)
    assert shapes["Cone"].vertices[:, 2].max() == pytest.approx(0.03), "its middle is the origin"


def test_edges_are_sharp_and_round_surfaces_are_not():
    scene = small_tasks.shipped("task02")
    (box,) = found(scene, CUBE)
    assert len(box.vertices) == 24, "each corner belongs to three faces"
    (post,) = module.collider_shapes((small_tasks.post(0.3, 0.4, 0.02, 0.1),), "", (1.0, 0.0, 0.0))
    assert len(post.vertices) == 4 * 32
