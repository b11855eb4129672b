"""The task Push-T (Chi et al., Diffusion Policy, RSS 2023; gym-pusht 0.1.8), at 1 mm per pixel.

The world's origin is the lower left corner of Push-T's window, and y points up. The T is quasi-static there: force and
torque move it in proportion, with ``D = diag(1, 1, 1/3000 px^2)`` about a given centre, so the limit surface has the
radius ``sqrt(3000) px``; nothing rubs on the tool. Height, mass and the friction with the table are chosen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pxr import Sdf, Usd

from oimppi_warp.authoring import task
from oimppi_warp.authoring.objects.flat_object import Box, FlatObject
from oimppi_warp.authoring.prims import apply_api, attribute
from oimppi_warp.authoring.task import TableTop, Task

WINDOW, WALL = 0.512, 0.008  # sides of the window; distance of the walls from them [m]
MOMENT = 3000e-6  # square of the radius of the limit surface [m^2]
GREY = (0.33, 0.38, 0.45)


@dataclass(frozen=True)
class QuasistaticObject(FlatObject):
    """A flat object whose centre and limit surface are given.

    Attributes:
        center: Centre of mass [m].
        moment: Moment of inertia per mass, and square of the radius of the limit surface [m^2].
    """

    center: tuple[float, float] = (0.0, 0.0)
    moment: float = 0.0

    def center_and_inertia(self) -> tuple[tuple[float, float, float], np.ndarray]:
        """Returns the centre of mass [m] and the inertia about it [kg m^2]."""
        flat = self.moment / 2 + self.height**2 / 12
        return (*self.center, 0.0), self.mass * np.diag([flat, flat, self.moment])

    def write(self, file: Path, *, note: str = "") -> None:
        """Writes the object's file, with ``note`` appended to its documentation."""
        super().write(file, note=note)
        stage = Usd.Stage.Open(str(file))
        root = stage.GetDefaultPrim()
        apply_api(root, "OimppiObjectAPI")
        radius = round(math.sqrt(self.moment), 9)
        attribute(root, "oimppi:limitSurfaceRadius", Sdf.ValueTypeNames.Double, radius)
        stage.Save()


T = QuasistaticObject(
    "pusht_t",
    "PushT",
    "The T of Push-T: bar 0.12 x 0.03 m, stem 0.03 x 0.09 m; the frame is at the middle of the bar's upper edge",
    (Box((0.0, -0.015), (0.12, 0.03)), Box((0.0, -0.075), (0.03, 0.09))),
    0.05,
    1.0,
    0.0,
    GREY,
    center=(0.0, -0.045),
    moment=MOMENT,
)
PUSHT = Task(
    "pusht",
    "Push-T: push the T onto its place with a disc that has no friction",
    T,
    (0.25, 0.262, 0.0),
    (0.256, 0.256, -math.pi / 4),
    tolerance=(0.002, 0.04),  # each alone costs 5 % of the overlap that Push-T demands
    tight=(0.002, 0.02),
    robot="disc",
    table=TableTop((WALL, WALL), (WINDOW - WALL, WINDOW - WALL)),
    spread=(0.15, math.pi),
    camera=((0.256, -0.28, 0.75), (0.256, 0.23, 0.0)),
)
OFF_CENTER = replace(
    PUSHT,
    name="pusht_off_centre",
    title="Push-T, with the T's centre of mass 10 mm further down its stem",
    object=replace(T, name="pusht_t_off_centre", doc=f"{T.doc}; centre of mass moved by 10 mm", center=(0.0, -0.055)),
)


def write(scenes: Path, *, note: str) -> None:
    """Writes the task to ``scenes``, and its variant to ``scenes/variants``."""
    for each, folder, robots in ((PUSHT, scenes, "./robots"), (OFF_CENTER, scenes / "variants", "../robots")):
        each.object.write(folder / "objects" / f"{each.object.name}.usda", note=note)
        task.write(each, folder, note=note, robots=robots)
