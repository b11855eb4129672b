"""Objects stored in USD files, made by the user or imported earlier."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Gf, Usd, UsdPhysics, UsdShade

from oimppi_warp.authoring.bundle import write_flattened
from oimppi_warp.authoring.objects.outlines import checked_friction, checked_mass
from oimppi_warp.authoring.prims import Color, Look, apply_api, mesh, physics_material
from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.footprint import collider_mesh, height_range
from oimppi_warp.scene import Collider, PushedObject
from oimppi_warp.usd.bodies import center_of_mass, largest_friction, limit_surface_radius
from oimppi_warp.usd.colliders import ALLOWED, collider_prims, read_colliders
from oimppi_warp.usd.conversion.units import editable_prims
from oimppi_warp.usd.conversion.upright import align_upright
from oimppi_warp.usd.densities import derive_mass, gives_mass
from oimppi_warp.usd.inertia import given_moments, given_tensor, read_mass, unit_inertia
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
        mass: Mass to use instead of the file's [kg]; ``None``: the mass that the file gives.
        changed_friction: Friction coefficient to use instead of the file's; ``None``: the file's.
        color: Colour of its ghost at the goal.
    """

    file: Path
    name: str
    doc: str
    colliders: tuple[Collider, ...]
    friction: float
    mass: float | None = None
    changed_friction: float | None = None
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
        """Returns whether a scene can reference the file as it is: SI units, z up, with a mass, without a transform.

        It cannot if another mass or friction than the file's was asked for.
        """
        if self.mass is not None or self.changed_friction is not None:
            return False
        stage = SceneStage(self.file)
        root = stage.stage.GetDefaultPrim()
        return stage.stage.GetSessionLayer().empty and gives_mass(root) and not _operations(root)

    def write(self, file: Path, *, note: str = "") -> None:
        """Writes the object as it was read to one file, with its textures in a folder beside it.

        ``note`` is not used, since the file has its own documentation.
        """
        opened = _open(self.file)
        _apply_options(opened, self.mass, self.changed_friction)
        flat = opened.stage.Flatten(addSourceFileComment=False)
        stage = Usd.Stage.Open(flat)
        root = stage.GetDefaultPrim()
        for name in _operations(root):
            root.RemoveProperty(name)
        for role in _ROLES:
            root.RemoveAppliedSchema(role)
        write_flattened(flat, file, self.file)


def read_object(file: str | Path, *, mass: float | None = None, friction: float | None = None) -> StoredObject:
    """Reads an object from a USD file: its default prim, with a mass and convex colliders.

    Without a mass, neither given nor in the file, it is computed from the densities of the shapes.

    Args:
        file: The file.
        mass: Mass to use instead of the file's [kg]; its inertia grows in proportion.
        friction: Coulomb coefficient with the table to use instead of the file's.

    Raises:
        ConfigError: The mass or the friction is invalid.
        SceneError: The file does not hold a valid object.
    """
    stage = _open(Path(file).expanduser().resolve())
    root = stage.stage.GetDefaultPrim()
    _apply_options(stage, mass, friction)
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
    found = largest_friction(stage, [root]) or 0.0
    return StoredObject(stage.file, stage.file.stem, doc, colliders, found, mass, friction)


def read_body(file: Path) -> PushedObject:
    """Reads the planner's model of the object in a USD file, with the friction of its own material.

    Raises:
        SceneError: The file does not hold a valid object.
    """
    obj, stage = read_object(file), _open(file.resolve())
    root = stage.stage.GetDefaultPrim()
    _apply_options(stage, None, None)
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


def _apply_options(stage: SceneStage, mass: float | None, friction: float | None) -> None:
    """Sets the mass [kg] and the friction of the default prim of a stage; ``None`` keeps those of the file."""
    root = stage.stage.GetDefaultPrim()
    colliders = read_colliders(stage, root, stage.body_frame(root))
    if mass is None:
        derive_mass(stage, root, colliders, fix=", or use --mass")
    else:
        _set_mass(stage, root, colliders, checked_mass(mass, 0.0))
    if friction is not None:
        material = physics_material(stage.stage, f"{root.GetPath()}/OimppiFriction", checked_friction(friction))
        for prim in editable_prims(stage.stage):
            if prim.GetPath().HasPrefix(root.GetPath()) and prim.HasAPI(UsdPhysics.CollisionAPI):
                UsdShade.MaterialBindingAPI.Apply(prim).Bind(
                    material, UsdShade.Tokens.strongerThanDescendants, "physics"
                )


def _set_mass(stage: SceneStage, root: Usd.Prim, colliders: tuple[Collider, ...], mass: float) -> None:
    """Sets a body's mass [kg], whatever the file says; an inertia in the file grows in proportion."""
    with suppress(SceneError):  # neither a mass nor densities, or unusable ones
        derive_mass(stage, root, colliders)
    api = UsdPhysics.MassAPI.Apply(root)
    before = float(api.GetMassAttr().Get() or 0.0)
    if 0.0 < before < math.inf:
        moments, tensor = given_moments(root), given_tensor(root)
        if moments is not None:
            api.CreateDiagonalInertiaAttr(Gf.Vec3f(*(mass / before * moments).tolist()))
        if tensor is not None:
            given = root.GetAttribute("newton:inertia")
            given.Set(type(given.Get())([mass / before * value for value in given.Get()]))
    api.CreateMassAttr(mass)


def _operations(prim: Usd.Prim) -> list[str]:
    """Returns the names of a prim's transform operations in its file; a scene positions objects itself."""
    return [name for name in prim.GetAuthoredPropertyNames() if name.startswith("xformOp")]
