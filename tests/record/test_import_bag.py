"""A laboratory's bag as a record: what is taken from it, and what is said of bags that cannot be used."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support.lab_bags import EPOCH, JOINTS, LabBag, add_pose, joint_at, make_bag, object_at

from oimppi_warp.errors import OimppiError
from oimppi_warp.record.import_bag import BagSources, ImportedBag, import_bag
from oimppi_warp.record.log import EpisodeLog
from oimppi_warp.record.metrics import pose_error, summarize
from oimppi_warp.scene import Scene
from oimppi_warp.usd import load_scene

pytest.importorskip("rosbags.highlevel")

STEPS = 70
"""Control steps of 0.05 s in a bag of 4 s in which the object is seen from 0.5 s on."""


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("task02")


def imported(bag: LabBag, scene: Scene, path: Path, **sources) -> ImportedBag:
    return import_bag(bag.write(path), scene, BagSources(**sources))


def wrapped(angles: np.ndarray) -> np.ndarray:
    return (angles + math.pi) % (2 * math.pi) - math.pi


def test_a_record_has_the_latest_state_and_pose_at_the_end_of_each_step(scene: Scene, tmp_path: Path):
    log = imported(make_bag(), scene, tmp_path / "bag").log
    assert len(log) == STEPS
    ends = 0.5 + 0.05 * np.arange(1, STEPS + 1)
    np.testing.assert_allclose(log["time"], ends - 0.5, atol=1e-9)
    np.testing.assert_allclose(log["joint_position"], [joint_at(time) for time in ends], atol=1e-9)
    speeds = [0.2 * np.cos(time + np.arange(6)) for time in ends]
    np.testing.assert_allclose(log["joint_velocity"], speeds, atol=1e-9)
    seen = np.array([object_at(0.5 + math.floor(time - 0.5 + 1e-9)) for time in ends])
    np.testing.assert_allclose(log["object_pose"][:, :2], seen[:, :2], atol=1e-9)
    np.testing.assert_allclose(wrapped(log["object_pose"][:, 2] - seen[:, 2]), 0.0, atol=1e-9)
    assert np.flatnonzero(log["detection"]).tolist() == [19, 39, 59]
    errors = [pose_error(pose, scene.goal)[0] for pose in seen]
    np.testing.assert_allclose(log["position_error"], errors, atol=1e-9)


def test_a_command_is_the_latest_at_the_beginning_of_its_step(scene: Scene, tmp_path: Path):
    log = imported(make_bag(), scene, tmp_path / "bag").log
    begins = 0.5 + 0.05 * np.arange(STEPS)
    np.testing.assert_allclose(log["command"], begins[:, None] + np.arange(6), atol=1e-9)
    np.testing.assert_allclose(log["planned_command"], 10 + begins[:, None] + np.arange(6), atol=1e-9)


def test_without_velocities_they_are_those_between_the_steps(scene: Scene, tmp_path: Path):
    log = imported(make_bag(velocity=False), scene, tmp_path / "bag").log
    before = np.array([joint_at(0.5 + 0.05 * step) for step in range(STEPS + 1)])
    np.testing.assert_allclose(log["joint_velocity"], np.diff(before, axis=0) / 0.05, atol=1e-9)


@pytest.mark.parametrize("pose", ["pose", "seen", "covariance", "odometry", "detection", "detections"])
def test_every_message_with_a_pose_says_the_same(pose: str, scene: Scene, tmp_path: Path):
    expected = imported(make_bag(), scene, tmp_path / "tf").log["object_pose"]
    found = imported(make_bag(pose=pose), scene, tmp_path / "bag")
    np.testing.assert_allclose(found.log["object_pose"], expected, atol=1e-9)
    assert found.tilt == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("ros", "storage"), [(2, "sqlite3"), (1, "")])
def test_every_kind_of_file_gives_the_same_record(ros: int, storage: str, scene: Scene, tmp_path: Path):
    expected = imported(make_bag(), scene, tmp_path / "mcap").log
    path = make_bag(ros=ros).write(tmp_path / ("other.bag" if ros == 1 else "other"), storage)
    log = import_bag(path, scene).log
    assert log.columns == expected.columns
    for name in log.columns:
        np.testing.assert_array_equal(log[name], expected[name])
    if ros == 2:
        (single,) = path.glob("*.db3")
        np.testing.assert_array_equal(import_bag(single, scene).log["time"], log["time"])
        (path / "metadata.yaml").unlink()
        np.testing.assert_array_equal(import_bag(path, scene).log["time"], log["time"])


def test_the_world_may_be_any_frame(scene: Scene, tmp_path: Path):
    """In the frame of a base at (1, 2) that is turned by a right angle, (x, y) is at (y - 2, 1 - x)."""
    bag = make_bag()
    bag.transform(0.0, "world", "link_base", (1, 2, 0), (0, 0, math.sin(math.pi / 4), math.cos(math.pi / 4)), "/tf")
    log = imported(bag, scene, tmp_path / "bag", world_frame="link_base").log
    x, y, yaw = object_at(0.5)
    np.testing.assert_allclose(log["object_pose"][0], [y - 2, 1 - x, yaw - math.pi / 2], atol=1e-9)


def test_other_names_of_topics_frames_and_joints_can_be_given(scene: Scene, tmp_path: Path):
    bag, joints = LabBag(), tuple(f"arm_{name}" for name in JOINTS)
    for i in range(101):
        bag.joint_state(i / 100, joints, joint_at(i / 100), topic="/arm/states")
        bag.joint_state(i / 100, joints[::-1], np.zeros(6), np.arange(6), topic="/arm/asked")
        bag.transform(i / 100, "/world", "/block", (0.1, i / 1000, 0), (0, 0, 0, 1))
    sources = {"joint_states": "/arm/states", "object": "block", "commands": "/arm/asked"}
    log = imported(bag, scene, tmp_path / "bag", joint_names=joints, control_period=0.1, **sources).log
    np.testing.assert_allclose(log["time"], 0.1 * np.arange(1, 11), atol=1e-9)
    np.testing.assert_allclose(log["object_pose"][:, 1], 0.01 * np.arange(1, 11), atol=1e-9)
    np.testing.assert_array_equal(log["command"], np.tile(np.arange(6)[::-1], (10, 1)))


def test_the_first_point_of_a_trajectory_is_a_command(scene: Scene, tmp_path: Path):
    bag = make_bag()
    still = bag.make("builtin_interfaces/Duration", sec=0, nanosec=0)
    nothing = np.zeros(0)
    points = [
        bag.make(
            "trajectory_msgs/JointTrajectoryPoint",
            positions=nothing,
            velocities=np.array(speeds, dtype=float),
            accelerations=nothing,
            effort=nothing,
            time_from_start=still,
        )
        for speeds in (np.arange(6), np.zeros(6))
    ]
    header = bag.header(0.7, "")
    asked = bag.make("trajectory_msgs/JointTrajectory", header=header, joint_names=list(JOINTS[::-1]), points=points)
    bag.add(0.7, "/asked", asked)
    log = imported(bag, scene, tmp_path / "bag", commands="/asked").log
    assert np.isnan(log["command"][:4]).all(), "nothing had been commanded"
    np.testing.assert_array_equal(log["command"][4:], np.tile(np.arange(6)[::-1], (STEPS - 4, 1)))
    assert "planned_command" not in log.columns


def test_a_detection_without_hypotheses_has_the_pose_of_its_box(scene: Scene, tmp_path: Path):
    bag = make_bag(pose="none")
    size = bag.vector("geometry_msgs/Vector3", (0.1, 0.1, 0.1))
    box = bag.make("vision_msgs/BoundingBox3D", center=bag.pose((0.4, 0.1, 0), (0, 0, 0, 1)), size=size)
    in_world = bag.header(0.5, "world")
    found = bag.make("vision_msgs/Detection3D", header=in_world, results=[], bbox=box, id="")
    for time, detections in ((0.5, [found]), (1.5, [])):
        message = bag.make("vision_msgs/Detection3DArray", header=in_world, detections=detections)
        bag.add(time, "/found", message)
    result = imported(bag, scene, tmp_path / "bag", object="/found")
    np.testing.assert_allclose(result.log["object_pose"], np.tile([0.4, 0.1, 0.0], (STEPS, 1)), atol=1e-12)
    assert len(result.tracks["object"].times) == 1, "nothing was found the second time"


def test_a_record_of_a_bag_is_saved_and_has_metrics(scene: Scene, tmp_path: Path):
    bag = make_bag(pose="none")
    x, y, yaw = scene.goal
    bag.transform(0.5, "world", "fp_object_pose", (x + 0.01, y, 0.025), (0, 0, math.sin(yaw / 2), math.cos(yaw / 2)))
    log = EpisodeLog.load(imported(bag, scene, tmp_path / "bag").log.save(tmp_path / "record"))
    metrics = summarize(log)
    assert metrics.success and metrics.steps == STEPS
    assert metrics.position_error_m == pytest.approx(0.01)
    assert metrics.run.plant == "bag"
    assert log.header["source"]["object"] == "the frame fp_object_pose"
    assert log.header["began_ns"] == EPOCH + 5 * 10**8


def test_a_tilted_object_is_noticed(scene: Scene, tmp_path: Path):
    bag = make_bag(pose="none")
    bag.transform(0.5, "world", "fp_object_pose", (0.4, 0, 0), (math.sin(0.35), 0, 0, math.cos(0.35)))
    assert imported(bag, scene, tmp_path / "bag").tilt == pytest.approx(0.7)


def _no_states(bag: LabBag) -> None:
    bag.messages = [each for each in bag.messages if each[1] != "/joint_states"]


def _gap(bag: LabBag) -> None:
    bag.messages = [each for each in bag.messages if each[1] != "/joint_states" or not 1.5 < each[0] < 2.5]


def _nothing(bag: LabBag) -> None:
    bag.messages = []


def _other_names(bag: LabBag) -> None:
    _no_states(bag)
    bag.joint_state(1.0, ["left", "right"], [0, 0])


def _short_state(bag: LabBag) -> None:
    bag.joint_state(1.0, JOINTS, [0, 0])


def _nan_state(bag: LabBag) -> None:
    bag.joint_state(2.0, JOINTS, [0, 0, math.nan, 0, 0, 0])


def _degrees(bag: LabBag) -> None:
    bag.joint_state(2.0, JOINTS, [0, 90, 0, 0, 0, 0])


def _second_arm(bag: LabBag) -> None:
    _no_states(bag)
    for topic in ("/left", "/right"):
        bag.joint_state(1.0, JOINTS, np.zeros(6), topic=topic)


def _no_object(bag: LabBag) -> None:
    bag.messages = [each for each in bag.messages if each[1] != "/tf"]


def _nan_object(bag: LabBag) -> None:
    bag.transform(2.0, "camera", "fp_object_pose", (math.nan, 0, 0), (0, 0, 0, 1))


def _no_rotation(bag: LabBag) -> None:
    bag.transform(2.0, "camera", "fp_object_pose", (0, 0, 0), (0, 0, 0, 0))


def _unconnected(bag: LabBag) -> None:
    bag.messages = [each for each in bag.messages if each[1] != "/tf_static"]


def _loop(bag: LabBag) -> None:
    bag.transform(0.1, "fp_object_pose", "world", (0, 0, 0), (0, 0, 0, 1))


def _long_command(bag: LabBag) -> None:
    bag.array(2.0, "/velocity_controller/commands", np.zeros(7))


def _late_object(bag: LabBag) -> None:
    _no_object(bag)
    add_pose(bag, 9.0, "tf")


BROKEN: dict[str, tuple[Callable[[LabBag], None], dict, str]] = {
    "nothing": (_nothing, {}, "contains no messages"),
    "no joint states": (
        _no_states,
        {},
        r"no joint states; its topics are: /tf \(tf2_msgs/TFMessage\), .*--joint-states",
    ),
    "two arms": (_second_arm, {}, "several topics of joint states: /left, /right.*--joint-states"),
    "other joints": (_other_names, {}, "no message has the joints joint1, .*but left, right.*--joint-names"),
    "too few names": (lambda bag: None, {"joint_names": ("a", "b")}, "2 joint names.*allowed: 6"),
    "too few positions": (_short_state, {}, "6 names and 2 positions, at 1.000 s"),
    "a joint that is not a number": (_nan_state, {}, "/joint_states: 1 of 402 messages have .*at 2.000 s"),
    "degrees": (_degrees, {}, "joint2 is at 90, .*outside its limits.*radians"),
    "a gap": (_gap, {}, "no joint state for 1.00 s, from 1.50 s on.*--longest-gap 1"),
    "no object": (
        _no_object,
        {},
        "neither a topic nor a frame fp_object_pose\n.*pose: none; frames: camera, world\n.*--object",
    ),
    "no such object": (lambda bag: None, {"object": "cup"}, "neither a topic nor a frame cup"),
    "an object without a pose": (lambda bag: None, {"object": "/joint_states"}, "has the type sensor_msgs/JointState"),
    "an object that is not a number": (_nan_object, {}, "the frame fp_object_pose: 1 of 5 messages.*at 2.000 s"),
    "an object without a rotation": (_no_rotation, {}, "1 of 5 messages have .*quaternion of zero"),
    "frames without a way": (_unconnected, {}, "fp_object_pose is not connected to world: it leads to camera"),
    "no such world": (lambda bag: None, {"world_frame": "map"}, "not connected to map.*--world-frame"),
    "frames in a loop": (_loop, {}, "are a loop"),
    "a long command": (_long_command, {}, "/velocity_controller/commands: a message has 7 velocities"),
    "no such commands": (
        lambda bag: None,
        {"commands": "/cmd"},
        "--commands /cmd: no such topic in the bag; its topics are: /joint.*/tf",
    ),
    "no such states": (lambda bag: None, {"joint_states": "/js"}, "--joint-states /js: no such topic"),
    "an object after the arm": (_late_object, {}, "joint states .0.00 to 4.00 s. and poses of the object .9.00"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_bag_that_cannot_be_used_is_refused_with_what_it_has(name: str, scene: Scene, tmp_path: Path):
    spoil, sources, expected = BROKEN[name]
    bag = make_bag()
    spoil(bag)
    with pytest.raises(OimppiError, match=f"(?s){expected}") as raised:
        imported(bag, scene, tmp_path / "bag", **sources)
    first, *others = str(raised.value).split("\n")
    assert others and all(line.startswith(("  allowed: ", "  to do:   ")) for line in others), first


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_file_that_is_cut_off_anywhere_is_refused_or_read(storage: str, scene: Scene, tmp_path: Path):
    (file,) = [
        each for each in make_bag(seconds=1.0).write(tmp_path / "bag", storage).iterdir() if each.suffix != ".yaml"
    ]
    content, cut = file.read_bytes(), tmp_path / f"cut{file.suffix}"
    refused = 0
    lengths = [0, 1, 7, 8, 20, *np.linspace(30, len(content) - 1, 25).astype(int).tolist()]
    for length in lengths:
        cut.write_bytes(content[:length])
        try:
            import_bag(cut, scene)
        except OimppiError as error:
            assert "\n  " in str(error)
            refused += 1
    assert refused >= len(lengths) - 3


def test_what_is_no_bag_is_refused(scene: Scene, tmp_path: Path):
    with pytest.raises(OimppiError, match="no such file"):
        import_bag(tmp_path / "none.mcap", scene)
    (tmp_path / "text.txt").write_text("hello")
    with pytest.raises(OimppiError, match=r"names ending in \.mcap"):
        import_bag(tmp_path / "text.txt", scene)
    (tmp_path / "text.mcap").write_text("hello")
    with pytest.raises(OimppiError, match="cannot be read as a bag"):
        import_bag(tmp_path / "text.mcap", scene)
    (tmp_path / "folder").mkdir()
    with pytest.raises(OimppiError, match=r"contains no bag, and no metadata\.yaml"):
        import_bag(tmp_path / "folder", scene)
    for name in ("a.mcap", "b.mcap"):
        (tmp_path / "folder" / name).write_text("hello")
    with pytest.raises(OimppiError, match=r"contains 2 of them \(a.mcap, b.mcap\)"):
        import_bag(tmp_path / "folder", scene)
