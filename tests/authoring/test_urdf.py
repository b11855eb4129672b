"""Robots from URDFs: the same chain, masses and shapes, a start that can be run, and words about what is wrong."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from pxr import Usd, UsdGeom
from scipy.spatial import ConvexHull
from support.sample_urdfs import arm_parts, joint, link, panda_parts, shape, ur_parts, write_urdf

from oimppi_warp.authoring import box, write_object
from oimppi_warp.authoring.robots.arm import Arm
from oimppi_warp.authoring.robots.articulation import GREY, ToolAxis
from oimppi_warp.authoring.robots.fitting import POINTS, fit_collider
from oimppi_warp.authoring.robots.from_urdf import read_urdf
from oimppi_warp.authoring.robots.start_pose import HEIGHT, lowered_heights, with_start
from oimppi_warp.cli.main import main
from oimppi_warp.config.presets import best
from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.feasibility import check_task, sample_start
from oimppi_warp.geometry.footprint import core_points, footprint, outline, rotation_matrix
from oimppi_warp.geometry.kinematics import link_frames, tip_frame
from oimppi_warp.geometry.reach import can_lift, reach_of
from oimppi_warp.record.metrics import summarize
from oimppi_warp.runtime.episode import Episode
from oimppi_warp.scene import PushedObject
from oimppi_warp.usd import load_scene

RANDOM = np.random.default_rng(4)
Parts = dict[str, str]


def made(
    folder: Path, parts: Parts | None = None, *, flange: str = "", axis: ToolAxis = "x", length: float = 0.17
) -> Arm:
    """The arm of a URDF of these parts."""
    chain, robot = read_urdf(write_urdf(folder, arm_parts() if parts is None else parts), flange=flange)
    return robot.arm(chain, name="Made", doc="", length=length, radius=0.008, axis=axis)


def bare(parts: Parts) -> Parts:
    """The parts without meshes, which MuJoCo looks for elsewhere."""
    plain = arm_parts() | {"fore": link("fore"), "roll": link("roll", mass=0.8, center="0 0.01 0.02")}
    return {name: plain[name] if "mesh" in text and name in ("fore", "roll") else text for name, text in parts.items()}


@pytest.fixture
def models(tmp_path: Path) -> tuple[Arm, mujoco.MjModel]:
    """The arm, and the same URDF as MuJoCo reads it."""
    parts = bare(arm_parts())
    arm = made(tmp_path, parts)
    text = (tmp_path / "made.urdf").read_text()
    text = text.replace('<visual><geometry><mesh filename="package://nowhere/look.dae"/></geometry></visual>', "")
    specification = mujoco.MjSpec.from_string(text)
    specification.compiler.fusestatic = False
    return arm, specification.compile()


def joints_of(arm: Arm) -> np.ndarray:
    return RANDOM.uniform([max(j.lower, -3.0) for j in arm.joints], [min(j.upper, 3.0) for j in arm.joints])


# The chain


def test_the_stick_is_where_the_urdf_has_the_flange(models):
    arm, model = models
    data = mujoco.MjData(model)
    for _ in range(10):
        data.qpos[:] = joints_of(arm)
        mujoco.mj_kinematics(model, data)
        flange = data.body("tool0")
        x = flange.xmat.reshape(3, 3)[:, 0]
        rotation, tip = tip_frame(arm.robot(), data.qpos)
        np.testing.assert_allclose(tip, flange.xpos + 0.17 * x, atol=2e-6)
        np.testing.assert_allclose(rotation[:, 2], x, atol=2e-6)


def test_its_inertia_is_that_of_the_urdf(models):
    arm, model = models
    data = mujoco.MjData(model)
    for _ in range(5):
        data.qpos[:] = joints_of(arm)
        mujoco.mj_forward(model, data)
        expected = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, expected)
        np.testing.assert_allclose(mass_matrix(arm, data.qpos), expected, atol=1e-5)


def mass_matrix(arm: Arm, joints: np.ndarray) -> np.ndarray:
    """Sum of m Jv^T Jv + Jw^T I Jw over the links, without the stick."""
    rotations, positions = link_frames(arm.robot(), joints)
    axes, total = rotations[:, :, 2], np.zeros((len(joints), len(joints)))
    for i, part in enumerate(arm.links):
        center = positions[i] + rotations[i] @ part.center
        moves = np.arange(len(joints)) <= i
        angular = (axes * moves[:, None]).T
        linear = (np.cross(axes, center - positions) * moves[:, None]).T
        inertia = rotations[i] @ part.inertia @ rotations[i].T
        total += part.mass * linear.T @ linear + angular.T @ inertia @ angular
    return total


def test_limits_masses_and_kinds_are_those_of_the_urdf(tmp_path):
    arm = made(tmp_path)
    assert [(joint.lower, joint.upper) for joint in arm.joints] == [
        (-3.0, 3.0), (-2.2, 2.2), (-2.7, 2.7), (-math.inf, math.inf), (-2.4, 2.4), (-3.0, 3.0)
    ]  # fmt: skip
    assert [joint.effort for joint in arm.joints] == [60, 60, 60, 60, 60, 15]
    assert {joint.velocity for joint in arm.joints} == {2.2}
    assert [part.mass for part in arm.links] == pytest.approx([1.5, 1.5, 1.8, 0.8, 0.6, 0.3])
    kinds = [[collider.kind for collider in part.colliders] for part in arm.links]
    assert kinds == [["sphere"], ["cylinder"], ["capsule", "box"], ["mesh"], [], ["cylinder"]]


def test_a_gripper_is_left_out_where_the_flange_is_named(tmp_path):
    parts = arm_parts()
    for side, way in (("left", 1), ("right", -1)):
        parts[side] = link(side, mass=0.1, shapes=shape('<box size="0.01 0.02 0.05"/>'))
        parts[f"{side}_slide"] = joint(
            f"{side}_slide", "turn", side, kind="prismatic", axis=f"0 {way} 0", lower=0.0, upper=0.04
        )
    with pytest.raises(SceneError, match="left and right move independently"):
        made(tmp_path, parts)
    arm = made(tmp_path, parts, flange="tool0")
    plain = made(tmp_path)
    assert len(arm.joints) == 6
    assert arm.links[-1].mass == plain.links[-1].mass
    np.testing.assert_allclose(arm.stick.mount, plain.stick.mount)


def test_the_stick_points_along_the_axis_that_was_asked_for(tmp_path):
    axes: tuple[ToolAxis, ...] = ("x", "y", "z", "-x", "-y", "-z")
    along = {axis: rotation_matrix(np.asarray(made(tmp_path, axis=axis).stick.turn))[:, 2] for axis in axes}
    np.testing.assert_allclose(np.cross(along["x"], along["y"]), along["z"], atol=1e-6)
    for axis in "xyz":
        np.testing.assert_allclose(along[f"-{axis}"], -along[axis], atol=1e-6)


# Where it begins


def test_an_arm_begins_with_its_tool_upright_just_above_the_table(tmp_path):
    arm = with_start(made(tmp_path))
    robot = arm.robot()
    rotation, tip = tip_frame(robot, robot.start)
    assert tip[2] == pytest.approx(HEIGHT, abs=1e-3)
    np.testing.assert_allclose(rotation[:, 2], [0, 0, -1], atol=1e-3)
    assert lowered_heights(robot, robot.start).min() >= 0.02
    for limits, position in zip(robot.joints, robot.start, strict=True):
        assert limits.lower <= position <= limits.upper


def test_an_arm_that_does_not_get_to_the_table_is_refused(tmp_path):
    parts = arm_parts()
    parts["mount"] = joint("mount", "world", "base", kind="fixed", xyz="0 0 3")
    with pytest.raises(SceneError, match="no joint positions were found that hold the tool upright"):
        with_start(made(tmp_path, parts))


def sliding(height: float, *, far: float = 0.9, aside: float = 0.7) -> Parts:
    """Two slides, the first along the world's -y, the second along x."""
    return {
        "base": link("base"),
        "bridge": link("bridge"),
        "carriage": link("carriage", shapes=shape('<box size="0.05 0.05 0.05"/>')),
        "y": joint(
            "y", "base", "bridge", kind="prismatic", xyz=f"0 0 {height}", axis="0 -1 0", lower=-aside, upper=aside
        ),
        "x": joint("x", "bridge", "carriage", kind="prismatic", axis="1 0 0", lower=0.05, upper=far),
    }


def test_slides_are_along_the_axes_that_the_urdf_gives(tmp_path):
    arm = with_start(made(tmp_path, sliding(0.182), axis="-z"))
    robot = arm.robot()
    assert robot.chain == "PP"
    for joints in ([0.3, 0.4], [-0.2, 0.6]):
        np.testing.assert_allclose(tip_frame(robot, np.array(joints))[1], [joints[1], -joints[0], 0.012], atol=1e-6)


def test_an_arm_whose_joints_all_stand_upright_stays_at_its_height(tmp_path):
    parts = {name: link(name) for name in ("base", "upper", "fore", "wrist")}
    parts["j1"] = joint("j1", "base", "upper", xyz="0 0 0.182")
    parts["j2"] = joint("j2", "upper", "fore", xyz="0.3 0 0")
    parts["j3"] = joint("j3", "fore", "wrist", xyz="0.3 0 0")
    parts["end"] = joint("end", "wrist", "hand", kind="fixed", xyz="0.05 0 0") + link("hand", mass=0.1)
    robot = with_start(made(tmp_path, parts, axis="-z")).robot()
    assert robot.chain == "RRR"
    assert tip_frame(robot, robot.start)[1][2] == pytest.approx(0.012, abs=1e-6)
    assert not can_lift(robot)
    assert reach_of(robot).radius == pytest.approx(0.65, abs=1e-3)


def test_slides_that_carry_the_tool_too_high_say_how_long_it_should_be(tmp_path):
    with pytest.raises(SceneError, match=r"the tip is at 0\.100 m") as error:
        with_start(made(tmp_path, sliding(0.27), axis="-z"))
    assert "increase --tool-length by 0.088 m" in str(error.value)


# Shapes of meshes


def beyond(points: np.ndarray, hull: np.ndarray) -> float:
    """How far points lie outside of a convex hull at the most [m]."""
    planes = ConvexHull(hull).equations
    return float((points @ planes[:, :3].T + planes[:, 3]).max())


def test_a_long_mesh_becomes_a_capsule_around_it():
    mesh = trimesh.creation.capsule(height=0.2, radius=0.04, count=(24, 24))
    mesh.apply_transform(trimesh.transformations.rotation_matrix(0.7, (1, 2, 0.5), (0.1, 0, 0.2)))
    collider = fit_collider("c", mesh.vertices)
    assert collider.kind == "capsule"
    assert collider.size == pytest.approx((0.04, 0.1), rel=0.03)
    (a, b), radius = core_points(collider)
    axis, along = (b - a) / np.linalg.norm(b - a), np.linalg.norm(b - a)
    t = np.clip((mesh.vertices - a) @ axis, 0.0, along)
    assert np.linalg.norm(mesh.vertices - a - t[:, None] * axis, axis=1).max() <= radius + 1e-9


def test_a_block_keeps_its_corners():
    collider = fit_collider("c", trimesh.creation.box((0.2, 0.1, 0.15)).vertices)
    assert collider.kind == "mesh"
    assert collider.vertices is not None
    assert len(collider.vertices) == 8


def test_a_fine_mesh_becomes_a_hull_with_few_points_around_it():
    mesh = trimesh.creation.icosphere(subdivisions=4)
    mesh.vertices *= (0.08, 0.05, 0.015)
    collider = fit_collider("c", mesh.vertices)
    assert collider.vertices is not None
    assert len(collider.vertices) <= POINTS
    assert beyond(np.asarray(mesh.vertices), collider.vertices) < 1e-9
    assert ConvexHull(collider.vertices).volume < 1.25 * mesh.volume


def test_a_flat_mesh_is_refused():
    with pytest.raises(ValueError, match="encloses no volume"):
        fit_collider("c", np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]]))


# Looks

RED = '<material name="red"><color rgba="0.8 0.1 0.1 1"/></material>'
RED_LIGHT = pytest.approx((0.6038, 0.0100, 0.0100), abs=1e-4)
"""The same in linear light."""
LOOKS = (
    f'<visual><origin xyz="0 0 0.1"/><geometry><box size="0.05 0.06 0.2"/></geometry>{RED}</visual>'
    '<visual><geometry><mesh filename="meshes/fore.stl" scale="0.001 0.001 0.001"/></geometry></visual>'
    '<visual><geometry><mesh filename="meshes/look.dae"/></geometry></visual>'
)


def test_looks_are_kept_and_those_that_are_not_there_left_out(tmp_path):
    parts = arm_parts() | {"upper": link("upper", shapes=shape('<sphere radius="0.05"/>') + LOOKS)}
    arm = made(tmp_path, parts)
    box, mesh = arm.links[1].visuals
    assert box.shape.kind == "box"
    assert box.shape.size == pytest.approx((0.025, 0.03, 0.1))
    assert box.color == RED_LIGHT
    assert len(mesh.faces) > 100
    assert mesh.color == pytest.approx(GREY, abs=2e-3)
    assert np.ptp(np.asarray(mesh.shape.vertices), axis=0).max() == pytest.approx(0.27, abs=0.01)
    assert not any(part.visuals for part in (arm.base, arm.links[0], *arm.links[2:]))


def test_a_base_without_a_mass_keeps_its_looks(tmp_path):
    plate = '<visual><geometry><box size="0.2 0.2 0.02"/></geometry></visual>'
    parts = arm_parts() | {"base": link("base", mass=0.0, shapes=plate)}
    base = made(tmp_path, parts).base
    assert [visual.shape.kind for visual in base.visuals] == ["box"]
    assert base.mass > 0.0


def test_looks_that_nobody_reads_do_not_stop_a_robot(tmp_path):
    parts = arm_parts() | {"upper": link("upper", shapes=shape('<sphere radius="0.05"/>') + LOOKS)}
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "look.dae").write_text("nothing")
    arm = made(tmp_path, parts)
    assert not arm.links[1].visuals
    assert [collider.kind for collider in arm.links[1].colliders] == ["sphere"]


def test_a_robot_with_looks_hides_the_shapes_that_collide(tmp_path, capsys):
    parts = arm_parts() | {"upper": link("upper", shapes=shape('<sphere radius="0.05"/>') + LOOKS)}
    asked = ["scene", "robot", str(write_urdf(tmp_path, parts)), "--tool-axis=x", "--out", str(tmp_path / "out")]
    assert main(asked) == 0
    scene = load_scene(tmp_path / "out" / "made_open.usda")
    assert [collider.kind for collider in scene.robot.links[1].colliders] == ["sphere"]
    stage = Usd.Stage.Open(str(scene.file))
    link2, link1 = "/World/Robot/link2", "/World/Robot/link1"
    assert UsdGeom.Imageable(stage.GetPrimAtPath(f"{link2}/collider0")).ComputePurpose() == "guide"
    assert UsdGeom.Imageable(stage.GetPrimAtPath(f"{link1}/collider0")).ComputePurpose() == "default"
    assert {prim.GetTypeName() for prim in stage.GetPrimAtPath(f"{link2}/skin").GetChildren()} == {"Cube", "Mesh"}


# What is wrong


def changed(**parts: str) -> Callable[[], Parts]:
    return lambda: arm_parts() | parts


BAD: dict[str, tuple[Callable[[], Parts], str, str]] = {
    "a joint without limits": (
        lambda: arm_parts() | {"j2": arm_parts()["j2"].replace("<limit", "<nolimit")},
        "joint j2 has no limits",
        "use the type continuous",
    ),
    "crossed limits": (
        changed(j2=joint("j2", "shoulder", "upper", lower=1.0, upper=-1.0)),
        "the lower limit (1 rad, 57.3 deg) is not below the upper limit (-1 rad, -57.3 deg)",
        "a lower limit",
    ),
    "no effort": (changed(j2=joint("j2", "shoulder", "upper", effort=0.0)), "effort limit is 0 N m", "more than zero"),
    "words for a limit": (
        lambda: arm_parts() | {"j2": arm_parts()["j2"].replace("-2.2", "pi")}, "lower is 'pi'", "a number",
    ),
    "a joint that moves with another": (
        changed(j3=joint("j3", "upper", "fore", more='<mimic joint="j2"/>')), "j3 follows another",
        "make the joint fixed",
    ),
    "a floating base": (
        changed(mount=joint("mount", "world", "base", kind="floating")), "of type floating", "base must be fixed",
    ),
    "an unknown joint": (changed(j2=joint("j2", "shoulder", "upper", kind="screw")), "of type screw", "prismatic"),
    "a link in the air": (changed(lamp=link("lamp")), "2 links have no parent: world, lamp", "one base"),
    "a link held twice": (changed(again=joint("again", "base", "fore")), "2 parent joints: j3, again", "a tree"),
    "a loop": (
        changed(j1=joint("j1", "fore", "shoulder")), "links shoulder, upper, fore form a loop", "one of the joints: j2",
    ),
    "a joint to nowhere": (changed(j6=joint("j6", "pitch", "hand")), "missing link 'hand'", "links of the URDF"),
    "a branch": (changed(arm2=link("arm2"), b=joint("b", "fore", "arm2")), "the arm branches", "--flange"),
    "a missing mesh": (
        changed(fore=link("fore", shapes=shape('<mesh filename="package://lost/fore.stl"/>'))),
        "'package://lost/fore.stl' does not exist",
        "package://NAME/",
    ),
    "a link without mass": (
        changed(fore='<link name="fore"/>', cover='<link name="cover"/>'), "fore has no mass", "a mass and an inertia",
    ),
    "an impossible inertia": (
        changed(pitch=link("pitch", inertia='<inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>')),
        "a physically impossible inertia",
        "correct",
    ),
    "no joint that moves": (
        lambda: {"a": link("a"), "b": link("b"), "j": joint("j", "a", "b", kind="fixed")}, "no moving joint", "a chain",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_a_bad_urdf_is_refused_with_words_that_help(tmp_path, case):
    parts, what, allowed = BAD[case]
    with pytest.raises(SceneError) as error:
        made(tmp_path, parts())
    assert what in str(error.value)
    assert allowed in str(error.value)
    assert "made.urdf" in str(error.value)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "cannot be read as XML"),
        ("<robot", "cannot be read as XML"),
        ("<sdf/>", "the root element is <sdf>"),
        ('<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="m"/></robot>', "xacro, not URDF"),
        ("<robot/>", "the file has no links"),
    ],
)
def test_what_is_no_urdf_is_refused(tmp_path, text, what):
    file = tmp_path / "arm.urdf"
    file.write_text(text)
    with pytest.raises(SceneError, match=what):
        read_urdf(file)
    with pytest.raises(SceneError, match="no such file"):
        read_urdf(tmp_path / "none.urdf")


def test_a_flange_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(SceneError, match="--flange hand: the robot has no such link") as error:
        made(tmp_path, flange="hand")
    assert "tool0" in str(error.value)


# The command


def test_the_command_makes_a_robot_and_a_task_that_can_be_run(tmp_path, capsys):
    urdf = write_urdf(tmp_path, arm_parts())
    asked = ["scene", "robot", str(urdf), "--tool-length", "0.15", "--tool-axis=x", "--out", str(tmp_path / "out")]
    assert main(asked) == 0
    told = capsys.readouterr().out
    for words in (
        "6 joints (RRRRRR)",
        "j1, j2, j3, j4, j5, j6",
        "along x of tool0",
        "oimppi run",
        "no collision shapes on pitch:",
    ):
        assert words in told
    scene = load_scene(tmp_path / "out" / "made_open.usda")
    check_task(scene)
    assert scene.robot.joints[3].upper == math.inf
    arm = made(tmp_path, length=0.15)
    for _ in range(5):
        joints = joints_of(arm)
        np.testing.assert_allclose(tip_frame(scene.robot, joints)[1], tip_frame(arm.robot(), joints)[1], atol=1e-5)

    assert main(asked) == 2
    assert "already exists" in capsys.readouterr().err
    assert main([*asked, "--force"]) == 0


def test_each_robot_in_a_folder_keeps_the_object_that_was_made_for_it(tmp_path):
    def add(name: str, *, far: float, aside: float) -> PushedObject:
        urdf = write_urdf(tmp_path, sliding(0.182, far=far, aside=aside), name)
        assert main(["scene", "robot", str(urdf), "--tool-axis=-z", "--out", str(tmp_path / "out")]) == 0
        return load_scene(tmp_path / "out" / f"{name}_open.usda").object

    def width(obj: PushedObject) -> float:
        return float(np.ptp(outline(footprint(obj.colliders)).bounds[::2]))

    other = replace(box(0.1, 0.06, 0.05), name="t_block_60")
    before = write_object(other, tmp_path / "out").read_bytes()
    sizes = {"larger": (0.5, 0.3), "small": (0.35, 0.25), "twin": (0.35, 0.24)}
    first = {name: add(name, far=far, aside=aside) for name, (far, aside) in sizes.items()}
    assert width(first["larger"]) == pytest.approx(0.8 * width(load_scene("task01").object), abs=1e-6)
    assert width(first["small"]) == pytest.approx(0.6 * width(load_scene("task01").object), abs=1e-6)
    for name, obj in first.items():
        again = load_scene(tmp_path / "out" / f"{name}_open.usda").object
        assert (again.mass, width(again)) == (obj.mass, width(obj))
    assert (tmp_path / "out" / "objects" / "t_block_60.usda").read_bytes() == before


@pytest.mark.parametrize(
    ("more", "what"),
    [
        (["--tool-length", "0"], "--tool-length 0"),
        (["--tool-length", "0.01"], "shorter than it is thick"),
        (["--name", "7up"], "--name 7up"),
        (["--flange", "hand"], "no such link"),
        (["--tool-axis=y", "--tool-length", "1.9"], "no joint positions"),
    ],
)
def test_a_mistake_on_the_command_line_writes_nothing(tmp_path, capsys, more, what):
    urdf = write_urdf(tmp_path, arm_parts())
    assert main(["scene", "robot", str(urdf), "--out", str(tmp_path / "out"), *more]) == 2
    assert what in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_an_arm_from_a_urdf_brings_its_object_to_the_goal(tmp_path, device):
    urdf = write_urdf(tmp_path, arm_parts())
    assert main(["scene", "robot", str(urdf), "--tool-axis=x", "--out", str(tmp_path)]) == 0
    log = Episode(load_scene(tmp_path / "made_open.usda"), best("cloi"), method="cloi", device=device, seed=0).run()
    assert summarize(log).success


@pytest.mark.parametrize("method", ["cloi", pytest.param("soi", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("name", "parts"), [pytest.param("ur", ur_parts, marks=pytest.mark.slow), ("panda", panda_parts)]
)
def test_an_imported_arm_is_as_gentle_as_the_one_that_is_shipped(tmp_path, device, name, parts, method):
    urdf = write_urdf(tmp_path, parts(), name)
    assert main(["scene", "robot", str(urdf), "--out", str(tmp_path)]) == 0
    scene = load_scene(tmp_path / f"{name}_open.usda")
    for seed in (1,) if method == "cloi" else (1, 2):
        start = replace(scene, start=sample_start(scene, seed))
        log = Episode(start, best(method), method=method, device=device, seed=seed).run()
        found = summarize(log)
        assert found.success, f"seed {seed}: {found.ended}"
        assert found.max_contact_robot_obstacle_n <= 5.0
        assert found.max_contact_object_obstacle_n <= 30.0
        assert found.max_contact_tool_object_n <= 25.0
        assert found.max_joint_acceleration <= best(method).safety.acceleration_limit + 1e-6
        assert found.max_joint_jerk <= best(method).safety.jerk_limit + 1e-6
