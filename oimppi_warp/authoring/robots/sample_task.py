"""Writes a sample task for a robot: a T on an open table, scaled to the robot's reach."""

from __future__ import annotations

import filecmp
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from oimppi_warp.authoring.objects.catalog import T_BLOCK
from oimppi_warp.authoring.objects.flat_object import Box, FlatObject
from oimppi_warp.authoring.project import write_object
from oimppi_warp.authoring.task import Pose, Task, write
from oimppi_warp.geometry.reach import Reach, reach_of
from oimppi_warp.scene import Robot

_REACH = 0.717
"""Reach of the xArm6, for which the poses and the T are designed [m]."""
_START, _GOAL = np.array([0.30, -0.45]), np.array([0.50, 0.30])


def write_sample_task(robot: Robot, name: str, folder: Path, *, destination: Path) -> Path:
    """Writes the task to a folder whose ``robots`` holds the robot, reads it back and checks it.

    Args:
        robot: The robot.
        name: Name of the task's file.
        folder: Folder to write to.
        destination: Folder that the files are moved to later; if another object there has the T's name, the robot's
            name is added to the T's.

    Raises:
        SceneError: The robot cannot do the task, or its file is invalid.
    """
    reach = reach_of(robot)
    obj = _t_block(reach)
    file = write_object(obj, folder)
    existing = destination / "objects" / file.name
    if existing.exists() and not filecmp.cmp(file, existing, shallow=False):
        obj = replace(obj, name=f"{obj.name}_{name}")
        file.rename(file.with_stem(obj.name))
    start, goal = _start_and_goal(reach)
    title = f"Push the T across an open table with {name}"
    return write(Task(f"{name}_open", title, obj, start, goal, robot=name), folder)


def _t_block(reach: Reach) -> FlatObject:
    """Returns the T, scaled down for a robot with a short reach."""
    scale = round(min(reach.radius / _REACH, 1.0), 1)
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


def _start_and_goal(reach: Reach) -> tuple[Pose, Pose]:
    """Returns start and goal: the first shipped task's, scaled to the robot's reach, or else across its workspace."""
    scale = min(reach.radius / _REACH, 1.1) if reach.border is None else 1.0
    start, goal = scale * _START, scale * _GOAL
    if reach.margin(np.array([start, goal])).min() < 0.1:
        lower, upper = reach.bounds
        middle, size = (lower + upper) / 2, upper - lower
        start, goal = middle - 0.25 * size, middle + 0.25 * size
    (x0, y0), (x1, y1) = np.round(start, 3).tolist(), np.round(goal, 3).tolist()
    return (x0, y0, 0.0), (x1, y1, math.pi)
