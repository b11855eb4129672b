"""Objects made from meshes: convex pieces of any height, and the surface to display."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom

from oimppi_warp.authoring.meshes.convex import FAR_OFF, SECONDS, Fit, decompose
from oimppi_warp.authoring.meshes.hulls import Hull
from oimppi_warp.authoring.meshes.moments import moments
from oimppi_warp.authoring.meshes.pose import Lay, lay_on_table
from oimppi_warp.authoring.meshes.progress import report
from oimppi_warp.authoring.meshes.read import read_surface
from oimppi_warp.authoring.objects.outlines import FRICTION, check_height, checked_friction, checked_mass
from oimppi_warp.authoring.prims import (
    COLLIDER,
    Color,
    Look,
    bind_physics,
    mass_properties,
    mesh,
    new_stage,
    physics_material,
)
from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.rolling import rolling_of_points

STEEL: Color = (0.45, 0.47, 0.5)

DISPLAY_FACES = 20_000
"""A surface with more triangles is discarded, and its convex pieces are displayed instead."""


@dataclass(frozen=True, eq=False)
class MeshObject:
    """An object made from a mesh; its frame's origin is at half its height, on the vertical through the centre of mass.

    Attributes:
        name: Name of the object and of its file.
        about: Size of the object, and the file that it was made from.
        hulls: Convex pieces in the object's frame: corners [n, 3] [m] and triangles [m, 3] each.
        surface: Display surface in the same form; if it is empty, the pieces are displayed.
        mass: Mass [kg].
        friction: Coulomb coefficient with the table.
        center: Centre of mass in the object's frame, shape [3] [m].
        inertia: Inertia about the centre of mass, in the object's axes, shape [3, 3] [kg m^2].
        fit: How closely the pieces match the mesh.
        notes: Changes made to the mesh, one line each.
        color: Red, green and blue, each from 0 to 1.
    """

    name: str
    about: str
    hulls: tuple[Hull, ...]
    surface: tuple[Hull, ...]
    mass: float
    friction: float
    center: np.ndarray
    inertia: np.ndarray
    fit: Fit
    notes: tuple[str, ...] = field(default=())
    color: Color = STEEL

    @property
    def doc(self) -> str:
        """Returns the description of the object."""
        return f"{self.name}: {self.about}"

    @property
    def prim(self) -> str:
        """Returns the name of the object's prim."""
        title = "".join(part.title() for part in self.name.split("_"))
        return title if title[0].isalpha() else f"Object{title}"

    @property
    def rest_height(self) -> float:
        """Returns the height of the object's frame when it lies on the table [m]."""
        return round(-min(float(corners[:, 2].min()) for corners, _ in self.hulls), 6)

    @property
    def yaw_matters(self) -> bool:
        """Returns whether the object's yaw is visible; that of a ball is not."""
        return rolling_of_points(np.vstack([corners for corners, _ in self.hulls]) - self.center) != "every way"

    def draw(self, stage: Usd.Stage, root: str, look: Look) -> None:
        """Writes the object's display geometry below ``root``."""
        for number, (corners, triangles) in enumerate(self.surface or self.hulls):
            mesh(stage, f"{root}/surface{number}", corners, triangles.tolist(), look)

    def write(self, file: Path, *, note: str = "") -> None:
        """Writes the object's file, with ``note`` appended to its documentation."""
        stage = new_stage(file, self.prim, ". ".join(filter(None, (self.doc, *self.notes, note))))
        root = stage.GetDefaultPrim()
        material = physics_material(stage, f"/{self.prim}/Material", self.friction)
        UsdGeom.Scope.Define(stage, f"/{self.prim}/shape")
        self.draw(stage, f"/{self.prim}/shape", Look(self.color))
        UsdGeom.Scope.Define(stage, f"/{self.prim}/colliders")
        for number, (corners, triangles) in enumerate(self.hulls):
            mesh(stage, f"/{self.prim}/colliders/piece{number}", corners, triangles.tolist(), COLLIDER)
        bind_physics(root, material)
        mass_properties(root, self.mass, self.center, self.inertia)
        stage.Save()


def import_mesh(
    file: str | Path,
    *,
    name: str | None = None,
    mass: float | None = None,
    friction: float = FRICTION,
    scale: str | None = None,
    lay: Lay = "stable",
    wall: float | None = None,
    color: Color = STEEL,
) -> MeshObject:
    """Imports a mesh as an object: closes it, lays it on the table and cuts it into convex pieces.

    Args:
        file: STL, OBJ, GLB, PLY or OFF; its whole content becomes one object.
        name: Name of the object; ``None``: the file's name without its extension.
        mass: Mass [kg]; ``None``: that of wood of the same volume.
        friction: Coulomb coefficient with the table.
        scale: Unit of the mesh: mm, cm, m or inch; ``None``: metres.
        lay: Pose on the table: ``"stable"`` (its most stable pose), ``"flat"`` (its most stable one in which it does
            not roll) or ``"as-is"`` (as modelled, z up).
        wall: Thickness of the wall to give to an open surface [m]; ``None``: its holes are closed.
        color: Red, green and blue, each from 0 to 1.

    Raises:
        ConfigError: A number or unit is invalid.
        SceneError: The mesh cannot be used as an object; the message gives the reason and the remedy.
    """
    file = Path(file).expanduser()
    friction = checked_friction(friction)
    report("reading the mesh", 0.0)
    found = read_surface(file, scale, wall)
    surface = found.mesh
    report("laying it on the table", 0.15)
    _, done = lay_on_table(surface, lay, file)
    check_height(file, float(surface.extents[2]))
    solid = moments(surface)
    weight = checked_mass(mass, solid.volume)
    try:
        hulls, fit = decompose(
            surface, progress=lambda share: report("cutting it into convex pieces", 0.2 + 0.8 * share)
        )
    except SceneError as error:
        raise SceneError(error.what, file=file, allowed=error.allowed, fix=error.fix) from None
    size = " x ".join(f"{side:.3g}" for side in surface.extents)
    pieces = f"{len(hulls)} convex piece{'' if len(hulls) == 1 else 's'}: {fit}"
    shown = ((np.asarray(surface.vertices), np.asarray(surface.faces)),) if len(surface.faces) <= DISPLAY_FACES else ()
    return MeshObject(
        name=plain_name(name or file.stem),
        about=f"a mesh of {size} m, from {file.name}",
        hulls=hulls,
        surface=shown,
        mass=weight,
        friction=friction,
        center=solid.center,
        inertia=weight * solid.inertia,
        fit=fit,
        notes=(*found.notes, done, pieces, *_far_off(fit)),
        color=color,
    )


def _far_off(fit: Fit) -> tuple[str, ...]:
    """Returns a warning about pieces that are far from the mesh, as notes."""
    if not fit.is_far_off:
        return ()
    percent, mm = 100 * FAR_OFF[0], 1000 * FAR_OFF[2]
    why = f" (cutting it was stopped after {SECONDS:g} s of computing)" if fit.stopped else ""
    return (
        f"warning: the pieces are not the mesh{why}: {fit}; allowed are {percent:g} % and {mm:g} mm\n"
        "    to do: fill cavities that the arm cannot reach, cut the part into simpler meshes, or model it coarsely",
    )


def plain_name(text: str) -> str:
    """Converts text to a name for a file and a prim: letters, digits and underscores.

    Raises:
        SceneError: No characters are left.
    """
    name = "_".join(part for part in "".join(c if c.isascii() and c.isalnum() else " " for c in text).split()).lower()
    if not name:
        raise SceneError(
            f"{text!r} is not a valid object name", allowed="letters, digits and underscores", fix="use --name"
        )
    return name
