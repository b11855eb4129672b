"""Bags as a laboratory records them: an arm that swings, and an object that a camera sees once a second."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

JOINTS = tuple(f"joint{i}" for i in range(1, 7))
SHUFFLED = ("joint4", "finger", "joint1", "joint6", "joint2", "joint5", "joint3")
EPOCH = 1_790_000_000 * 10**9
"""Time at which the bags begin [ns]."""
CAMERA = np.array([0.8, -0.2, 0.9]), Rotation.from_euler("xyz", [2.5, 0.3, -1.1])
"""Position and rotation of the camera's frame in the world."""

DETECTION = """std_msgs/Header header
vision_msgs/ObjectHypothesisWithPose[] results
vision_msgs/BoundingBox3D bbox
string id
"""
HYPOTHESIS = "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n"
VISION = {
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score\n",
    "vision_msgs/msg/ObjectHypothesisWithPose": HYPOTHESIS,
    "vision_msgs/msg/Detection3D": DETECTION,
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections\n",
}


def joint_at(time: float) -> np.ndarray:
    """Positions of the arm's joints [rad]."""
    return np.array([0.0, -0.3, -0.9, 0.0, 1.2, 0.0]) + 0.2 * np.sin(time + np.arange(6))


def object_at(time: float) -> tuple[float, float, float]:
    """Planar pose of the object; it turns beyond pi."""
    return 0.4 + 0.01 * time, -0.2 + 0.02 * time, 2.9 + 0.2 * time


class LabBag:
    """Messages of a bag to be, and the ways to write it.

    Args:
        ros: 2 or 1.
    """

    def __init__(self, ros: int = 2) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.ros = ros
        self.store = get_typestore(Stores.ROS2_HUMBLE if ros == 2 else Stores.ROS1_NOETIC)
        types: dict[str, Any] = {}
        tf = {} if ros == 2 else {"tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n"}
        for name, text in (VISION | tf).items():
            types |= get_types_from_msg(text, name)
        self.store.register(types)
        self.messages: list[tuple[float, str, Any]] = []

    def make(self, kind: str, **fields: Any) -> Any:
        package, name = kind.split("/")
        return self.store.types[f"{package}/msg/{name}"](**fields)

    def add(self, time: float, topic: str, message: Any) -> None:
        self.messages.append((time, topic, message))

    def header(self, time: float, frame: str) -> Any:
        stamp = self.make("builtin_interfaces/Time", sec=int(time), nanosec=round(1e9 * (time % 1)))
        more = {"seq": 0} if self.ros == 1 else {}
        return self.make("std_msgs/Header", stamp=stamp, frame_id=frame, **more)

    def vector(self, kind: str, values: Any) -> Any:
        return self.make(kind, **dict(zip("xyzw", map(float, values), strict=False)))

    def pose(self, position: Any, quaternion: Any) -> Any:
        return self.make(
            "geometry_msgs/Pose",
            position=self.vector("geometry_msgs/Point", position),
            orientation=self.vector("geometry_msgs/Quaternion", quaternion),
        )

    def joint_state(
        self, time: float, names: Any, position: Any, velocity: Any = (), topic: str = "/joint_states"
    ) -> None:
        fields = {
            name: np.array(given, dtype=float) for name, given in (("position", position), ("velocity", velocity))
        }
        self.add(
            time,
            topic,
            self.make(
                "sensor_msgs/JointState", header=self.header(time, ""), name=list(names), effort=np.zeros(0), **fields
            ),
        )

    def array(self, time: float, topic: str, values: Any) -> None:
        layout = self.make("std_msgs/MultiArrayLayout", dim=[], data_offset=0)
        data = np.array(values, dtype=float)
        self.add(time, topic, self.make("std_msgs/Float64MultiArray", layout=layout, data=data))

    def transform(
        self, time: float, parent: str, child: str, position: Any, quaternion: Any, topic: str = "/tf"
    ) -> None:
        moved = self.make(
            "geometry_msgs/Transform",
            translation=self.vector("geometry_msgs/Vector3", position),
            rotation=self.vector("geometry_msgs/Quaternion", quaternion),
        )
        header = self.header(time, parent)
        stamped = self.make("geometry_msgs/TransformStamped", header=header, child_frame_id=child, transform=moved)
        self.add(time, topic, self.make("tf2_msgs/TFMessage", transforms=[stamped]))

    def write(self, path: Path, storage: str = "mcap") -> Path:
        """Writes the folder of a bag (``mcap``, ``sqlite3``) or, with ROS 1, a file; returns its path."""
        from rosbags.rosbag1 import Writer as Writer1
        from rosbags.rosbag2 import StoragePlugin, Writer

        if self.ros == 1:
            bag: Any = Writer1(path)
            encode: Callable[[Any, str], Any] = self.store.serialize_ros1
        else:
            bag = Writer(path, version=8, storage_plugin=StoragePlugin[storage.upper()])
            encode = self.store.serialize_cdr
        with bag:
            topics: dict[str, Any] = {}
            for time, topic, message in sorted(self.messages, key=lambda each: each[0]):
                kind = message.__msgtype__
                if topic not in topics:
                    topics[topic] = bag.add_connection(topic, kind, typestore=self.store)
                bag.write(topics[topic], EPOCH + round(1e9 * time), encode(message, kind))
        return path


def seen_by_camera(pose: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Position and quaternion xyzw, in the camera's frame, of an object that lies on the table at a planar pose."""
    position, rotation = CAMERA
    x, y, yaw = pose
    there = rotation.inv().apply(np.array([x, y, 0.025]) - position)
    return there, (rotation.inv() * Rotation.from_euler("z", yaw)).as_quat()


def make_bag(*, seconds: float = 4.0, pose: str = "tf", ros: int = 2, velocity: bool = True) -> LabBag:
    """A bag of a swinging arm: joint states at 100 Hz, commands at 20 Hz, the object once a second from 0.5 s on.

    Args:
        seconds: Its length.
        pose: Message that holds the object's pose: ``tf``, ``pose`` (in the world), ``seen`` (in the camera's frame),
            ``covariance``, ``odometry``, ``detection``, ``detections``, or ``none``.
        ros: 2 or 1.
        velocity: Whether joint states have velocities.
    """
    bag = LabBag(ros)
    for i in range(round(100 * seconds) + 1):
        time = i / 100
        values = dict(zip(JOINTS, joint_at(time), strict=True)) | {"finger": 0.01}
        ahead = dict(zip(JOINTS, 0.2 * np.cos(time + np.arange(6)), strict=True)) | {"finger": 0.0}
        speeds = [ahead[name] for name in SHUFFLED] if velocity else []
        bag.joint_state(time, SHUFFLED, [values[name] for name in SHUFFLED], speeds)
        if i % 5 == 0:
            bag.joint_state(time + 0.001, ["finger"], [0.01])
            bag.array(time, "/velocity_controller/commands", time + np.arange(6))
            bag.array(time, "/velocity_controller/commands_nominal", 10 + time + np.arange(6))
    bag.transform(0.0, "world", "camera", CAMERA[0], CAMERA[1].as_quat(), topic="/tf_static")
    for i in range(max(math.ceil(seconds - 0.5), 0)):
        add_pose(bag, 0.5 + i, pose)
    return bag


def add_pose(bag: LabBag, time: float, kind: str) -> None:
    """Adds the object's pose at a time, as a message of one kind (see :func:`make_bag`)."""
    planar = object_at(time)
    position, quaternion = seen_by_camera(planar)
    upright = bag.pose((*planar[:2], 0.025), Rotation.from_euler("z", planar[2]).as_quat())
    in_camera, seen = bag.header(time, "camera"), bag.pose(position, quaternion)
    spread = {"covariance": np.zeros(36)}
    if kind == "tf":
        bag.transform(time, "camera", "fp_object_pose", position, quaternion)
    elif kind == "pose":
        bag.add(time, "/object_pose", bag.make("geometry_msgs/PoseStamped", header=bag.header(time, ""), pose=upright))
    elif kind == "seen":
        bag.add(time, "/object_pose", bag.make("geometry_msgs/PoseStamped", header=in_camera, pose=seen))
    elif kind == "covariance":
        estimated = bag.make("geometry_msgs/PoseWithCovariance", pose=seen, **spread)
        message = bag.make("geometry_msgs/PoseWithCovarianceStamped", header=in_camera, pose=estimated)
        bag.add(time, "/object_pose", message)
    elif kind == "odometry":
        zero = bag.vector("geometry_msgs/Vector3", (0, 0, 0))
        still = bag.make("geometry_msgs/Twist", linear=zero, angular=zero)
        message = bag.make(
            "nav_msgs/Odometry",
            header=bag.header(time, "world"),
            child_frame_id="object",
            pose=bag.make("geometry_msgs/PoseWithCovariance", pose=upright, **spread),
            twist=bag.make("geometry_msgs/TwistWithCovariance", twist=still, **spread),
        )
        bag.add(time, "/object_pose", message)
    elif kind in ("detection", "detections"):
        elsewhere = bag.pose((9.0, 9.0, 9.0), (0, 0, 0, 1))
        results = []
        for score, where in ((0.2, elsewhere), (0.9, seen), (0.3, elsewhere)):
            guess = bag.make("vision_msgs/ObjectHypothesis", class_id="block", score=score)
            guessed = bag.make("geometry_msgs/PoseWithCovariance", pose=where, **spread)
            results.append(bag.make("vision_msgs/ObjectHypothesisWithPose", hypothesis=guess, pose=guessed))
        size = bag.vector("geometry_msgs/Vector3", (0.1, 0.1, 0.1))
        box = bag.make("vision_msgs/BoundingBox3D", center=elsewhere, size=size)
        message = bag.make("vision_msgs/Detection3D", header=in_camera, results=results, bbox=box, id="")
        if kind == "detections":
            message = bag.make("vision_msgs/Detection3DArray", header=in_camera, detections=[message])
        bag.add(time, "/object_pose", message)
