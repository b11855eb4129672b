"""Robots as people bring them: what does not matter refuses nothing, and a refusal gives the true reason."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from support.sample_arms import ARMS, FORMATS, Part, SampleArm, Shape, mjcf, ur5_like, urdf, write_arm

from oimppi_warp.authoring.robots.from_urdf import read_urdf
from oimppi_warp.authoring.robots.read import read_arm
from oimppi_warp.authoring.robots.start_pose import with_start
from oimppi_warp.cli.main import main
from oimppi_warp.config.presets import best
from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.feasibility import check_task, sample_start
from oimppi_warp.geometry.kinematics import link_frames, pack_arm, tip_frame, touching_turret
from oimppi_warp.geometry.postures import postures_of
from oimppi_warp.geometry.reach import can_tilt, reach_of
from oimppi_warp.physics.newton_model import ROLES
from oimppi_warp.physics.world import World
from oimppi_warp.record.metrics import summarize
from oimppi_warp.runtime.episode import Episode
from oimppi_warp.scene import Robot, Scene
from oimppi_warp.usd import load_scene

REACH = {"ur5_like": 0.90, "panda_like": 0.80, "widowx_like": 0.48, "so101_like": 0.31, "lite6_like": 0.44}
"""With the stick upright, from the base's origin [m]."""
EVERY = [pytest.param(name, form, id=f"{name}-{form}") for name in ARMS for form in FORMATS]


def desk_arm(size: float = 1.0, **changes: Part) -> SampleArm:
    """An arm of five joints that pans, lifts twice, nods and rolls, 0.69 m long at size 1, with changed parts."""
    long, thick, half = 0.35 * size, 0.03, np.pi / 2
    rod = (Shape("box", (long, thick, thick), (long / 2, 0, 0)),)
    parts = {
        "base": Part("base", shapes=(Shape("box", (0.1, 0.1, 0.02), (0, 0, 0.01)),)),
        "turret": Part(
            "turret", "base", axis=(0, 0, 1), limits=(-2, 2), shapes=(Shape("cylinder", (0.03, 0.06), (0, 0, 0.08)),)
        ),
        "upper": Part("upper", "turret", (0, 0, 0.12), (half, 0, 0), (0, 0, 1), (-0.2, 2.8), mass=0.4, shapes=rod),
        "fore": Part("fore", "upper", (long, 0, 0), axis=(0, 0, 1), limits=(-2.8, 0.5), mass=0.3, shapes=rod),
        "hand": Part("hand", "fore", (long, 0, 0), axis=(0, 0, 1), limits=(-2.5, 2.5), mass=0.1),
        "flange": Part("flange", "hand", (0.06, 0, 0), (0, half, 0), (0, 0, 1), mass=0.05),
    }
    return SampleArm("desk_arm", tuple((parts | changes).values()), effort=20.0, velocity=2.0)


def started(folder: Path, text: str) -> Robot:
    """The robot in a URDF of this text, at its start."""
    file = folder / "arm.urdf"
    file.write_text(text)
    chain, arm = read_arm(file, name="Arm", doc="", length=0.17, radius=0.008)
    return with_start(arm, links=chain.links, joints=chain.joints).robot()


def part(arm: SampleArm, name: str) -> Part:
    return next(each for each in arm.parts if each.name == name)


def added(folder: Path, text: str, *options: str, form: str = "urdf") -> int:
    """The exit status of ``oimppi scene robot`` for a file of this text."""
    file = folder / f"arm.{form}"
    file.write_text(text)
    return main(["scene", "robot", str(file), "--out", str(folder / "out"), *options])


def trial(folder: Path) -> Scene:
    return load_scene(folder / "out" / "arm_open.usda")


def one_message(words: str) -> str:
    """The error message in what the command told, of which there must be one."""
    assert len(re.findall("^oimppi: ", words, re.MULTILINE)) == 1
    assert "Traceback" not in words
    return words[words.index("oimppi: ") :]


# The arms


@pytest.mark.parametrize(("name", "form"), EVERY)
def test_an_arm_becomes_a_robot_with_a_task_in_front_of_it(tmp_path, capsys, name, form):
    file, options = write_arm(tmp_path, name, form)
    assert main(["scene", "robot", str(file), "--out", str(tmp_path), *options]) == 0
    told = capsys.readouterr().out
    assert ("cannot   tilt the stick sideways, with 5 joints" in told) == (name == "so101_like")
    scene = load_scene(tmp_path / f"{name}_open.usda")
    check_task(scene)
    assert scene.start[0] > 0.1
    assert scene.goal[0] > 0.1
    assert reach_of(scene.robot).radius == pytest.approx(REACH[name], abs=0.006)


@pytest.mark.parametrize("name", ARMS)
def test_an_arm_is_the_same_from_both_formats(tmp_path, name):
    arms = []
    for form in FORMATS:
        file, options = write_arm(tmp_path, name, form)
        flange = options[options.index("--flange") + 1] if "--flange" in options else ""
        arms.append(read_arm(file, name="Arm", doc="", length=0.17, radius=0.008, flange=flange)[1])
    (one, other), random = arms, np.random.default_rng(1)
    for _ in range(5):
        joints = random.uniform(-1.0, 1.0, len(one.joints))
        for a, b in zip(tip_frame(one.robot(), joints), tip_frame(other.robot(), joints), strict=True):
            np.testing.assert_allclose(a, b, atol=2e-6)
    for a, b in zip(one.links, other.links, strict=True):
        assert a.mass == pytest.approx(b.mass, rel=1e-5)
        np.testing.assert_allclose(a.inertia, b.inertia, atol=1e-6)
    for a, b in zip(one.joints, other.joints, strict=True):
        assert a.kind == b.kind
        assert (a.lower, a.upper, a.effort) == pytest.approx((b.lower, b.upper, b.effort), rel=1e-5)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("name", "form"), EVERY)
def test_an_arm_pushes_the_object_to_its_goal_gently(tmp_path, device, name, form):
    file, options = write_arm(tmp_path, name, form)
    assert main(["scene", "robot", str(file), "--out", str(tmp_path), *options]) == 0
    scene = load_scene(tmp_path / f"{name}_open.usda")
    start = scene.with_start(sample_start(scene, 1))
    found = summarize(Episode(start, best("cloi"), method="cloi", device=device, seed=1).run())
    assert found.success, found.ended
    assert found.max_contact_robot_obstacle_n <= 5.0
    assert found.max_contact_object_obstacle_n <= 30.0
    assert found.max_contact_tool_object_n <= 25.0


# Turrets


@pytest.mark.parametrize(("radius", "bottom"), [(0.08, 0.05), (0.03, 0.015), (0.06, 0.0), (0.06, -0.05)])
def test_a_turret_may_be_near_the_table_which_no_joint_brings_it_nearer_to(tmp_path, radius, bottom):
    shape = Shape("cylinder", (radius, 0.06), (0, 0, bottom + 0.03))
    arm = desk_arm(turret=replace(part(desk_arm(), "turret"), shapes=(shape,)))
    assert added(tmp_path, urdf(arm)) == 0
    assert [link.path for link in touching_turret(trial(tmp_path).robot)] == (
        ["/World/Robot/link1"] if bottom <= 0 else []
    )


def test_a_turret_in_the_table_neither_collides_with_it_nor_hides_other_links(tmp_path):
    shape = Shape("cylinder", (0.06, 0.06), (0, 0, -0.02))
    arm = desk_arm(turret=replace(part(desk_arm(), "turret"), shapes=(shape,)))
    assert added(tmp_path, urdf(arm)) == 0
    scene = trial(tmp_path)
    assert pack_arm(scene.robot, np.ones(5), "cpu").turret == 1
    made = World(scene).mujoco
    data = mujoco.MjData(made.model)
    data.qpos[made.joint_qpos] = scene.robot.start
    mujoco.mj_forward(made.model, data)
    roles = [{ROLES[made.roles[geom]] for geom in pair} for pair in data.contact.geom]
    assert {"arm", "object"} in roles  # which is at the origin here, in the turret
    assert {"arm", "table"} not in roles


def test_a_link_that_comes_too_near_the_table_is_named_with_its_height(tmp_path, capsys):
    bulky = (Shape("sphere", (0.28,), (0, 0, 0)),)
    arm = desk_arm(hand=replace(part(desk_arm(), "hand"), shapes=bulky))
    assert added(tmp_path, urdf(arm)) == 2
    words = one_message(capsys.readouterr().err)
    assert re.search(r"the best has link hand 0\.\d+ m above|the best has link hand -0\.\d+ m above", words)
    assert "at least 0.02 m below every link" in words
    assert "--tool-length" in words


def test_a_joint_that_has_to_be_at_its_limit_is_named(tmp_path, capsys):
    arm = desk_arm(turret=replace(part(desk_arm(), "turret"), limits=(0.587, 2.0)))
    assert added(tmp_path, urdf(arm)) == 2
    words = one_message(capsys.readouterr().err)
    assert "only with joint turret_joint at a limit (0.588, where it goes from 0.587 to 2)" in words


def test_an_arm_that_faces_the_other_way_is_told_so(tmp_path, capsys):
    arm = desk_arm(turret=replace(part(desk_arm(), "turret"), rpy=(0, 0, np.pi), limits=(-1.0, 1.0)))
    assert added(tmp_path, urdf(arm)) == 2
    assert "turn its base: the tool gets to the table on the side of -x" in one_message(capsys.readouterr().err)


@pytest.mark.parametrize(("height", "side"), [(-0.7, "below"), (0.9, "above")])
def test_an_arm_on_the_floor_or_on_a_pedestal_is_told_so(tmp_path, capsys, height, side):
    turret = part(desk_arm(), "turret")
    arm = desk_arm(turret=replace(turret, at=(0.0, 0.0, height)))
    assert added(tmp_path, urdf(arm)) == 2
    words = one_message(capsys.readouterr().err)
    assert f"put its base on the table, z = 0: its first joint is {abs(height):.2f} m {side} that" in words


@pytest.mark.parametrize("limits", [(-0.5, 0.5), (-0.1, 0.1)])
def test_an_arm_that_hardly_turns_starts_straight_ahead(tmp_path, limits):
    arm = desk_arm(turret=replace(part(desk_arm(), "turret"), limits=limits))
    assert abs(started(tmp_path, urdf(arm)).start[0]) < 0.01


def test_an_arm_whose_base_is_elsewhere_starts_in_front_of_it(tmp_path):
    arm = desk_arm(turret=replace(part(desk_arm(), "turret"), at=(-0.7, 0.8, 0)))
    robot = started(tmp_path, urdf(arm))
    x, y, z = tip_frame(robot, robot.start)[1]
    assert np.hypot(x + 0.7, y - 0.8) < 0.6
    assert x > -0.7
    assert z == pytest.approx(0.05, abs=1e-3)


def quill(up: float, turn: float) -> str:
    """A SCARA whose quill begins this high above the table [m], its frame turned about x [rad]."""
    return urdf(
        replace(
            scara(0.1),
            parts=tuple(
                replace(each, at=(*each.at[:2], up))
                if each.name == "arm1"
                else replace(each, rpy=(turn, 0, 0))
                if each.name == "quill"
                else each
                for each in scara(0.1).parts
            ),
        )
    )


@pytest.mark.parametrize(("text", "what"), [
    (lambda: quill(0.4, np.pi), "to do:   give a --tool-length of 0.37 m"),
    (lambda: quill(0.2, 0.0), "to do:   give the opposite --tool-axis: no joint turns the stick, which points up"),
    (lambda: urdf(replace(desk_arm(), parts=desk_arm().parts[:4])), "the robot has only 3 joints"),
])  # fmt: skip
def test_an_arm_without_a_start_is_told_what_would_give_it_one(tmp_path, text, what):
    with pytest.raises(SceneError, match=re.escape(what)):
        started(tmp_path, text())


@pytest.mark.parametrize("limits", [(3.5, 9.0), (-9.4, -3.2), (3.0, 6.2832)])
def test_a_joint_may_have_its_range_beyond_half_a_turn(tmp_path, limits):
    usual = started(tmp_path, urdf(desk_arm()))
    arm = desk_arm(turret=replace(part(desk_arm(), "turret"), limits=limits))
    found = started(tmp_path, urdf(arm))
    assert limits[0] + 0.1 < found.start[0] < limits[1] - 0.1
    np.testing.assert_allclose(tip_frame(found, found.start)[1], tip_frame(usual, usual.start)[1], atol=1e-3)


# The reach


def test_a_tilted_first_axis_does_not_lengthen_the_reach(tmp_path):
    arm = ur5_like()
    usual = reach_of(started(tmp_path, urdf(arm))).radius
    for tilt in (0.011, 0.05):
        parts = [replace(each, rpy=(tilt, 0, 0), shapes=()) if each.name == "shoulder" else each for each in arm.parts]
        found = started(tmp_path, urdf(replace(arm, parts=tuple(parts))))
        assert -0.6 * tilt - 0.006 < reach_of(found).radius - usual < 0.006


# The sample task


@pytest.mark.parametrize("size", [0.34, 0.42, 0.5, 0.6, 0.7])
def test_the_task_of_a_short_arm_is_in_front_of_it(tmp_path, size):
    assert added(tmp_path, urdf(desk_arm(size)), "--tool-length", "0.1") == 0
    scene = trial(tmp_path)
    check_task(scene)
    reach = reach_of(scene.robot).radius
    assert 0.2 < reach < 0.56
    assert scene.start[0] > 0.3 * reach
    assert scene.goal[0] > 0.3 * reach


def test_a_robot_is_written_even_if_it_cannot_do_the_task(tmp_path, capsys):
    desk = (Shape("box", (2.0, 2.0, 0.03), (0, 0, 0.015)),)
    arm = desk_arm(base=Part("base", shapes=desk))
    assert added(tmp_path, urdf(arm)) == 0
    told = capsys.readouterr().out
    assert "there is no sample task: the object's start" in told
    assert "oimppi scene new TASK --robot arm" in told
    assert sorted(file.name for file in (tmp_path / "out").rglob("*.usda")) == ["arm.usda"]


# Names


def test_names_with_slashes_and_quotes_are_names(tmp_path, capsys):
    text = urdf(desk_arm())
    for name in ("base", "turret", "upper", "fore", "hand", "flange"):
        text = re.sub(rf'"{name}(_joint)?"', rf'"desk/it&apos;s/{name}\1"', text)
    assert added(tmp_path, text, "--flange", "desk/it's/flange") == 0
    told = capsys.readouterr().out
    assert "along z of desk/it's/flange" in told
    assert "desk/it's/turret_joint, desk/it's/upper_joint" in told


def test_an_elbow_that_could_fold_starts_stretched(tmp_path):
    file, options = write_arm(tmp_path, "lite6_like", "urdf")
    assert main(["scene", "robot", str(file), "--out", str(tmp_path), *options]) == 0
    robot = load_scene(tmp_path / "lite6_like_open.usda").robot
    assert robot.joints[2].upper > 5.0  # it turns beyond half a turn
    assert np.abs(robot.start).max() < 2.0


def test_joints_of_a_suspicious_speed_are_named(tmp_path):
    for velocity, asked in ((0.001, 5), (2.2, 0)):
        (tmp_path / "arm.urdf").write_text(urdf(replace(desk_arm(), velocity=velocity)))
        chain, _ = read_urdf(tmp_path / "arm.urdf")
        notes = [note for note in chain.notes if "moves at 0.001 rad/s at most; is that its unit?" in note]
        assert len(notes) == asked, chain.notes


# Rounded angles


@pytest.mark.parametrize("angle", [0.0016, *(pytest.param(angle, marks=pytest.mark.slow) for angle in (0.0001, 0.008))])
@pytest.mark.parametrize("name", ["turret", "upper", "hand", "flange"])
def test_rounded_angles_change_neither_reach_nor_postures(tmp_path, name, angle):
    exact = desk_arm()
    x, y, z = part(exact, name).rpy
    tilted = desk_arm(**{name: replace(part(exact, name), rpy=(x + angle, y, z))})
    robots: list[Robot] = []
    for number, arm in enumerate((exact, tilted)):
        folder = tmp_path / str(number)
        folder.mkdir()
        assert added(folder, urdf(arm)) == 0
        robots.append(trial(folder).robot)
    reaches = [reach_of(robot) for robot in robots]
    assert reaches[1].border is None
    assert reaches[1].radius == pytest.approx(reaches[0].radius, abs=0.006)
    assert not any(map(can_tilt, robots))
    reached = [int(postures_of(robot, 0.02).reached.sum()) for robot in robots]
    assert reached[1] == pytest.approx(reached[0], rel=0.03)
    assert tip_frame(robots[1], robots[1].start)[0][2, 2] < -np.cos(1.2 * angle + 1e-3)


def test_slides_with_rounded_angles_stay_flat(tmp_path):
    def gantry(angle: float) -> SampleArm:
        head = (Shape("box", (0.05, 0.05, 0.05), (0, 0, 0.05)),)
        return SampleArm(
            "gantry",
            (
                Part("base"),
                Part("bridge", "base", (0, 0, 0.182), (angle, 0, 0), (0, 1, 0), (-0.7, 0.7), slides=True),
                Part("carriage", "bridge", axis=(1, 0, 0), limits=(0.05, 0.9), slides=True, shapes=head),
            ),
        )

    assert added(tmp_path, urdf(gantry(3.14)), "--tool-axis=z") == 0
    (lower, upper) = reach_of(trial(tmp_path).robot).bounds
    np.testing.assert_allclose([*lower, *upper], [0.05, -0.7, 0.9, 0.7], atol=2e-3)


# What is wrong


def scara(stroke: float) -> SampleArm:
    """Two upright joints, and a quill whose tip gets down to 0.23 m minus the stroke with a stick of 0.17 m."""
    arm = (Shape("box", (0.3, 0.05, 0.05), (0.15, 0, 0)),)
    return SampleArm(
        "scara",
        (
            Part("base", mass=3.0),
            Part("arm1", "base", (0, 0, 0.4), axis=(0, 0, 1), limits=(-2.5, 2.5), shapes=arm),
            Part("arm2", "arm1", (0.3, 0, 0), axis=(0, 0, 1), limits=(-2.5, 2.5), shapes=arm),
            Part("quill", "arm2", (0.3, 0, 0), axis=(0, 0, 1), limits=(-stroke, 0.0), slides=True, mass=0.3),
        ),
    )


def test_a_tip_that_does_not_get_down_to_the_table_is_told_how_low_it_gets(tmp_path, capsys):
    assert added(tmp_path, urdf(scara(0.24)), "--tool-axis=-z") == 0
    capsys.readouterr()
    assert added(tmp_path, urdf(scara(0.22)), "--tool-axis=-z", "--force") == 2
    words = one_message(capsys.readouterr().err)
    assert "the tip gets no lower than 0.010 m" in words
    assert "give a --tool-length that is longer by 0.010 m" in words
    assert added(tmp_path, urdf(scara(0.22)), "--tool-axis=-z", "--tool-length", "0.185", "--force") == 0


def changed(what: str, to: str, count: int = 1) -> str:
    text = urdf(desk_arm())
    assert what in text
    return text.replace(what, to, count)


MOMENTS = 'ixx="0.0016" iyy="0.0016" izz="0.0016"'
"""The moments of the link upper."""
BAD: dict[str, tuple[Callable[[], str], str]] = {
    "two joints of one name": (lambda: changed("fore_joint", "upper_joint"), "2 joints have the name upper_joint"),
    "two links of one name": (
        lambda: changed('<link name="fore"', '<link name="upper"'), "2 links have the name upper",
    ),
    "a link without a name": (lambda: changed('<link name="fore"', "<link"), "<link> number 4 has no name"),
    "no child": (lambda: changed('<child link="fore"/>', ""), "joint fore_joint has no child"),
    "an unknown link": (lambda: changed('<child link="fore"/>', '<child link="arm"/>'), "a missing link 'arm'"),
    "an axis of zero": (
        lambda: changed('<axis xyz="0 0 1"/><limit lower="-2.8"', '<axis xyz="0 0 0"/><limit lower="-2.8"'),
        "joint fore_joint: the axis is 0 0 0",
    ),
    "an axis of two numbers": (
        lambda: changed('<axis xyz="0 0 1"', '<axis xyz="0 1"'), "joint turret_joint: xyz is '0 1'",
    ),
    "an angle that is none": (
        lambda: changed('rpy="1.5708 0 0"', 'rpy="nan 0 0"'), "joint upper_joint: rpy is 'nan 0 0'",
    ),
    "an offset in the sky": (lambda: changed('xyz="0 0 0.12"', 'xyz="0 0 1e9"'), "joint upper_joint: xyz is '0 0 1e9'"),
    "no effort": (lambda: changed('effort="20"', 'effort="0"'), "joint turret_joint: the effort limit is 0 N m"),
    "limits from a converter": (
        lambda: changed('lower="-2" upper="2"', 'lower="-3.4e38" upper="3.4e38"'),
        "joint turret_joint: the limits -3.4e38 and 3.4e38 are no limits",
    ),
    "infinite limits": (
        lambda: changed('lower="-2" upper="2"', 'lower="-inf" upper="inf"'), "turret_joint: the limits -inf and inf",
    ),
    "a limit that is none": (lambda: changed('lower="-2"', 'lower="nan"'), "joint turret_joint: lower is 'nan'"),
    "a size of zero": (
        lambda: changed('<cylinder radius="0.03"', '<cylinder radius="0"'),
        "link turret: the radius of its <cylinder> is 0",
    ),
    "no size": (lambda: changed('radius="0.03" ', ""), "link turret: <cylinder> has no radius"),
    "no shape": (
        lambda: changed('<cylinder radius="0.03" length="0.06"/>', ""), "link turret: <collision> has no shape",
    ),
    "a mass that is none": (lambda: changed('value="0.4"', 'value="heavy"'), "link upper: mass is 'heavy'"),
    "a negative mass": (lambda: changed('value="0.4"', 'value="-0.4"'), "link upper: the mass is -0.4"),
    "an inertia of zero": (
        lambda: changed('ixx="0.0016" iyy="0.0016" izz="0.0016"', 'ixx="0" iyy="0" izz="0"'),
        "link upper has a physically impossible inertia",
    ),
    "neither an inertial nor a shape": (
        lambda: re.sub(
            r'(<link name="upper">)<inertial>.*?</inertial>.*?</link>', r"\1</link>", urdf(desk_arm()), flags=re.DOTALL
        ),
        "link upper has no mass",
    ),
    "a mass without an inertia": (
        lambda: changed(f'<inertia {MOMENTS} ixy="0" ixz="0" iyz="0"/>', ""),
        "link upper has a physically impossible inertia",
    ),
    "moments of no body": (
        lambda: changed(MOMENTS, 'ixx="0.1" iyy="0.001" izz="0.001"'),
        "link upper has a physically impossible inertia: its principal moments are 0.001, 0.001, 0.1 kg m^2",
    ),
    "moments in g cm^2": (
        lambda: changed(MOMENTS, 'ixx="160" iyy="160" izz="160"'),
        "link upper has a physically impossible inertia for its mass: 160, 160, 160 kg m^2 with 0.4 kg",
    ),
    "a mass in grams": (lambda: changed('value="0.4"', 'value="400"'), "is it in grams? give it in kilograms"),
    "a centre in millimetres": (
        lambda: changed('<inertial><mass value="0.4"', '<inertial><origin xyz="75 0 0"/><mass value="0.4"'),
        "the centre of mass of link upper is 75 m from its frame",
    ),
    "a shape in millimetres": (
        lambda: changed('<box size="0.35 0.03 0.03"/>', '<mesh filename="millimetres.obj"/>'),
        'link upper extends 353 m from the link\'s frame',
    ),
    "all in millimetres": (
        lambda: re.sub(r'xyz="([.\d]+) 0 0"', lambda found: f'xyz="{1000 * float(found[1]):g} 0 0"', urdf(desk_arm())),
        "the arm is 760.1 m long",
    ),
    "limits in degrees": (
        lambda: re.sub('lower="-2" upper="2" (.*?) velocity="2"', r'lower="-115" upper="115" \1 velocity="115"',
                       urdf(desk_arm()), count=1),
        "joint turret_joint turns to 115 rad, at up to 115 rad/s",
    ),
    "a mesh that is empty": (
        lambda: changed('<cylinder radius="0.03" length="0.06"/>', '<mesh filename="empty.obj"/>'),
        "link turret: the collision mesh 'empty.obj'",
    ),
    "a mesh that is none": (
        lambda: changed('<cylinder radius="0.03" length="0.06"/>', '<mesh filename="none.stl"/>'),
        "link turret: the collision mesh 'none.stl' is empty",
    ),
    "a mesh that is flat": (
        lambda: changed('<cylinder radius="0.03" length="0.06"/>', '<mesh filename="flat.obj"/>'),
        "link turret: a collision mesh encloses no volume",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_a_plain_mistake_gives_one_message_that_names_the_element(tmp_path, capsys, case):
    text, what = BAD[case]
    (tmp_path / "empty.obj").write_text("")
    (tmp_path / "none.stl").write_text("nothing")
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n")
    box = np.array(list(np.ndindex(2, 2, 2))) * [350, 30, 30]
    trimesh.convex.convex_hull(box).export(tmp_path / "millimetres.obj")
    assert added(tmp_path, text()) == 2
    assert what in one_message(capsys.readouterr().err)
    assert not (tmp_path / "out").exists()


def test_what_does_not_matter_refuses_nothing(tmp_path):
    text = urdf(desk_arm())
    base = 'ixx="0.004" iyy="0.004" izz="0.004"'
    assert added(tmp_path, text.replace(base, 'ixx="0" iyy="0" izz="0"', 1)) == 0
    assert added(tmp_path, text.replace(base, 'ixx="nan" iyy="a" izz="-1"', 1), "--force") == 0
    finger = Part("finger", "flange", axis=(0, 0, 1), slides=True, shapes=(Shape("sphere", (0.01,)),))
    wrong = urdf(SampleArm("desk_arm", (*desk_arm().parts, finger)))
    for what, to in (
        ('radius="0.01"', 'radius="x"'),
        ('<axis xyz="0 0 1"/><limit lower="-3"', '<axis xyz="0 0 0"/><limit lower="a"'),
    ):
        head, found, tail = wrong.rpartition(what)
        assert found
        wrong = head + to + tail
    assert added(tmp_path, wrong, "--flange", "flange", "--force") == 0


def test_an_inertia_that_no_body_has_is_that_of_the_part_that_is_named(tmp_path, capsys):
    arm = desk_arm()
    cover = Part("cover", "fore", mass=0.4)
    text = urdf(SampleArm("desk_arm", (*arm.parts, cover)))
    head, found, tail = text.rpartition('ixx="0.0016" iyy="0.0016" izz="0.0016"')
    assert found
    assert added(tmp_path, f'{head}ixx="-0.02" iyy="-0.02" izz="-0.02"{tail}') == 2
    assert "link cover has a physically impossible inertia" in one_message(capsys.readouterr().err)


def test_a_part_without_mass_takes_none_from_its_shapes(tmp_path):
    cover = Part("cover", "fore", mass=0.0, shapes=(Shape("box", (0.1, 0.1, 0.1)),))
    text = urdf(SampleArm("desk_arm", (*desk_arm().parts, cover)))
    assert started(tmp_path, text).links[2].mass == pytest.approx(0.3)


def test_a_link_whose_mass_nobody_gives_gets_that_of_its_shapes_and_a_note_says_so(tmp_path, capsys):
    text = re.sub(r'(<link name="upper">)<inertial>.*?</inertial>', r"\1", urdf(desk_arm()), flags=re.DOTALL)
    known, supposed = started(tmp_path, urdf(desk_arm())), started(tmp_path, text)
    assert supposed.links[1].mass > 0.0
    assert supposed.links[1].mass != known.links[1].mass
    assert supposed.links[2].mass == known.links[2].mass
    assert added(tmp_path, text) == 0
    assert "link upper has no mass in the file: taken as" in " ".join(capsys.readouterr().out.split())


def test_an_mjcf_in_radians_that_is_read_in_degrees_is_told_so(tmp_path, capsys):
    text = mjcf(desk_arm()).replace('angle="radian"', 'angle="degree"')
    assert added(tmp_path, text, form="xml") == 2
    words = one_message(capsys.readouterr().err)
    assert "no joint turns further than 3 degrees" in words
    assert '<compiler angle="radian"/>' in words


# What is left out


def in_mjcf(joint: str = "", end: str = "") -> str:
    """The arm as MJCF, with more attributes of the fore joint, and more at the end."""
    text = mjcf(desk_arm()).replace('<joint name="fore_joint"', f'<joint name="fore_joint" {joint}')
    return text.replace("</mujoco>", f"{end}</mujoco>")


TENDON = (
    '<tendon><fixed name="t"><joint joint="upper_joint" coef="1"/><joint joint="fore_joint" coef="1"/></fixed></tendon>'
)
NOTED: dict[str, tuple[Callable[[], str], str]] = {
    "dynamics": (
        lambda: changed('<axis xyz="0 0 1"/><limit lower="-2.8"',
                        '<dynamics damping="2" friction="0.5"/><axis xyz="0 0 1"/><limit lower="-2.8"'),
        "left out: friction and damping of fore_joint;",
    ),
    "damping in mjcf": (lambda: in_mjcf('damping="2"'), "left out: friction and damping of fore_joint;"),
    "a weld": (
        lambda: in_mjcf(end='<equality><weld body1="hand" body2="base"/></equality>'),
        "left out: an equality that joins hand and base",
    ),
    "a tendon": (lambda: in_mjcf(end=TENDON), "left out: a tendon between the joints upper_joint, fore_joint"),
    "a cup": (
        lambda: changed("</robot>", '<link name="cup"/><joint name="cup_joint" type="floating"><parent link="base"/>'
                        '<child link="cup"/></joint></robot>'),
        "left out: link cup, on joint cup_joint of type floating",
    ),
    "one finger": (
        lambda: urdf(SampleArm("arm", (*desk_arm().parts, Part("tool", "flange"), Part(
            "finger", "tool", axis=(0, 1, 0), limits=(0, 0.04), slides=True, mass=0.02)))),
        "if it is that of a gripper, leave it out with --flange tool",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", NOTED)
def test_what_the_robot_does_not_get_is_told_in_one_line(tmp_path, capsys, case):
    text, note = NOTED[case]
    assert added(tmp_path, text(), form="xml" if "<mujoco" in text() else "urdf") == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("  note")]
    assert note in line


@pytest.mark.parametrize(("text", "what", "fix"), [
    (lambda: in_mjcf().replace('range="-2.8 0.5"', 'range="2 -2"'), "fore_joint: the range from 2 to -2", "range"),
    (lambda: in_mjcf(end='<equality><joint joint1="fore_joint"/></equality>'), "joint fore_joint is held", "equality"),
    (lambda: '<mujoco><worldbody><body name="cup"><freejoint/><geom size="0.03"/></body></worldbody></mujoco>',
     "body cup floats", "oimppi scene import arm.xml"),
    (lambda: changed('"upper_joint" type="revolute"', '"upper_joint" type="planar"'),
     "joint upper_joint between turret and upper is of type planar", "replace it by revolute or prismatic joints"),
])  # fmt: skip
def test_what_holds_or_frees_a_joint_is_refused(tmp_path, capsys, text, what, fix):
    assert added(tmp_path, text(), form="xml" if "<mujoco" in text() else "urdf") == 2
    words = one_message(capsys.readouterr().err)
    assert what in words
    assert fix in words[words.index("to do:") :]


def test_a_bad_colour_refuses_nothing(tmp_path):
    box = '<visual><geometry><sphere radius="1"/></geometry><material name="{}"><color rgba="{}"/></material></visual>'
    text = changed('<link name="upper">', f'<link name="upper">{box.format("one", "1 0")}')
    text = text.replace(
        '<link name="base">', '<material name="two"><color rgba="a b c d"/></material><link name="base">'
    )
    assert len(started(tmp_path, text).links) == 5


def test_a_file_whose_name_is_no_name_of_a_robot_is_told_one(tmp_path, capsys):
    file = tmp_path / "6dof arm.urdf"
    file.write_text(urdf(desk_arm()))
    assert main(["scene", "robot", str(file), "--out", str(tmp_path)]) == 2
    assert "to do:   --name arm_6dof_arm" in one_message(capsys.readouterr().err)


def test_the_advice_for_a_xacro_file_keeps_the_file(tmp_path, capsys):
    macro = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="m"/></robot>'
    for form in ("urdf", "urdf.xacro", "xacro"):
        assert added(tmp_path, macro, form=form) == 2
        (source, made) = re.findall(r"xacro (\S+) > (\S+)", one_message(capsys.readouterr().err))[0]
        assert (source, made) == (f"arm.{form}", "arm_expanded.urdf")


@pytest.mark.parametrize(
    "text", ["", "<", "<robot/>", "<mujoco/>", "<sdf/>", "nothing", '<?xml version="1.0" encoding="x"?><a/>']
)
def test_what_is_no_robot_is_refused_in_one_message(tmp_path, capsys, text):
    for form in ("urdf", "xml", "usda"):
        assert added(tmp_path, text, form=form) == 2
        one_message(capsys.readouterr().err)
    assert main(["scene", "robot", str(tmp_path / "none.xml")]) == 2
    assert "there is no such file" in one_message(capsys.readouterr().err)


def test_a_format_is_known_by_its_root_element(tmp_path):
    for form, text in (("xml", urdf(desk_arm())), ("urdf", mjcf(desk_arm()))):
        assert added(tmp_path, text, "--force", form=form) == 0
        assert len(link_frames(trial(tmp_path).robot, trial(tmp_path).robot.start)[1]) == 5
