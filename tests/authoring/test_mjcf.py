"""Robots from MJCF files: the same chain, masses and shapes as in MuJoCo, and words about what is wrong."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from oimppi_warp.authoring.robots.arm import Arm
from oimppi_warp.authoring.robots.chain import Chain
from oimppi_warp.authoring.robots.read import read_arm
from oimppi_warp.cli.main import main
from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.kinematics import link_frames, tip_frame
from oimppi_warp.usd import load_scene

PARTS = """<mujocoinclude>
  <default>
    <default class="arm">
      <joint axis="0 1 0" range="-120 120" damping="1"/>
      <geom type="capsule" size="0.03"/>
      <position kp="100" forcerange="-50 50"/>
      <default class="look"><geom contype="0" conaffinity="0" group="2"/></default>
    </default>
  </default>
  <asset>
    <material name="orange" rgba="0.8 0.4 0.1 1"/>
    <mesh name="cover" file="cover.stl" scale="0.001 0.001 0.001"/>
  </asset>
</mujocoinclude>
"""
ARM = """<mujoco model="sample">
  <compiler meshdir="assets" autolimits="true"/>
  <include file="parts.xml"/>
  <worldbody>
    <light pos="0 0 2"/>
    <geom name="floor" type="plane" size="2 2 0.1"/>
    <body name="cube" pos="0.5 0 0.1"><freejoint/><geom type="box" size="0.02 0.02 0.02"/></body>
    <body name="base" childclass="arm" pos="0 0 0.02">
      <geom type="cylinder" size="0.06 0.02"/>
      <body name="turret" pos="0 0 0.08" quat="0.9239 0 0 0.3827">
        <joint name="pan" axis="0 0 1" range="-170 170" actuatorfrcrange="-30 30"/>
        <geom size="0.05 0.02"/>
        <geom class="look" type="box" size="0.04 0.04 0.04" material="orange"/>
        <geom class="look" type="mesh" mesh="cover" rgba="0 0 1 1"/>
        <body name="upper" pos="0 0 0.1">
          <joint name="lift" pos="0 0 0.02" ref="15"/>
          <geom fromto="0 0 0 0.3 0 0" mass="1.2"/>
          <frame pos="0.3 0 0" euler="0 10 0">
            <body name="fore">
              <inertial pos="0.1 0.01 0" mass="0.9" fullinertia="0.004 0.006 0.007 0.0004 0.0002 -0.0003"/>
              <joint name="elbow"/>
              <geom type="mesh" mesh="cover"/>
              <geom type="ellipsoid" size="0.03 0.04 0.05" pos="0.05 0 0"/>
              <body name="wrist" pos="0.3 0 0" euler="0 90 0">
                <joint name="nod"/>
                <geom type="sphere" size="0.03"/>
                <body name="slider" pos="0 0 0.05">
                  <joint name="out" type="slide" axis="0.6 0 0.8" range="0 0.1"/>
                  <geom type="box" size="0.02 0.02 0.02"/>
                  <body name="head" pos="0 0 0.03">
                    <joint name="roll" axis="0 0 1" limited="false"/>
                    <geom type="cylinder" size="0.02 0.01"/>
                    <site name="attachment_site" pos="0 0 0.02" euler="0 0 30"/>
                  </body>
                </body>
              </body>
            </body>
          </frame>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="pan" class="arm"/><position joint="lift" class="arm"/>
    <position joint="elbow" class="arm" gear="2"/>
    <motor joint="nod" gear="10" ctrlrange="-3 3"/><motor joint="roll"/>
  </actuator>
</mujoco>
"""


def write(folder: Path, text: str = ARM) -> Path:
    """The file, the one that it includes, and its mesh."""
    (folder / "assets").mkdir(exist_ok=True)
    trimesh.creation.box((180.0, 50.0, 40.0)).export(folder / "assets" / "cover.stl")
    (folder / "parts.xml").write_text(PARTS)
    file = folder / "sample.xml"
    file.write_text(text)
    return file


def read(folder: Path, text: str = ARM, *, flange: str = "") -> tuple[Chain, Arm]:
    return read_arm(write(folder, text), name="Sample", doc="", length=0.17, radius=0.008, flange=flange)


@pytest.fixture
def models(tmp_path: Path) -> tuple[Chain, Arm, mujoco.MjModel]:
    """The arm, and the file as MuJoCo reads it."""
    chain, arm = read(tmp_path)
    return chain, arm, mujoco.MjModel.from_xml_path(str(tmp_path / "sample.xml"))


def placed(model: mujoco.MjModel, chain: Chain, joints: np.ndarray) -> mujoco.MjData:
    """MuJoCo's state with the arm's joints at these positions."""
    data = mujoco.MjData(model)
    for name, position in zip(chain.joints, joints, strict=True):
        data.joint(name).qpos = position
    mujoco.mj_forward(model, data)
    return data


def test_the_stick_is_where_mujoco_has_the_site(models):
    chain, arm, model = models
    assert chain.joints == ("pan", "lift", "elbow", "nod", "out", "roll")
    assert chain.flange == "attachment_site"
    for joints in np.random.default_rng(3).uniform(-1.0, 1.0, (10, 6)) * [2, 1, 2, 2, 0.1, 3]:
        site = placed(model, chain, joints).site("attachment_site")
        rotation, tip = tip_frame(arm.robot(), joints)
        z = site.xmat.reshape(3, 3)[:, 2]
        np.testing.assert_allclose(tip, site.xpos + 0.17 * z, atol=2e-6)
        np.testing.assert_allclose(rotation[:, 2], z, atol=2e-6)


def test_its_inertia_is_that_of_mujoco(models):
    chain, arm, model = models
    for joints in np.random.default_rng(4).uniform(-1.0, 1.0, (5, 6)) * [2, 1, 2, 2, 0.1, 3]:
        data = placed(model, chain, joints)
        whole = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, whole)
        dofs = [int(model.joint(name).dofadr[0]) for name in chain.joints]
        np.testing.assert_allclose(mass_matrix(arm, joints), whole[np.ix_(dofs, dofs)], atol=1e-5)


def mass_matrix(arm: Arm, joints: np.ndarray) -> np.ndarray:
    """Sum of m Jv^T Jv + Jw^T I Jw over the links, without the stick."""
    rotations, positions = link_frames(arm.robot(), joints)
    axes, total = rotations[:, :, 2], np.zeros((len(joints), len(joints)))
    turns = np.array([joint.kind == "revolute" for joint in arm.joints])
    for i, part in enumerate(arm.links):
        center = positions[i] + rotations[i] @ part.center
        moves = (np.arange(len(joints)) <= i)[:, None]
        angular = (axes * (moves & turns[:, None])).T
        linear = (np.where(turns[:, None], np.cross(axes, center - positions), axes) * moves).T
        inertia = rotations[i] @ part.inertia @ rotations[i].T
        total += part.mass * linear.T @ linear + angular.T @ inertia @ angular
    return total


def test_limits_are_those_of_joints_and_actuators(models):
    _, arm, _ = models
    wide, most = math.radians(120), math.radians(170)
    expected = [(-most, most), (-wide, wide), (-wide, wide), (-wide, wide), (0.0, 0.1), (-math.inf, math.inf)]
    assert [(joint.lower, joint.upper) for joint in arm.joints] == [pytest.approx(pair, abs=1e-6) for pair in expected]
    assert [joint.effort for joint in arm.joints] == [30.0, 50.0, 100.0, 30.0, math.inf, math.inf]
    assert {joint.velocity for joint in arm.joints} == {math.inf}
    assert [joint.kind for joint in arm.joints] == ["revolute"] * 4 + ["prismatic", "revolute"]


def test_shapes_and_looks_are_told_apart_by_what_collides(models):
    _, arm, _ = models
    kinds = [[collider.kind for collider in link.colliders] for link in (arm.base, *arm.links)]
    assert kinds == [["cylinder"], ["capsule"], ["capsule"], ["mesh", "mesh"], ["sphere"], ["box"], ["cylinder"]]
    box, mesh = arm.links[0].visuals
    assert (box.shape.kind, mesh.shape.kind) == ("box", "mesh")
    assert box.shape.size == pytest.approx((0.04, 0.04, 0.04))
    assert box.color == pytest.approx([((c + 0.055) / 1.055) ** 2.4 for c in (0.8, 0.4, 0.1)], abs=1e-3)
    assert mesh.color == pytest.approx((0, 0, 1), abs=1e-3)
    assert sorted(np.ptp(np.asarray(mesh.shape.vertices), axis=0)) == pytest.approx([0.04, 0.05, 0.18], abs=1e-6)


def test_the_command_takes_it_like_a_urdf(tmp_path, capsys):
    text = ARM.replace('<joint name="out" type="slide" axis="0.6 0 0.8" range="0 0.1"/>', "")
    assert main(["scene", "robot", str(write(tmp_path, text)), "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    assert "5 joints (RRRRR), from sample.xml" in told
    assert "pan, lift, elbow, nod, roll" in told
    assert "along z of attachment_site" in told
    scene = load_scene(tmp_path / "out" / "sample_open.usda")
    assert scene.robot.joints[0].velocity_limit == math.inf
    assert tip_frame(scene.robot, scene.robot.start)[1][2] == pytest.approx(0.05, abs=1e-3)


@pytest.mark.parametrize("flange", ["head", "wrist"])
def test_a_body_can_be_the_flange(tmp_path, flange):
    chain, arm = read(tmp_path, flange=flange)
    assert chain.flange == flange
    assert len(arm.joints) == (6 if flange == "head" else 4)


BASE = '<body name="base" childclass="arm" pos="0 0 0.02">'
OTHER = '<body name="other"><joint name="o"/><geom size="0.01 0.01"/></body>'
BAD = {
    "a floating base": ((BASE, BASE + "<freejoint/>"), "floats", "a fixed base"),
    "a ball joint": (
        ('<joint name="nod"/>', '<joint name="nod" type="ball" range="0 100"/>'),
        "nod is a ball joint",
        "hinge, slide",
    ),
    "two joints on a body": (
        ('<joint name="nod"/>', '<joint name="nod"/><joint name="tilt" axis="1 0 0"/>'),
        "body wrist has 2 joints: nod, tilt",
        "one joint for each body",
    ),
    "a slide without limits": (
        ('axis="0.6 0 0.8" range="0 0.1"', 'axis="0.6 0 0.8" limited="false"'),
        "joint out has no limits",
        "an upper limit [m]",
    ),
    "a joint that follows": (
        ("<actuator>", '<equality><joint joint1="nod" joint2="elbow"/></equality><actuator>'),
        "nod follows another joint",
        "make the joint fixed",
    ),
    "a branch": (
        ('<body name="slider"', OTHER + '<body name="slider"'),
        "the arm branches",
        "--flange",
    ),
    "a missing mesh": (('file="cover.stl"', 'file="lost.stl"'), "lost.stl", "add the missing file"),
    "a missing include": (
        ('<include file="parts.xml"/>', '<include file="lost.xml"/>'),
        "lost.xml",
        "add the missing file",
    ),
    "two joints of one name": (('name="nod"', 'name="elbow"'), "repeated name 'elbow' in joint", "correct"),
    "an axis of zero": (('axis="0.6 0 0.8"', 'axis="0 0 0"'), "axis", "correct"),
    "an unknown element": (("<light", "<lamp"), "unrecognized element", "correct"),
    "words for a number": (('pos="0 0 0.1">', 'pos="0 0 high">'), "MuJoCo cannot read the file", "correct"),
    "a place at infinity": (('pos="0 0 0.1">', 'pos="0 0 -inf">'), "has a number that is not finite", "correct"),
    "a place in mm, beyond all": (('pos="0 0 0.1">', 'pos="0 0 1e5">'), "has a length of 1000 m or more", "correct"),
    "an unknown flange": (("", ""), "--flange hand: the robot has no such link", "attachment_site"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_is_refused_with_words_that_help(tmp_path, case):
    (what, to), reason, allowed = BAD[case]
    parts = write(tmp_path).with_name("parts.xml")
    text = ARM.replace(what, to, 1) if what else ARM
    if what and what in PARTS:
        parts.write_text(PARTS.replace(what, to, 1))
    else:
        (tmp_path / "sample.xml").write_text(text)
    with pytest.raises(SceneError) as error:
        read_arm(
            tmp_path / "sample.xml", name="S", doc="", length=0.17, radius=0.008, flange="hand" if not what else ""
        )
    assert reason in str(error.value)
    assert allowed in str(error.value)
    assert str(error.value).count("\n") in (1, 2)
