"""An object whose own z axis does not point up, given a frame whose does.

Planar poses are those of a frame with z up. Shapes drawn with y up come with a body that lies on its side when it is
stood up. Its frame is turned in the stage's session layer, by the shortest turn of its own axes, and all that is in it
is turned back: shapes, centre of mass and inertia stay where they were.
"""

from __future__ import annotations

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdPhysics

from oimppi_warp.usd.conversion.units import editable_prims, turn

_NEAR = 1e-4


def align_upright(stage: Usd.Stage) -> None:
    """Turns the frames of objects to be pushed, where another of their axes than z points up."""
    if any(_wrong_up(prim) is not None for prim in Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies())):
        for prim in editable_prims(stage):
            if (up := _wrong_up(prim)) is not None:
                _turn_frame(prim, Gf.Matrix4d().SetRotate(Gf.Rotation(Gf.Vec3d(0.0, 0.0, 1.0), Gf.Vec3d(*up))))


def _wrong_up(prim: Usd.Prim) -> np.ndarray | None:
    """Which axis of an object's frame points up, if another than z, as :func:`_axis_up`."""
    is_object = "OimppiObjectAPI" in prim.GetPrimTypeInfo().GetAppliedAPISchemas()
    if not is_object or not prim.IsA(UsdGeom.Xformable) or prim.IsA(UsdGeom.Gprim):
        return None
    up = _axis_up(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default()))
    return None if up is None or np.allclose(up, (0.0, 0.0, 1.0)) else up


def _axis_up(frame: Gf.Matrix4d) -> np.ndarray | None:
    """Which of a frame's axes points up, as a direction in it, shape [3]; ``None`` where it stands askew."""
    up = np.array([frame.GetRow3(i).GetNormalized()[2] for i in range(3)])
    axis = np.round(up)
    return axis if np.abs(up - axis).max() < _NEAR and np.abs(axis).sum() == 1.0 else None


def _turn_frame(body: Usd.Prim, by: Gf.Matrix4d) -> None:
    back = by.GetInverse()
    UsdGeom.Xformable(body).AddTransformOp(UsdGeom.XformOp.PrecisionDouble, "upright").Set(by)
    parts = iter(Usd.PrimRange(body))
    next(parts)
    for part in parts:
        if part.IsA(UsdGeom.Xformable):
            if not UsdGeom.Xformable(part).GetResetXformStack():
                turn(UsdGeom.Xformable(part), back, "upright")
            parts.PruneChildren()
    if not body.HasAPI(UsdPhysics.MassAPI):
        return
    mass = UsdPhysics.MassAPI(body)
    center, axes = mass.GetCenterOfMassAttr().Get(), mass.GetPrincipalAxesAttr().Get()
    moments = mass.GetDiagonalInertiaAttr().Get()
    if center is not None and np.isfinite(center).all():
        mass.CreateCenterOfMassAttr(Gf.Vec3f(back.Transform(Gf.Vec3d(center))))
    if moments is not None and any(moments):  # without them the shapes decide; without axes, they are the frame's
        own = axes if axes is not None and axes.GetLength() > 0.5 else Gf.Quatf(1.0)
        mass.CreatePrincipalAxesAttr(Gf.Quatf(back.ExtractRotationQuat() * Gf.Quatd(own)))
