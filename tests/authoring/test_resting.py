"""How meshes are laid down: balls and rods, whose round sides are made of many faces, and what is said of them."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from support.meshes import saved

from oimppi_warp.authoring import import_mesh
from oimppi_warp.authoring.checks.check import check_scene
from oimppi_warp.authoring.meshes.pose import resting_poses
from oimppi_warp.cli.main import main
from oimppi_warp.errors import SceneError
from oimppi_warp.usd import load_scene

BALLS = {
    "of triangles of one size": lambda: trimesh.creation.icosphere(3, 0.04),
    "with poles": lambda: trimesh.creation.uv_sphere(0.04),
}


@pytest.mark.parametrize("kind", ["of triangles of one size", pytest.param("with poles", marks=pytest.mark.slow)])
def test_a_ball_is_imported_and_rolls_every_way(tmp_path, kind, capsys):
    file = saved(BALLS[kind](), tmp_path, "ball.stl")
    ball = import_mesh(file)
    assert ball.rest_height == pytest.approx(0.04, abs=5e-4)
    assert not ball.yaw_matters
    assert "100 % of drops" in " ".join(ball.notes)
    with pytest.raises(SceneError, match="no flat side"):
        import_mesh(file, lay="flat")
    assert main(["scene", "new", "roll", "--object", str(file), "--out", str(tmp_path)]) == 0
    assert "warning: the object is round like a ball and rolls" in capsys.readouterr().out
    assert math.isinf(load_scene(tmp_path / "roll.usda").tolerance.yaw)
    assert any("round like a ball" in problem.what for problem in check_scene(tmp_path / "roll.usda"))


@pytest.mark.parametrize("sections", [12, 32, 200])
def test_a_rod_lies_down_however_finely_it_is_made_or_stands_if_asked(tmp_path, sections):
    rod = trimesh.creation.cylinder(0.015, 0.12, sections=sections)
    rests = resting_poses(rod, rod.center_mass)
    assert [rest.rolls for rest in rests] == ["one way", "", ""]
    assert rests[0].probability > 0.95
    file = saved(rod, tmp_path, "rod.stl")
    assert import_mesh(file).rest_height == pytest.approx(0.015, abs=6e-4)
    standing = import_mesh(file, lay="flat")
    assert standing.rest_height == pytest.approx(0.06, abs=1e-5)
    assert "flat side" in " ".join(standing.notes)


def test_the_command_warns_of_a_rod_that_rolls(tmp_path, capsys):
    file = saved(trimesh.creation.cylinder(0.015, 0.12), tmp_path, "rod.stl")
    assert main(["scene", "import", str(file), "--out", str(tmp_path)]) == 0
    assert "warning: the object lies on its round side" in capsys.readouterr().out
    assert main(["scene", "import", str(file), "--out", str(tmp_path), "--lay", "flat", "--force"]) == 0
    assert "warning" not in capsys.readouterr().out


def test_a_finely_meshed_solid_rests_on_one_of_its_own_faces():
    loaf = trimesh.creation.icosphere(4, 0.05)
    loaf.apply_scale((1.5, 1.0, 1.0))
    loaf = loaf.slice_plane((0.0, 0.0, -0.02), (0.0, 0.0, 1.0), cap=False).convex_hull
    loaf.apply_transform(trimesh.transformations.rotation_matrix(0.7, (1.0, 2.0, 0.5)))
    best = resting_poses(loaf, loaf.center_mass)[0]
    assert best.rolls == ""
    # the cut is a face of its own: on it, its points are level
    heights = loaf.vertices @ best.up
    assert (heights < heights.min() + 1e-5).sum() > 20


def test_the_faces_of_a_box_are_ways_of_their_own():
    rests = resting_poses(trimesh.creation.box((0.1, 0.05, 0.03)), np.zeros(3))
    assert len(rests) == 6
    assert sum(rest.probability for rest in rests) == pytest.approx(1.0)
    assert np.abs(rests[0].up).tolist() == pytest.approx([0.0, 0.0, 1.0])
