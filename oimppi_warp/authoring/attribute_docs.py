"""Documents each attribute of a written file, with its unit, in the file itself, where USD tools show it."""

from __future__ import annotations

from pxr import Usd

from oimppi_warp.authoring.schema import SCHEMAS

_STANDARD = {
    "physics:mass": "Mass [kg].",
    "physics:centerOfMass": "Centre of mass in the object's frame [m].",
    "physics:diagonalInertia": "Principal moments of inertia about the centre of mass [kg m^2].",
    "physics:principalAxes": "Orientation of the principal axes of inertia: a quaternion (w, x, y, z).",
    "physics:dynamicFriction": "Coefficient of sliding friction; for a pair of shapes, the larger one applies.",
    "physics:staticFriction": "Coefficient of static friction; the planner uses dynamicFriction instead.",
    "physics:restitution": "Coefficient of restitution, 0 to 1; not used.",
    "physics:gravityDirection": "Direction of gravity: downwards.",
    "physics:gravityMagnitude": "Acceleration of gravity [m/s^2].",
    "physics:approximation": "The collision shape is the convex hull of the points.",
    "xformOp:translate": "Position (x, y, z) [m]; the table's top is at z = 0, the arm's base at the origin.",
    "xformOp:rotateZ": "Yaw [degrees].",
    "xformOp:scale": "Side lengths (x, y, z) [m], as `size` is 1.",
    "radius": "Radius [m].",
    "height": "Height, along z [m].",
}

_OURS = {a.name: f"{a.doc}{f' [{a.unit}]' if a.unit else ''}" for schema in SCHEMAS for a in schema.attributes}
_ROLES = {schema.name: schema.doc for schema in SCHEMAS}

_PLACES = {
    "/World/Robot": "The arm, from its own file.",
    "/World/Object": "The object to be pushed, from its own file; its pose here is its start.",
    "/World/Goal": "A ghost at the goal, for display only; the goal itself is oimppi:goal.",
    "/World/Obstacles": "Obstacles, which neither the arm nor the object may hit.",
    "/World/Table": "The surface that the object slides on: a box with its top at z = 0.",
    "/World/Materials": "Friction of the table and the obstacles.",
    "/World/Camera": "View across the table towards the arm.",
}


def write_attribute_docs(stage: Usd.Stage) -> None:
    """Writes documentation for prims and attributes into a stage's root layer, with units in square brackets.

    Prims that override part of another file, such as the links of a posed arm, are left unchanged.
    """
    layer = stage.GetRootLayer()
    for prim in stage.TraverseAll():
        spec = layer.GetPrimAtPath(prim.GetPath())
        path = str(prim.GetPath())
        if spec is None:
            continue
        if path in _PLACES:
            prim.SetDocumentation(_PLACES[path])
        elif "OimppiTaskAPI" in prim.GetAppliedSchemas():
            prim.SetDocumentation(_ROLES["OimppiTaskAPI"])
        below_ghost = path.startswith("/World/Goal/")
        below_robot = path.startswith("/World/Robot/")
        if below_ghost or below_robot:
            continue
        for name in [each.name for each in spec.properties]:
            if text := _OURS.get(name) or _STANDARD.get(name):
                prim.GetAttribute(name).SetDocumentation(text)
