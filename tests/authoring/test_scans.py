"""Scans of tens of thousands of triangles, with noise and holes, become objects in seconds, and it is said how true."""

from __future__ import annotations

import os

import numpy as np
import pytest
import trimesh
from support.meshes import bracket, one_sided, saved
from support.scans import SCANS, scan

from oimppi_warp.authoring import import_mesh
from oimppi_warp.authoring.meshes import convex
from oimppi_warp.authoring.meshes.coarse import coarsened
from oimppi_warp.authoring.meshes.convex import Fit, compare, decompose
from oimppi_warp.authoring.meshes.progress import listening
from oimppi_warp.cli.main import main
from oimppi_warp.geometry.orient import orient

LONGEST = 20.0
"""Time that an import may take [s]."""


def _computing_time() -> float:
    """Time that this process and those that it started have computed [s]."""
    return sum(os.times()[:4])


@pytest.mark.slow
@pytest.mark.parametrize("kind", SCANS)
def test_a_scan_is_imported_within_twenty_seconds_and_what_is_far_off_is_said(tmp_path, kind):
    file = saved(scan(kind), tmp_path, f"{kind}.ply")
    began, shares = _computing_time(), [0.0]
    with listening(lambda _, share: shares.append(share)):
        solid = import_mesh(file)
    assert _computing_time() - began < LONGEST
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert any(note.startswith("closed") for note in solid.notes)
    warnings = [note for note in solid.notes if note.startswith("warning: the pieces")]
    assert bool(warnings) == solid.fit.is_far_off
    assert all(("was stopped" in warning) == solid.fit.stopped for warning in warnings)  # on a slow machine, some are


def test_a_fit_is_far_off_from_ten_percent_or_five_millimetres_on():
    assert not Fit(0.09, 0.09, 0.0049).is_far_off
    assert Fit(-0.11, 0.0, 0.0).is_far_off
    assert Fit(0.0, 0.11, 0.0).is_far_off
    assert Fit(0.0, 0.0, 0.0051).is_far_off


def test_where_time_runs_out_the_hull_is_used_and_the_figures_are_given(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(convex.decompose, "__kwdefaults__", convex.decompose.__kwdefaults__ | {"seconds": 1e-6})
    file = saved(bracket(), tmp_path, "l.stl")
    assert main(["scene", "import", str(file), "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "one convex piece" in out
    assert "warning: the pieces are not the mesh (cutting it was stopped after 13 s of computing): volume +" in out
    assert main(["scene", "new", "mine", "--object", str(file), "--out", str(tmp_path)]) == 0
    assert "warning: the pieces are not the mesh" in capsys.readouterr().out


def test_progress_of_the_cutting_grows_to_one():
    shares: list[float] = []
    hulls, fit = decompose(bracket(), progress=shares.append)
    assert len(hulls) == 2
    assert fit.is_close
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_a_surface_with_fewer_triangles_is_nearly_the_same():
    fine = trimesh.creation.box((0.1, 0.06, 0.04))
    for _ in range(6):
        fine = fine.subdivide()
    coarse = coarsened(fine, 3000)
    assert len(coarse.faces) <= 3600
    assert coarse.volume == pytest.approx(0.1 * 0.06 * 0.04, rel=1e-4)  # its edges keep their place
    ball = trimesh.creation.icosphere(6, 0.05)
    coarse = coarsened(ball, 3000)
    assert coarse.volume == pytest.approx(ball.volume, rel=0.01)
    assert coarsened(ball, 100_000) is ball


def test_thin_walls_keep_their_thickness():
    tube = trimesh.creation.annulus(0.048, 0.05, 0.1, sections=256)
    for _ in range(3):
        tube = tube.subdivide()
    assert coarsened(tube, 1000).volume == pytest.approx(tube.volume, rel=0.02)


@pytest.mark.parametrize("flips", [1, 40, 600])
def test_faces_are_oriented_as_their_neighbours_are(flips):
    mesh = trimesh.creation.icosphere(3, 0.05)
    turned = np.random.default_rng(0).choice(len(mesh.faces), flips, replace=False)
    faces = mesh.faces.copy()
    faces[turned] = faces[turned, ::-1]
    mesh = trimesh.util.concatenate([trimesh.Trimesh(mesh.vertices, faces, process=False), bracket()])
    assert not mesh.is_winding_consistent
    orient(mesh)
    assert mesh.is_winding_consistent
    strip = one_sided(0)
    orient(strip)
    assert not strip.is_winding_consistent


def test_the_fit_of_a_scan_is_that_of_all_its_triangles():
    mesh = trimesh.creation.icosphere(6, 0.05)
    fit = compare(mesh, ((np.asarray(mesh.vertices), np.asarray(mesh.faces)),))
    assert abs(fit.volume) < 1e-6
    assert fit.footprint < 0.01
    assert fit.distance < 3e-4  # the distance between its samples
