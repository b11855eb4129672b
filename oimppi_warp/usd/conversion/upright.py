"""Reorients the frame of an object whose own z axis does not point up.

Planar poses require a frame with z up. A shape modelled with y up, when stood upright, has a body frame that lies on
its side. The frame is rotated in the stage's session layer, by the shortest rotation between its own axes, and its
contents are rotated back: shapes, centre of mass and inertia keep their place.
"""

from __future__ import annotations

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdPhysics

from oimppi_warp.usd.conversion.units import editable_prims, turn

_NEAR = 1e-4


def align_upright(stage: Usd.Stage) -> None:
    """Rotates the frames of pushable objects in which an axis other than z points up."""
    if any(_wrong_up(prim) is not None for prim in Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies())):
        for prim in editable_prims(stage):
            if (up := _wrong_up(prim)) is not None:
                _turn_frame(prim, Gf.Matrix4d().SetRotate(Gf.Rotation(Gf.Vec3d(0.0, 0.0, 1.0), Gf.Vec3d(*up))))


def _wrong_up(prim: Usd.Prim) -> np.ndarray | None:
    """Returns the axis of an object's frame that points up, if it is not z, as for :func:`_axis_up`."""
    is_object = "OimppiObjectAPI" in prim.GetPrimTypeInfo().GetAppliedAPISchemas()
    if not is_object or not prim.IsA(UsdGeom.Xformable) or prim.IsA(UsdGeom.Gprim):
        return None
    up = _axis_up(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default()))
    return None if up is None or np.allclose(up, (0.0, 0.0, 1.0)) else up


def _axis_up(frame: Gf.Matrix4d) -> np.ndarray | None:
    """Returns the axis of a frame that points up, as a direction in it, shape [3]; ``None`` if the frame is tilted."""
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
    if moments is not None and any(moments):  # else from the shapes; principal axes default to the frame's
        own = axes if axes is not None and axes.GetLength() > 0.5 else Gf.Quatf(1.0)
        mass.CreatePrincipalAxesAttr(Gf.Quatf(back.ExtractRotationQuat() * Gf.Quatd(own)))
