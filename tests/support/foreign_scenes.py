"""Shipped scenes as other programs would write them: in other units, with y up, packed, with instances."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdPhysics, Vt

from oimppi_warp.usd import shipped_scenes


def flat(name: str) -> Usd.Stage:
    """A shipped scene as one layer of its own."""
    (shipped,) = [scene.path for scene in shipped_scenes() if scene.name == name]
    return Usd.Stage.Open(Usd.Stage.Open(str(shipped)).Flatten(addSourceFileComment=False))


def measured_in(stage: Usd.Stage, metres: float, kilograms: float) -> None:
    """Write all numbers of a stage in metres and kilograms in other units."""
    newton = kilograms * metres
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Xformable):
            for operation in UsdGeom.Xformable(prim).GetOrderedXformOps():
                if operation.GetOpType() == UsdGeom.XformOp.TypeTranslate:
                    operation.Set(Gf.Vec3d(operation.Get()) / metres)
        lengths = {"size", "radius", "height", "points", "extent", "physics:centerOfMass", "physics:localPos0"}
        lengths |= {"physics:localPos1", "physics:gravityMagnitude"}
        factors = dict.fromkeys(lengths, 1.0 / metres)
        factors |= {"physics:mass": 1.0 / kilograms, "physics:diagonalInertia": 1.0 / (kilograms * metres**2)}
        factors["drive:angular:physics:maxForce"] = 1.0 / (newton * metres)
        factors["drive:linear:physics:maxForce"] = 1.0 / newton
        if prim.IsA(UsdPhysics.PrismaticJoint):
            names = ("physics:lowerLimit", "physics:upperLimit", "newton:velocityLimit")
            factors |= dict.fromkeys(names, 1.0 / metres)
        for name, factor in factors.items():
            attribute = prim.GetAttribute(name)
            if attribute and attribute.HasAuthoredValue():
                value = attribute.Get()
                if isinstance(value, Vt.Vec3fArray):
                    attribute.Set(Vt.Vec3fArray.FromNumpy(np.array(value) * np.float32(factor)))
                else:
                    attribute.Set(value * factor)
    UsdGeom.SetStageMetersPerUnit(stage, metres)
    UsdPhysics.SetStageKilogramsPerUnit(stage, kilograms)


def with_y_up(stage: Usd.Stage) -> None:
    """Turn a stage over, as exporters do: one rotation at the root of everything."""
    over = Gf.Rotation(Gf.Vec3d(1.0, 0.0, 0.0), -90.0)
    root = UsdGeom.Xformable(stage.GetDefaultPrim())
    operations = root.GetOrderedXformOps()
    turn = root.AddRotateXOp(UsdGeom.XformOp.PrecisionDouble, "yUp")
    turn.Set(-90.0)
    root.SetXformOpOrder([turn, *operations])
    for prim in stage.Traverse():
        if prim.IsA(UsdPhysics.Scene):
            UsdPhysics.Scene(prim).GetGravityDirectionAttr().Set(Gf.Vec3f(0.0, -1.0, 0.0))
        if prim.IsA(UsdPhysics.Joint) and not UsdPhysics.Joint(prim).GetBody0Rel().GetTargets():
            UsdPhysics.Joint(prim).CreateLocalRot0Attr(Gf.Quatf(over.GetQuat()))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)


def reframed(stage: Usd.Stage, path: str, by: Gf.Rotation, joints: tuple[str, ...] = ()) -> None:
    """Turn the frame of a body, but nothing that is in it.

    Args:
        stage: The stage.
        path: The body.
        by: The new frame in the old one.
        joints: Joints that start at the body.
    """
    turned = Gf.Matrix4d().SetRotate(by)
    body = stage.GetPrimAtPath(path)
    UsdGeom.Xformable(body).AddOrientOp(UsdGeom.XformOp.PrecisionDouble, "drawn").Set(by.GetQuat())
    for part in body.GetChildren():
        if part.IsA(UsdGeom.Xformable):
            _prepend(UsdGeom.Xformable(part), turned.GetInverse())
        for inner in part.GetChildren() if not part.IsA(UsdGeom.Xformable) else ():
            _prepend(UsdGeom.Xformable(inner), turned.GetInverse())
    center, axes = (body.GetAttribute(f"physics:{name}") for name in ("centerOfMass", "principalAxes"))
    if center:
        center.Set(Gf.Vec3f(turned.GetInverse().Transform(Gf.Vec3d(center.Get()))))
        axes.Set(Gf.Quatf(by.GetInverse().GetQuat() * Gf.Quatd(axes.Get())))
    for name in joints:
        joint = UsdPhysics.Joint(stage.GetPrimAtPath(name))
        joint.CreateLocalPos0Attr(Gf.Vec3f(turned.GetInverse().Transform(Gf.Vec3d(joint.GetLocalPos0Attr().Get()))))
        orientation = by.GetInverse().GetQuat() * Gf.Quatd(joint.GetLocalRot0Attr().Get())
        joint.CreateLocalRot0Attr(Gf.Quatf(orientation))


def _prepend(xform: UsdGeom.Xformable, matrix: Gf.Matrix4d) -> None:
    operations = xform.GetOrderedXformOps()
    turn = xform.AddTransformOp(UsdGeom.XformOp.PrecisionDouble, "drawn")
    turn.Set(matrix)
    xform.SetXformOpOrder([turn, *operations])


def written(stage: Usd.Stage, file: Path) -> Path:
    """Write a stage to a file."""
    stage.GetRootLayer().Export(str(file))
    return file


def differences(a: object, b: object, *, tolerance: float, place: str = "") -> list[str]:
    """Where two tasks differ by more than a tolerance, but for their files and names."""
    if dataclasses.is_dataclass(a) and not isinstance(a, type):
        names = [field.name for field in dataclasses.fields(a) if field.name not in ("file", "name")]
        pairs = [(getattr(a, name), getattr(b, name), f"{place}.{name}") for name in names]
    elif isinstance(a, tuple) and isinstance(b, tuple) and len(a) == len(b):
        pairs = [(each, other, f"{place}[{i}]") for i, (each, other) in enumerate(zip(a, b, strict=True))]
    elif isinstance(a, np.ndarray | float):
        x, y = np.asarray(a), np.asarray(b)
        same = x.shape == y.shape and np.allclose(x, y, rtol=0.0, atol=tolerance, equal_nan=True)
        return [] if same or _same_pose(x, y, tolerance) else [f"{place}: {a} and {b}"]
    else:
        return [] if a == b else [f"{place}: {a} and {b}"]
    return [found for each, other, at in pairs for found in differences(each, other, tolerance=tolerance, place=at)]


def _same_pose(x: np.ndarray, y: np.ndarray, tolerance: float) -> bool:
    """Whether two transforms [7] are the same though their quaternions have opposite signs."""
    if not (x.shape == y.shape == (7,)):
        return False
    return bool(np.allclose(x[:3], y[:3], atol=tolerance) and np.allclose(x[3:], -y[3:], atol=tolerance))
