"""The point robot of the paper's Example 1: a stick carried above the table by a gantry, without vertical motion.

A bridge slides along x on rails beside the table, and a carriage slides along y on the bridge. Only the stick and the
rod that holds it have colliders; everything else is above all objects on the table.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom
from scene_skin import DARK, METAL, SHELL, drum, stretch

from oimppi_warp.authoring.prims import Look, box, new_stage
from oimppi_warp.authoring.robots import arm_usd
from oimppi_warp.authoring.robots.arm import Arm, ArmJoint, ArmLink, Stick, capsule_between

HEIGHT = 0.40  # height of the bridge and the carriage
TIP = 0.012  # height of the stick's tip
STICK_LENGTH, ROD_RADIUS = 0.175, 0.012
X_LIMITS, Y_LIMITS = (-0.22, 0.97), (-0.77, 0.77)  # up to 3 cm from the edges of the table
RAIL = 0.86  # distance of the rails from the centre line
SPEED = 0.3  # m/s
EFFORT = 150.0  # N
START = (0.30, -0.20)

_HALF = math.sqrt(0.5)
_DROP = HEIGHT - TIP - STICK_LENGTH  # from the carriage to the upper end of the stick


def _solid(mass: float, size: tuple[float, float, float]) -> np.ndarray:
    """Returns the inertia of a box about its centre [kg m^2]."""
    x, y, z = np.square(size)
    return mass / 12.0 * np.diag([y + z, x + z, x + y])


# The z axes of the bridge and the carriage point along the world's x and y axis; the x axes of both point down.
POINT = Arm(
    name="Point",
    doc="A stick that slides in x and y over the table. Written by tools/make_scenes.py; do not edit by hand.",
    base=ArmLink(10.0, (0.0, 0.0, 0.0), _solid(10.0, (1.3, 1.8, 0.4))),
    joints=(
        ArmJoint((0.0, 0.0, HEIGHT), (0.0, _HALF, 0.0, _HALF), *X_LIMITS, EFFORT, SPEED, "prismatic"),
        ArmJoint((0.0, 0.0, 0.0), (-_HALF, 0.0, 0.0, _HALF), *Y_LIMITS, EFFORT, SPEED, "prismatic"),
    ),
    links=(
        ArmLink(2.0, (0.0, 0.0, 0.0), _solid(2.0, (0.05, 1.72, 0.05))),
        ArmLink(
            1.0,
            (0.05, 0.0, 0.0),
            _solid(1.0, (0.15, 0.08, 0.08)),
            (capsule_between("rod", (0.0, 0.0, 0.0), (_DROP, 0.0, 0.0), ROD_RADIUS),),
        ),
    ),
    stick=Stick(STICK_LENGTH, position=(_DROP, 0.0, 0.0), turn=(0.0, _HALF, 0.0, _HALF)),
    start=START,
)


def write(folder: Path) -> None:
    """Write the robot's files."""
    _write_skin(folder / "point_skin.usda")
    arm_usd.write(POINT, folder / "point.usda", skin="point_skin.usda")


def _write_skin(file: Path) -> None:
    """Writes the robot's display geometry."""
    stage = new_stage(file, "Point", "Looks of the point robot. Written by tools/make_scenes.py; do not edit by hand.")
    for link in ("base", "link1", "link2", "tool"):
        UsdGeom.Scope.Define(stage, f"/Point/{link}/skin")
    middle, length = sum(X_LIMITS) / 2, X_LIMITS[1] - X_LIMITS[0] + 0.12
    for side, y in (("left", RAIL), ("right", -RAIL)):
        rail = f"/Point/base/skin/{side}"
        box(stage, f"{rail}_rail", (middle, y, HEIGHT), (length, 0.03, 0.03), Look(METAL))
        for end, x in (("near", middle - length / 2), ("far", middle + length / 2)):
            box(stage, f"{rail}_{end}", (x, y, HEIGHT / 2), (0.04, 0.04, HEIGHT + 0.03), Look(DARK))
    box(stage, "/Point/link1/skin/bridge", (0.0, 0.0, 0.0), (0.04, 2 * RAIL, 0.05), Look(SHELL))
    box(stage, "/Point/link2/skin/carriage", (0.0, 0.0, 0.0), (0.07, 0.07, 0.09), Look(DARK))
    _tube(stage, "/Point/link2/skin/rod", (0.0, 0.0, 0.0), (_DROP, 0.0, 0.0), ROD_RADIUS)
    _tube(stage, "/Point/tool/skin/stick", (0.0, 0.0, 0.0), (0.0, 0.0, STICK_LENGTH), POINT.stick.radius)
    stage.Save()


def _tube(
    stage: Usd.Stage, path: str, start: tuple[float, float, float], end: tuple[float, float, float], radius: float
) -> None:
    """Adds a round bar with rounded ends."""
    stretch(stage, path, drum(start, end, radius, fillet=radius * 0.999), METAL)
