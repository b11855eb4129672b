"""Writes a sample task for a robot: a T on an open table, scaled to the robot's reach."""

from __future__ import annotations

import filecmp
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from oimppi_warp.authoring.arm_start import clear_start
from oimppi_warp.authoring.objects.catalog import T_BLOCK
from oimppi_warp.authoring.objects.flat_object import Box, FlatObject
from oimppi_warp.authoring.project import write_object
from oimppi_warp.authoring.task import SPREAD, Pose, Task, write
from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.reach import Reach, reach_of
from oimppi_warp.scene import Robot

_REACH = 0.717
"""Reach of the xArm6, for which the poses and the T are designed [m]."""
_START, _GOAL = np.array([0.30, -0.45]), np.array([0.50, 0.30])
_OTHERS = tuple(
    (np.array([x, -y]), np.array([x, y])) for x, y in ((0.42, 0.30), (0.50, 0.22), (0.32, 0.36), (0.56, 0.15))
)
"""Starts and goals that are tried where these do not do: narrower, further out or further in [m]."""


def write_sample_task(robot: Robot, name: str, folder: Path, *, destination: Path) -> Path:
    """Writes the task to a folder whose ``robots`` holds the robot, reads it back and checks it.

    Start and goal are in front of the arm, at the first of several places that the robot can push between.

    Args:
        robot: The robot.
        name: Name of the task's file.
        folder: Folder to write to; if the robot cannot do the task, nothing of it is left there.
        destination: Folder that the files are moved to later; if another object there has the T's name, the robot's
            name is added to the T's.

    Raises:
        SceneError: The robot cannot do the task, or its file is invalid.
    """
    workspace = _workspace(robot)
    scale = min(workspace.radius / _REACH, 1.0)
    obj = _t_block(round(scale, 1))
    file = write_object(obj, folder)
    existing = destination / "objects" / file.name
    if existing.exists() and not filecmp.cmp(file, existing, shallow=False):
        obj = replace(obj, name=f"{obj.name}_{name}")
        file = file.rename(file.with_stem(obj.name))
    title = f"Push the T across an open table with {name}"
    spread = (round(SPREAD[0] * scale, 3), SPREAD[1])
    errors = []
    for start, goal in _places(workspace):
        task = Task(f"{name}_open", title, obj, start, goal, robot=name, spread=spread)
        try:
            return write(task, folder, find_arm_start=clear_start)
        except SceneError as error:
            errors.append(error.with_traceback(None))  # whose frames would keep the stage open, and its file taken
    file.unlink()
    (folder / f"{name}_open.usda").unlink(missing_ok=True)
    raise errors[0]


@dataclass(frozen=True, eq=False)
class _Workspace:
    """The region in which a robot can push.

    Attributes:
        reach: The region that its tip reaches.
        center: Axis about which it turns, shape [2] [m]; ``None`` if sliding joints carry it.
        radius: Reach around the axis, or the largest distance that it reaches [m].
    """

    reach: Reach
    center: np.ndarray | None
    radius: float


def _workspace(robot: Robot) -> _Workspace:
    reach = reach_of(robot)
    if robot.joints[0].kind == "prismatic":
        return _Workspace(reach, None, reach.radius)
    center = np.zeros(2) if reach.border is None else np.asarray(robot.joints[0].parent_transform[:2], dtype=float)
    lower, upper = reach.bounds
    return _Workspace(reach, center, float((upper - lower).min()) / 2)


def _t_block(scale: float) -> FlatObject:
    """Returns the T, scaled down for a robot with a short reach."""
    if scale == 1.0:
        return T_BLOCK
    pieces = tuple(
        Box((scale * box.center[0], scale * box.center[1]), (scale * box.size[0], scale * box.size[1]))
        for box in T_BLOCK.pieces
        if isinstance(box, Box)
    )
    doc = f"T block, {scale:g} times as large in the plane as the shipped one"
    name = f"{T_BLOCK.name}_{100.0 * scale:.0f}"
    return replace(T_BLOCK, name=name, doc=doc, pieces=pieces, mass=round(T_BLOCK.mass * scale**2, 3))


def _places(workspace: _Workspace) -> Iterator[tuple[Pose, Pose]]:
    """Yields starts and goals: the first shipped task's, scaled to the robot's reach, then others in its workspace."""
    reach, center = workspace.reach, workspace.center
    if center is not None:
        scale = min(workspace.radius / _REACH, 1.1)
        for start, goal in ((_START, _GOAL), *_OTHERS):
            yield _pose(center + scale * start, 0.0), _pose(center + scale * goal, math.pi)
        return
    if reach.margin(np.array([_START, _GOAL])).min() >= 0.1:
        yield _pose(_START, 0.0), _pose(_GOAL, math.pi)
    lower, upper = reach.bounds
    middle, size = (lower + upper) / 2, upper - lower
    yield _pose(middle - 0.25 * size, 0.0), _pose(middle + 0.25 * size, math.pi)


def _pose(at: np.ndarray, yaw: float) -> Pose:
    x, y = np.round(at, 3).tolist()
    return (x, y, yaw)
