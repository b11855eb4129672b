"""Records as bags: the log of an episode as messages, and the log again from them.

Every column is a topic of its own below :data:`COLUMN`, with one message per control step: std_msgs/Float64 for a
number, which Foxglove and PlotJuggler plot, and std_msgs/Float64MultiArray for several. A record is read from these,
from the plans and from the header, which :data:`RECORD` holds as JSON. Joint states, commands and poses are there once
more as the messages that ROS has for them, on the topics of :mod:`oimppi_warp.config.ros2_topics`.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from oimppi_warp.config import ros2_topics as names
from oimppi_warp.observation import planar_transform
from oimppi_warp.record.bag import BagReader, BagWriter, is_bag
from oimppi_warp.record.log import COLUMNS, EpisodeLog, LogError, to_json

RECORD = "/oimppi/record"
"""std_msgs/String, latched: the header of the record and the number of control steps, as JSON."""
COLUMN = "/oimppi/columns/"
"""Prefix of the topics of the columns."""
TRUE_OBJECT_POSE = "/oimppi/true_object_pose"
"""geometry_msgs/PoseStamped: the object's pose in the column ``object_pose``, if it differs from the estimate."""


def load_record(path: str | Path) -> EpisodeLog:
    """Reads a record from its folder, or from a bag that was exported from it.

    Raises:
        LogError: The path is neither.
        ConfigError: It is a bag, and the package rosbags is not installed.
    """
    return read_log(path) if is_bag(path) and not (Path(path) / "episode.json").exists() else EpisodeLog.load(path)


def stamps_of(log: EpisodeLog) -> tuple[int, np.ndarray]:
    """Returns the times of the messages: of the beginning of the record [ns], and of the control steps [ns].

    They count from the epoch, or from the time ``began_ns`` in the header. They never decrease.
    """
    seconds = log["time"]
    last = np.maximum.accumulate(np.where(np.isfinite(seconds), seconds, 0.0).clip(min=0.0))
    began = int(log.header.get("began_ns") or 0)
    return began, began + np.round(1e9 * last).astype(np.int64)


def write_log(bag: BagWriter, log: EpisodeLog, joints: Sequence[str], height: float) -> None:
    """Writes a log with at least one control step.

    Commands, plans and references have the time at which their control step began, everything else that of its end.

    Args:
        bag: The bag.
        log: The log.
        joints: Names of the joints.
        height: z of the object's frame when the object lies on the table [m].
    """
    began, stamps = stamps_of(log)
    record = {"steps": len(log), "header": log.header, "plans": [step for step, _ in log.references]}
    text = json.dumps(to_json(record), allow_nan=False)
    bag.write(RECORD, began, bag.make("std_msgs/msg/String", data=text), latched=True)
    columns = {name: log[name] for name in log.columns}
    estimate = columns.get("estimated_pose", log["object_pose"])
    truth = log["object_pose"]
    known = np.isfinite(estimate).all(1) & np.isfinite(truth).all(1)
    poses = {names.OBJECT_POSE: estimate, names.REFERENCE: log["reference_pose"]}
    if not np.array_equal(estimate[known], truth[known]):
        poses[TRUE_OBJECT_POSE] = truth
    commands = {names.NOMINAL_COMMANDS: log["planned_command"], names.FILTERED_COMMANDS: log["command"]}
    plans: dict[int, list[np.ndarray]] = {}
    for step, path in log.references:
        plans.setdefault(min(step, len(log) - 1), []).append(path)
    before = max(began, int(stamps[0]) - round(1e9 * float(log.header["control_period"])))
    starts = [before, *stamps[:-1].tolist()]
    for row, (start, stamp) in enumerate(zip(starts, stamps.tolist(), strict=True)):
        for path in plans.get(row, ()):
            bag.write(names.PLAN, start, _path(bag, start, path, height))
        bag.write(names.JOINT_STATES, stamp, _joint_state(bag, stamp, log, row, joints))
        for topic, values in commands.items():
            if values.shape[1] and np.isfinite(values[row]).all():
                bag.write(topic, start, bag.array(values[row], "joint"))
        for topic, values in poses.items():
            if values.shape[1] and np.isfinite(values[row]).all():
                time = start if topic == names.REFERENCE else stamp
                bag.write(topic, time, bag.pose_stamped(time, planar_transform(tuple(values[row]), height)))
        for name, values in columns.items():
            value = values[row]
            message = bag.array(value, name) if value.ndim else bag.make("std_msgs/msg/Float64", data=float(value))
            bag.write(COLUMN + name, stamp, message)


def read_log(path: str | Path) -> EpisodeLog:
    """Reads a log from a bag that :func:`write_log` wrote. All columns are the same to the bit, in float64.

    Raises:
        LogError: The bag cannot be read, or does not contain a complete record.
        ConfigError: The package rosbags is not installed.
    """
    with BagReader(path) as bag:
        if RECORD not in bag.topics:
            raise LogError(
                f"{path}: contains no record (there is no topic {RECORD}); its topics are: {bag.contents()}\n"
                "  to do:   `oimppi import-bag BAG --scene SCENE` makes a record of a bag from a laboratory"
            )
        columns = {COLUMN + name: name for name in COLUMNS}
        values: dict[str, list[Any]] = {name: [] for topic, name in columns.items() if topic in bag.topics}
        text, paths = "", []
        for message in bag.messages([RECORD, names.PLAN, *columns]):
            if message.topic == RECORD:
                text = message.content.data
            elif message.topic == names.PLAN:
                paths.append(_planar(message.content))
            else:
                values[columns[message.topic]].append(message.content.data)
    try:
        record = json.loads(text)
        steps, header, made = int(record["steps"]), dict(record["header"]), [int(step) for step in record["plans"]]
    except (ValueError, KeyError, TypeError) as error:
        raise LogError(f"{path}: {RECORD} is not the header of a record ({error})") from error
    lengths = {name: len(rows) for name, rows in values.items()} | {"plan": len(paths)}
    expected = dict.fromkeys(values, steps) | {"plan": len(made)}
    if short := [name for name, length in lengths.items() if length != expected[name]]:
        counts = ", ".join(f"{lengths[name]} of {expected[name]} of {name}" for name in short[:3])
        raise LogError(f"{path}: contains no complete record ({counts})\n  to do:   export it again")
    arrays = {name: np.array(rows, dtype=float) for name, rows in values.items()}
    return EpisodeLog.of_columns(header, arrays, list(zip(made, paths, strict=True)))


def _joint_state(bag: BagWriter, stamp: int, log: EpisodeLog, row: int, joints: Sequence[str]) -> Any:
    return bag.make(
        "sensor_msgs/msg/JointState",
        header=bag.header(stamp, ""),
        name=list(joints),
        position=np.ascontiguousarray(log["joint_position"][row]),
        velocity=np.ascontiguousarray(log["joint_velocity"][row]),
        effort=np.zeros(0),
    )


def _path(bag: BagWriter, stamp: int, path: np.ndarray, height: float) -> Any:
    poses = [bag.pose_stamped(stamp, planar_transform((x, y, yaw), height)) for x, y, yaw in path.tolist()]
    return bag.make("nav_msgs/msg/Path", header=bag.header(stamp, names.WORLD_FRAME), poses=poses)


def _planar(path: Any) -> np.ndarray:
    """Returns the planar poses of a nav_msgs/Path of upright poses, shape [n, 3]; the yaw is from -2 pi to 2 pi."""
    poses = [stamped.pose for stamped in path.poses]
    rows = [(at.position.x, at.position.y, 2 * np.arctan2(at.orientation.z, at.orientation.w)) for at in poses]
    return np.array(rows, dtype=float).reshape(-1, 3)
