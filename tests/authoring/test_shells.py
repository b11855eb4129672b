"""Surfaces without thickness and surfaces whose faces are listed for both sides, told from solids."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from support.meshes import bracket, saved

from oimppi_warp.authoring import import_mesh
from oimppi_warp.authoring.meshes.read import read_surface
from oimppi_warp.cli.main import main
from oimppi_warp.errors import ConfigError, SceneError

QUADS = ((1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4))
"""A box of 0.1 x 0.06 x 0.04 m; the last face is its top."""


def quads(file: Path, faces) -> Path:
    """A box of four-sided faces: back to back, they are cut along different diagonals when they are read."""
    corners = [(x, y, z) for x in (0.0, 0.1) for y in (0.0, 0.06) for z in (0.0, 0.04)]
    lines = [*(f"v {x} {y} {z}" for x, y, z in corners), *("f " + " ".join(map(str, face)) for face in faces)]
    file.write_text("\n".join(lines) + "\n")
    return file


def both_sides(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, np.vstack([mesh.faces, mesh.faces[:, ::-1]]), process=False)


def cup(sections: int = 48) -> trimesh.Trimesh:
    """A cup of 35 mm radius, 0.1 m high, without thickness."""
    mesh = trimesh.creation.cylinder(0.035, 0.1, sections=sections)
    mesh.update_faces(mesh.face_normals[:, 2] < 0.9)
    return mesh


@pytest.mark.parametrize("name", ["part.stl", "part.obj", "part.glb", "part.ply"])
@pytest.mark.parametrize("make", [bracket, lambda: trimesh.creation.icosphere(3, 0.04)])
def test_a_closed_surface_with_both_sides_is_the_solid_itself(tmp_path, name, make):
    found = read_surface(saved(both_sides(make()), tmp_path, name))
    assert found.mesh.is_watertight
    assert found.mesh.volume == pytest.approx(make().volume, rel=1e-4)
    assert found.notes[0].startswith("double-sided")
    assert read_surface(saved(make(), tmp_path, f"once_{name}")).notes == ()


def test_sides_that_are_cut_differently_are_known_as_sides(tmp_path):
    file = quads(tmp_path / "box.obj", [*QUADS, *(face[::-1] for face in QUADS)])
    found = read_surface(file)
    assert found.mesh.volume == pytest.approx(0.1 * 0.06 * 0.04)
    assert found.notes[0].startswith("double-sided")


def test_an_open_surface_with_both_sides_is_a_shell_and_is_refused(tmp_path):
    tray = quads(tmp_path / "tray.obj", [*QUADS[:5], *(face[::-1] for face in QUADS[:5])])
    for file in (tray, saved(both_sides(cup()), tmp_path, "cup.stl")):
        with pytest.raises(SceneError, match="a shell without thickness, with 1 opening") as error:
            import_mesh(file)
        assert "--wall 0.002" in str(error.value)


@pytest.mark.parametrize("sides", [lambda mesh: mesh, both_sides])
def test_a_shell_gets_a_wall_if_it_is_asked_for(tmp_path, sides):
    file = saved(sides(cup(256)), tmp_path, "cup.stl")
    found = read_surface(file, wall=0.002)
    assert found.mesh.is_watertight
    # from the outside in: pi (R^2 h - (R - t)^2 (h - t))
    assert found.mesh.volume == pytest.approx(np.pi * (0.035**2 * 0.1 - 0.033**2 * 0.098), rel=2e-3)
    assert any("a wall of 2 mm" in note for note in found.notes)
    assert found.mesh.extents == pytest.approx((0.07, 0.07, 0.1), abs=1e-4)


def test_a_sheet_gets_a_thickness(tmp_path):
    sheet = trimesh.Trimesh([(0, 0, 0), (0.1, 0, 0), (0.1, 0.1, 0), (0, 0.1, 0)], [(0, 1, 2), (0, 2, 3)])
    assert import_mesh(saved(sheet, tmp_path, "sheet.stl"), wall=0.01).rest_height == pytest.approx(0.005)


def test_a_solid_needs_no_wall(tmp_path, capsys):
    file = saved(bracket(), tmp_path, "l.stl")
    assert main(["scene", "import", str(file), "--wall", "0.002", "--out", str(tmp_path)]) == 2
    assert "--wall 0.002 does not apply: the surface is closed" in capsys.readouterr().err
    assert main(["scene", "new", "mine", "--object", "t-block", "--wall", "0.002", "--out", str(tmp_path)]) == 2
    assert "only with a mesh" in capsys.readouterr().err
    for wall in (0.0, -0.01, float("nan"), 1.0):
        with pytest.raises(ConfigError, match="--wall"):
            import_mesh(file, wall=wall)


def test_what_is_closed_by_filling_a_large_opening_is_said_to_count_as_solid(tmp_path):
    notes = " ".join(read_surface(saved(cup(), tmp_path, "cup.stl")).notes)
    assert "closed 1 hole of 38" in notes
    assert "--wall" in notes


def test_two_boxes_side_by_side_are_not_double_sided(tmp_path):
    boxes = [trimesh.creation.box((0.05, 0.05, 0.05)).apply_translation((0.05 * i, 0.0, 0.0)) for i in range(2)]
    found = read_surface(saved(trimesh.util.concatenate(boxes), tmp_path, "boxes.stl"))
    assert found.mesh.volume == pytest.approx(2 * 0.05**3)
    assert found.notes == ()
