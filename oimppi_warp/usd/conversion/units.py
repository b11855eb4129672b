"""Converts a stage in other units, or with another up axis, to metres, kilograms and z up.

The changes are opinions in the stage's session layer: the files are not modified, and every reader of the stage sees
the same converted numbers. The package's own attributes are always in SI units and in the z-up frame.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdPhysics

_LENGTH, _MASS, _FORCE, _TORQUE = (1, 0), (0, 1), (1, 1), (2, 1)

_POWERS = {
    # Powers of length and mass in the unit of an attribute, by a pattern of its name.
    r"size|radius|radius(Top|Bottom)|height|width|length|widths|points|extent|extentsHint|velocities": _LENGTH,
    r"xformOp:(translate|transform).*": _LENGTH,
    r"clippingRange|focusDistance|focalLength|(horizontal|vertical)Aperture(Offset)?": _LENGTH,
    r"physics:(centerOfMass|localPos[01]|velocity|minDistance|maxDistance|gravityMagnitude)": _LENGTH,
    r"physics:mass": _MASS,
    r"physics:density": (-3, 1),
    r"physics:diagonalInertia|newton:inertia": (2, 1),
    r"physics:breakForce": _FORCE,
    r"physics:breakTorque": _TORQUE,
    r"limit:trans[XYZ]:physics:(low|high)": _LENGTH,
    r"drive:(linear|trans[XYZ]):physics:(targetPosition|targetVelocity)": _LENGTH,
    r"drive:(linear|trans[XYZ]):physics:maxForce": _FORCE,
    r"drive:(linear|trans[XYZ]):physics:(stiffness|damping)": _MASS,
    r"drive:(angular|rot[XYZ]):physics:(maxForce|stiffness|damping)": _TORQUE,
    r"newton:(contactMargin|contactGap|shellThickness|sdf(TargetVoxelSize|NarrowBand.*|Padding))": _LENGTH,
}
_SLIDING = {
    # The same for attributes whose unit depends on the joint: first a sliding joint, then a revolute one.
    r"physics:(lowerLimit|upperLimit)|newton:velocityLimit": (_LENGTH, (0, 0)),
    r"newton:(armature|damping|limitStiffness|limitDamping)": (_MASS, _TORQUE),
    r"newton:friction": (_FORCE, _TORQUE),
}
_FALLBACKS = ("size", "radius", "radiusTop", "radiusBottom", "height", "width", "length")
"""Size attributes whose schema fallback applies when they are not authored."""

TO_Z_UP = Gf.Matrix4d().SetRotate(Gf.Rotation(Gf.Vec3d(1.0, 0.0, 0.0), 90.0))
"""Rotates y to z."""


def to_si(stage: Usd.Stage) -> None:
    """Converts all quantities of a stage to metres and kilograms, in its current edit target."""
    metres, kilograms = UsdGeom.GetStageMetersPerUnit(stage), UsdPhysics.GetStageKilogramsPerUnit(stage)
    if abs(metres - 1.0) < 1e-9 and abs(kilograms - 1.0) < 1e-9:
        return
    for prim in editable_prims(stage):
        for attribute in prim.GetAttributes():
            length, mass = _powers(prim, attribute)
            given = attribute.HasAuthoredValue() or (attribute.GetName() in _FALLBACKS and prim.IsA(UsdGeom.Gprim))
            factor = metres**length * kilograms**mass
            if factor != 1.0 and given:
                _scale(attribute, factor)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)


def to_z_up(stage: Usd.Stage) -> None:
    """Rotates a stage whose up axis is y."""
    if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z:
        return
    for prim in editable_prims(stage):
        if prim.IsA(UsdGeom.Xformable) and _is_in_world_frame(prim):
            turn(UsdGeom.Xformable(prim), TO_Z_UP, "toZUp")
        if prim.IsA(UsdPhysics.Scene):
            gravity = UsdPhysics.Scene(prim).GetGravityDirectionAttr()
            gravity.Set(Gf.Vec3f(TO_Z_UP.TransformDir(Gf.Vec3d(gravity.Get()))))
        if prim.IsA(UsdPhysics.Joint):
            _turn_world_end(UsdPhysics.Joint(prim))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)


def editable_prims(stage: Usd.Stage) -> Iterator[Usd.Prim]:
    """Yields all prims of a stage, each made editable by uninstancing; edit each one before taking the next."""
    while instances := [prim for prim in stage.Traverse() if prim.IsInstance()]:
        for prim in instances:
            prim.SetInstanceable(False)
    yield from list(stage.Traverse())


def turn(xform: UsdGeom.Xformable, by: Gf.Matrix4d, suffix: str) -> None:
    """Rotates a prim by ``by`` in its parent's frame, by an additional operation ``xformOp:transform:<suffix>``."""
    operations, resets = xform.GetOrderedXformOps(), xform.GetResetXformStack()
    turned = xform.AddTransformOp(UsdGeom.XformOp.PrecisionDouble, suffix)
    turned.Set(by)
    xform.SetXformOpOrder([turned, *operations], resets)


def _powers(prim: Usd.Prim, attribute: Usd.Attribute) -> tuple[int, int]:
    name = attribute.GetName()
    if ":" not in name and attribute.IsCustom():
        return 0, 0  # a size defined by another schema
    for pattern, (slides, turns) in _SLIDING.items():
        if re.fullmatch(pattern, name):
            return slides if prim.IsA(UsdPhysics.PrismaticJoint) else turns
    return next((powers for pattern, powers in _POWERS.items() if re.fullmatch(pattern, name)), (0, 0))


def _scale(attribute: Usd.Attribute, factor: float) -> None:
    """Scales an attribute's numbers, at all times; values that are not numbers are left to their reader."""
    for time in (Usd.TimeCode.Default(), *attribute.GetTimeSamples()):
        value = attribute.Get(time)
        if isinstance(value, Gf.Matrix4d):
            attribute.Set(Gf.Matrix4d(value).SetTranslateOnly(value.ExtractTranslation() * factor), time)
        elif isinstance(value, float) or hasattr(value, "GetLength"):  # a number or a vector
            attribute.Set(value * factor, time)
        elif hasattr(type(value), "FromNumpy") and np.asarray(value).dtype.kind == "f":
            numbers = np.asarray(value)
            attribute.Set(type(value).FromNumpy((numbers * factor).astype(numbers.dtype)), time)


def _is_in_world_frame(prim: Usd.Prim) -> bool:
    """Returns whether no ancestor of a prim has a transform."""
    if UsdGeom.Xformable(prim).GetResetXformStack():
        return True
    above = prim.GetParent()
    while above and not above.IsPseudoRoot():
        if above.IsA(UsdGeom.Xformable):
            return False
        above = above.GetParent()
    return True


def _turn_world_end(joint: UsdPhysics.Joint) -> None:
    """Rotates a joint's frame at the end attached to the world, which is expressed in the world's frame."""
    ends = (
        (joint.GetBody0Rel(), joint.GetLocalPos0Attr(), joint.GetLocalRot0Attr()),
        (joint.GetBody1Rel(), joint.GetLocalPos1Attr(), joint.GetLocalRot1Attr()),
    )
    for body, position, orientation in ends:
        if not body.GetTargets():
            position.Set(Gf.Vec3f(TO_Z_UP.TransformDir(Gf.Vec3d(position.Get()))))
            orientation.Set(Gf.Quatf(TO_Z_UP.ExtractRotationQuat() * Gf.Quatd(orientation.Get())))
