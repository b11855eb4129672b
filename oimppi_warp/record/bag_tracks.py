"""What a laboratory's bag tells over time: joint states, commands, and poses of the object."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from oimppi_warp.record.bag import BagMessage
from oimppi_warp.record.bag_frames import FrameTree, multiply, transform_of
from oimppi_warp.record.log import LogError


@dataclass(frozen=True, eq=False)
class Track:
    """Values over time.

    Attributes:
        source: Topic or frame that they come from, for messages.
        times: Times at which they were recorded, sorted, shape [n] [s].
        values: Values, shape [n, size].
    """

    source: str
    times: np.ndarray
    values: np.ndarray

    def at(self, times: np.ndarray) -> np.ndarray:
        """Returns the latest values at some times [s], shape [times, size]; NaN before the first one."""
        index = np.searchsorted(self.times, times, side="right") - 1
        found = self.values[np.maximum(index, 0)].astype(float)
        found[index < 0] = np.nan
        return found

    def longest_gap(self, begin: float, end: float) -> tuple[float, float]:
        """Returns the longest time without a new value between two times, and when it began [s]."""
        inside = self.times[(self.times > begin) & (self.times < end)]
        times = np.concatenate([[begin], inside, [end]])
        index = int(np.argmax(np.diff(times)))
        return float(times[index + 1] - times[index]), float(times[index])

    def checked(self) -> Track:
        """Returns itself, if there are values and all of them are finite.

        Raises:
            LogError: There are none, or some are not finite.
        """
        if not len(self.times):
            raise LogError(f"{self.source}: the bag has no messages of it\n  to do:   name another topic or frame")
        bad = np.flatnonzero(~np.isfinite(self.values).all(axis=1))
        if len(bad):
            raise LogError(
                f"{self.source}: {len(bad)} of {len(self.times)} messages have numbers that are not finite, or a "
                f"quaternion of zero, the first one at {self.times[bad[0]]:.3f} s\n"
                "  to do:   import a part of the bag without them, or name another topic or frame"
            )
        return self


def joint_tracks(messages: Sequence[tuple[float, BagMessage]], joints: Sequence[str]) -> tuple[Track, Track | None]:
    """Returns positions and velocities of joints, in their order.

    Messages without all of the joints, such as those of a gripper on the same topic, are left out.

    Args:
        messages: Messages of one topic of the type sensor_msgs/JointState, with their times [s].
        joints: Names of the joints.

    Returns:
        Positions, and velocities if all messages have them.

    Raises:
        LogError: No message has all of the joints, or a message has not as many positions as names.
    """
    source = messages[0][1].topic if messages else "joint states"
    seen: dict[str, None] = {}
    times, positions, velocities = [], [], []
    for time, message in messages:
        state = message.content
        seen |= dict.fromkeys(state.name)
        if not set(joints) <= set(state.name):
            continue
        if len(state.position) != len(state.name):
            raise LogError(
                f"{source}: a message has {len(state.name)} names and {len(state.position)} positions, at {time:.3f} s"
                "\n  allowed: as many positions as names"
            )
        order = [state.name.index(joint) for joint in joints]
        times.append(time)
        positions.append(np.asarray(state.position)[order])
        complete = len(state.velocity) == len(state.name)
        velocities.append(np.asarray(state.velocity)[order] if complete else np.full(len(joints), np.nan))
    if messages and not times:
        raise LogError(
            f"{source}: no message has the joints {', '.join(joints)} of the scene's arm, "
            f"but {', '.join(sorted(seen)) or 'no joints'}\n"
            "  to do:   --joint-names NAME,..., the names in the bag in the order of the arm's joints"
        )
    track = Track(source, np.array(times), np.array(positions).reshape(-1, len(joints))).checked()
    speeds = np.array(velocities)
    return track, Track(source, track.times, speeds) if np.isfinite(speeds).all() else None


def command_track(messages: Sequence[tuple[float, BagMessage]], joints: Sequence[str]) -> Track:
    """Returns commanded joint velocities, in the order of the joints.

    Args:
        messages: Messages of one topic, with their times [s]: std_msgs/Float64MultiArray in the order of the joints,
            sensor_msgs/JointState, or trajectory_msgs/JointTrajectory, whose first point counts.
        joints: Names of the joints.

    Raises:
        LogError: A message has not one velocity for each joint.
    """
    source = messages[0][1].topic if messages else "commands"
    rows = []
    for time, message in messages:
        content, kind = message.content, message.kind
        if kind == "std_msgs/msg/Float64MultiArray":
            named, values = list(joints), content.data
        elif kind == "sensor_msgs/msg/JointState":
            named, values = content.name, content.velocity
        else:
            named, values = content.joint_names, content.points[0].velocities if content.points else ()
        if len(values) != len(named) or not set(joints) <= set(named):
            raise LogError(
                f"{source}: a message has {len(values)} velocities for the joints {', '.join(named)}, at {time:.3f} s\n"
                f"  allowed: one velocity for each joint of the scene's arm: {', '.join(joints)}"
            )
        rows.append(np.asarray(values, dtype=float)[[named.index(joint) for joint in joints]])
    times = np.array([time for time, _ in messages])
    return Track(source, times, np.array(rows).reshape(-1, len(joints))).checked()


COMMAND_KINDS = ("std_msgs/msg/Float64MultiArray", "sensor_msgs/msg/JointState", "trajectory_msgs/msg/JointTrajectory")
"""Types of message that :func:`command_track` reads."""


def topic_track(messages: Sequence[tuple[float, BagMessage]], frames: FrameTree, world: str) -> Track:
    """Returns transforms of the object in the world, shape [n, 7], from messages of one topic.

    Args:
        messages: Messages of one of :data:`POSE_KINDS`, with their times [s].
        frames: The frames in which they may be.
        world: Frame of the world; a message without a frame is in the world.

    Raises:
        LogError: A frame is not connected to the world, or there is no pose that can be used.
    """
    times, values = [], []
    for time, message in messages:
        for header, pose in POSE_KINDS[message.kind](message.content):
            in_world = frames.transform(header.frame_id or world, world, time)
            if in_world is not None:
                times.append(time)
                values.append(multiply(in_world, transform_of(pose.position, pose.orientation)))
    source = messages[0][1].topic if messages else "the object's pose"
    return Track(source, np.array(times), np.array(values).reshape(-1, 7)).checked()


def frame_track(frame: str, frames: FrameTree, world: str) -> Track:
    """Returns transforms of a frame in the world, shape [n, 7], one each time that it was reported.

    Raises:
        LogError: The frame is not connected to the world, or there is no transform that can be used.
    """
    found = [(time, frames.transform(frame, world, time)) for time in frames.updates(frame) or [0.0]]
    known = [(time, transform) for time, transform in found if transform is not None]
    times, values = np.array([time for time, _ in known]), np.array([transform for _, transform in known])
    return Track(f"the frame {frame}", times, values.reshape(-1, 7)).checked()


def _best_detection(detections: Iterable[Any]) -> Iterable[tuple[Any, Any]]:
    """Yields header and pose of the vision_msgs/Detection3D with the highest score; without hypotheses, of its box."""
    ranked = []
    for detection in detections:
        ranked += [(each.hypothesis.score, detection.header, each.pose.pose) for each in detection.results]
        if not detection.results:
            ranked.append((-np.inf, detection.header, detection.bbox.center))
    if ranked:
        _, header, pose = max(ranked, key=lambda each: each[0])
        yield header, pose


POSE_KINDS: dict[str, Callable[[Any], Iterable[tuple[Any, Any]]]] = {
    "geometry_msgs/msg/PoseStamped": lambda message: [(message.header, message.pose)],
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda message: [(message.header, message.pose.pose)],
    "nav_msgs/msg/Odometry": lambda message: [(message.header, message.pose.pose)],
    "vision_msgs/msg/Detection3D": lambda message: _best_detection([message]),
    "vision_msgs/msg/Detection3DArray": lambda message: _best_detection(message.detections),
}
"""Types of message that hold the object's pose; the functions yield header and geometry_msgs/Pose, if there is one."""
