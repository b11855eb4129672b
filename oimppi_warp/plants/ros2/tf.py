"""Transforms between frames, from the topics /tf and /tf_static."""

from __future__ import annotations

import math
import threading
from typing import Any

import numpy as np

from oimppi_warp.plants.ros2.messages import seconds


class TfTree:
    """The newest transform of each frame; it may be used from several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._edges: dict[str, tuple[str, np.ndarray, float]] = {}

    def take(self, message: Any, *, static: bool = False) -> None:
        """Takes a ``tf2_msgs/msg/TFMessage``; transforms that are not finite are left out.

        Args:
            message: The message.
            static: Whether its transforms are valid at any time.
        """
        with self._lock:
            for each in message.transforms:
                matrix = matrix_of(each.transform.translation, each.transform.rotation)
                if np.isfinite(matrix).all():
                    stamp = math.inf if static else seconds(each.header.stamp)
                    self._edges[_plain(each.child_frame_id)] = (_plain(each.header.frame_id), matrix, stamp)

    def lookup(self, target: str, source: str) -> tuple[np.ndarray, float] | None:
        """Returns the pose of a frame in another one.

        Args:
            target: Frame in which the pose is given.
            source: Frame whose pose is given.

        Returns:
            Transform, shape [4, 4] [m], and the stamp of its oldest part, since 1970 [s], infinite if all are static;
            ``None`` if the frames are not connected.
        """
        with self._lock:
            up, down = self._to_root(_plain(source)), self._to_root(_plain(target))
        for frame, (matrix, stamp) in up.items():  # from the source upwards
            if frame in down:
                there, other = down[frame]
                return np.linalg.inv(there) @ matrix, min(stamp, other)
        return None

    def frames(self) -> list[str]:
        """Returns the names of all frames, in alphabetical order."""
        with self._lock:
            return sorted({*self._edges, *(parent for parent, _, _ in self._edges.values())})

    def _to_root(self, frame: str) -> dict[str, tuple[np.ndarray, float]]:
        """Returns the pose of a frame, and its stamp, in each frame from itself to the root."""
        matrix, stamp = np.eye(4), math.inf
        found = {frame: (matrix, stamp)}
        while frame in self._edges:
            frame, step, at = self._edges[frame]
            if frame in found:  # a loop
                break
            matrix, stamp = step @ matrix, min(stamp, at)
            found[frame] = (matrix, stamp)
        return found


def matrix_of(translation: Any, rotation: Any) -> np.ndarray:
    """Returns a transform, shape [4, 4] [m], from the fields x, y, z [m] and x, y, z, w of a quaternion.

    A quaternion that is not of unit length is normalised; one of zeros makes the transform NaN.
    """
    x, y, z, w = rotation.x, rotation.y, rotation.z, rotation.w
    size = math.sqrt(x * x + y * y + z * z + w * w)
    x, y, z, w = (value / size if size > 1e-6 else math.nan for value in (x, y, z, w))
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = translation.x, translation.y, translation.z
    return matrix


def planar(matrix: np.ndarray) -> np.ndarray:
    """Returns the planar pose of a frame, shape [3] [m, m, rad], from its transform, shape [4, 4] [m]."""
    return np.array([matrix[0, 3], matrix[1, 3], math.atan2(matrix[1, 0], matrix[0, 0])])


def _plain(frame: str) -> str:
    """Returns the name of a frame without the slash that old programs put in front."""
    return frame.removeprefix("/")
