"""Objects stored in USD files, made by the user or imported earlier."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdPhysics, UsdShade

from oimppi_warp.authoring.bundle import write_flattened
from oimppi_warp.authoring.objects.outlines import (
    SIDES,
    SIZES,
    TABLE_FRICTION,
    check_height,
    checked_friction,
    checked_mass,
)
from oimppi_warp.authoring.prims import Color, Look, apply_api, mesh, physics_material
from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.footprint import collider_mesh, core_points, height_range
from oimppi_warp.scene import Collider, PushedObject
from oimppi_warp.usd.bodies import (
    center_of_mass,
    largest_friction,
    limit_surface_radius,
    nested_bodies,
    nested_error,
    object_frame,
)
from oimppi_warp.usd.colliders import ALLOWED, collider_prims, read_colliders
from oimppi_warp.usd.conversion.units import editable_prims
from oimppi_warp.usd.conversion.upright import align_upright
from oimppi_warp.usd.densities import derive_mass, gives_mass
from oimppi_warp.usd.frames import format_numbers, scales
from oimppi_warp.usd.inertia import given_moments, given_tensor, read_mass, unit_inertia
from oimppi_warp.usd.stage import SceneStage

GREY: Color = (0.45, 0.47, 0.5)

ENDINGS = (".usda", ".usd", ".usdc", ".usdz")
"""File name extensions of USD files."""

_ROLES = ("OimppiObjectAPI", "PhysicsRigidBodyAPI")
"""API schemas that a scene applies to an object; the same object may be a static obstacle in another scene."""


_OUTSIDE = 1e-3
"""Largest distance of the centre of mass outside the object that is put down to rounding [m]."""

_ORDER, _SCALE = "xformOpOrder", "xformOp:scale"


@dataclass(frozen=True, eq=False)
class StoredObject:
    """An object in a USD file.

    Attributes:
        file: The USD file.
        name: Name of the file that the object is written to.
        doc: Description.
        colliders: The object's collision shapes in its frame.
        friction: Largest Coulomb coefficient of its materials; ``None`` without a material: the table's own is used.
        mass: Mass to use instead of the file's [kg]; ``None``: the mass that the file gives.
        changed_friction: Friction coefficient to use instead of the file's; ``None``: the file's.
        color: Colour of its ghost at the goal.
    """

    file: Path
    name: str
    doc: str
    colliders: tuple[Collider, ...]
    friction: float | None
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

        It cannot if another mass or friction than the file's was asked for. It may be scaled along its own axes.
        """
        if self.mass is not None or self.changed_friction is not None:
            return False
        stage = SceneStage(self.file)
        root = stage.stage.GetDefaultPrim()
        return stage.stage.GetSessionLayer().empty and gives_mass(root) and set(_operations(root)) <= {_ORDER, _SCALE}

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
        scale = scales(opened.frame(opened.stage.GetDefaultPrim()))
        if not np.allclose(scale, 1.0, rtol=1e-6):
            UsdGeom.Xformable(root).AddScaleOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(*scale.tolist()))
        for role in _ROLES:
            root.RemoveAppliedSchema(role)
        write_flattened(flat, file, self.file)


def read_object(
    file: str | Path, *, mass: float | None = None, friction: float | None = None, static: bool = False
) -> StoredObject:
    """Reads an object from a USD file: its default prim, with a mass and convex colliders.

    Without a mass, neither given nor in the file, it is computed from the densities of the shapes.

    Args:
        file: The file.
        mass: Mass to use instead of the file's [kg]; its inertia grows in proportion.
        friction: Coulomb coefficient with the table to use instead of the file's.
        static: Whether the object is an obstacle, which may be of any size, friction and centre of mass.

    Raises:
        ConfigError: The mass or the friction is invalid.
        SceneError: The file does not hold a valid object.
    """
    stage = _open(Path(file).expanduser().resolve())
    root = stage.stage.GetDefaultPrim()
    _apply_options(stage, mass, friction)
    read_mass(stage, root)
    frame = object_frame(stage, root)
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
    found = largest_friction(stage, [root])
    if not static:
        _check_size(stage.file, colliders)
        _check_center(stage, root, colliders)
        _check_friction(stage, root, found)
    return StoredObject(stage.file, stage.file.stem, doc, colliders, found, mass, friction)


def read_body(file: Path) -> PushedObject:
    """Reads the planner's model of the object in a USD file, with the friction of its own material.

    Without a material, its friction is that of a new scene's table.

    Raises:
        SceneError: The file does not hold a valid object.
    """
    obj, stage = read_object(file, static=True), _open(file.resolve())
    root = stage.stage.GetDefaultPrim()
    _apply_options(stage, None, None)
    mass = read_mass(stage, root)
    friction = TABLE_FRICTION if obj.friction is None else obj.friction
    return PushedObject(
        path=str(root.GetPath()),
        mass=mass,
        friction=friction,
        tool_friction=friction,
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
        SceneError: It has no default prim, is a complete scene, or has another rigid body than its default prim.
    """
    stage = SceneStage(file)
    root = stage.stage.GetDefaultPrim()
    if not root:
        fix = "set the object's root as the file's default prim: defaultPrim = \"...\""
        raise stage.error("a file without a default prim cannot be referenced", fix=fix)
    if stage.prims_with("OimppiTaskAPI"):
        allowed = "an object: a default prim with PhysicsMassAPI and colliders, as `oimppi scene import` writes them"
        raise stage.error("this is a complete scene, not an object", root, allowed=allowed)
    _check_bodies(stage, root)
    apply_api(root, "OimppiObjectAPI")
    align_upright(stage.stage)
    return stage


def _check_bodies(stage: SceneStage, root: Usd.Prim) -> None:
    """Raises SceneError if a prim below the default prim is a rigid body."""
    parts = nested_bodies(stage, root)
    if len(parts) == 1 and not any(collider_prims(root)):
        raise stage.error(
            f"the rigid body is <{parts[0].GetPath()}>, not the default prim",
            root,
            allowed="the rigid body as the default prim, as in </Object> with its shapes below it",
            fix=f"move PhysicsRigidBodyAPI, PhysicsMassAPI and the mass from <{parts[0].GetPath()}> to this prim",
        )
    if parts:
        raise nested_error(stage, parts[0])


def _check_size(file: Path, colliders: tuple[Collider, ...]) -> None:
    """Raises SceneError for an object that the arm cannot push because of its size."""
    cores = [core_points(collider) for collider in colliders]
    lowest = np.min([points.min(axis=0) - radius for points, radius in cores], axis=0)
    extents = np.max([points.max(axis=0) + radius for points, radius in cores], axis=0) - lowest
    low, high = SIZES[0], SIDES[1]
    if not low <= extents.max() <= high:
        size = " x ".join(f"{side:.3g}" for side in extents)
        raise SceneError(
            f"the object is too {'large' if extents.max() > high else 'small'} for the arm: {size} m",
            file=file,
            allowed=f"{low:g} to {high:g} m for the longest side",
            fix="scale its shapes, or correct metersPerUnit; the units of a file that it refers to are not converted",
        )
    check_height(file, float(extents[2]))


def _check_center(stage: SceneStage, root: Usd.Prim, colliders: tuple[Collider, ...]) -> None:
    """Raises SceneError for a centre of mass outside the object's convex hull."""
    import trimesh

    center = center_of_mass(stage, root, colliders)
    hull = trimesh.convex.convex_hull(np.vstack([collider_mesh(collider).vertices for collider in colliders]))
    outside = np.einsum("fi,fi->f", hull.face_normals, center - hull.triangles_center).max()
    if outside > _OUTSIDE:
        raise stage.error(
            f"its centre of mass {format_numbers(center)} is outside the object",
            root,
            allowed="a point within its convex hull, in the object's frame",
            fix="correct physics:centerOfMass, or leave it out to have it computed from the shapes",
        )


def _check_friction(stage: SceneStage, root: Usd.Prim, friction: float | None) -> None:
    """Raises SceneError for a material with whose friction nothing can be pushed; there may be no material."""
    if friction is not None and not 0.0 < friction <= 2.0:
        raise stage.error(
            f"the largest physics:dynamicFriction of its materials is {friction:g}",
            root,
            allowed="more than 0, up to 2; physics:staticFriction is not used",
            fix="correct physics:dynamicFriction, or use --friction",
        )


def _apply_options(stage: SceneStage, mass: float | None, friction: float | None) -> None:
    """Sets the mass [kg] and the friction of the default prim of a stage; ``None`` keeps those of the file."""
    root = stage.stage.GetDefaultPrim()
    colliders = read_colliders(stage, root, object_frame(stage, root))
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
