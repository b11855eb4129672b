"""Robots from USD files as simulators have them: other axes, other frames, no schemas of ours."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdPhysics
from support.foreign_scenes import differences, measured_in, with_y_up

from oimppi_warp.authoring.robots.arm import Arm
from oimppi_warp.authoring.robots.from_usd import read_usd
from oimppi_warp.cli.main import main
from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.feasibility import check_task
from oimppi_warp.geometry.kinematics import tip_frame
from oimppi_warp.usd import load_scene
from oimppi_warp.usd.stage import SCENES

SHIFT = Gf.Vec3f(0.0, 0.0, 0.03)
"""From a link's frame to its joint's, along the axis [m]."""


def foreign(folder: Path, change: Callable[[Usd.Stage], object] = lambda stage: None) -> Path:
    """The arm of seven joints as others would write it: joints about x, with frames away from their links'."""
    layer = Usd.Stage.Open(str(SCENES / "robots" / "arm7.usda")).Flatten()
    stage = Usd.Stage.Open(layer)
    root = stage.GetDefaultPrim()
    root.RemoveAppliedSchema("OimppiRobotAPI")
    root.RemoveProperty("oimppi:startJoints")
    for name in ("tool", "joints/weld"):
        stage.RemovePrim(root.GetPath().AppendPath(name))
    # The joint's x lies where its z was, and its frame is further along that axis than its link's.
    turn = Gf.Quatf(Gf.Rotation(Gf.Vec3d(0, 1, 0), -90.0).GetQuat())
    for prim in stage.Traverse():
        joint = UsdPhysics.RevoluteJoint(prim)
        if joint:
            before = joint.GetLocalRot0Attr().Get()
            joint.GetAxisAttr().Set("X")
            joint.GetLocalRot0Attr().Set(before * turn)
            joint.GetLocalRot1Attr().Set(turn)
            joint.GetLocalPos1Attr().Set(SHIFT)
            moved = Gf.Rotation(Gf.Quatd(before)).TransformDir(Gf.Vec3d(SHIFT))
            joint.GetLocalPos0Attr().Set(joint.GetLocalPos0Attr().Get() + Gf.Vec3f(moved))
    change(stage)
    file = folder / "foreign.usda"
    stage.GetRootLayer().Export(str(file))
    return file


def arm_of(file: Path, flange: str = "") -> Arm:
    chain, robot = read_usd(file, flange=flange)
    return robot.arm(chain, name="Foreign", doc="", length=0.21, radius=0.008, axis="z")


def test_a_foreign_arm_moves_as_it_did(tmp_path):
    arm, known = arm_of(foreign(tmp_path)), load_scene("arm7_01").robot
    robot = arm.robot()
    assert robot.chain == "RRRRRRR"
    random = np.random.default_rng(2)
    for _ in range(10):
        joints = random.uniform(-2.0, 2.0, 7)
        rotation, tip = tip_frame(robot, joints)
        expected_rotation, expected = tip_frame(known, joints)  # the flange is 0.04 m, the stick 0.17 m long
        np.testing.assert_allclose(tip, expected, atol=2e-6)
        np.testing.assert_allclose(rotation[:, 2], expected_rotation[:, 2], atol=2e-6)


def test_looks_are_kept(tmp_path):
    arm = arm_of(foreign(tmp_path))
    known = Usd.Stage.Open(str(SCENES / "robots" / "arm7.usda"))
    for number, link in enumerate(arm.links, start=1):
        skin = known.GetPrimAtPath(f"/Arm7/link{number}/skin").GetChildren()
        assert len(link.visuals) == len(skin)
        for visual, prim in zip(link.visuals, skin, strict=True):
            (color,) = UsdGeom.Gprim(prim).GetDisplayColorAttr().Get()
            assert visual.color == pytest.approx(tuple(color), abs=1e-6)


def test_a_base_on_a_pedestal_stays_there(tmp_path):
    def lift(stage: Usd.Stage) -> None:
        UsdGeom.Xformable(stage.GetDefaultPrim()).AddTranslateOp().Set(Gf.Vec3d(0.0, 0.1, 0.2))
        UsdPhysics.Joint(stage.GetPrimAtPath("/Arm7/joints/mount")).CreateLocalPos0Attr(Gf.Vec3f(0.0, 0.1, 0.2))

    folders = tmp_path / "lifted", tmp_path / "plain"
    for folder in folders:
        folder.mkdir()
    lifted, plain = arm_of(foreign(folders[0], lift)), arm_of(foreign(folders[1]))
    joints = np.linspace(-0.5, 0.7, 7)
    offset = tip_frame(lifted.robot(), joints)[1] - tip_frame(plain.robot(), joints)[1]
    np.testing.assert_allclose(offset, [0.0, 0.1, 0.2], atol=1e-6)
    heights = np.array([[collider.transform[2] for collider in arm.base.colliders] for arm in (lifted, plain)])
    np.testing.assert_allclose(heights[0] - heights[1], 0.2, atol=1e-6)


def test_limits_masses_and_shapes_are_kept(tmp_path):
    arm, known = arm_of(foreign(tmp_path)), load_scene("arm7_01").robot
    for joint, expected in zip(arm.joints, known.joints, strict=True):
        assert (joint.lower, joint.upper) == pytest.approx((expected.lower, expected.upper), abs=1e-6)
        assert (joint.effort, joint.velocity) == pytest.approx(
            (expected.effort_limit, expected.velocity_limit), rel=1e-5
        )
    masses = [link.mass for link in known.links]
    assert [link.mass for link in arm.links] == pytest.approx([*masses[:-1], masses[-1] - 0.05], rel=1e-5)
    assert [len(link.colliders) for link in arm.links] == [2, 2, 2, 2, 2, 2, 1]
    assert {collider.kind for link in arm.links for collider in link.colliders} == {"capsule"}


@pytest.mark.parametrize(
    ("metres", "kilograms", "y_up"), [(0.01, 1.0, False), (1.0, 1.0, True), (0.0254, 0.4536, True)]
)
def test_an_arm_in_other_units_is_the_same_arm(tmp_path, metres, kilograms, y_up):
    def change(stage: Usd.Stage) -> None:
        measured_in(stage, metres, kilograms)
        if y_up:
            with_y_up(stage)

    folders = tmp_path / "converted", tmp_path / "plain"
    for folder in folders:
        folder.mkdir()
    arm, expected = arm_of(foreign(folders[0], change)), arm_of(foreign(folders[1]))
    assert differences(expected.robot(), arm.robot(), tolerance=2e-5) == []
    for link, other in zip(arm.links, expected.links, strict=True):
        assert link.mass == pytest.approx(other.mass, rel=1e-5)
        np.testing.assert_allclose(link.inertia, other.inertia, atol=2e-6)
        assert differences(other.visuals, link.visuals, tolerance=2e-5) == []


def test_the_command_takes_it_like_a_urdf(tmp_path, capsys):
    file = foreign(tmp_path)
    asked = ["scene", "robot", str(file), "--tool-length", "0.21", "--flange", "link7", "--name", "mine"]
    assert main([*asked, "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    assert "7 joints (RRRRRRR), from foreign.usda" in told
    assert "joint1, joint2" in told
    scene = load_scene(tmp_path / "out" / "mine_open.usda")
    check_task(scene)
    tip = tip_frame(scene.robot, scene.robot.start)
    assert tip[1][2] == pytest.approx(0.05, abs=1e-3)
    np.testing.assert_allclose(tip[0][:, 2], [0, 0, -1], atol=1e-3)


def two_articulations(stage: Usd.Stage) -> None:
    UsdPhysics.ArticulationRootAPI.Apply(stage.GetPrimAtPath("/Arm7/link1"))


def ball_joint(stage: Usd.Stage) -> None:
    stage.GetPrimAtPath("/Arm7/joints/joint3").SetTypeName("PhysicsSphericalJoint")


def branch(stage: Usd.Stage) -> None:
    UsdPhysics.RevoluteJoint(stage.GetPrimAtPath("/Arm7/joints/joint7")).GetBody0Rel().SetTargets(["/Arm7/link5"])


BAD: dict[str, tuple[Callable[[Usd.Stage], object], str, str]] = {
    "a floating base": (
        lambda stage: stage.RemovePrim("/Arm7/joints/mount"),
        "not fixed to the world",
        "PhysicsFixedJoint",
    ),
    "two articulations": (two_articulations, "2 articulations", "one robot"),
    "no units": (
        lambda stage: stage.ClearMetadata("metersPerUnit"),
        "the unit of length is not given",
        "metersPerUnit",
    ),
    "no axis up": (lambda stage: stage.ClearMetadata("upAxis"), "the up axis is not given", 'upAxis "Y" or "Z"'),
    "a ball joint": (ball_joint, "type ball", "PhysicsRevoluteJoint"),
    "a branch": (branch, "the arm branches", "--flange"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_robot_is_refused_with_words_that_help(tmp_path, case):
    change, what, allowed = BAD[case]
    with pytest.raises(SceneError) as error:
        arm_of(foreign(tmp_path, change))
    assert what in str(error.value)
    assert allowed in str(error.value)


def test_what_is_no_robot_is_refused(tmp_path):
    (tmp_path / "no.usda").write_text("nothing")
    with pytest.raises(SceneError, match="cannot be read as USD"):
        read_usd(tmp_path / "no.usda")
    with pytest.raises(SceneError, match="no such file"):
        read_usd(tmp_path / "none.usda")
    with pytest.raises(SceneError, match="no such link"):
        arm_of(foreign(tmp_path), flange="hand")
