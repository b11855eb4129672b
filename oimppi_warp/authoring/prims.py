"""Writes the few kinds of prims that the shipped scenes are made of.

Functions that add a prim take the stage and the path, and return the prim. Inputs are in metres, kilograms and radians;
output is in the units of UsdPhysics (degrees).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade, Vt
from scipy.spatial.transform import Rotation

Vector = Sequence[float] | np.ndarray
Points = Sequence[Vector] | np.ndarray
Color = tuple[float, float, float]


def new_stage(file: Path, root: str, doc: str) -> Usd.Stage:
    """Creates an empty stage in metres and kilograms, z up, with one component ``/root`` as its default prim."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.unlink(missing_ok=True)
    stage = Usd.Stage.CreateNew(str(file))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    stage.SetMetadata("documentation", doc)
    prim = UsdGeom.Xform.Define(stage, f"/{root}").GetPrim()
    Usd.ModelAPI(prim).SetKind(Kind.Tokens.component)
    stage.SetDefaultPrim(prim)
    return stage


def rounded(values: Vector, digits: int = 12) -> list[float]:
    """Rounds to ``digits`` decimals and returns plain floats (-0.0 becomes 0.0).

    Files are then readable, and the same on every machine.
    """
    return [round(float(v), digits) + 0.0 for v in values]


def vec3(v: Vector) -> Gf.Vec3f:
    """Converts three numbers to a single-precision vector, rounded to 9 decimals."""
    return Gf.Vec3f(*rounded(v, 9))


def quat(q: Vector) -> Gf.Quatf:
    """Converts a quaternion xyzw to USD's (w, x, y, z), in single precision and rounded to 9 decimals."""
    x, y, z, w = rounded(q, 9)
    return Gf.Quatf(w, x, y, z)


def set_pose(prim: Usd.Prim, position: Vector, orientation: Vector | None = None) -> None:
    """Places a prim at a position [m] and, if given, an orientation (quaternion xyzw) in its parent's frame."""
    UsdGeom.Xformable(prim).ClearXformOpOrder()
    _add_operation(prim, UsdGeom.XformOp.TypeTranslate, Gf.Vec3d(*rounded(position)))
    if orientation is not None:
        _add_operation(prim, UsdGeom.XformOp.TypeOrient, quat(orientation))


def set_planar_pose(prim: Usd.Prim, pose: Vector, height: float) -> None:
    """Places a prim at a planar pose (x [m], y [m], yaw [rad]) and a height [m] in its parent's frame.

    A scale along its own axes, which the file that it refers to may give it, is kept.
    """
    set_pose(prim, (pose[0], pose[1], height))
    _add_operation(prim, UsdGeom.XformOp.TypeRotateZ, round(math.degrees(pose[2]), 9))
    if scale := prim.GetAttribute("xformOp:scale"):
        xform = UsdGeom.Xformable(prim)
        xform.SetXformOpOrder([*xform.GetOrderedXformOps(), UsdGeom.XformOp(scale)])


def _add_operation(prim: Usd.Prim, kind: UsdGeom.XformOp.Type, value: Gf.Vec3d | Gf.Quatf | float) -> None:
    """Adds a transform operation in the prim's precision, or in that of an attribute defined by another file."""
    there = prim.GetAttribute(f"xformOp:{UsdGeom.XformOp.GetOpTypeToken(kind)}")
    own = UsdGeom.XformOp.PrecisionFloat if isinstance(value, Gf.Quatf) else UsdGeom.XformOp.PrecisionDouble
    precision = UsdGeom.XformOp(there).GetPrecision() if there else own
    operation = UsdGeom.Xformable(prim).AddXformOp(kind, precision)
    operation.Set(type(operation.GetTypeName().defaultValue)(value))


def apply_api(prim: Usd.Prim, *names: str) -> None:
    """Applies API schemas by name; the package's own and Newton's need not be registered to be written."""
    for name in names:
        prim.AddAppliedSchema(name)


def attribute(prim: Usd.Prim, name: str, type_name: Sdf.ValueTypeName, value: object) -> None:
    """Authors an attribute that an API schema of the prim defines."""
    prim.CreateAttribute(name, type_name, custom=False).Set(value)


def _finish(gprim: UsdGeom.Gprim, color: Color | None, collide: bool, opacity: float = 1.0) -> Usd.Prim:
    """Sets colour, extent and collision of a geometry prim; without a colour it becomes a guide, which is not drawn."""
    prim = gprim.GetPrim()
    extent = UsdGeom.Boundable.ComputeExtentFromPlugins(UsdGeom.Boundable(prim), Usd.TimeCode.Default())
    gprim.CreateExtentAttr(extent)
    if color is None:
        gprim.CreatePurposeAttr(UsdGeom.Tokens.guide)
    else:
        gprim.CreateDisplayColorAttr([Gf.Vec3f(*color)])
    if opacity < 1.0:
        gprim.CreateDisplayOpacityAttr([opacity])
    if collide:
        UsdPhysics.CollisionAPI.Apply(prim)
    return prim


@dataclass(frozen=True)
class Look:
    """The look of a geometry prim: its colour (``None``: hidden), its opacity, and whether the prim collides."""

    color: Color | None = None
    collide: bool = False
    opacity: float = 1.0


COLLIDER = Look(collide=True)


def box(
    stage: Usd.Stage, path: str, center: Vector, extents: Vector, look: Look, turn: Vector | None = None
) -> Usd.Prim:
    """Adds a box at ``center`` with the side lengths ``extents`` [m], turned by ``turn``, a quaternion xyzw."""
    cube = UsdGeom.Cube.Define(stage, path)
    cube.CreateSizeAttr(1.0)
    set_pose(cube.GetPrim(), center, turn)
    cube.AddScaleOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(*rounded(extents)))
    return _finish(cube, look.color, look.collide, look.opacity)


def sphere(stage: Usd.Stage, path: str, center: Vector, radius: float, look: Look) -> Usd.Prim:
    """Adds a sphere at ``center`` [m]."""
    gprim = UsdGeom.Sphere.Define(stage, path)
    gprim.CreateRadiusAttr(radius)
    set_pose(gprim.GetPrim(), center)
    return _finish(gprim, look.color, look.collide, look.opacity)


def cylinder(
    stage: Usd.Stage, path: str, center: Vector, radius: float, height: float, look: Look, turn: Vector | None = None
) -> Usd.Prim:
    """Adds a cylinder at ``center`` [m] along z, or turned by ``turn``, a quaternion xyzw."""
    gprim = UsdGeom.Cylinder.Define(stage, path)
    gprim.CreateRadiusAttr(radius)
    gprim.CreateHeightAttr(height)
    gprim.CreateAxisAttr(UsdGeom.Tokens.z)
    set_pose(gprim.GetPrim(), center, turn)
    return _finish(gprim, look.color, look.collide, look.opacity)


def capsule(stage: Usd.Stage, path: str, a: Vector, b: Vector, radius: float, look: Look) -> Usd.Prim:
    """Adds a capsule whose axis runs from point ``a`` to point ``b`` [m]."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    gprim = UsdGeom.Capsule.Define(stage, path)
    gprim.CreateRadiusAttr(radius)
    gprim.CreateHeightAttr(round(float(np.linalg.norm(b - a)), 9))
    gprim.CreateAxisAttr(UsdGeom.Tokens.z)
    set_pose(gprim.GetPrim(), (a + b) / 2, z_to(b - a))
    return _finish(gprim, look.color, look.collide, look.opacity)


def mesh(
    stage: Usd.Stage, path: str, points: np.ndarray, faces: Sequence[Sequence[int]], look: Look, normals: Points = ()
) -> Usd.Prim:
    """Adds a polygon mesh [m], smooth if ``normals`` has one per point; a mesh that collides does so as its hull."""
    gprim = UsdGeom.Mesh.Define(stage, path)
    gprim.CreatePointsAttr(Vt.Vec3fArray([vec3(np.round(p, 5)) for p in points]))
    gprim.CreateFaceVertexCountsAttr([len(face) for face in faces])
    gprim.CreateFaceVertexIndicesAttr([i for face in faces for i in face])
    gprim.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    if len(normals):
        gprim.CreateNormalsAttr(Vt.Vec3fArray([vec3(np.round(n, 2)) for n in normals]))
        gprim.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    prim = _finish(gprim, look.color, look.collide, look.opacity)
    if look.collide:
        UsdPhysics.MeshCollisionAPI.Apply(prim).CreateApproximationAttr(UsdPhysics.Tokens.convexHull)
    return prim


def prism(stage: Usd.Stage, path: str, polygon: np.ndarray, height: float, look: Look) -> Usd.Prim:
    """Adds a convex polygon (counter-clockwise, shape [n, 2] [m]), extruded up and down by half its height."""
    n = len(polygon)
    points = np.vstack([np.c_[polygon, np.full(n, z)] for z in (-height / 2, height / 2)])
    sides = [[i, (i + 1) % n, n + (i + 1) % n, n + i] for i in range(n)]
    return mesh(stage, path, points, [list(range(n))[::-1], list(range(n, 2 * n)), *sides], look)


def about_z(yaw: float) -> np.ndarray | None:
    """Returns a rotation about z [rad] as a quaternion xyzw; ``None`` for no rotation."""
    return np.array([0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)]) if yaw else None


def z_to(direction: Vector) -> np.ndarray:
    """Returns the shortest rotation that turns z into ``direction``, as a quaternion xyzw."""
    d = np.asarray(direction, float) / np.linalg.norm(direction)
    if d[2] < -1.0 + 1e-9:
        return np.array([1.0, 0.0, 0.0, 0.0])
    q = np.array([-d[1], d[0], 0.0, 1.0 + d[2]])
    return q / np.linalg.norm(q)


def physics_material(stage: Usd.Stage, path: str, friction: float) -> UsdShade.Material:
    """Adds a material with equal static and dynamic friction, and no restitution."""
    material = UsdShade.Material.Define(stage, path)
    api = UsdPhysics.MaterialAPI.Apply(material.GetPrim())
    api.CreateStaticFrictionAttr(friction)
    api.CreateDynamicFrictionAttr(friction)
    api.CreateRestitutionAttr(0.0)
    return material


def bind_physics(root: Usd.Prim, material: UsdShade.Material) -> None:
    """Binds a physics material to each collider at and below a prim, since not every reader inherits bindings."""
    for prim in Usd.PrimRange(root):
        if prim.HasAPI(UsdPhysics.CollisionAPI):
            binding = UsdShade.MaterialBindingAPI.Apply(prim)
            binding.Bind(material, UsdShade.Tokens.weakerThanDescendants, "physics")


def mass_properties(prim: Usd.Prim, mass: float, center: Vector, inertia: np.ndarray) -> None:
    """Authors mass [kg], centre of mass [m] and inertia about it in the prim's axes, shape [3, 3] [kg m^2]."""
    moments, axes = np.linalg.eigh(inertia)
    axes = axes[:, np.argsort(np.abs(axes).argmax(axis=0), kind="stable")] if _is_diagonal(inertia) else axes
    moments = np.diag(axes.T @ inertia @ axes)
    axes *= np.where(axes[np.abs(axes).argmax(axis=0), range(3)] < 0, -1.0, 1.0)
    if np.linalg.det(axes) < 0:
        axes[:, 2] *= -1.0
    api = UsdPhysics.MassAPI.Apply(prim)
    api.CreateMassAttr(mass)
    api.CreateCenterOfMassAttr(vec3(center))
    api.CreateDiagonalInertiaAttr(vec3(np.round(moments, 9)))
    api.CreatePrincipalAxesAttr(quat(matrix_quat(axes)))


def _is_diagonal(matrix: np.ndarray) -> bool:
    return bool(np.allclose(matrix, np.diag(np.diag(matrix)), atol=1e-12))


def matrix_quat(matrix: np.ndarray) -> np.ndarray:
    """Returns the quaternion (xyzw) of a rotation matrix.

    Of the two equivalent ones it is the one with w > 0, or for half a turn the one whose first non-zero number is
    negative, so that the result is the same on every machine.
    """
    q = Rotation.from_matrix(matrix).as_quat()
    w, first = q[3], q[np.flatnonzero(np.abs(q) > 1e-9)[0]]
    return q if w > 1e-9 or (w > -1e-9 and first < 0.0) else -q
