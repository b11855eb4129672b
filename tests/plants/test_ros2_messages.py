"""ROS 2 messages without ROS: bytes, names and hashes."""

from __future__ import annotations

import numpy as np
import pytest

from oimppi_warp.plants.ros2 import messages
from oimppi_warp.plants.ros2.messages import build, dds_name, dds_type, header, ros_name, type_hash, typestore

FILLED = {
    messages.POSE: {
        "header": header(1.000000002, "world"),
        "pose": {"position": {"x": 1.0, "y": 2.0, "z": 3.0}, "orientation": {"w": 1.0}},
    },
    messages.POSE_COVARIANCE: {
        "header": header(5.5, "a"),
        "pose": {"pose": {"position": {"y": -2.5}}, "covariance": [float(i) for i in range(36)]},
    },
    messages.JOINT_STATE: {
        "header": header(1795819741.1, "base"),
        "name": ["joint1", "j2", "third_joint"],
        "position": [0.1, -0.2, 0.3],
        "velocity": [1.0],
    },
    messages.NUMBERS: {
        "layout": {"dim": [{"label": "joint", "size": 6, "stride": 6}], "data_offset": 0},
        "data": [0.1, 0.2, 0.3, 0.4, 0.5, 0.0],
    },
    messages.TRANSFORMS: {
        "transforms": [
            {"header": header(2.0, "world"), "child_frame_id": "camera", "transform": {"rotation": {"w": 1.0}}},
            {"child_frame_id": "fp_object_pose", "transform": {"translation": {"x": 0.5}}},
        ]
    },
    messages.DETECTIONS: {
        "header": header(3.0, "camera"),
        "detections": [
            {"id": "can", "results": [{"hypothesis": {"class_id": "can", "score": 0.75}}]},
            {"bbox": {"size": {"x": 0.1}}},
        ],
    },
    messages.JOINT_JOG: {"joint_names": ["joint1", "j2"], "velocities": [0.1, 0.2], "duration": 0.05},
    messages.TRAJECTORY: {
        "joint_names": ["joint1"],
        "points": [
            {"positions": [1.0], "velocities": [0.5], "time_from_start": {"nanosec": 100_000_000}},
            {"positions": [1.1], "time_from_start": {"sec": 1}},
        ],
    },
    messages.CLOCK: {"clock": {"sec": 7, "nanosec": 8}},
    messages.DETECTION: {"header": header(3.0, "camera"), "id": "x"},
}
HASHES = {  # of a ROS installation, by their first digits
    messages.POSE: "10f3786d7d40fd2b",
    messages.POSE_COVARIANCE: "26432f9803e43727",
    messages.NUMBERS: "1025ddc6b9552d19",
    messages.JOINT_STATE: "a13ee3a330e346c9",
    messages.TRAJECTORY: "179b33eba59d676f",
    messages.TRANSFORMS: "e369d0f05a23ae52",
}


def rosbags_type(kind: str):
    """The class of rosbags, whose lists of numbers are arrays."""
    cls, members = typestore().types[kind], dict(typestore().fielddefs[kind][1])

    def made(**values):
        arrays = {
            name: np.array(v) for name, v in values.items() if isinstance(v, list) and "float64" in str(members[name])
        }
        return cls(**values | arrays)

    return made


@pytest.mark.parametrize("kind", FILLED)
def test_bytes_are_those_of_another_implementation(kind):
    ours = build(kind, FILLED[kind], dds_type).serialize(use_version_2=False)
    theirs = bytes(typestore().serialize_cdr(build(kind, FILLED[kind], rosbags_type), kind))
    assert ours == theirs
    back = dds_type(kind).deserialize(ours)
    assert back == build(kind, FILLED[kind], dds_type)


def test_a_pose_stamped_byte_by_byte():
    data = build(messages.POSE, FILLED[messages.POSE], dds_type).serialize(use_version_2=False)
    assert len(data) == 84
    assert data[:4] == bytes([0, 1, 0, 0]), "CDR, little endian, XCDR1"
    assert data[4:12] == bytes([1, 0, 0, 0, 2, 0, 0, 0])
    assert data[12:22] == bytes([6, 0, 0, 0]) + b"world\0"
    assert data[28:36] == np.float64(1.0).tobytes(), "doubles lie at multiples of 8 after the first 4 bytes"


@pytest.mark.parametrize("kind", HASHES)
def test_hashes_are_those_of_ros(kind):
    assert type_hash(kind).startswith(f"RIHS01_{HASHES[kind]}")
    assert len(type_hash(kind)) == len("RIHS01_") + 64


def test_names_in_dds():
    assert dds_name(messages.POSE) == "geometry_msgs::msg::dds_::PoseStamped_"
    assert ros_name(dds_name(messages.POSE)) == messages.POSE


def test_a_field_that_does_not_exist():
    with pytest.raises(KeyError, match="no field stamp"):
        build(messages.POSE, {"stamp": 1.0}, dds_type)
