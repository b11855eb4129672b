"""Makes a record of a laboratory's bag, for the plots, the metrics and the replay.

All times are those at which the messages were recorded: this is one clock, which messages without a stamp have too. A
control step ends every control period after the first moment at which joint states and the object's pose are known.
At its end count the latest joint state and the latest pose until then, and during it the latest command at its
beginning; nothing is interpolated. Of the object's pose, x, y and the yaw are kept.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from oimppi_warp.config import ros2_topics as names
from oimppi_warp.errors import ConfigError
from oimppi_warp.geometry.fields import ExactClearance
from oimppi_warp.geometry.kinematics import tip_frame
from oimppi_warp.observation import BEYOND_LIMITS, beyond_limits, planar_pose
from oimppi_warp.record.bag import BagMessage, BagReader
from oimppi_warp.record.bag_frames import FrameTree
from oimppi_warp.record.bag_tracks import (
    COMMAND_KINDS,
    POSE_KINDS,
    Track,
    command_track,
    frame_track,
    joint_tracks,
    topic_track,
)
from oimppi_warp.record.log import EVENTS, EpisodeLog, LogError, to_json, versions
from oimppi_warp.record.metrics import pose_error
from oimppi_warp.scene import Scene

JOINT_STATE = "sensor_msgs/msg/JointState"
TILTED = math.radians(15.0)
"""Angle between the object's z axis and the vertical from which on its yaw means little [rad]."""


@dataclass(frozen=True)
class BagSources:
    """What to take from a laboratory's bag.

    Attributes:
        joint_states: Topic of the joint states; ``None``: :data:`oimppi_warp.config.ros2_topics.JOINT_STATES`, or the
            only topic of this type.
        joint_names: Names in the bag of the arm's joints, in their order; empty: those in the scene.
        object: Topic or frame of the object's pose; ``None``: the topic ``OBJECT_POSE`` or the frame ``OBJECT_FRAME``
            of :mod:`oimppi_warp.config.ros2_topics`.
        commands: Topic of the commanded joint velocities; ``None``: ``FILTERED_COMMANDS`` or ``NOMINAL_COMMANDS``, if
            the bag has them.
        world_frame: Frame that is the scene's world.
        control_period: Duration of a control step [s].
        hold_seconds: Time for which the object must stay within tolerance for success [s].
        longest_gap: Longest time without a joint state that is accepted [s].
    """

    joint_states: str | None = None
    joint_names: tuple[str, ...] = ()
    object: str | None = None
    commands: str | None = None
    world_frame: str = names.WORLD_FRAME
    control_period: float = 0.05
    hold_seconds: float = 0.5
    longest_gap: float = 0.5


@dataclass(frozen=True, eq=False)
class ImportedBag:
    """The record of a bag.

    Attributes:
        log: The record.
        tracks: What it was made of: ``joint states``, ``object``, and ``commands`` if there are any.
        tilt: Largest angle between the object's z axis and the vertical [rad].
    """

    log: EpisodeLog
    tracks: dict[str, Track]
    tilt: float


def import_bag(path: str | Path, scene: Scene, sources: BagSources | None = None) -> ImportedBag:
    """Makes a record of a bag.

    Args:
        path: A rosbag2 folder, an MCAP or SQLite file, or a bag of ROS 1.
        scene: The task, with the goal.
        sources: What to take from the bag.

    Raises:
        LogError: The bag cannot be read, or lacks something; the message names what it contains.
        ConfigError: A topic is not in the bag, or has a type that cannot be used, or rosbags is not installed.
    """
    chosen = sources or BagSources()
    joints = list(chosen.joint_names or (joint.path.rpartition("/")[2] for joint in scene.robot.joints))
    if len(joints) != scene.robot.dof:
        raise ConfigError(f"{len(joints)} joint names\n  allowed: {scene.robot.dof}, one for each joint of the arm")
    with BagReader(path) as bag:
        if not bag.topics:
            raise LogError(f"{path}: the bag contains no messages\n  to do:   record topics of the arm and the object")
        states = _state_topic(bag, chosen.joint_states)
        pose, frame = _pose_source(bag, chosen.object)
        commands = _command_topics(bag, chosen.commands)
        wanted = {states, *commands, names.TF, names.TF_STATIC} | ({pose} if pose else set())
        began, messages = _collect(bag, wanted)
        with_poses = bag.contents(POSE_KINDS.keys())
    frames = FrameTree()
    static = [(time, message, True) for time, message in messages.get(names.TF_STATIC, [])]
    moving = [(time, message, False) for time, message in messages.get(names.TF, [])]
    for time, message, still in [*static, *moving]:
        frames.add(message.content, time, static=still)
    if not pose and frame not in frames.frames:
        raise LogError(
            f"{path}: the object's pose is missing: there is neither a topic nor a frame {chosen.object or frame}\n"
            f"  allowed: topics with a pose: {with_poses}; frames: {', '.join(frames.frames) or 'none'}\n"
            "  to do:   --object NAME"
        )
    position, velocity = joint_tracks(messages.get(states, []), joints)
    _check_limits(position, scene, joints)
    tracks = {"joint states": position}
    if pose:
        tracks["object"] = topic_track(messages.get(pose, []), frames, chosen.world_frame)
    else:
        tracks["object"] = frame_track(frame, frames, chosen.world_frame)
    for topic in commands:
        tracks["commands" if topic == commands[0] else "planned commands"] = command_track(
            messages.get(topic, []), joints
        )
    log = _log_of(tracks, velocity, scene, chosen, began, Path(path).name)
    return ImportedBag(log, tracks, _largest_tilt(tracks["object"].values))


def _collect(bag: BagReader, topics: Collection[str]) -> tuple[int, dict[str, list[tuple[float, BagMessage]]]]:
    """Returns the time of the first message [ns], and the messages of each topic with their times since then [s]."""
    began: int | None = None
    found: dict[str, list[tuple[float, BagMessage]]] = {}
    for message in bag.messages(topics):
        began = message.time if began is None else began
        found.setdefault(message.topic, []).append((1e-9 * (message.time - began), message))
    return began or 0, found


def _state_topic(bag: BagReader, asked: str | None) -> str:
    """Returns the topic of the joint states."""
    found = [topic for topic, kind in bag.topics.items() if kind == JOINT_STATE]
    if asked is not None:
        return _checked_topic(bag, "--joint-states", asked, (JOINT_STATE,))
    if names.JOINT_STATES in found:
        return names.JOINT_STATES
    if len(found) == 1:
        return found[0]
    what = f"several topics of joint states: {', '.join(sorted(found))}" if found else "no joint states"
    raise LogError(
        f"{bag.path}: the bag has {what}; its topics are: {bag.contents()}\n"
        "  to do:   --joint-states TOPIC, a topic of the type sensor_msgs/JointState"
    )


def _pose_source(bag: BagReader, asked: str | None) -> tuple[str | None, str]:
    """Returns the topic of the object's pose, or ``None`` and the frame."""
    if asked is not None and asked in bag.topics:
        return _checked_topic(bag, "--object", asked, tuple(POSE_KINDS)), ""
    if asked is None and bag.topics.get(names.OBJECT_POSE) in POSE_KINDS:
        return names.OBJECT_POSE, ""
    return None, (asked or names.OBJECT_FRAME).lstrip("/")


def _command_topics(bag: BagReader, asked: str | None) -> list[str]:
    """Returns the topics of the commands that moved the arm and, where they are others, of those planned."""
    if asked is not None:
        return [_checked_topic(bag, "--commands", asked, COMMAND_KINDS)]
    usual = (names.FILTERED_COMMANDS, names.NOMINAL_COMMANDS)
    return [topic for topic in usual if bag.topics.get(topic) in COMMAND_KINDS]


def _checked_topic(bag: BagReader, option: str, topic: str, kinds: Collection[str]) -> str:
    """Returns a topic that the bag has, with a type that can be read.

    Raises:
        ConfigError: It has not.
    """
    allowed = " or ".join(kind.replace("/msg/", "/") for kind in kinds)
    if topic not in bag.topics:
        raise ConfigError(
            f"{option} {topic}: no such topic in the bag; its topics are: {bag.contents()}\n"
            f"  allowed: a topic of the type {allowed}"
        )
    if bag.topics[topic] not in kinds:
        found = bag.topics[topic].replace("/msg/", "/")
        raise ConfigError(f"{option} {topic}: the topic has the type {found}\n  allowed: a topic of the type {allowed}")
    return topic


def _check_limits(positions: Track, scene: Scene, joints: Sequence[str]) -> None:
    """Raises LogError if a joint is where the arm cannot be."""
    beyond = beyond_limits(scene.robot, positions.values)
    row, joint = divmod(int(np.argmax(beyond)), len(joints))
    if beyond[row, joint] > BEYOND_LIMITS:
        raise LogError(
            f"{positions.source}: {joints[joint]} is at {positions.values[row, joint]:.4g}, at "
            f"{positions.times[row]:.3f} s, {beyond[row, joint]:.4g} outside its limits\n"
            "  allowed: radians, and metres for a prismatic joint\n"
            "  to do:   --joint-names, if the names are those of other joints"
        )


def _log_of(
    tracks: dict[str, Track], velocity: Track | None, scene: Scene, chosen: BagSources, began: int, name: str
) -> EpisodeLog:
    """Returns the log of the tracks, resampled."""
    states, poses, period = tracks["joint states"], tracks["object"], chosen.control_period
    begin, end = max(states.times[0], poses.times[0]), states.times[-1]
    steps = math.floor((end - begin) / period + 1e-6)
    if steps < 1:
        raise LogError(
            f"{name}: joint states ({states.times[0]:.2f} to {end:.2f} s) and poses of the object "
            f"({poses.times[0]:.2f} to {poses.times[-1]:.2f} s) are not there together for a control period of "
            f"{period:g} s\n  to do:   record both at once"
        )
    gap, since = states.longest_gap(begin, end)
    if gap > chosen.longest_gap:
        raise LogError(
            f"{states.source}: no joint state for {gap:.2f} s, from {since:.2f} s on\n"
            f"  allowed: gaps of at most {chosen.longest_gap:g} s, or --longest-gap {math.ceil(10 * gap) / 10:g}"
        )
    ends = begin + period * np.arange(1, steps + 1)
    times = np.concatenate([[begin], ends])
    joints = states.at(times + 1e-9)
    planar = Track("", poses.times, np.array([planar_pose(transform) for transform in poses.values])).at(times + 1e-9)
    arrived = np.diff(np.searchsorted(poses.times, times + 1e-9, side="right")) > 0
    errors = np.array([pose_error(pose, scene.goal) for pose in planar[1:]])
    clearance = ExactClearance(scene)
    columns = {
        "time": period * np.arange(1, steps + 1),
        "joint_position": joints[1:],
        "joint_velocity": np.diff(joints, axis=0) / period if velocity is None else velocity.at(ends + 1e-9),
        "tool_position": np.array([tip_frame(scene.robot, each)[1] for each in joints[1:]]),
        "object_pose": planar[1:],
        "estimated_pose": planar[1:],
        "detection": np.where(arrived, float(EVENTS.index("accepted")), 0.0),
        "position_error": errors[:, 0],
        "yaw_error": errors[:, 1],
        "clearance": np.array([clearance.at(pose) for pose in planar[1:]]),
    }
    for column, track in (("command", "commands"), ("planned_command", "planned commands")):
        if track in tracks:
            columns[column] = tracks[track].at(times[:-1] + 1e-9)
    header = _header(scene, chosen, tuple(map(float, planar[0]))) | {
        "began_ns": began + round(1e9 * begin),
        "source": {"bag": name, **{role: track.source for role, track in tracks.items()}},
    }
    return EpisodeLog.of_columns(header, columns)


def _header(scene: Scene, chosen: BagSources, start: tuple[float, ...]) -> dict[str, Any]:
    """Returns the header of the log: nothing was planned here, so method, engine and device are only names."""
    return {
        "scene": scene.name,
        "file": str(scene.file),
        "method": "imported",
        "engine": "none",
        "device": "none",
        "seed": 0,
        "threads": None,
        "plant": "bag",
        "mode": "realtime",
        "preset": "none",
        "config": {},
        "requested": {},
        "start": list(start),
        "goal": list(scene.goal),
        "tolerance": to_json(scene.tolerance),
        "tight_tolerance": to_json(scene.tight_tolerance),
        "exact_tolerance": to_json(scene.exact_tolerance),
        "hold_seconds": chosen.hold_seconds,
        "control_period": chosen.control_period,
        "cost_terms": [],
        "scores": [],
        "preplan_time_s": 0.0,
        "ended": "end of the bag",
        "problems": [],
        "filtered": {},
        "versions": versions(),
    }


def _largest_tilt(transforms: np.ndarray) -> float:
    """Returns the largest angle between the z axis of a frame and the vertical [rad], given transforms [n, 7]."""
    upward = 1.0 - 2.0 * (transforms[:, 3] ** 2 + transforms[:, 4] ** 2)
    return float(np.arccos(np.clip(upward, -1.0, 1.0)).max())
