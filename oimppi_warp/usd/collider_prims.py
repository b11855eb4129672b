"""Writes the collision shapes of a scene as USD."""

from __future__ import annotations

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdPhysics, Vt

from oimppi_warp.geometry.footprint import collider_mesh
from oimppi_warp.scene import Collider

COLOR = (0.35, 0.37, 0.4)
"""Colour of shapes that have no prim in any file."""

_HERE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def define_collider(stage: Usd.Stage, path: str, collider: Collider) -> Usd.Prim:
    """Adds a collider to a stage, in the frame of its parent prim.

    Args:
        stage: In metres, z up.
        path: Path of the new prim.
        collider: The shape.
    """
    if collider.kind == "box":
        shape = UsdGeom.Cube.Define(stage, path)
        shape.CreateSizeAttr(2.0)
    elif collider.kind == "sphere":
        shape = UsdGeom.Sphere.Define(stage, path)
        shape.CreateRadiusAttr(collider.size[0])
    elif collider.kind == "mesh":
        shape = _define_mesh(stage, path, collider)
    else:
        shape = (UsdGeom.Capsule if collider.kind == "capsule" else UsdGeom.Cylinder).Define(stage, path)
        shape.CreateRadiusAttr(collider.size[0])
        shape.CreateHeightAttr(2.0 * collider.size[1])
        shape.CreateAxisAttr(UsdGeom.Tokens.z)
    x, y, z, qx, qy, qz, qw = collider.transform.tolist()
    shape.AddTranslateOp().Set(Gf.Vec3d(x, y, z))
    shape.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Quatd(qw, qx, qy, qz))
    if collider.kind == "box":
        shape.AddScaleOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(*map(float, collider.size)))
    shape.CreateDisplayColorAttr([Gf.Vec3f(*COLOR)])
    extent = UsdGeom.Boundable.ComputeExtentFromPlugins(UsdGeom.Boundable(shape.GetPrim()), Usd.TimeCode.Default())
    shape.CreateExtentAttr(extent)
    UsdPhysics.CollisionAPI.Apply(shape.GetPrim())
    return shape.GetPrim()


def _define_mesh(stage: Usd.Stage, path: str, collider: Collider) -> UsdGeom.Mesh:
    """Defines a mesh that collides as its convex hull; a collider without faces is drawn with those of its hull."""
    points, faces = collider.vertices, collider.faces
    if points is None or faces is None:
        hull = collider_mesh(Collider(collider.path, "mesh", _HERE, (), points))
        points, faces = np.asarray(hull.vertices), np.asarray(hull.faces)
    shape = UsdGeom.Mesh.Define(stage, path)
    shape.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
    shape.CreateFaceVertexCountsAttr([3] * len(faces))
    shape.CreateFaceVertexIndicesAttr(faces.flatten().tolist())
    shape.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    UsdPhysics.MeshCollisionAPI.Apply(shape.GetPrim()).CreateApproximationAttr(UsdPhysics.Tokens.convexHull)
    return shape
