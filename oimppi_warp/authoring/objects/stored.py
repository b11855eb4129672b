"""Objects stored in USD files, made by the user or imported earlier."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Usd, UsdPhysics, UsdShade

from oimppi_warp.authoring.bundle import write_flattened
from oimppi_warp.authoring.objects.outlines import checked_mass
from oimppi_warp.authoring.prims import Color, Look, apply_api, mesh
from oimppi_warp.geometry.footprint import collider_mesh, height_range
from oimppi_warp.scene import Collider, PushedObject
from oimppi_warp.usd.bodies import center_of_mass, largest_friction, limit_surface_radius
from oimppi_warp.usd.colliders import ALLOWED, collider_prims, read_colliders, solid
from oimppi_warp.usd.conversion.upright import align_upright
from oimppi_warp.usd.inertia import read_mass, unit_inertia
from oimppi_warp.usd.stage import SceneStage

GREY: Color = (0.45, 0.47, 0.5)

ENDINGS = (".usda", ".usd", ".usdc", ".usdz")
"""File name extensions of USD files."""

_ROLES = ("OimppiObjectAPI", "PhysicsRigidBodyAPI")
"""API schemas that a scene applies to an object; the same object may be a static obstacle in another scene."""


@dataclass(frozen=True, eq=False)
class StoredObject:
    """An object in a USD file.

    Attributes:
        file: The USD file.
        name: Name of the file that the object is written to.
        doc: Description.
        colliders: The object's collision shapes in its frame.
        friction: Largest Coulomb coefficient of its materials; 0 without a material: the table's own value is used.
        mass: Mass used because the file gives none [kg]; ``None``: the mass in the file.
        color: Colour of its ghost at the goal.
    """

    file: Path
    name: str
    doc: str
    colliders: tuple[Collider, ...]
    friction: float
    mass: float | None = None
    color: Color = GREY

    @property
    def rest_height(self) -> float:
        """Returns the height of the object's frame when it lies on the table [m]."""
        return round(-float(height_range(self.colliders)[0]), 6)

    @property
    def yaw_matters(self) -> bool:
        """Returns whether the object's yaw is visible."""
        return True

    def draw(self, stage: Usd.Stage, root: str, look: Look) -> None:
        """Writes the hulls of the object's shapes below ``root``."""
        for number, collider in enumerate(self.colliders):
            hull = collider_mesh(collider)
            mesh(stage, f"{root}/piece{number}", np.asarray(hull.vertices), hull.faces.tolist(), look)

    @property
    def is_ready(self) -> bool:
        """Returns whether a scene can reference the file as it is: SI units, z up, with a mass, without a transform."""
        stage = SceneStage(self.file)
        root = stage.stage.GetDefaultPrim()
        return stage.stage.GetSessionLayer().empty and _gives_mass(root) and not _operations(root)

    def write(self, file: Path, *, note: str = "") -> None:
        """Writes the object as it was read to one file, with its textures in a folder beside it.

        ``note`` is not used, since the file has its own documentation.
        """
        opened = _open(self.file)
        _set_mass(opened, self.mass)
        flat = opened.stage.Flatten(addSourceFileComment=False)
        stage = Usd.Stage.Open(flat)
        root = stage.GetDefaultPrim()
        for name in _operations(root):
            root.RemoveProperty(name)
        for role in _ROLES:
            root.RemoveAppliedSchema(role)
        write_flattened(flat, file, self.file)


def read_object(file: str | Path, *, mass: float | None = None) -> StoredObject:
    """Reads an object from a USD file: its default prim, with a mass and convex colliders.

    If the file gives no mass, the given one is used, or else one computed from the densities of its shapes.

    Args:
        file: The file.
        mass: Mass to use if the file gives none [kg].

    Raises:
        ConfigError: The mass is invalid.
        SceneError: The file does not hold a valid object.
    """
    stage = _open(Path(file).expanduser().resolve())
    root = stage.stage.GetDefaultPrim()
    weighed = _set_mass(stage, mass)
    read_mass(stage, root)
    frame = stage.body_frame(root)
    if frame.GetRow3(2)[2] < 1.0 - 1e-6:
        fix = "make an Xform the default prim, and rotate the shapes below it"
        raise stage.error("the object does not lie flat", root, allowed="rotation about z only", fix=fix)
    colliders = read_colliders(stage, root, frame)
    if not colliders:
        fix = "apply PhysicsCollisionAPI to this prim or to a shape below it"
        raise stage.error("the object has no collider", root, allowed=ALLOWED, fix=fix)
    for prim in collider_prims(root):
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
        if material and not material.GetPath().HasPrefix(root.GetPath()):
            what = f"its material <{material.GetPath()}> is not below the default prim, and would be left behind"
            raise stage.error(what, prim, allowed=f"a prim below <{root.GetPath()}>", fix="move it there")
    doc = str(stage.stage.GetRootLayer().documentation).partition(". ")[0] or f"the object {stage.file.stem}"
    friction = largest_friction(stage, [root]) or 0.0
    return StoredObject(stage.file, stage.file.stem, doc, colliders, friction, mass if weighed else None)


def read_body(file: Path) -> PushedObject:
    """Reads the planner's model of the object in a USD file, with the friction of its own material.

    Raises:
        SceneError: The file does not hold a valid object.
    """
    obj, stage = read_object(file), _open(file.resolve())
    root = stage.stage.GetDefaultPrim()
    _set_mass(stage, None)
    mass = read_mass(stage, root)
    return PushedObject(
        path=str(root.GetPath()),
        mass=mass,
        friction=obj.friction,
        tool_friction=obj.friction,
        center_of_mass=center_of_mass(stage, root, obj.colliders),
        colliders=obj.colliders,
        rest_height=obj.rest_height,
        unit_inertia=unit_inertia(root, mass),
        limit_surface_radius=limit_surface_radius(stage, root),
    )


def is_object_file(file: Path) -> bool:
    """Returns whether a file's name has the extension of a USD file."""
    return file.suffix in ENDINGS


def _open(file: Path) -> SceneStage:
    """Opens an object's file, with its default prim turned upright as in a scene.

    Raises:
        SceneError: It has no default prim, or is a complete scene.
    """
    stage = SceneStage(file)
    root = stage.stage.GetDefaultPrim()
    if not root:
        fix = "set the object's root as the file's default prim: defaultPrim = \"...\""
        raise stage.error("a file without a default prim cannot be referenced", fix=fix)
    if stage.prims_with("OimppiTaskAPI"):
        allowed = "an object: a default prim with PhysicsMassAPI and colliders, as `oimppi scene import` writes them"
        raise stage.error("this is a complete scene, not an object", root, allowed=allowed)
    apply_api(root, "OimppiObjectAPI")
    align_upright(stage.stage)
    return stage


def _gives_mass(root: Usd.Prim) -> bool:
    """Returns whether the file gives a mass for the body as a whole, usable or not."""
    return bool(UsdPhysics.MassAPI(root).GetMassAttr().Get()) if root.HasAPI(UsdPhysics.MassAPI) else False


def _set_mass(stage: SceneStage, mass: float | None) -> bool:
    """Gives a body without a mass the requested one, or else one computed from the densities of its shapes.

    Args:
        stage: A stage whose default prim is the body.
        mass: The requested mass [kg].

    Returns:
        Whether the requested mass was needed.

    Raises:
        SceneError: The body has neither a mass nor densities, and no mass was requested.
    """
    root = stage.stage.GetDefaultPrim()
    if _gives_mass(root):
        return False
    if mass is not None:
        found = checked_mass(mass, 0.0)
    else:
        found = 0.0
        for collider in read_colliders(stage, root, stage.body_frame(root)):
            density = _density(stage.stage.GetPrimAtPath(collider.path), root)
            if not density > 0.0:
                fix = "set physics:mass or physics:density with PhysicsMassAPI, or use --mass"
                raise stage.error("the body has no mass", root, allowed="a mass or a density above zero", fix=fix)
            found += density * _volume(collider)
    if found:
        UsdPhysics.MassAPI.Apply(root).CreateMassAttr(found)
    return mass is not None


def _density(prim: Usd.Prim, root: Usd.Prim) -> float:
    """Returns the density given in a body's file for one of its shapes [kg/m^3], or 0 if there is none.

    As in UsdPhysics, a shape's own density takes precedence over that of its ancestors, and that over its material's.
    """
    for place in prim.GetPath().GetAncestorsRange():
        if place.HasPrefix(root.GetPath()):
            above = prim.GetStage().GetPrimAtPath(place)
            given = UsdPhysics.MassAPI(above).GetDensityAttr().Get() if above.HasAPI(UsdPhysics.MassAPI) else None
            if given:
                return float(given)
    material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
    physics = UsdPhysics.MaterialAPI(material.GetPrim()) if material else None
    return float(physics.GetDensityAttr().Get() or 0.0) if physics else 0.0


def _volume(collider: Collider) -> float:
    """Returns the volume of a shape [m^3]."""
    if collider.kind == "mesh":
        return float(solid(collider).volume)
    if collider.kind == "box":
        return 8.0 * math.prod(collider.size)
    radius, half_height = (*collider.size, 0.0)[:2]
    ball = 4.0 / 3.0 * math.pi * radius**3 if collider.kind in ("sphere", "capsule") else 0.0
    return ball + 2.0 * math.pi * radius**2 * half_height


def _operations(prim: Usd.Prim) -> list[str]:
    """Returns the names of a prim's transform operations in its file; a scene positions objects itself."""
    return [name for name in prim.GetAuthoredPropertyNames() if name.startswith("xformOp")]
