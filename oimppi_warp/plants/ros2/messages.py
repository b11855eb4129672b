"""ROS 2 messages: their definitions, their types for DDS, and their type hashes.

Definitions come from rosbags, those of vision_msgs and control_msgs from here. A message to be sent is given as a
nested mapping of its fields; one that is received has its fields as attributes, as in rclpy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

from oimppi_warp.errors import ConfigError, missing_package

POSE = "geometry_msgs/msg/PoseStamped"
POSE_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
DETECTION = "vision_msgs/msg/Detection3D"
DETECTIONS = "vision_msgs/msg/Detection3DArray"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
JOINT_STATE = "sensor_msgs/msg/JointState"
NUMBERS = "std_msgs/msg/Float64MultiArray"
JOINT_JOG = "control_msgs/msg/JointJog"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
CLOCK = "rosgraph_msgs/msg/Clock"

_DEFINITIONS = {
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose"
    ),
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    DETECTION: (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\nvision_msgs/BoundingBox3D bbox\n"
        "string id"
    ),
    DETECTIONS: "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
    JOINT_JOG: (
        "std_msgs/Header header\nstring[] joint_names\nfloat64[] displacements\nfloat64[] velocities\nfloat64 duration"
    ),
}
"""Definitions of messages that rosbags lacks, by type."""


@cache
def typestore() -> Any:
    """Returns the definitions, as a type store of rosbags.

    Raises:
        ConfigError: The extra is not installed.
    """
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError:
        raise missing("rosbags") from None
    store = get_typestore(Stores.ROS2_HUMBLE)
    for kind, definition in _DEFINITIONS.items():
        store.register(get_types_from_msg(definition, kind))
    return store


def type_hash(kind: str) -> str:
    """Returns the type hash (REP 2011) of a message, such as ``RIHS01_…``.

    Args:
        kind: Type of the message, such as ``std_msgs/msg/String``.
    """
    return typestore().hash_rihs01(kind)


def dds_name(kind: str) -> str:
    """Returns the name that a type has in DDS, such as ``std_msgs::msg::dds_::String_``."""
    package, folder, name = kind.split("/")
    return f"{package}::{folder}::dds_::{name}_"


def ros_name(name: str) -> str:
    """Returns the type that has a name in DDS; see :func:`dds_name`."""
    return name.replace("::dds_::", "::").removesuffix("_").replace("::", "/")


@cache
def dds_type(kind: str) -> Any:
    """Returns a message's type for cyclonedds, a subclass of its ``IdlStruct``.

    Raises:
        ConfigError: The extra is not installed.
    """
    try:
        from cyclonedds.idl import make_idl_struct
    except ImportError:
        raise missing("cyclonedds") from None
    members = {name: _dds_field(description) for name, description in typestore().fielddefs[kind][1]}
    name = dds_name(kind).replace("::", ".")
    return make_idl_struct(name.rpartition(".")[2], name, members)


def _dds_field(description: Any) -> Any:
    """Returns cyclonedds' type of a field that rosbags describes."""
    from cyclonedds.idl import types
    from rosbags.interfaces import Nodetype

    node, details = description
    match node:
        case Nodetype.BASE:
            name = details[0]
            return {"string": str, "bool": bool}[name] if name in ("string", "bool") else getattr(types, name)
        case Nodetype.NAME:
            return dds_type(details)
        case Nodetype.ARRAY:
            return types.array[_dds_field(details[0]), details[1]]
        case _:
            return types.sequence[_dds_field(details[0])]


def build(kind: str, values: Mapping[str, Any], types: Callable[[str], Any]) -> Any:
    """Makes a message.

    Args:
        kind: Its type.
        values: Its fields by name; those of nested messages are mappings again, and those that are missing are zero or
            empty.
        types: The class of each type.

    Raises:
        KeyError: The type has no such field.
    """
    members = dict(typestore().fielddefs[kind][1])
    if unknown := values.keys() - members.keys():
        raise KeyError(f"{kind} has no field {', '.join(sorted(unknown))}")
    return types(kind)(**{name: _field(member, values.get(name), types) for name, member in members.items()})


def _field(description: Any, value: Any, types: Callable[[str], Any]) -> Any:
    """Returns the value of a field that rosbags describes; ``None`` stands for one that is missing."""
    from rosbags.interfaces import Nodetype

    node, details = description
    match node:
        case Nodetype.BASE:
            empty = {"string": "", "bool": False}.get(details[0], 0.0 if details[0].startswith("float") else 0)
            return empty if value is None else value
        case Nodetype.NAME:
            return build(details, value or {}, types)
        case Nodetype.ARRAY if value is None:
            return [_field(details[0], None, types)] * details[1]
        case _:
            return [_field(details[0], each, types) for each in (() if value is None else value)]


def missing(package: str) -> ConfigError:
    """Returns the error of a package that is not installed."""
    return missing_package("ROS 2", package, "ros2")


def header(stamp: float, frame: str) -> dict[str, Any]:
    """Returns a ``std_msgs/msg/Header``.

    Args:
        stamp: Time since 1970 [s].
        frame: Frame.
    """
    return {"stamp": time_fields(stamp), "frame_id": frame}


def time_fields(stamp: float) -> dict[str, int]:
    """Returns a ``builtin_interfaces/msg/Time`` or ``Duration`` of seconds."""
    sec, nanosec = divmod(round(1e9 * stamp), 10**9)
    return {"sec": sec, "nanosec": nanosec}


def seconds(time: Any) -> float:
    """Returns the seconds of a ``builtin_interfaces/msg/Time`` or ``Duration``."""
    return time.sec + 1e-9 * time.nanosec
