"""Edits of a stage that make it look like one of another program."""

from __future__ import annotations

import numpy as np
import trimesh
from pxr import Gf, Usd, UsdGeom, UsdPhysics, UsdShade
from support.foreign_scenes import reframed

Y_TO_Z = Gf.Rotation(Gf.Vec3d(1.0, 0.0, 0.0), 90.0)


TURNS = {
    "y up": Y_TO_Z.GetInverse(),
    "y down": Y_TO_Z,
    "x up": Gf.Rotation(Gf.Vec3d(0.0, 1.0, 0.0), 90.0),
    "z down": Gf.Rotation(Gf.Vec3d(1.0, 0.0, 0.0), 180.0),
}


def box_mesh(stage: Usd.Stage, path: str, approximation: str | None) -> None:
    """A cube of 0.1 m as a triangle mesh in the place of task02's."""
    stage.GetPrimAtPath("/World/Obstacles/Cube").SetActive(False)
    solid = trimesh.creation.box((0.1, 0.1, 0.1))
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr([Gf.Vec3f(*map(float, point)) for point in solid.vertices])
    mesh.CreateFaceVertexCountsAttr([3] * len(solid.faces))
    mesh.CreateFaceVertexIndicesAttr([int(i) for face in solid.faces for i in face])
    mesh.AddTranslateOp().Set(Gf.Vec3d(0.5, 0.05, 0.05))
    UsdPhysics.CollisionAPI.Apply(mesh.GetPrim())
    mesh.GetPrim().AddAppliedSchema("OimppiObstacleAPI")
    material = UsdShade.Material(stage.GetPrimAtPath("/World/Materials/Obstacle"))
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material, materialPurpose="physics")
    if approximation is not None:
        UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr(approximation)


def odd_obstacles(stage: Usd.Stage) -> None:
    """A scaled mesh and a lying cylinder below turned and scaled frames."""
    outer = UsdGeom.Xform.Define(stage, "/World/Obstacles/Outer")
    outer.AddTranslateOp().Set(Gf.Vec3d(0.1, 0.5, 0.0))
    outer.AddRotateZOp().Set(40.0)
    outer.AddScaleOp().Set(Gf.Vec3f(2.0))
    outer.GetPrim().AddAppliedSchema("OimppiObstacleAPI")
    mesh = stage.OverridePrim("/World/Obstacles/Outer/Mesh")
    box_mesh(stage, str(mesh.GetPath()), "convexHull")
    mesh.RemoveAppliedSchema("OimppiObstacleAPI")
    scale = UsdGeom.Xformable(mesh).AddScaleOp()
    scale.Set(Gf.Vec3f(0.5, 0.25, 0.5))
    UsdGeom.Xformable(mesh).GetOrderedXformOps()[0].Set(Gf.Vec3d(0.0, 0.0, 0.025))
    post = UsdGeom.Cylinder.Define(stage, "/World/Obstacles/Outer/Post")
    post.CreateRadiusAttr(0.02)
    post.CreateHeightAttr(0.1)
    post.CreateAxisAttr("X")
    post.AddTranslateOp().Set(Gf.Vec3d(0.1, 0.0, 0.02))
    UsdPhysics.CollisionAPI.Apply(post.GetPrim())


def frames_turned(stage: Usd.Stage) -> None:
    reframed(stage, "/World/Object", TURNS["x up"])
    reframed(stage, "/World/Robot/base", Y_TO_Z, ("/World/Robot/joints/joint1",))
    UsdPhysics.Joint(stage.GetPrimAtPath("/World/Robot/joints/mount")).CreateLocalRot0Attr(Gf.Quatf(Y_TO_Z.GetQuat()))


def scaled_cube(stage: Usd.Stage) -> None:
    """A scaled Cube that is a rigid body itself, in the place of the T."""
    stage.GetPrimAtPath("/World/Object").SetActive(False)
    cube = UsdGeom.Cube.Define(stage, "/World/Block")
    cube.CreateSizeAttr(1.0)
    cube.AddTranslateOp().Set(Gf.Vec3d(0.3, -0.45, 0.025))
    cube.AddRotateZOp().Set(30.0)
    cube.AddScaleOp().Set(Gf.Vec3f(0.2, 0.1, 0.05))
    UsdPhysics.RigidBodyAPI.Apply(cube.GetPrim())
    UsdPhysics.CollisionAPI.Apply(cube.GetPrim())
    mass = UsdPhysics.MassAPI.Apply(cube.GetPrim())
    mass.CreateMassAttr(0.5)
    mass.CreateCenterOfMassAttr(Gf.Vec3f(0.1, 0.0, 0.0))
    cube.GetPrim().AddAppliedSchema("OimppiObjectAPI")


def corner_mesh(stage: Usd.Stage) -> None:
    """An L of two bars of 0.1 x 0.03 x 0.05 m as one mesh that collides as its hull, in the place of the T."""
    body = stage.GetPrimAtPath("/World/Object")
    for part in Usd.PrimRange(body):
        part.RemoveAPI(UsdPhysics.CollisionAPI)
    for name in ("centerOfMass", "diagonalInertia", "principalAxes"):
        body.RemoveProperty(f"physics:{name}")
    UsdPhysics.MassAPI(body).GetMassAttr().Set(0.001)
    corners = np.array([(0.0, 0.0), (0.1, 0.0), (0.1, 0.03), (0.03, 0.03), (0.03, 0.1), (0.0, 0.1)])
    points = np.concatenate([np.column_stack([corners, np.full(6, z)]) for z in (-0.025, 0.025)])
    fans = [[0, i, i + 1] for i in range(1, 5)]
    sides = [[i, (i + 1) % 6, (i + 1) % 6 + 6, i + 6] for i in range(6)]
    faces = [*(fan[::-1] for fan in fans), *([i + 6 for i in fan] for fan in fans), *sides]
    mesh = UsdGeom.Mesh.Define(stage, "/World/Object/Corner")
    mesh.CreatePointsAttr([Gf.Vec3f(*point) for point in points.tolist()])
    mesh.CreateFaceVertexCountsAttr([len(face) for face in faces])
    mesh.CreateFaceVertexIndicesAttr([i for face in faces for i in face])
    UsdPhysics.CollisionAPI.Apply(mesh.GetPrim())
    UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr(UsdPhysics.Tokens.convexHull)
    material = next(UsdShade.Material(part) for part in Usd.PrimRange(body) if part.IsA(UsdShade.Material))
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material, materialPurpose="physics")
