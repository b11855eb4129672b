"""The object's pose from a ROS 2 topic or a TF frame, and to both."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from oimppi_warp.config.ros2_topics import OBJECT_FRAME, OBJECT_POSE, TF, TF_STATIC, WORLD_FRAME
from oimppi_warp.errors import ConfigError
from oimppi_warp.observation import planar_transform
from oimppi_warp.perception.pose_source import StampedPose
from oimppi_warp.plants.ros2.link import Link, why_no_messages
from oimppi_warp.plants.ros2.messages import (
    DETECTION,
    DETECTIONS,
    POSE,
    POSE_COVARIANCE,
    TRANSFORMS,
    header,
    seconds,
)
from oimppi_warp.plants.ros2.tf import TfTree, matrix_of, planar

_KEPT = 4
"""Number of the latest poses that are kept."""
_TF_DEPTH = 100
"""Number of messages of /tf that may wait."""
_OFF = 0.03
"""Distance of the object's frame from its height on the table from which on its pose cannot be right [m]."""
_MOVED = 0.5
"""Difference of the stamps of a pose and of the frame in which it is given, up to which they belong together [s]."""
_LEAST_UPRIGHT = 0.9
"""Least vertical component of the object's z axis with which it lies flat."""


@dataclass(frozen=True)
class _Seen:
    """A pose in a message, and the classes that it may be of."""

    pose: Any
    classes: tuple[str, ...] = ()


def _pose(message: Any) -> list[_Seen]:
    return [_Seen(message.pose)]


def _pose_with_covariance(message: Any) -> list[_Seen]:
    return [_Seen(message.pose.pose)]


def _detection(message: Any) -> list[_Seen]:
    """Returns the pose of the best hypothesis or, if it has none, that of the bounding box."""
    best = max(message.results, key=lambda result: result.hypothesis.score, default=None)
    classes = (message.id, *(() if best is None else (best.hypothesis.class_id,)))
    pose = None if best is None else best.pose.pose
    unset = pose is None or not any((pose.position.x, pose.position.y, pose.position.z))
    return [_Seen(message.bbox.center if unset else pose, classes)]


def _detections(message: Any) -> list[_Seen]:
    return [seen for each in message.detections for seen in _detection(each)]


_READERS: dict[str, Callable[[Any], list[_Seen]]] = {
    POSE: _pose,
    POSE_COVARIANCE: _pose_with_covariance,
    DETECTION: _detection,
    DETECTIONS: _detections,
}
"""Functions that return the poses in a message, by its type."""


class Ros2Poses:
    """Receives the object's pose (:class:`oimppi_warp.perception.pose_source.PoseSource`).

    Args:
        link: The connection.
        source: Name of a topic, with a slash in front, or of a TF frame.
        kind: Type of the topic's messages; empty: as it is published.
        wanted: Class of the object among several detections; empty: any.
        world: Frame of the scene, in which poses are wanted.
        height: Height of the object's frame while the object lies on the table [m]; ``None``: it is not checked.
        clock: Returns the time of the stamps, since 1970 [s].

    Attributes:
        tree: The transforms between frames.

    Raises:
        ConfigError: The type cannot be read.
    """

    def __init__(
        self,
        link: Link,
        source: str,
        *,
        kind: str = "",
        wanted: str = "",
        world: str,
        height: float | None = None,
        clock: Callable[[], float] = time.time,
    ) -> None:
        if kind and kind not in _READERS:
            raise ConfigError(f"object_type {kind} cannot be read\n  allowed: {', '.join(_READERS)}")
        self._link, self._source, self._world, self._clock = link, source, world, clock
        self._wanted, self._height = wanted, height
        self._kind = "" if source.startswith("/") else TRANSFORMS
        self._poses: deque[StampedPose] = deque(maxlen=_KEPT)
        self._defect = ""
        self._open = True
        self._lock = threading.Lock()
        self.tree = TfTree()
        link.subscribe(TF, TRANSFORMS, self._take_transforms, depth=_TF_DEPTH)
        link.subscribe(TF_STATIC, TRANSFORMS, lambda message: self.tree.take(message, static=True), latched=True)
        if kind:
            self._subscribe(kind)

    @property
    def poses(self) -> list[StampedPose]:
        """Returns the newest poses, the latest last; empty before the first one."""
        self._find_kind()
        return list(self._poses)

    @property
    def problem(self) -> str:
        """Returns why no poses arrive at present, in words; empty if none is known."""
        self._find_kind()
        if self._defect or self._poses:
            return self._defect
        if self._kind != TRANSFORMS:
            return why_no_messages(self._link, self._source, self._kind or POSE)
        known = self.tree.frames()
        if not known:
            return f"no pose of {self._source}: {why_no_messages(self._link, TF, TRANSFORMS)}"
        return (
            f"the frame {self._source} is not connected with {self._world}\n"
            f"  to do:   start what detects the object, or name another frame; there are {', '.join(known)}"
        )

    def close(self) -> None:
        """Takes no further poses; the connection stays open."""
        self._open = False

    def _find_kind(self) -> None:
        """Subscribes to a topic of unknown type once somebody publishes it."""
        if self._kind:
            return
        kinds = [end.kind for end in self._link.endpoints(self._source) if end.publishes and not end.own]
        known = [kind for kind in kinds if kind in _READERS]
        if known:
            self._subscribe(known[0])
        elif kinds:
            self._defect = f"{self._source} is published as {kinds[0]}\n  to do:   publish {', '.join(_READERS)}"

    def _subscribe(self, kind: str) -> None:
        with self._lock:
            if self._kind:
                return
            self._kind, self._defect = kind, ""
        self._link.subscribe(self._source, kind, self._take)

    def _take_transforms(self, message: Any) -> None:
        self.tree.take(message)
        if self._kind != TRANSFORMS:
            return
        found = self.tree.lookup(self._world, self._source)
        if found is not None:
            self._add(*found)

    def _take(self, message: Any) -> None:
        """Takes the pose in a message: of several ones that which is nearest to the latest."""
        stamp, frame = seconds(message.header.stamp), message.header.frame_id
        to_world = np.eye(4)
        if frame not in ("", self._world):
            found = self.tree.lookup(self._world, frame)
            if found is None:
                self._defect = (
                    f"the object's pose is given in the frame {frame}, which is not connected with {self._world}\n"
                    f"  to do:   publish that transform on {TF_STATIC}"
                )
                return
            to_world, placed = found
            if placed != math.inf and abs(placed - stamp) > _MOVED:
                self._defect = (
                    f"the object's pose is given in the frame {frame}, whose place is known for another time only "
                    f"({abs(placed - stamp):.1f} s away)\n  to do:   publish that transform at 10 Hz or more"
                )
                return
        every = _READERS[self._kind](message)
        seen = [each for each in every if not self._wanted or self._wanted in each.classes]
        if not seen:
            if every:
                classes = ", ".join(sorted({name for each in every for name in each.classes if name}))
                self._defect = (
                    f"{self._source} has no {self._wanted}\n  to do:   object_class, one of {classes or 'none'}"
                )
            return
        if len(seen) > 1 and not self._poses:
            self._defect = f"{self._source} has {len(seen)} objects\n  to do:   say which with object_class"
            return
        matrices = [to_world @ matrix_of(each.pose.position, each.pose.orientation) for each in seen]
        if self._poses:
            last = self._poses[-1].pose
            matrices.sort(key=lambda matrix: float(np.hypot(*(planar(matrix) - last)[:2])))
        self._add(matrices[0], stamp)

    def _add(self, matrix: np.ndarray, stamp: float) -> None:
        if not self._open:
            return
        if stamp == math.inf:
            self._defect = f"the frame {self._source} is static\n  to do:   publish what moves on {TF}"
            return
        if not np.isfinite(matrix).all():
            self._defect = f"the object's pose from {self._source} is not finite, or its quaternion is zero"
            return
        if matrix[2, 2] < _LEAST_UPRIGHT:
            tilt = np.degrees(np.arccos(np.clip(matrix[2, 2], -1.0, 1.0)))
            self._defect = (
                f"the object's frame from {self._source} is tilted by {tilt:.0f} degrees\n"
                "  to do:   use a frame whose z axis points up while the object lies on the table"
            )
            return
        if self._height is not None and abs(matrix[2, 3] - self._height) > _OFF:
            self._defect = (
                f"the object's frame from {self._source} is {matrix[2, 3]:.3f} m above {self._world}, not "
                f"{self._height:.3f} m\n"
                f"  to do:   check that {self._world} is at the robot's base, and where on the object the frame is"
            )
            return
        self._defect = ""
        if not any(known.stamp == stamp for known in self._poses):  # a frame is repeated until it changes
            self._poses.append(StampedPose(planar(matrix), time.monotonic(), self._clock() - stamp, stamp))


def pose_publisher(link: Link, height: float) -> Callable[[np.ndarray, float], None]:
    """Returns a function that publishes the object's pose, as a topic and as a TF frame.

    Its arguments are a planar pose, shape [3] [m, m, rad], and the time at which the object had it, in seconds since
    1970.

    Args:
        link: The connection.
        height: Height of the object's frame while the object lies on the table [m].
    """
    topic, frames = link.advertise(OBJECT_POSE, POSE), link.advertise(TF, TRANSFORMS)

    def publish(pose: np.ndarray, stamp: float) -> None:
        x, y, yaw = map(float, pose)
        px, py, pz, qx, qy, qz, qw = planar_transform((x, y, yaw), height).tolist()
        place, turn = {"x": px, "y": py, "z": pz}, {"x": qx, "y": qy, "z": qz, "w": qw}
        head = header(stamp, WORLD_FRAME)
        topic({"header": head, "pose": {"position": place, "orientation": turn}})
        moved = {"translation": place, "rotation": turn}
        frames({"transforms": [{"header": head, "child_frame_id": OBJECT_FRAME, "transform": moved}]})

    return publish
