"""Reads USD collision shapes as :class:`oimppi_warp.scene.Collider`, and computes their mass properties."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdPhysics

from oimppi_warp.geometry.footprint import collider_mesh, transform_points
from oimppi_warp.scene import Collider
from oimppi_warp.usd.frames import is_orthogonal, scales, transform
from oimppi_warp.usd.meshes import approximation, enclosing, triangles
from oimppi_warp.usd.stage import MAX_LENGTH, SceneStage

if TYPE_CHECKING:
    import trimesh

ALLOWED = "Cube, Sphere, Cylinder, Capsule, or a Mesh that is convex or has a convex physics:approximation"

_THINNEST = 1e-6
"""Least half side or radius of a shape [m]; with less, its volume and inertia are lost to rounding."""
_TO_Z = {
    UsdGeom.Tokens.x: Gf.Matrix4d().SetRotate(Gf.Rotation(Gf.Vec3d(0, 1, 0), 90.0)),
    UsdGeom.Tokens.y: Gf.Matrix4d().SetRotate(Gf.Rotation(Gf.Vec3d(1, 0, 0), -90.0)),
    UsdGeom.Tokens.z: Gf.Matrix4d(1.0),
}


def collider_prims(root: Usd.Prim) -> Iterator[Usd.Prim]:
    """Yields the colliding prims below ``root``, excluding bodies nested in it."""
    prims = iter(Usd.PrimRange(root, Usd.TraverseInstanceProxies()))
    for prim in prims:
        if prim != root and prim.HasAPI(UsdPhysics.RigidBodyAPI):
            prims.PruneChildren()
        elif prim.HasAPI(UsdPhysics.CollisionAPI) and UsdPhysics.CollisionAPI(prim).GetCollisionEnabledAttr().Get():
            yield prim


def read_colliders(scene: SceneStage, root: Usd.Prim, body: Gf.Matrix4d) -> tuple[Collider, ...]:
    """Reads the collision shapes of ``root`` and below it; one with a mistake is noted and skipped.

    Args:
        scene: The stage.
        root: A body, or an obstacle.
        body: Frame in the world in which the shapes are expressed.
    """
    inverse = body.GetInverse()
    found = [scene.attempt(None, _read, scene, prim, scene.frame(prim) * inverse) for prim in collider_prims(root)]
    return tuple(collider for collider in found if collider is not None)


def _read(scene: SceneStage, prim: Usd.Prim, frame: Gf.Matrix4d) -> Collider:
    found = _shape(scene, prim, frame)
    sides = found.size[:1] if found.kind == "capsule" else found.size  # a capsule may be as short as a sphere
    if min(sides, default=_THINNEST) < _THINNEST:
        raise scene.error(
            f"the shape is only {2.0 * min(sides):.2g} m thick",
            prim,
            allowed=f"{2.0 * _THINNEST:g} m or more",
            fix="correct its size, or remove it",
        )
    return found


def _shape(scene: SceneStage, prim: Usd.Prim, frame: Gf.Matrix4d) -> Collider:
    path, scale = str(prim.GetPath()), scales(frame)
    if scale.min() < 1e-9 or frame.GetDeterminant() <= 0.0:
        raise scene.error(
            "the shape has a zero or negative scale",
            prim,
            allowed="a positive scale",
            fix="scale it by positive numbers; to mirror a mesh, mirror its points",
        )
    if not is_orthogonal(frame):
        raise scene.error(
            "the shape is sheared",
            prim,
            allowed="translation, rotation, and scale along its own axes",
            fix="apply the scale first (xformOp:scale last in xformOpOrder), and scale its ancestors uniformly",
        )

    if prim.IsA(UsdGeom.Cube):
        side = _positive(scene, prim, "size")
        return Collider(path, "box", transform(frame), tuple(float(s) * side / 2 for s in scale))
    if prim.IsA(UsdGeom.Sphere):
        factor = _uniform(scene, prim, scale)
        return Collider(path, "sphere", transform(frame), (_positive(scene, prim, "radius") * factor,))
    if prim.IsA(UsdGeom.Cylinder) or prim.IsA(UsdGeom.Capsule):
        kind = "cylinder" if prim.IsA(UsdGeom.Cylinder) else "capsule"
        axis = prim.GetAttribute("axis").Get()
        if axis not in _TO_Z:
            raise scene.error(
                f"axis is {axis}", prim, allowed=", ".join(_TO_Z), fix="set axis to the direction of the shape's height"
            )
        frame = _TO_Z[axis] * frame
        x, y, z = scales(frame)
        across = _uniform(scene, prim, np.array([x, y, z] if kind == "capsule" else [x, y]))
        radius, height = _positive(scene, prim, "radius"), _positive(scene, prim, "height")
        return Collider(path, kind, transform(frame), (radius * across, height * float(z) / 2))
    if prim.IsA(UsdGeom.Mesh):
        points = _mesh_points(scene, prim) * scale
        return Collider(path, "mesh", transform(frame), (), points, _enclosing_faces(prim, points))
    raise scene.error(
        f"the collider's type is {prim.GetTypeName() or 'not set'}",
        prim,
        allowed=ALLOWED,
        fix="use one of these as the collider, and keep this prim for display only",
    )


def _positive(scene: SceneStage, prim: Usd.Prim, name: str) -> float:
    value = scene.number(prim, name, 0.0)
    if not 0.0 < value < MAX_LENGTH:
        raise scene.error(
            f"{name} is {value:g} m",
            prim,
            allowed=f"more than zero and less than {MAX_LENGTH:g} m",
            fix=f"set {name} to a length above zero",
        )
    return value


def _uniform(scene: SceneStage, prim: Usd.Prim, scale: np.ndarray) -> float:
    if np.ptp(scale) > 1e-5 * scale.max():
        raise scene.error(
            "the round shape has a non-uniform scale",
            prim,
            allowed="the same scale for all of its radii",
            fix="scale it uniformly, or use a Mesh",
        )
    return float(scale.mean())


def _mesh_points(scene: SceneStage, prim: Usd.Prim) -> np.ndarray:
    """Returns the points of a mesh that is represented by its convex hull, in the prim's frame, shape [n, 3]."""
    kind = approximation(prim)
    if kind != UsdPhysics.Tokens.convexHull:
        reason = ", but the mesh is not a closed convex surface" if kind == UsdPhysics.Tokens.none else ""
        raise scene.error(
            f"physics:approximation is {kind}{reason}",
            prim,
            allowed="convexHull, boundingCube, boundingSphere, or none for a closed convex surface",
            fix="set physics:approximation to convexHull; or export the mesh as STL, and cut that into convex pieces "
            "with `oimppi scene import`",
        )
    points = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get() or [], dtype=float).reshape(-1, 3)
    if not (np.abs(points) < MAX_LENGTH).all():
        allowed = f"finite coordinates below {MAX_LENGTH:g} m"
        raise scene.error(
            "the mesh has points that are too far away or not finite",
            prim,
            allowed=allowed,
            fix="correct its points",
        )
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) if len(points) >= 4 else np.zeros(3)
    if spread[-1] < 1e-6:
        raise scene.error(
            f"the {len(points)} points of the mesh span no volume",
            prim,
            allowed="a solid shape",
            fix="give it some thickness",
        )
    if triangles(prim) is None:
        raise scene.error(
            "the faces of the mesh are missing, have fewer than 3 corners, or refer to points that do not exist",
            prim,
            allowed="faceVertexCounts of 3 or more; as many faceVertexIndices as their sum, below the number of points",
            fix="correct faceVertexCounts and faceVertexIndices",
        )
    return points


def _enclosing_faces(prim: Usd.Prim, points: np.ndarray) -> np.ndarray | None:
    """Returns the triangles that enclose a mesh with these points [n, 3], shape [m, 3]; ``None`` if it is open."""
    faces = triangles(prim)
    return None if faces is None else enclosing(points, faces)


def volume_and_center(collider: Collider) -> tuple[float, np.ndarray]:
    """Returns a collider's volume [m^3] and the centre of that volume in the body's frame, shape [3] [m]."""
    size, position = collider.size, collider.transform[:3]
    if collider.kind == "box":
        return 8 * math.prod(size), position
    if collider.kind == "sphere":
        return 4 / 3 * math.pi * size[0] ** 3, position
    if collider.kind in ("cylinder", "capsule"):
        radius, half = size
        ends = 4 / 3 * math.pi * radius**3 if collider.kind == "capsule" else 0.0
        return 2 * math.pi * radius**2 * half + ends, position
    body = solid(collider)
    return float(body.volume), body.center_mass


def solid(collider: Collider) -> trimesh.Trimesh:
    """Returns the solid whose volume counts for the mass, in the body's frame [m].

    For a mesh, it is what the mesh's own faces enclose; its convex hull, if they are open.
    """
    import trimesh

    if collider.vertices is None or collider.faces is None:
        return collider_mesh(collider)
    points = transform_points(collider.transform, collider.vertices)
    return trimesh.Trimesh(points, collider.faces, process=False)
