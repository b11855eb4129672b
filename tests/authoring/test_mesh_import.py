"""Objects from meshes: what is repaired, what is refused and why, and how true the convex pieces are."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from pxr import Usd, UsdValidation
from support.meshes import L_SHAPE, bracket, one_sided, prism, saved

from oimppi_warp.authoring import import_mesh, write_object
from oimppi_warp.authoring.meshes.convex import PIECES, compare, decompose, signed_depths
from oimppi_warp.authoring.meshes.moments import moments, winding
from oimppi_warp.authoring.objects.preview import draw_preview
from oimppi_warp.authoring.objects.stored import read_body, read_object
from oimppi_warp.cli.main import main
from oimppi_warp.config.overrides import set_option
from oimppi_warp.config.presets import best
from oimppi_warp.errors import ConfigError, OimppiError, SceneError
from oimppi_warp.geometry.footprint import footprint, outline
from oimppi_warp.record.metrics import summarize
from oimppi_warp.runtime.episode import Episode
from oimppi_warp.usd import load_scene


def without(mesh: trimesh.Trimesh, faces: np.ndarray) -> trimesh.Trimesh:
    """A mesh with holes."""
    mesh = mesh.copy()
    mesh.update_faces(~faces)
    return mesh


def test_a_bracket_becomes_two_pieces_that_are_it(tmp_path):
    solid = import_mesh(saved(bracket(), tmp_path, "Bracket-1.stl"), mass=0.4)
    assert (solid.name, solid.prim, solid.mass, solid.friction) == ("bracket_1", "Bracket1", 0.4, 0.4)
    assert len(solid.hulls) == 2
    assert abs(solid.fit.volume) < 0.005
    assert solid.fit.footprint < 0.005
    assert solid.fit.distance < 0.0005
    assert solid.rest_height == pytest.approx(0.02, abs=1e-5)


def test_mass_and_inertia_are_those_of_the_solid(tmp_path):
    solid = import_mesh(saved(bracket(), tmp_path, "l.stl"), mass=0.4)
    assert solid.center == pytest.approx((0, 0, 0), abs=1e-6)
    centre = np.array(L_SHAPE.centroid.coords[0])
    # J = m / A * integral of |r - c|^2 over the area, by two rectangles and Steiner's theorem
    spin = 0.0
    for x0, y0, x1, y1 in ((0, 0, 0.12, 0.03), (0, 0.03, 0.03, 0.10)):
        w, h = x1 - x0, y1 - y0
        away = np.array([(x0 + x1) / 2, (y0 + y1) / 2]) - centre
        spin += w * h * ((w**2 + h**2) / 12 + away @ away)
    assert solid.inertia[2, 2] == pytest.approx(0.4 * spin / L_SHAPE.area, rel=1e-6)


@pytest.mark.parametrize(
    ("name", "scale", "unit"), [("l.stl", 1000, "mm"), ("l.obj", 1 / 0.0254, "inch"), ("l.ply", 100, "cm")]
)
def test_units_are_suspected_and_then_told(tmp_path, name, scale, unit):
    file = saved(bracket(), tmp_path, name, scale=scale)
    with pytest.raises(SceneError) as error:
        import_mesh(file)
    assert "too large for the arm" in str(error.value)
    assert f"--scale {unit} makes it 0.12 m long" in str(error.value)
    solid = import_mesh(file, scale=unit)
    assert np.ptp(np.vstack([corners for corners, _ in solid.hulls])[:, 0]) == pytest.approx(0.12, abs=1e-4)


def test_a_part_that_no_unit_makes_fit_is_refused(tmp_path):
    file = saved(trimesh.creation.box((3e5, 1e5, 1e5)), tmp_path, "mountain.stl")
    with pytest.raises(SceneError, match="no unit makes it fit"):
        import_mesh(file)


def test_a_small_hole_is_closed_and_said(tmp_path):
    mesh = bracket()
    for _ in range(2):
        mesh = mesh.subdivide()
    holes = np.isin(np.arange(len(mesh.faces)), [3, 40])
    solid = import_mesh(saved(without(mesh, holes), tmp_path, "open.stl"))
    assert any(note.startswith("closed 2 holes") for note in solid.notes)
    assert abs(solid.fit.volume) < 0.005


def test_a_mesh_that_is_inside_out_is_turned(tmp_path):
    mesh = bracket()
    mesh.invert()
    solid = import_mesh(saved(mesh, tmp_path, "inside_out.stl"))
    assert len(solid.hulls) == 2
    assert (np.linalg.eigvalsh(solid.inertia) > 0.0).all()


def test_a_single_face_that_looks_the_wrong_way_is_turned(tmp_path):
    mesh = bracket()
    faces = mesh.faces.copy()
    faces[5] = faces[5][::-1]
    file = tmp_path / "flipped.obj"
    trimesh.Trimesh(mesh.vertices, faces, process=False).export(file)
    assert "inconsistently oriented" in import_mesh(file).notes[0]


def test_a_part_that_stands_on_edge_is_laid_down(tmp_path):
    plate = trimesh.creation.box((0.03, 0.16, 0.12))
    plate.apply_transform(trimesh.transformations.rotation_matrix(0.4, [0, 0, 1]))
    solid = import_mesh(saved(plate, tmp_path, "plate.stl"))
    size = np.ptp(np.vstack([corners for corners, _ in solid.hulls]), axis=0)
    assert sorted(size) == pytest.approx([0.03, 0.12, 0.16], abs=1e-4)
    assert size[2] == pytest.approx(0.03, abs=1e-4)  # flat, and along the axes
    assert "tilted by 90 degrees" in " ".join(solid.notes)
    upright = import_mesh(tmp_path / "plate.stl", lay="as-is")
    assert 2 * upright.rest_height == pytest.approx(0.12, abs=1e-4)


def test_a_glb_comes_with_its_y_axis_up(tmp_path):
    file = saved(trimesh.creation.box((0.1, 0.08, 0.06)), tmp_path, "box.glb")
    assert 2 * import_mesh(file, lay="as-is").rest_height == pytest.approx(0.08, abs=1e-4)


def test_what_cannot_stand_as_it_is_is_refused(tmp_path):
    leaning = trimesh.creation.box((0.04, 0.04, 0.12))
    leaning.apply_transform(trimesh.transformations.rotation_matrix(0.6, [1, 0, 0]))
    with pytest.raises(SceneError, match="fall over"):
        import_mesh(saved(leaning, tmp_path, "leaning.stl"), lay="as-is")


def test_parts_that_overlap_weigh_what_their_union_does(tmp_path):
    arms = [trimesh.creation.box((0.12, 0.03, 0.03)), trimesh.creation.box((0.03, 0.12, 0.03))]
    solid = import_mesh(saved(trimesh.util.concatenate(arms), tmp_path, "cross.stl"), mass=1.0)
    assert len(solid.hulls) == 2
    assert abs(solid.fit.volume) < 0.02
    found = moments(trimesh.load_mesh(tmp_path / "cross.stl"))
    assert found.volume == pytest.approx(0.03 * (2 * 0.12 * 0.03 - 0.03**2), rel=0.01)


def test_parts_that_share_edges_or_a_wall_are_one_object(tmp_path):
    for shift in (0.035, 0.065):  # with common corners, and side by side
        legs = [trimesh.creation.box((0.12, 0.03, 0.04)), trimesh.creation.box((0.12, 0.1, 0.04))]
        legs[1].apply_translation((0.0, shift, 0.0))
        solid = import_mesh(saved(trimesh.util.concatenate(legs), tmp_path, "legs.stl"), mass=1.0)
        assert abs(solid.fit.volume) < 0.02
        shape = shapely.union_all([shapely.MultiPoint(corners[:, :2]).convex_hull for corners, _ in solid.hulls])
        assert shape.area == pytest.approx(0.12 * (shift + 0.065), rel=1e-3)


def test_faces_that_are_there_twice_count_once(tmp_path):
    mesh = bracket()
    twice = trimesh.Trimesh(mesh.vertices, np.vstack([mesh.faces, mesh.faces[:7]]), process=False)
    assert len(import_mesh(saved(twice, tmp_path, "twice.stl")).hulls) == 2


def test_a_sheet_with_two_sides_is_flat(tmp_path):
    corners = [(0, 0, 0), (0.1, 0, 0), (0.1, 0.1, 0), (0, 0.1, 0.05)]
    file = tmp_path / "sheet.obj"
    trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3), (2, 1, 0), (3, 2, 0)], process=False).export(file)
    with pytest.raises(SceneError, match="flat"):
        import_mesh(file)


def test_moments_of_parts_apart_are_exact_and_of_parts_that_overlap_close():
    apart = trimesh.util.concatenate(
        [trimesh.creation.box((0.1, 0.02, 0.02)), trimesh.creation.box((0.02, 0.02, 0.02))]
    )
    apart.vertices[8:] += (0.2, 0.0, 0.0)
    found = moments(apart)
    assert found.volume == pytest.approx(0.02**2 * 0.12)
    assert found.center == pytest.approx((0.2 * 0.02 / 0.12, 0, 0))
    same = moments(trimesh.util.concatenate([trimesh.creation.box((0.1, 0.06, 0.04)).subdivide() for _ in range(2)]))
    assert same.volume == pytest.approx(0.1 * 0.06 * 0.04, rel=1e-3)
    assert np.diag(same.inertia) == pytest.approx(np.array([0.0052, 0.0116, 0.0136]) / 12, rel=0.01)


def test_points_beside_sharp_edges_are_on_their_own_side():
    """Above a blade's edge a point is below the plane of one of its flanks; inside is what the surface goes round."""
    blade = prism(shapely.Polygon([(-0.05, 0.0), (0.05, -0.004), (0.05, 0.004)]), 0.04)
    points = np.random.default_rng(0).uniform((-0.06, -0.01, -0.01), (-0.03, 0.01, 0.05), (4000, 3))
    depths = signed_depths(blade, points)
    assert ((depths > 0.0) == (winding(blade, points) > 0.5)).all()


@pytest.mark.parametrize("hollow", [pytest.param(20, marks=pytest.mark.slow), 3])
def test_many_parts_are_no_more_pieces_than_one(hollow):
    parts = []
    for number in range(20):
        part = bracket() if number < hollow else trimesh.creation.box((0.03, 0.03, 0.03))
        parts.append(part.apply_translation((0.3 * (number % 5), 0.3 * (number // 5), 0.0)))
    hulls, fit = decompose(trimesh.util.concatenate(parts))
    assert len(hulls) == min(PIECES, 20 + hollow)
    assert fit.is_close == (hollow == 3)


def test_the_three_errors_are_those_of_a_hull_in_place_of_an_l():
    mesh = bracket()
    hull = mesh.convex_hull
    fit = compare(mesh, ((np.asarray(hull.vertices), np.asarray(hull.faces)),))
    grown = shapely.area(L_SHAPE.convex_hull) / L_SHAPE.area - 1.0
    furthest = 1.0 / (1.0 / 0.09 + 1.0 / 0.07)  # on the slanted face, as far from one leg as from the other
    assert fit.volume == pytest.approx(grown, abs=1e-3)
    assert fit.footprint == pytest.approx(grown, abs=1e-3)
    assert fit.distance == pytest.approx(furthest, abs=3e-4)


REFUSED = {
    "a sheet": (
        lambda: trimesh.Trimesh([(0, 0, 0), (0.1, 0, 0), (0.1, 0.1, 0), (0, 0.1, 0)], [(0, 1, 2), (0, 2, 3)]),
        "flat",
    ),
    "an open box": (
        lambda: without(b := trimesh.creation.box((0.1, 0.1, 0.05)), b.face_normals[:, 2] > 0.9),
        "too much of the surface is missing: 1 hole",
    ),
    "a tube without walls": (
        lambda: without(b := trimesh.creation.box((0.1, 0.1, 0.05)), np.abs(b.face_normals[:, 2]) > 0.9),
        "too much of the surface is missing",
    ),
    "three hundred marbles": (
        lambda: trimesh.util.concatenate(
            [
                trimesh.creation.icosphere(1, 0.004).apply_translation(place)
                for place in 0.01 * np.array([(i % 18, i // 18, 0) for i in range(300)])
            ]
        ),
        "300 separate parts",
    ),
    "a surface with one side": (lambda: one_sided(0), "the faces cannot be oriented consistently"),
    "a surface with one side and a hole": (lambda: one_sided(1), "the faces cannot be oriented consistently"),
    "an open Moebius strip": (
        lambda: without(b := one_sided(0), (b.faces == len(b.vertices) - 1).any(axis=1)),
        "the faces cannot be oriented consistently",
    ),
    "a box with a fin": (
        lambda: trimesh.util.concatenate(
            [
                trimesh.creation.box((0.1, 0.1, 0.05)),
                trimesh.Trimesh([(0.05, 0.05, -0.025), (0.05, 0.05, 0.025), (0.09, 0.09, 0.0)], [(0, 1, 2)]),
            ]
        ),
        "a part of the mesh is flat",
    ),
    "a washer": (lambda: trimesh.creation.box((0.1, 0.1, 0.003)), "too flat for the stick"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_what_cannot_be_pushed_is_refused_with_the_reason(tmp_path, kind):
    make, reason = REFUSED[kind]
    file = saved(make(), tmp_path, "part.stl")
    with pytest.raises(SceneError) as error:
        import_mesh(file)
    assert reason in str(error.value)
    assert str(file) in str(error.value)
    assert "allowed:" in str(error.value)
    assert "to do:" in str(error.value)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("part.stl", b"no mesh"),
        ("part.obj", b"v 0 0 0"),
        ("flat.obj", b"v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n"),
        ("part.glb", b"glTF" + bytes(20)),
        ("part.step", b"x"),
    ],
)
def test_what_is_no_mesh_is_refused(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SceneError, match=r"allowed:.*\n  to do:"):
        import_mesh(tmp_path / name)
    with pytest.raises(SceneError, match="there is no such file"):
        import_mesh(tmp_path / f"not_{name}")


def test_what_happened_to_a_file_is_said(tmp_path):
    whole = saved(bracket(), tmp_path, "whole.stl").read_bytes()
    for content, reason in (
        (b"", "the file is empty"),
        (b"\n<!DOCTYPE html><html>404</html>", "the file is a web page"),
        (whole[:300], f"the file is cut off: it has 300 of {len(whole)} bytes"),
    ):
        (tmp_path / "part.stl").write_bytes(content)
        with pytest.raises(SceneError, match=f"{reason}.*\n.*\n  to do: "):
            import_mesh(tmp_path / "part.stl")


@pytest.mark.parametrize("options", [{"mass": -1.0}, {"mass": float("nan")}, {"friction": 0.0}, {"scale": "foot"}])
def test_numbers_that_cannot_be_used_are_refused(tmp_path, options):
    file = saved(bracket(), tmp_path, "l.stl")
    with pytest.raises(ConfigError, match="allowed:"):
        import_mesh(file, **options)


def test_the_file_has_convex_colliders_a_surface_and_what_everything_means(tmp_path):
    solid = import_mesh(saved(bracket(), tmp_path, "l.stl"), mass=0.4, friction=0.5)
    file = write_object(solid, tmp_path)
    body = read_body(file)
    assert (body.mass, body.friction, body.rest_height) == (pytest.approx(0.4), pytest.approx(0.5), 0.02)
    assert shapely.area(outline(footprint(body.colliders))) == pytest.approx(L_SHAPE.area, rel=1e-3)
    stage = Usd.Stage.Open(str(file))
    assert "[kg]" in stage.GetDefaultPrim().GetAttribute("physics:mass").GetDocumentation()
    assert "2 convex pieces: volume" in stage.GetRootLayer().documentation
    registry = UsdValidation.ValidationRegistry()
    errors = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators()).Validate(stage)
    assert [e.GetErrorAsString() for e in errors if e.GetType() == UsdValidation.ValidationErrorType.Error] == []
    with pytest.raises(OimppiError, match="the file already exists"):
        write_object(solid, tmp_path)


def test_the_command_writes_object_and_picture_and_states_the_error(tmp_path, capsys):
    file = saved(bracket(), tmp_path, "bracket.stl", scale=1000)
    assert main(["scene", "import", str(file), "--scale", "mm", "--mass", "0.4", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "2 convex pieces: volume" in out
    assert "mm off" in out
    assert f"oimppi scene new push_bracket --object bracket --out {tmp_path}" in out
    assert (tmp_path / "objects" / "bracket.png").read_bytes().startswith(b"\x89PNG")
    named = ["--name", "Angle 2", "--scale", "mm", "--out", str(tmp_path)]
    assert main(["scene", "import", str(file), *named]) == 0
    assert read_object(tmp_path / "objects" / "angle_2.usda").doc.startswith("angle_2: a mesh of 0.12 x 0.1 x 0.04 m")
    assert main(["scene", "import", str(file), "--out", str(tmp_path)]) == 2
    assert "--scale mm" in capsys.readouterr().err


def test_a_picture_can_be_made_of_any_object(tmp_path):
    ring = prism(shapely.Point(0, 0).buffer(0.05, quad_segs=4), 0.03)
    solid = import_mesh(saved(ring, tmp_path, "disc.glb"))
    file = write_object(solid, tmp_path)
    assert draw_preview(solid, read_body(file), tmp_path / "disc.png").stat().st_size > 5000


BOXES = st.lists(st.tuples(*[st.integers(-3, 3)] * 2, *[st.integers(1, 4)] * 3), min_size=1, max_size=4)


def check_any_mesh(boxes, holes, flips, seed):
    """Boxes on a grid, in any way into and beside each other, with some faces gone and some turned."""
    solids = []
    for x, y, *sides in boxes:
        solid = trimesh.creation.box(0.02 * np.array(sides))
        solids.append(solid.apply_translation([0.02 * x, 0.02 * y, 0.01 * sides[2]]))
    mesh = trimesh.util.concatenate(solids)
    random = np.random.default_rng(seed)
    faces = mesh.faces.copy()
    turned = random.choice(len(faces), flips, replace=False)
    faces[turned] = faces[turned, ::-1]
    kept = np.sort(random.choice(len(faces), len(faces) - holes, replace=False))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "part.stl"
        trimesh.Trimesh(mesh.vertices, faces[kept], process=False).export(file)
        try:
            solid = import_mesh(file, mass=0.5)
        except SceneError as error:
            assert "allowed:" in str(error) and "to do:" in str(error)
            return
        assert (np.linalg.eigvalsh(solid.inertia) > 0.0).all()
        body = read_body(write_object(solid, folder))
        shape = outline(footprint(body.colliders))
        assert shapely.distance(shape.convex_hull, shapely.Point(body.center_of_mass[:2])) == 0.0
        if not holes and not flips:
            assert abs(solid.fit.volume) < 0.06
            assert solid.fit.footprint < 0.06


ANY_MESH = {"boxes": BOXES, "holes": st.integers(0, 2), "flips": st.integers(0, 2), "seed": st.integers(0, 99)}


@settings(max_examples=4, deadline=None, suppress_health_check=list(HealthCheck))
@example(boxes=[(3, 1, 2, 1, 3), (2, 1, 1, 1, 2), (1, 3, 2, 2, 3)], holes=2, flips=2, seed=63)  # leaves a flat piece
@example(boxes=[(0, 0, 2, 1, 1), (0, 0, 2, 1, 2)], holes=0, flips=1, seed=0)  # leaves a face without neighbours
@given(**ANY_MESH)
def test_any_mesh_becomes_a_sound_object_or_is_refused_in_words(boxes, holes, flips, seed):
    check_any_mesh(boxes, holes, flips, seed)


@pytest.mark.slow
@pytest.mark.timeout(1200)
@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(**ANY_MESH)
def test_any_mesh_becomes_a_sound_object_or_is_refused_in_words_at_length(boxes, holes, flips, seed):
    check_any_mesh(boxes, holes, flips, seed)


def test_an_imported_bracket_is_pushed_around_a_box_to_its_goal(tmp_path, device):
    file = saved(bracket(), tmp_path, "bracket.stl", scale=1000)
    assert main(["scene", "import", str(file), "--scale", "mm", "--mass", "0.4", "--out", str(tmp_path)]) == 0
    options = ["--object", "bracket", "--start", "0.3,-0.4,0", "--goal", "0.45,0.2,1.57"]
    obstacle = ["--obstacle", "box:0.1,0.1,0.1@0.45,-0.1"]
    assert main(["scene", "new", "push", *options, *obstacle, "--out", str(tmp_path)]) == 0
    scene = load_scene(tmp_path / "push.usda")
    config = set_option(set_option(best("cloi"), "robot.optimizer.samples=512"), "object.optimizer.samples=512")
    log = Episode(scene, config, method="cloi", engine="quasistatic", device=device).run()
    metrics = summarize(log)
    assert metrics.success_tight, (metrics.position_error_m, metrics.yaw_error_rad)
    assert metrics.min_clearance_m > -0.005
    assert np.linalg.norm(log["object_pose"][-1][:2] - log["object_pose"][0][:2]) > 0.5
