"""Bags, the files in which ROS 2 keeps messages: writes them as MCAP, and reads those of all distributions.

No ROS is needed: the package rosbags (extra ``export`` or ``ros2``) defines and encodes the messages.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from oimppi_warp.config import ros2_topics as names
from oimppi_warp.errors import OimppiError, missing_package
from oimppi_warp.record.log import LogError

SUFFIXES = (".mcap", ".db3", ".bag")
"""Suffixes of bags that are single files: MCAP, SQLite, and ROS 1."""

_FOREVER = (9223372036, 854775807)
"""Duration that ROS 2 understands as infinite: seconds and nanoseconds."""
_DEPTHS = {names.TF: 100}
"""Number of messages that late subscribers may be behind, where it is not 10."""
_LISTED = 20
"""Number of topics that an error message lists at most."""
_METADATA = "metadata.yaml"


@dataclass(frozen=True)
class BagMessage:
    """A message that was read from a bag.

    Attributes:
        topic: Name of its topic.
        kind: Type, such as ``sensor_msgs/msg/JointState``.
        time: Time at which it was recorded [ns].
        content: The message; its attributes are the fields of the type.
    """

    topic: str
    kind: str
    time: int
    content: Any


class BagWriter:
    """Writes a bag: a folder with an MCAP file and ``metadata.yaml``, readable from ROS 2 Humble on.

    It is a context manager; when its block raises, the bag is incomplete.

    Args:
        folder: Folder to write; it must not exist.

    Attributes:
        types: Classes of the messages by type; their attributes in capitals are the type's constants.
        file: The MCAP file in the folder.

    Raises:
        ConfigError: The package rosbags is not installed.
    """

    def __init__(self, folder: Path) -> None:
        bags = _rosbags("rosbags.rosbag2")
        self._store = _typestore()
        self.types: Mapping[str, Any] = self._store.types
        self._bag = bags.Writer(folder, version=8, storage_plugin=bags.StoragePlugin.MCAP)
        self._bag.set_compression(bags.CompressionMode.STORAGE, bags.CompressionFormat.ZSTD)
        self._connections: dict[str, Any] = {}
        self.file = folder / f"{folder.name}.mcap"

    def __enter__(self) -> BagWriter:
        self._bag.open()
        return self

    def __exit__(self, *raised: Any) -> None:
        self._bag.__exit__(*raised)

    def make(self, kind: str, **fields: Any) -> Any:
        """Returns a message of the type ``kind``, given all of its fields."""
        return self.types[kind](**fields)

    def write(self, topic: str, nanoseconds: int, message: Any, *, latched: bool = False) -> None:
        """Writes a message.

        Args:
            topic: Name of the topic, which is added on first use.
            nanoseconds: Time of the message, since the epoch [ns].
            message: The message.
            latched: Whether late subscribers receive the last message (``transient local``).
        """
        kind = message.__msgtype__
        if topic not in self._connections:
            self._connections[topic] = self._bag.add_connection(
                topic, kind, typestore=self._store, offered_qos_profiles=[_profile(topic, latched)]
            )
        self._bag.write(self._connections[topic], nanoseconds, self._store.serialize_cdr(message, kind))

    def header(self, nanoseconds: int, frame: str) -> Any:
        """Returns a std_msgs/Header."""
        stamp = self.make("builtin_interfaces/msg/Time", sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def pose(self, transform: np.ndarray) -> Any:
        """Returns a geometry_msgs/Pose, given position [m] and quaternion xyzw, shape [7]."""
        x, y, z, qx, qy, qz, qw = map(float, transform)
        return self.make(
            "geometry_msgs/msg/Pose",
            position=self.make("geometry_msgs/msg/Point", x=x, y=y, z=z),
            orientation=self.make("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
        )

    def pose_stamped(self, nanoseconds: int, transform: np.ndarray) -> Any:
        """Returns a geometry_msgs/PoseStamped in the world frame, given a transform, shape [7]."""
        header = self.header(nanoseconds, names.WORLD_FRAME)
        return self.make("geometry_msgs/msg/PoseStamped", header=header, pose=self.pose(transform))

    def transforms(self, nanoseconds: int, frames: Mapping[str, np.ndarray]) -> Any:
        """Returns a tf2_msgs/TFMessage with the transforms, shape [7], of frames in the world frame."""
        header = self.header(nanoseconds, names.WORLD_FRAME)
        stamped = []
        for name, transform in frames.items():
            x, y, z, *_ = map(float, transform)
            moved = self.make(
                "geometry_msgs/msg/Transform",
                translation=self.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
                rotation=self.pose(transform).orientation,
            )
            stamped.append(
                self.make("geometry_msgs/msg/TransformStamped", header=header, child_frame_id=name, transform=moved)
            )
        return self.make("tf2_msgs/msg/TFMessage", transforms=stamped)

    def array(self, values: np.ndarray, label: str) -> Any:
        """Returns a std_msgs/Float64MultiArray with one dimension, which is called ``label``."""
        size = len(values)
        dimension = self.make("std_msgs/msg/MultiArrayDimension", label=label, size=size, stride=size)
        layout = self.make("std_msgs/msg/MultiArrayLayout", dim=[dimension], data_offset=0)
        data = np.ascontiguousarray(values, dtype=np.float64)
        return self.make("std_msgs/msg/Float64MultiArray", layout=layout, data=data)


class BagReader:
    """Reads a bag; a context manager.

    Args:
        path: A rosbag2 folder, or a file with one of :data:`SUFFIXES`.

    Attributes:
        path: The bag's path.
        topics: Types of the topics, such as ``sensor_msgs/msg/JointState``, by name.

    Raises:
        LogError: The path is not a bag that can be read.
        ConfigError: The package rosbags is not installed.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.topics: dict[str, str] = {}
        highlevel = _rosbags("rosbags.highlevel")
        with _readable(self.path):
            self._reader = highlevel.AnyReader([_entry(self.path)], default_typestore=_typestore())
        self._stack = ExitStack()

    def __enter__(self) -> BagReader:
        with _readable(self.path):
            self._stack.enter_context(self._reader)
            self.topics = {
                connection.topic: connection.msgtype for connection in self._reader.connections if connection.msgcount
            }
        return self

    def __exit__(self, *raised: Any) -> None:
        self._stack.__exit__(*raised)

    def messages(self, topics: Collection[str]) -> Iterator[BagMessage]:
        """Yields the messages of some topics, sorted by time.

        Raises:
            LogError: The bag is damaged.
        """
        wanted = [connection for connection in self._reader.connections if connection.topic in topics]
        if not wanted:
            return
        for kind in sorted({connection.msgtype for connection in wanted} - self._reader.typestore.fielddefs.keys()):
            raise LogError(
                f"{self.path}: contains no definition of the type {kind}\n"
                "  to do:   convert it to MCAP with `ros2 bag convert` where this type is installed"
            )
        with _readable(self.path):
            for connection, time, data in self._reader.messages(wanted):
                content = self._reader.deserialize(data, connection.msgtype)
                yield BagMessage(connection.topic, connection.msgtype, time, content)

    def contents(self, kinds: Collection[str] = ()) -> str:
        """Returns a list of the topics with their types, for error messages.

        Args:
            kinds: Types of the topics to list; empty: all.
        """
        topics = sorted((topic, kind) for topic, kind in self.topics.items() if not kinds or kind in kinds)
        listed = [f"{topic} ({kind.replace('/msg/', '/')})" for topic, kind in topics[:_LISTED]]
        more = [f"and {len(topics) - _LISTED} more"] if len(topics) > _LISTED else []
        return ", ".join([*listed, *more]) or "none"


def is_bag(path: str | Path) -> bool:
    """Returns whether a path looks like a bag: a file with one of :data:`SUFFIXES`, or a folder with such a file."""
    path = Path(path)
    return _stored_in(path) != [] or (path / _METADATA).is_file() if path.is_dir() else path.suffix in SUFFIXES


def _stored_in(folder: Path) -> list[Path]:
    return sorted(file for file in folder.iterdir() if file.suffix in SUFFIXES and file.is_file())


def _entry(path: Path) -> Path:
    """Returns the path that rosbags opens: of a folder without metadata, the single file in it.

    Raises:
        LogError: There is no bag.
    """
    if path.is_dir() and not (path / _METADATA).is_file():
        files = _stored_in(path)
        if len(files) == 1:
            return files[0]
        found = f"{len(files)} of them ({', '.join(file.name for file in files)})" if files else "no bag"
        raise LogError(
            f"{path}: contains {found}, and no {_METADATA}\n"
            f"  allowed: a file ending in {', '.join(SUFFIXES)}, or a folder with {_METADATA}"
        )
    if not path.exists():
        raise LogError(f"{path}: there is no such file or folder\n  allowed: a bag")
    if path.is_file() and path.suffix not in SUFFIXES:
        raise LogError(f"{path}: not the name of a bag\n  allowed: names ending in {', '.join(SUFFIXES)}, or a folder")
    return path


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Turns what rosbags raises for a damaged file, from its own errors to those of struct and sqlite3, to LogError."""
    try:
        yield
    except OimppiError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise LogError(
            f"{path}: cannot be read as a bag ({reason.rstrip('.')})\n"
            "  to do:   if it is cut off, copy it again, or repair it: `ros2 bag reindex FOLDER`, `mcap recover FILE`"
        ) from error


def _profile(topic: str, latched: bool) -> Any:
    """Returns the quality of service under which a topic is published."""
    ros = _rosbags("rosbags.interfaces")
    forever = ros.QosTime(*_FOREVER)
    return ros.Qos(
        history=ros.QosHistory.KEEP_LAST,
        depth=1 if latched else _DEPTHS.get(topic, 10),
        reliability=ros.QosReliability.RELIABLE,
        durability=ros.QosDurability.TRANSIENT_LOCAL if latched else ros.QosDurability.VOLATILE,
        deadline=forever,
        lifespan=forever,
        liveliness=ros.QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=forever,
        avoid_ros_namespace_conventions=False,
    )


@cache
def _typestore() -> Any:
    """Returns the message types of ROS 2 Jazzy; those used here are the same from Humble on."""
    types = _rosbags("rosbags.typesys")
    return types.get_typestore(types.Stores.ROS2_JAZZY)


def _rosbags(module: str) -> Any:
    try:
        return import_module(module)
    except ImportError as error:
        raise missing_package("ROS 2 bags", "rosbags", "export") from error
