"""Objects from MJCF files: what is read through defaults, includes and meshes, and what is refused in words."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from support.meshes import bracket

from oimppi_warp.authoring.objects.mjcf import import_mjcf
from oimppi_warp.authoring.objects.stored import read_body
from oimppi_warp.cli.main import main
from oimppi_warp.errors import SceneError
from oimppi_warp.usd import load_scene

BOX = '<geom type="box" size="0.05 0.03 0.02" density="500"/>'


def model(folder: Path, content: str, *, above: str = "") -> Path:
    """A file whose <worldbody> has this content, after other elements."""
    file = folder / "thing.xml"
    file.write_text(f"<mujoco>{above}<worldbody>{content}</worldbody></mujoco>")
    return file


def test_a_body_with_a_free_joint_is_an_object(tmp_path):
    obj = import_mjcf(model(tmp_path, f'<body name="brick" pos="0 0 1"><freejoint/>{BOX}</body>'))
    assert (obj.name, len(obj.hulls)) == ("thing", 1)
    assert obj.mass == pytest.approx(500 * 0.1 * 0.06 * 0.04)
    # m (a^2 + b^2) / 12 about each axis
    expected = obj.mass / 12.0 * np.diag((0.06**2 + 0.04**2, 0.1**2 + 0.04**2, 0.1**2 + 0.06**2))
    assert obj.inertia == pytest.approx(expected, abs=1e-9)
    assert obj.friction == 1.0  # MuJoCo's default
    assert obj.rest_height == pytest.approx(0.02)


def test_defaults_includes_and_meshes_are_resolved(tmp_path):
    (tmp_path / "parts").mkdir()
    cup = trimesh.creation.cylinder(30.0, 50.0, sections=64)
    cup.export(tmp_path / "parts" / "cup.stl")
    (tmp_path / "common.xml").write_text(
        '<mujoco><default><default class="solid"><geom density="400" friction="0.3 0.005 0.0001"/></default>'
        '<default class="shown"><geom contype="0" conaffinity="0" mass="0" group="2"/></default></default></mujoco>'
    )
    above = (
        '<compiler meshdir="parts" angle="degree"/><include file="common.xml"/>'
        '<asset><mesh name="cup" file="cup.stl" scale="0.001 0.001 0.001"/></asset>'
    )
    content = (
        '<geom type="plane" size="1 1 0.1"/><body euler="0 0 30"><freejoint/>'
        '<geom class="solid" type="mesh" mesh="cup"/>'
        '<geom class="solid" type="capsule" size="0.005 0.01" pos="0.04 0 0"/>'
        '<geom class="shown" type="sphere" size="0.09"/></body>'
    )
    obj = import_mjcf(model(tmp_path, content, above=above), lay="as-is")
    capsule = np.pi * 0.005**2 * (0.02 + 4.0 / 3.0 * 0.005)
    assert obj.mass == pytest.approx(400 * (cup.volume * 1e-9 + capsule), rel=1e-3)
    assert obj.friction == pytest.approx(0.3)
    assert len(obj.hulls) == 2
    assert len(obj.surface) == 1  # what is only shown
    assert obj.rest_height == pytest.approx(0.025, abs=1e-4)


def test_the_centre_and_the_inertia_of_an_inertial_turn_with_the_body(tmp_path):
    inertial = '<inertial pos="0.01 0 0" mass="0.3" diaginertia="0.001 0.002 0.0025"/>'
    plate = f'<body><freejoint/>{inertial}<geom type="box" size="0.02 0.05 0.05"/></body>'
    obj = import_mjcf(model(tmp_path, plate))  # it is laid down: x points up or down
    assert obj.mass == 0.3
    assert abs(obj.center[2]) == pytest.approx(0.01, abs=1e-6)
    assert obj.center[:2] == pytest.approx((0.0, 0.0), abs=1e-9)
    assert np.sort(np.diag(obj.inertia)) == pytest.approx((0.001, 0.002, 0.0025))
    assert obj.inertia[2, 2] == pytest.approx(0.001)
    assert obj.notes[1:] == (
        "warning: its inertia is 1.6 times the largest that a body of this shape and mass can have",
    )
    heavy = import_mjcf(tmp_path / "thing.xml", mass=0.6, friction=0.2, lay="as-is")
    assert (heavy.mass, heavy.friction) == (0.6, 0.2)
    assert np.diag(heavy.inertia) == pytest.approx((0.002, 0.004, 0.005))


def test_bodies_that_are_welded_together_are_one(tmp_path):
    nested = f'<body>{BOX}<body pos="0.08 0 0"><geom type="box" size="0.03 0.03 0.02" density="500"/></body></body>'
    obj = import_mjcf(model(tmp_path, nested))
    assert len(obj.hulls) == 2
    assert obj.mass == pytest.approx(500 * 0.06 * 0.04 * (0.1 + 0.06))


def test_parts_that_are_welded_together_have_the_inertia_of_the_whole(tmp_path):
    part = '<body pos="0.08 0 0" euler="0 0 90"><geom type="box" size="0.03 0.03 0.02" density="500"/></body>'
    obj = import_mjcf(model(tmp_path, f"<body><freejoint/>{BOX}{part}</body>"), lay="as-is")
    # boxes of 0.12 and 0.072 kg, 0.08 m apart: together a box of 0.16 x 0.06 x 0.04 m
    expected = obj.mass / 12.0 * np.diag((0.06**2 + 0.04**2, 0.16**2 + 0.04**2, 0.16**2 + 0.06**2))
    assert obj.inertia == pytest.approx(expected, abs=1e-9)


RESOLVED = {
    "shellinertia": ("", '<geom type="box" size="0.05 0.03 0.02" density="5" shellinertia="true"/>', 5 * 0.0248, 1),
    "settotalmass": ('<compiler settotalmass="1"/>', BOX, 1.0, 1),
    "replicate": (
        "",
        '<replicate count="3" offset="0.1 0 0"><geom type="box" size="0.05 0.03 0.02" mass="0.1"/></replicate>',
        0.3,
        3,
    ),
    "attach": (
        '<asset><model name="part" file="part.xml"/></asset>',
        '<attach model="part" body="brick" prefix="its_"/>',
        0.12,
        1,
    ),
}


@pytest.mark.parametrize("kind", RESOLVED)
def test_what_only_mujocos_compiler_resolves_counts(tmp_path, kind):
    above, content, mass, shapes = RESOLVED[kind]
    (tmp_path / "part.xml").write_text(
        f'<mujoco model="part"><worldbody><body name="brick">{BOX}</body></worldbody></mujoco>'
    )
    obj = import_mjcf(model(tmp_path, f"<body><freejoint/>{content}</body>", above=above))
    assert obj.mass == pytest.approx(mass)
    assert len(obj.hulls) == shapes


def test_a_mesh_that_fills_its_hull_badly_is_mentioned(tmp_path):
    bracket().export(tmp_path / "l.stl")
    body = '<body><geom type="mesh" mesh="l"/></body>'
    obj = import_mjcf(model(tmp_path, body, above='<asset><mesh file="l.stl"/></asset>'))
    assert any("of its convex hull empty" in note for note in obj.notes)


def test_the_commands_take_mjcf_as_they_take_a_mesh(tmp_path, capsys):
    file = model(tmp_path, f"<body><freejoint/>{BOX}</body>")
    assert main(["scene", "import", str(file), "--mass", "0.2", "--friction", "0.05", "--out", str(tmp_path)]) == 0
    assert "0.2 kg, friction 0.05" in capsys.readouterr().out
    assert read_body(tmp_path / "objects" / "thing.usda").mass == pytest.approx(0.2)
    assert main(["scene", "new", "mine", "--object", str(file), "--out", str(tmp_path)]) == 0
    assert load_scene(tmp_path / "mine.usda").object.mass == pytest.approx(0.12)
    assert main(["scene", "new", "other", "--object", f"mjcf:{file}", "--out", str(tmp_path)]) == 0
    assert main(["scene", "import", str(file), "--scale", "mm", "--out", str(tmp_path)]) == 2


REFUSED = {
    "not XML": ("<mujoco><worldbody>", "cannot be read as XML"),
    "a URDF": ('<robot name="arm"/>', "the root element is <robot>"),
    "an unknown element": ("<mujoco><worldbody><body><gem/></body></worldbody></mujoco>", "MuJoCo cannot read"),
    "a size at infinity": (
        '<mujoco><worldbody><body><geom name="lid" type="box" size="0.05 inf 0.05"/></body></worldbody></mujoco>',
        "number that is not finite",
    ),
    "a mesh that is missing": (
        '<mujoco><asset><mesh file="no.stl"/></asset><worldbody><body><geom type="mesh" mesh="no"/></body></worldbody>'
        "</mujoco>",
        "no.stl",
    ),
    "an include that is missing": ('<mujoco><include file="no.xml"/><worldbody/></mujoco>', "no.xml"),
    "a hinge": (
        f'<mujoco><worldbody><body>{BOX}<body><joint name="lid" axis="0 1 0"/>{BOX}</body></body></worldbody></mujoco>',
        "1 joint (lid)",
    ),
    "two bodies": (
        f'<mujoco><worldbody><body name="a">{BOX}</body><body name="b" pos="0.2 0 0">{BOX}</body></worldbody></mujoco>',
        "2 bodies (a, b)",
    ),
    "no body": ('<mujoco><worldbody><geom type="plane" size="1 1 1"/></worldbody></mujoco>', "no body in the file"),
    "nothing that collides": (
        '<mujoco><worldbody><body><geom size="0.04" contype="0" conaffinity="0"/></body></worldbody></mujoco>',
        "nothing in the file collides",
    ),
    "a world of geoms without a mass": (f"<mujoco><worldbody>{BOX}</worldbody></mujoco>", "the body has no mass"),
    "a centre of mass that is elsewhere": (
        '<mujoco><worldbody><body><inertial pos="0.2 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>'
        '<geom size="0.04"/></body></worldbody></mujoco>',
        "its centre of mass is not within its convex hull",
    ),
    "an inertia in g m^2": (
        '<mujoco><worldbody><body><inertial pos="0 0 0" mass="0.4" diaginertia="1 1 1.2"/>'
        '<geom type="box" size="0.05 0.04 0.03"/></body></worldbody></mujoco>',
        "a physically impossible inertia for its size: moments of 2.5, 2.5, 3 kg m^2 per kilogram",
    ),
    "a house": ('<mujoco><worldbody><body><geom type="box" size="5 5 5"/></body></worldbody></mujoco>', "too large"),
    "a crumb": ('<mujoco><worldbody><body><geom size="0.001"/></body></worldbody></mujoco>', "too small"),
    "no friction": (
        '<mujoco><worldbody><body><geom size="0.04" friction="0 0 0"/></body></worldbody></mujoco>',
        "friction of its geoms is 0",
    ),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_what_is_no_rigid_body_is_refused_in_words(tmp_path, kind):
    content, reason = REFUSED[kind]
    file = tmp_path / "thing.xml"
    file.write_text(content)
    with pytest.raises(SceneError) as error:
        import_mjcf(file)
    assert reason in str(error.value)
    assert str(file) in str(error.value)
    assert "allowed:" in str(error.value)
    with pytest.raises(SceneError, match="there is no such file"):
        import_mjcf(tmp_path / "none.xml")
