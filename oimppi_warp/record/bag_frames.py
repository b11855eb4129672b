"""Transforms between named frames over time, as the topics ``/tf`` and ``/tf_static`` report them."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from oimppi_warp.geometry.footprint import quaternion_product, rotation_matrix
from oimppi_warp.record.log import LogError

IDENTITY = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


@dataclass(eq=False)
class _Edge:
    """The transforms of a frame in its parent: times [s] and transforms, shape [7]."""

    parent: str
    static: bool
    times: list[float] = field(default_factory=list)
    transforms: list[np.ndarray] = field(default_factory=list)

    def at(self, time: float) -> np.ndarray | None:
        """Returns the latest transform at a time [s]; ``None`` before the first one. Static ones hold at all times."""
        index = len(self.times) if self.static else bisect_right(self.times, time)
        return self.transforms[index - 1] if index else None


class FrameTree:
    """Frames, each with the transforms in its parent. A leading slash in a frame's name has no meaning."""

    def __init__(self) -> None:
        self._edges: dict[str, _Edge] = {}

    @property
    def frames(self) -> tuple[str, ...]:
        """Returns the names of all frames, sorted."""
        return tuple(sorted({*self._edges, *(edge.parent for edge in self._edges.values())}))

    def add(self, message: Any, time: float, *, static: bool) -> None:
        """Adds the transforms of a tf2_msgs/TFMessage.

        Args:
            message: The message.
            time: Time at which it was recorded [s]; messages are added in the order of time.
            static: Whether its transforms hold at all times.
        """
        for stamped in message.transforms:
            child, parent = stamped.child_frame_id.lstrip("/"), stamped.header.frame_id.lstrip("/")
            edge = self._edges.get(child)
            if edge is not None and edge.parent == parent and static and not edge.static:
                continue  # it moves, whatever else is said
            if edge is None or edge.parent != parent or edge.static != static:
                edge = self._edges[child] = _Edge(parent, static)  # the frame now hangs on another parent
            edge.times.append(time)
            edge.transforms.append(transform_of(stamped.transform.translation, stamped.transform.rotation))

    def updates(self, frame: str) -> list[float]:
        """Returns the times at which a frame was reported [s]; of a static one, those of the frames that it hangs on.

        It is empty if all of them are static.
        """
        for name in self._chain(frame):
            edge = self._edges.get(name)
            if edge is not None and not edge.static:
                return edge.times
        return []

    def transform(self, frame: str, world: str, time: float) -> np.ndarray | None:
        """Returns the latest transform of a frame in the world at a time [s], shape [7]; ``None`` if it is not known.

        Raises:
            LogError: The frames are not connected.
        """
        frame, world = frame.lstrip("/"), world.lstrip("/")
        up, down = self._chain(frame), self._chain(world)
        common = next((name for name in up if name in down), None)
        if common is None:
            raise LogError(
                f"the frame {frame} is not connected to {world}: it leads to {up[-1]}, in which there is no {world}\n"
                f"  allowed: {', '.join(self.frames) or 'there are no frames'}\n"
                "  to do:   --world-frame NAME, the bag's frame that is the scene's world"
            )
        object_in_common = self._product(up[: up.index(common)], time)
        world_in_common = self._product(down[: down.index(common)], time)
        if object_in_common is None or world_in_common is None:
            return None
        return multiply(inverse(world_in_common), object_in_common)

    def _product(self, chain: list[str], time: float) -> np.ndarray | None:
        """Returns the transform of the first frame of a chain in the parent of the last one."""
        product = IDENTITY
        for name in chain:
            step = self._edges[name].at(time)
            if step is None:
                return None
            product = multiply(step, product)
        return product

    def _chain(self, frame: str) -> list[str]:
        """Returns a frame, its parent, and so on.

        Raises:
            LogError: The frames are a loop.
        """
        chain = [frame.lstrip("/")]
        while chain[-1] in self._edges:
            parent = self._edges[chain[-1]].parent
            if parent in chain:
                raise LogError(f"the frames {', '.join([*chain, parent])} are a loop\n  allowed: one parent per frame")
            chain.append(parent)
        return chain


def transform_of(position: Any, quaternion: Any) -> np.ndarray:
    """Returns the transform of messages with x, y, z and x, y, z, w, shape [7]: position [m] and unit quaternion xyzw.

    It is NaN if a number is not finite, or the quaternion is zero.
    """
    values = [position.x, position.y, position.z, quaternion.x, quaternion.y, quaternion.z, quaternion.w]
    transform = np.array(values, dtype=float)
    length = np.linalg.norm(transform[3:])
    if not np.isfinite(transform).all() or length < 1e-6:
        return np.full(7, np.nan)
    transform[3:] /= length
    return transform


def multiply(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Returns the product of two transforms, shape [7]: ``second`` is applied first."""
    position = first[:3] + rotation_matrix(first[3:]) @ second[:3]
    return np.concatenate([position, quaternion_product(first[3:], second[3:])])


def inverse(transform: np.ndarray) -> np.ndarray:
    """Returns the inverse of a transform, shape [7]."""
    back = transform[3:] * np.array([-1.0, -1.0, -1.0, 1.0])
    return np.concatenate([-rotation_matrix(back) @ transform[:3], back])
