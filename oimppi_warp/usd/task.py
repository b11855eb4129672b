"""Reads the task from the attributes of the scene's default prim."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from pxr import Usd, UsdPhysics

from oimppi_warp.geometry.footprint import GRAVITY
from oimppi_warp.scene import PlanarPose, Tolerance
from oimppi_warp.usd.frames import format_numbers, shortest_decimal
from oimppi_warp.usd.stage import SceneStage

_POSE = "(x [m], y [m], yaw [rad])"


@dataclass(frozen=True, eq=False)
class TaskAttributes:
    """Values of the attributes of OimppiTaskAPI, with the meanings given in :class:`oimppi_warp.scene.Scene`.

    Attributes:
        title, goal, spread, tolerance, tight_tolerance: See there.
        starts: The listed starts, shape [n, 3]; empty if the pose in the file is the only one.
    """

    title: str
    goal: PlanarPose
    starts: np.ndarray
    spread: tuple[float, float]
    tolerance: Tolerance
    tight_tolerance: Tolerance

    def starts_or(self, start: PlanarPose) -> np.ndarray:
        """Returns the listed starts or, if there are none, ``start`` alone, shape [n, 3] [m, m, rad]."""
        return self.starts if len(self.starts) else np.array([start])


def read_task(stage: SceneStage) -> TaskAttributes:
    """Reads the task from the prim with OimppiTaskAPI.

    Raises:
        SceneError: There is no task or more than one, or one of its attributes is missing or invalid.
    """
    world = stage.single_prim("OimppiTaskAPI", "task", "the scene's default prim")
    unread = Tolerance(math.nan, math.nan)
    return TaskAttributes(
        title=stage.text(world, "oimppi:title"),
        goal=stage.attempt((math.nan, math.nan, math.nan), _goal, stage, world),
        starts=stage.attempt(np.zeros((0, 3)), _starts, stage, world),
        spread=stage.attempt((math.nan, math.nan), _spread, stage, world),
        tolerance=stage.attempt(unread, _tolerance, stage, world, "oimppi:tolerance"),
        tight_tolerance=stage.attempt(unread, _tolerance, stage, world, "oimppi:tightTolerance"),
    )


def read_gravity(stage: SceneStage) -> tuple[float, float, float]:
    """Reads the acceleration of gravity from the first PhysicsScene, in the world frame [m/s^2].

    Without a PhysicsScene it is 9.81 m/s^2 downwards, and with newton:gravityEnabled = false it is zero. As in
    UsdPhysics, a direction of zero means downwards, and a negative magnitude the earth's.

    Raises:
        SceneError: The direction or the magnitude is not finite.
    """
    for prim in stage.prims():
        if not prim.IsA(UsdPhysics.Scene):
            continue
        given = UsdPhysics.Scene(prim)
        direction = np.array([shortest_decimal(c) for c in given.GetGravityDirectionAttr().Get() or (0.0, 0.0, 0.0)])
        magnitude = stage.number(prim, "physics:gravityMagnitude", -1.0)
        enabled = prim.GetAttribute("newton:gravityEnabled")
        if not (np.isfinite(direction).all() and magnitude < math.inf):
            raise stage.error(
                f"gravity is {magnitude:g} m/s^2 along {format_numbers(direction)}",
                prim,
                allowed="finite numbers",
                fix="correct physics:gravityDirection and physics:gravityMagnitude, or leave them out",
            )
        if enabled and enabled.Get() is False:
            return (0.0, 0.0, 0.0)
        down = direction / np.linalg.norm(direction) if direction.any() else np.array([0.0, 0.0, -1.0])
        x, y, z = ((magnitude if magnitude >= 0.0 else GRAVITY) * down).tolist()
        return (x, y, z)
    return (0.0, 0.0, -GRAVITY)


def _goal(stage: SceneStage, world: Usd.Prim) -> PlanarPose:
    x, y, yaw = map(float, stage.numbers(world, "oimppi:goal", (3,), f"{_POSE} of the object's goal"))
    if not all(map(math.isfinite, (x, y, yaw))):
        what = f"oimppi:goal is not finite: ({x:g}, {y:g}, {yaw:g})"
        raise stage.error(what, world, allowed=f"{_POSE}, all finite", fix="correct oimppi:goal")
    return x, y, yaw


def _starts(stage: SceneStage, world: Usd.Prim) -> np.ndarray:
    starts = stage.numbers(world, "oimppi:starts", (-1, 3), f"a list of {_POSE}")
    for number in np.flatnonzero(~np.isfinite(starts).all(axis=1)):
        what = f"oimppi:starts[{number}] is not finite: {tuple(starts[number].tolist())}"
        stage.collect(stage.error(what, world, allowed=f"{_POSE}, all finite", fix="correct oimppi:starts"))
    return starts


def _spread(stage: SceneStage, world: Usd.Prim) -> tuple[float, float]:
    meaning = "half-widths (position [m], yaw [rad]), zero or more"
    position, yaw = map(float, stage.numbers(world, "oimppi:spread", (2,), meaning))
    if not (0.0 <= position < math.inf and 0.0 <= yaw < math.inf):
        raise stage.error(
            f"oimppi:spread is ({position:g}, {yaw:g})",
            world,
            allowed="(position [m], yaw [rad]), both finite and zero or more",
            fix="set it to the half-widths of the box of starts, or leave it out",
        )
    return position, yaw


def _tolerance(stage: SceneStage, world: Usd.Prim, name: str) -> Tolerance:
    position, yaw = map(float, stage.numbers(world, name, (2,), "(position [m], yaw [rad]), each more than zero"))
    if not (position > 0.0 and yaw > 0.0):
        raise stage.error(
            f"{name} is ({position:g}, {yaw:g})",
            world,
            allowed="(position [m], yaw [rad]), both above zero",
            fix="correct it, or leave it out; use inf for a yaw that does not matter",
        )
    return Tolerance(position, yaw)
