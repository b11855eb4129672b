"""Point robots, as in the paper's Example 1: a stick carried above the table by a gantry, without vertical motion.

A bridge slides along x on rails beside the table, and a carriage slides along y on the bridge. Only the stick and the
rod that holds it have colliders; everything else is above all objects on the table.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom
from scene_skin import DARK, METAL, SHELL, drum, stretch

from oimppi_warp.authoring.prims import Look, box, new_stage
from oimppi_warp.authoring.robots import arm_usd
from oimppi_warp.authoring.robots.arm import Arm, ArmJoint, ArmLink, Stick, capsule_between

TIP = 0.012  # height of the stick's tip
ROD_RADIUS = 0.012
EFFORT = 150.0  # N

_HALF = math.sqrt(0.5)


@dataclass(frozen=True)
class Gantry:
    """A gantry.

    Attributes:
        file: Name of the robot's file.
        name: Name of the robot's root prim.
        doc: Description.
        x, y: Limits of the joints [m].
        speed: Velocity limit of the joints [m/s].
        rails: Positions of the two rails along y [m].
        start: Joint positions at the start of an episode [m].
        height: Height of the bridge and the carriage [m].
        stick_length: Length of the stick [m].
        stick_radius: Radius of the stick [m].
        stick_friction: Coulomb friction coefficient of the stick.
    """

    file: str
    name: str
    doc: str
    x: tuple[float, float]
    y: tuple[float, float]
    speed: float
    rails: tuple[float, float]
    start: tuple[float, float]
    height: float = 0.40
    stick_length: float = 0.175
    stick_radius: float = 0.008
    stick_friction: float = 0.3

    @property
    def drop(self) -> float:
        """Returns the distance from the carriage to the upper end of the stick [m]."""
        return self.height - TIP - self.stick_length

    @cached_property
    def arm(self) -> Arm:
        """Returns the robot. The z axes of bridge and carriage point along the world's x and y, their x axes down."""
        along, across = self.x[1] - self.x[0] + 0.12, self.rails[1] - self.rails[0]
        return Arm(
            name=self.name,
            doc=f"{self.doc}. Written by tools/make_scenes.py; do not edit by hand.",
            base=ArmLink(10.0, (0.0, 0.0, 0.0), _solid(10.0, (along, across, self.height))),
            joints=(
                ArmJoint((0.0, 0.0, self.height), (0.0, _HALF, 0.0, _HALF), *self.x, EFFORT, self.speed, "prismatic"),
                ArmJoint((0.0, 0.0, 0.0), (-_HALF, 0.0, 0.0, _HALF), *self.y, EFFORT, self.speed, "prismatic"),
            ),
            links=(
                ArmLink(2.0, (0.0, 0.0, 0.0), _solid(2.0, (0.05, across, 0.05))),
                ArmLink(
                    1.0,
                    (0.05, 0.0, 0.0),
                    _solid(1.0, (0.15, 0.08, 0.08)),
                    (capsule_between("rod", (0.0, 0.0, 0.0), (self.drop, 0.0, 0.0), ROD_RADIUS),),
                ),
            ),
            stick=Stick(
                self.stick_length,
                self.stick_radius,
                position=(self.drop, 0.0, 0.0),
                turn=(0.0, _HALF, 0.0, _HALF),
                friction=self.stick_friction,
            ),
            start=self.start,
        )


def _solid(mass: float, size: tuple[float, float, float]) -> np.ndarray:
    """Returns the inertia of a box about its centre [kg m^2]."""
    x, y, z = np.square(size)
    return mass / 12.0 * np.diag([y + z, x + z, x + y])


GANTRIES = (
    Gantry(
        "point",
        "Point",
        "A stick that slides in x and y over the table",
        x=(-0.22, 0.97),  # up to 3 cm from the edges of the table
        y=(-0.77, 0.77),
        speed=0.3,
        rails=(-0.86, 0.86),
        start=(0.30, -0.20),
    ),
    Gantry(
        "disc",
        "Disc",
        "A thick stick without friction that slides in x and y: the agent of Push-T, at 1 mm per pixel",
        x=(0.0, 0.512),
        y=(0.0, 0.512),
        speed=2.0,
        rails=(-0.06, 0.572),
        start=(0.06, 0.06),
        height=0.19,
        stick_length=0.11,
        stick_radius=0.015,
        stick_friction=0.0,
    ),
)


def write(folder: Path) -> None:
    """Write the files of both robots."""
    for gantry in GANTRIES:
        _write_skin(gantry, folder / f"{gantry.file}_skin.usda")
        arm_usd.write(gantry.arm, folder / f"{gantry.file}.usda", skin=f"{gantry.file}_skin.usda")


def _write_skin(gantry: Gantry, file: Path) -> None:
    """Writes a robot's display geometry."""
    root = f"/{gantry.name}"
    called = "the point robot" if gantry.file == "point" else "the disc robot"
    stage = new_stage(file, gantry.name, f"Looks of {called}. Written by tools/make_scenes.py; do not edit by hand.")
    for link in ("base", "link1", "link2", "tool"):
        UsdGeom.Scope.Define(stage, f"{root}/{link}/skin")
    middle, length = sum(gantry.x) / 2, gantry.x[1] - gantry.x[0] + 0.12
    for side, y in (("left", gantry.rails[1]), ("right", gantry.rails[0])):
        rail = f"{root}/base/skin/{side}"
        box(stage, f"{rail}_rail", (middle, y, gantry.height), (length, 0.03, 0.03), Look(METAL))
        for end, x in (("near", middle - length / 2), ("far", middle + length / 2)):
            box(stage, f"{rail}_{end}", (x, y, gantry.height / 2), (0.04, 0.04, gantry.height + 0.03), Look(DARK))
    center, across = sum(gantry.rails) / 2, gantry.rails[1] - gantry.rails[0]
    box(stage, f"{root}/link1/skin/bridge", (0.0, center, 0.0), (0.04, across, 0.05), Look(SHELL))
    box(stage, f"{root}/link2/skin/carriage", (0.0, 0.0, 0.0), (0.07, 0.07, 0.09), Look(DARK))
    _tube(stage, f"{root}/link2/skin/rod", (0.0, 0.0, 0.0), (gantry.drop, 0.0, 0.0), ROD_RADIUS)
    _tube(stage, f"{root}/tool/skin/stick", (0.0, 0.0, 0.0), (0.0, 0.0, gantry.stick_length), gantry.stick_radius)
    stage.Save()


def _tube(
    stage: Usd.Stage, path: str, start: tuple[float, float, float], end: tuple[float, float, float], radius: float
) -> None:
    """Adds a round bar with rounded ends."""
    stretch(stage, path, drum(start, end, radius, fillet=radius * 0.999), METAL)
