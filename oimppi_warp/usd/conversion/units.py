"""A stage in other units, or with another axis up, taken to metres, kilograms and z up.

The changes are opinions of the stage's session layer: the files stay as they are, and whoever reads the stage reads the
same converted numbers. Attributes of ours are in SI units and in the z-up frame whatever the stage's units are.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdPhysics

_LENGTH, _MASS, _FORCE, _TORQUE = (1, 0), (0, 1), (1, 1), (2, 1)

_POWERS = {
    # Powers of length and mass in the unit of an attribute, by the pattern of its name.
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
    # The same for attributes whose unit depends on the joint: those of one that slides, and of one that turns.
    r"physics:(lowerLimit|upperLimit)|newton:velocityLimit": (_LENGTH, (0, 0)),
    r"newton:(armature|damping|limitStiffness|limitDamping)": (_MASS, _TORQUE),
    r"newton:friction": (_FORCE, _TORQUE),
}
_FALLBACKS = ("size", "radius", "radiusTop", "radiusBottom", "height", "width", "length")
"""Sizes that a shape has though nobody gave them."""

TO_Z_UP = Gf.Matrix4d().SetRotate(Gf.Rotation(Gf.Vec3d(1.0, 0.0, 0.0), 90.0))
"""Takes y to z."""


def to_si(stage: Usd.Stage) -> None:
    """Converts a stage's lengths and masses, if they are not in metres and kilograms."""
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
    """Turns a stage on which y is up."""
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
    """All prims of a stage, made editable: an instance gets prims of its own. They are to be edited one by one."""
    while instances := [prim for prim in stage.Traverse() if prim.IsInstance()]:
        for prim in instances:
            prim.SetInstanceable(False)
    yield from list(stage.Traverse())


def turn(xform: UsdGeom.Xformable, by: Gf.Matrix4d, suffix: str) -> None:
    """Turns a prim in its parent's frame, on top of how it stands there."""
    operations, resets = xform.GetOrderedXformOps(), xform.GetResetXformStack()
    turned = xform.AddTransformOp(UsdGeom.XformOp.PrecisionDouble, suffix)
    turned.Set(by)
    xform.SetXformOpOrder([turned, *operations], resets)


def _powers(prim: Usd.Prim, attribute: Usd.Attribute) -> tuple[int, int]:
    name = attribute.GetName()
    if ":" not in name and attribute.IsCustom():
        return 0, 0  # a size of somebody else's
    for pattern, (slides, turns) in _SLIDING.items():
        if re.fullmatch(pattern, name):
            return slides if prim.IsA(UsdPhysics.PrismaticJoint) else turns
    return next((powers for pattern, powers in _POWERS.items() if re.fullmatch(pattern, name)), (0, 0))


def _scale(attribute: Usd.Attribute, factor: float) -> None:
    """Multiplies an attribute's numbers, at all times; what are no numbers is left to its reader."""
    for time in (Usd.TimeCode.Default(), *attribute.GetTimeSamples()):
        value = attribute.Get(time)
        if isinstance(value, Gf.Matrix4d):
            attribute.Set(Gf.Matrix4d(value).SetTranslateOnly(value.ExtractTranslation() * factor), time)
        elif isinstance(value, float) or hasattr(value, "GetLength"):  # a number, a vector
            attribute.Set(value * factor, time)
        elif hasattr(type(value), "FromNumpy") and np.asarray(value).dtype.kind == "f":
            numbers = np.asarray(value)
            attribute.Set(type(value).FromNumpy((numbers * factor).astype(numbers.dtype)), time)


def _is_in_world_frame(prim: Usd.Prim) -> bool:
    """Whether nothing above a prim moves it."""
    if UsdGeom.Xformable(prim).GetResetXformStack():
        return True
    above = prim.GetParent()
    while above and not above.IsPseudoRoot():
        if above.IsA(UsdGeom.Xformable):
            return False
        above = above.GetParent()
    return True


def _turn_world_end(joint: UsdPhysics.Joint) -> None:
    """The frame of a joint at the world's end is in the world's frame."""
    ends = (
        (joint.GetBody0Rel(), joint.GetLocalPos0Attr(), joint.GetLocalRot0Attr()),
        (joint.GetBody1Rel(), joint.GetLocalPos1Attr(), joint.GetLocalRot1Attr()),
    )
    for body, position, orientation in ends:
        if not body.GetTargets():
            position.Set(Gf.Vec3f(TO_Z_UP.TransformDir(Gf.Vec3d(position.Get()))))
            orientation.Set(Gf.Quatf(TO_Z_UP.ExtractRotationQuat() * Gf.Quatd(orientation.Get())))
