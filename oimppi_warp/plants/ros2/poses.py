"""The object's pose from a ROS 2 topic or a TF frame, and to both."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable
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
_LEAST_UPRIGHT = 0.9
"""Least vertical component of the object's z axis with which it lies flat."""


def _pose(message: Any) -> list[Any]:
    return [message.pose]


def _pose_with_covariance(message: Any) -> list[Any]:
    return [message.pose.pose]


def _detection(message: Any) -> list[Any]:
    best = max(message.results, key=lambda result: result.hypothesis.score, default=None)
    return [message.bbox.center if best is None else best.pose.pose]


def _detections(message: Any) -> list[Any]:
    return [pose for each in message.detections for pose in _detection(each)]


_READERS: dict[str, Callable[[Any], list[Any]]] = {
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
        world: Frame of the scene, in which poses are wanted.
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
        world: str,
        clock: Callable[[], float] = time.time,
    ) -> None:
        if kind and kind not in _READERS:
            raise ConfigError(f"object_type {kind} cannot be read\n  allowed: {', '.join(_READERS)}")
        self._link, self._source, self._world, self._clock = link, source, world, clock
        self._kind = "" if source.startswith("/") else TRANSFORMS
        self._poses: deque[StampedPose] = deque(maxlen=_KEPT)
        self._defect = ""
        self._open = True
        self._lock = threading.Lock()
        self.tree = TfTree()
        link.subscribe(TF, TRANSFORMS, self._take_transforms)
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
            to_world = found[0]
        seen = [to_world @ matrix_of(pose.position, pose.orientation) for pose in _READERS[self._kind](message)]
        if not seen:
            return
        if self._poses:
            last = self._poses[-1].pose
            seen.sort(key=lambda matrix: float(np.hypot(*(planar(matrix) - last)[:2])))
        self._add(seen[0], stamp)

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
