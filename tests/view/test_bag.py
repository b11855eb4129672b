"""A record as a ROS 2 bag: what is in the file, and the record read back from it."""

from __future__ import annotations

import struct
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from support.device import DEVICE

from oimppi_warp.cli.main import main
from oimppi_warp.config.overrides import set_option
from oimppi_warp.config.presets import best
from oimppi_warp.errors import ConfigError
from oimppi_warp.record.bag_record import load_record
from oimppi_warp.record.log import COLUMNS, EpisodeLog
from oimppi_warp.record.metrics import summarize
from oimppi_warp.runtime.episode import Episode
from oimppi_warp.usd import load_scene
from oimppi_warp.view.export import export
from oimppi_warp.view.replay import Replay

highlevel = pytest.importorskip("rosbags.highlevel")
interfaces = pytest.importorskip("rosbags.interfaces")
zstd = pytest.importorskip("backports.zstd")

STEPS = 20
KINDS = {
    "/joint_states": ("sensor_msgs/msg/JointState", STEPS),
    "/velocity_controller/commands_nominal": ("std_msgs/msg/Float64MultiArray", STEPS),
    "/velocity_controller/commands": ("std_msgs/msg/Float64MultiArray", STEPS),
    "/object_pose": ("geometry_msgs/msg/PoseStamped", STEPS),
    "/oimppi/reference": ("geometry_msgs/msg/PoseStamped", STEPS),
    "/oimppi/plan": ("nav_msgs/msg/Path", 2),
    "/oimppi/markers": ("visualization_msgs/msg/MarkerArray", 1),
    "/oimppi/record": ("std_msgs/msg/String", 1),
    "/tf": ("tf2_msgs/msg/TFMessage", STEPS),
    "/tf_static": ("tf2_msgs/msg/TFMessage", 1),
    "/oimppi/columns/position_error": ("std_msgs/msg/Float64", STEPS),
    "/oimppi/columns/cost_terms": ("std_msgs/msg/Float64MultiArray", STEPS),
}
LATCHED = {"/oimppi/markers", "/oimppi/record", "/tf_static"}


@pytest.fixture(scope="module")
def record(tmp_path_factory) -> Path:
    config = set_option(best("cloi"), "episode.max_sim_seconds=1.0")
    for level in ("robot", "object"):
        config = set_option(config, f"{level}.optimizer.samples=64")
    log = Episode(load_scene("task02"), config, method="cloi", engine="quasistatic", device=DEVICE).run()
    return log.save(tmp_path_factory.mktemp("record"))


@pytest.fixture(scope="module")
def file(record: Path) -> Path:
    return export(record, "mcap")


@pytest.fixture(scope="module")
def messages(file: Path) -> dict[str, list]:
    found: dict[str, list] = {}
    with highlevel.AnyReader([file]) as bag:
        for connection, time, data in bag.messages():
            found.setdefault(connection.topic, []).append((time, bag.deserialize(data, connection.msgtype)))
    return found


def test_a_record_comes_back_from_its_bag(record: Path, file: Path):
    log, again = EpisodeLog.load(record), load_record(file)
    assert again.header == log.header
    assert len(again) == STEPS
    assert again.columns == log.columns
    for name in COLUMNS:
        np.testing.assert_array_equal(again[name], log[name], err_msg=name)
    assert [step for step, _ in again.references] == [0, 10]
    for (_, path), (_, other) in zip(log.references, again.references, strict=True):
        np.testing.assert_allclose(other, path, atol=1e-15)
    assert summarize(again).json() == summarize(log).json()


def test_a_bag_is_replayed_like_its_record(record: Path, file: Path):
    shown, expected = Replay(file).picture(7), Replay(record).picture(7)
    np.testing.assert_array_equal(shown.joints, expected.joints)
    np.testing.assert_array_equal(shown.object_transform, expected.object_transform)
    np.testing.assert_allclose(shown.reference, expected.reference, atol=1e-15)
    assert shown.figures == expected.figures


def test_topics_have_the_types_and_the_profiles_that_ros_expects(file: Path):
    with highlevel.AnyReader([file]) as bag:
        found = {each.topic: each for each in bag.connections}
    assert {topic: (found[topic].msgtype, found[topic].msgcount) for topic in KINDS} == KINDS
    for topic, each in found.items():
        (profile,) = each.ext.offered_qos_profiles
        latched = profile.durability is interfaces.QosDurability.TRANSIENT_LOCAL
        assert latched == (topic in LATCHED), topic
        assert profile.reliability is interfaces.QosReliability.RELIABLE


def test_messages_hold_what_the_record_holds(record: Path, messages: dict[str, list]):
    log = EpisodeLog.load(record)
    row, start, stamp = 7, round(1e9 * log["time"][6]), round(1e9 * log["time"][7])
    for topic, column in (
        ("/velocity_controller/commands", "command"),
        ("/velocity_controller/commands_nominal", "planned_command"),
    ):
        time, message = messages[topic][row]
        assert time == start, "the command is for the control step that begins"
        np.testing.assert_array_equal(message.data, log[column][row])
    joints = messages["/joint_states"][row][1]
    assert joints.name == [f"joint{i}" for i in range(1, 7)]
    np.testing.assert_array_equal(joints.position, log["joint_position"][row])
    np.testing.assert_array_equal(joints.velocity, log["joint_velocity"][row])
    assert joints.header.stamp.sec * 10**9 + joints.header.stamp.nanosec == stamp
    pose = messages["/object_pose"][row][1]
    assert pose.header.frame_id == "world"
    yaw = 2 * np.arctan2(pose.pose.orientation.z, pose.pose.orientation.w)
    np.testing.assert_allclose(
        [pose.pose.position.x, pose.pose.position.y, yaw], log["estimated_pose"][row], atol=1e-12
    )
    assert messages["/oimppi/columns/clearance"][row][1].data == log["clearance"][row]


def test_frames_of_the_markers_lead_to_the_world_and_the_object_is_where_it_was(
    record: Path, messages: dict[str, list]
):
    still, moved = messages["/tf_static"][0][1].transforms, messages["/tf"][7][1].transforms
    frames = {each.child_frame_id: each for each in [*still, *moved]}
    assert len(frames) == len(still) + len(moved)
    assert {each.header.frame_id for each in frames.values()} == {"world"}
    (_, array), *others = messages["/oimppi/markers"]
    assert not others
    assert {marker.header.frame_id for marker in array.markers} <= frames.keys() | {"world"}
    assert len({(marker.ns, marker.id) for marker in array.markers}) == len(array.markers)
    assert {"base", "goal"} <= {each.child_frame_id for each in still}
    block = frames["fp_object_pose"].transform.translation
    np.testing.assert_allclose([block.x, block.y], EpisodeLog.load(record)["object_pose"][7, :2], atol=1e-6)


def test_markers_have_the_sizes_of_their_shapes(messages: dict[str, list]):
    markers = {marker.ns: marker for marker in messages["/oimppi/markers"][0][1].markers}
    cube = markers["World/Obstacles/Cube"]
    assert (cube.type, cube.header.frame_id) == (cube.CUBE, "world")
    np.testing.assert_allclose([cube.scale.x, cube.scale.y, cube.scale.z], 0.1, atol=1e-6)
    link = markers["World/Robot/link1/skin/column"]
    assert link.type == link.TRIANGLE_LIST and len(link.points) == 3 * 288
    assert link.frame_locked and link.action == link.ADD
    ghosts = [marker for marker in messages["/oimppi/markers"][0][1].markers if marker.header.frame_id == "goal"]
    assert len(ghosts) == 2, "the two boxes of the T"
    assert all(ghost.color.a < 0.5 < cube.color.a for ghost in ghosts)


def test_the_file_has_the_encodings_that_foxglove_reads(file: Path):
    """In an MCAP file schemas have the encoding ros2msg, and channels cdr (https://mcap.dev/spec/registry)."""
    schemas, channels = {}, {}
    for code, body in mcap_records(file.read_bytes()):
        if code == 0x03:
            (number,) = struct.unpack_from("<H", body)
            schemas[number] = strings(body[2:], 2)
        elif code == 0x04:
            _, schema = struct.unpack_from("<HH", body)
            topic, encoding = strings(body[4:], 2)
            channels[topic] = (schemas[schema], encoding)
    assert {topic: channels[topic] for topic in KINDS} == {
        topic: ([kind, "ros2msg"], "cdr") for topic, (kind, _) in KINDS.items()
    }


def mcap_records(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Yields the records of an MCAP file, those in chunks included: operation code and content."""
    assert content.startswith(b"\x89MCAP0\r\n")
    yield from _records(content[8:-8])


def _records(content: bytes) -> Iterator[tuple[int, bytes]]:
    at = 0
    while at < len(content):
        code, length = struct.unpack_from("<BQ", content, at)
        body = content[at + 9 : at + 9 + length]
        at += 9 + length
        if code == 0x06:
            (named,) = struct.unpack_from("<I", body, 28)
            compression, packed = body[32 : 32 + named], body[40 + named :]
            yield from _records(zstd.decompress(packed) if compression == b"zstd" else packed)
        else:
            yield code, body


def strings(content: bytes, count: int) -> list[str]:
    found = []
    for _ in range(count):
        (length,) = struct.unpack_from("<I", content)
        found.append(content[4 : 4 + length].decode())
        content = content[4 + length :]
    return found


def test_a_folder_for_older_tools_has_metadata_and_the_same_record(record: Path, tmp_path: Path, capsys):
    folder = tmp_path / "bag"
    assert main(["export", str(record), "--to", "rosbag2", "--output", str(folder)]) == 0
    assert capsys.readouterr().out.strip() == str(folder)
    about = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert about["storage_identifier"] == "mcap"
    assert about["relative_file_paths"] == [file.name for file in folder.glob("*.mcap")]
    profiles = {
        each["topic_metadata"]["name"]: yaml.safe_load(each["topic_metadata"]["offered_qos_profiles"])
        for each in about["topics_with_message_count"]
    }
    assert profiles["/tf_static"][0]["durability"] == 1  # as Humble reads it: transient local
    assert profiles["/tf"][0]["durability"] == 2
    np.testing.assert_array_equal(load_record(folder)["command"], EpisodeLog.load(record)["command"])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bag"]
    assert main(["export", str(record), "--to", "rosbag2", "--output", str(folder)]) == 2
    assert "exists already\n  to do:" in capsys.readouterr().err


def test_a_bag_is_exported_again_beside_itself(file: Path, tmp_path: Path):
    copy = tmp_path / "copy.mcap"
    copy.write_bytes(file.read_bytes())
    assert export(copy, "rosbag2") == tmp_path / "copy"
    np.testing.assert_array_equal(load_record(tmp_path / "copy")["time"], load_record(file)["time"])


def test_a_bag_without_rosbags_asks_for_it(file: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(ConfigError, match=r"rosbags is not.*\n  to do:   pip install 'oimppi-warp\[export\]'"):
        load_record(file)
