"""The package's codeless API schemas as data, as USD's own files, and as a page of the manual."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Attribute:
    """An attribute of a schema.

    Attributes:
        name, type: Its name, and its USD type.
        default: Its default as USD text; empty: the attribute is required.
        unit: Its unit; empty: none.
        doc: Description.
    """

    name: str
    type: str
    default: str
    unit: str
    doc: str


@dataclass(frozen=True)
class Schema:
    """An API schema, which gives a prim its role.

    Attributes:
        name: Its name.
        where: Prims that it is applied to, and how many of them a scene has.
        doc: Description of the role.
        attributes: Its attributes.
    """

    name: str
    where: str
    doc: str
    attributes: tuple[Attribute, ...] = ()


SCHEMAS = (
    Schema(
        "OimppiTaskAPI",
        "the scene's default prim; exactly one in a scene",
        "The task: push the object to the goal. Planar poses are (x, y, yaw) in the world frame, whose origin is the "
        "centre of the arm's base; z points up, and the table's top is at z = 0. The object's start is its pose in the "
        "file.",
        (
            Attribute("oimppi:title", "string", '""', "", "One-line description of the task."),
            Attribute(
                "oimppi:goal",
                "double3",
                "",
                "m, m, rad",
                "Goal of the object: planar pose of the object's frame.",
            ),
            Attribute(
                "oimppi:starts",
                "double3[]",
                "[]",
                "m, m, rad",
                "Starts that the task is evaluated with: planar poses of the object's frame. If omitted, the object's "
                "pose in the file is the only one.",
            ),
            Attribute(
                "oimppi:spread",
                "double2",
                "(0, 0)",
                "m, rad",
                "Half-widths of the range around the object's start in the file from which starts are drawn "
                "(`--seed`): of x and y, and of the yaw.",
            ),
            Attribute(
                "oimppi:tolerance",
                "double2",
                "(0.2, 0.5)",
                "m, rad",
                "Largest distance from the goal and largest absolute yaw error for success; `inf` as the yaw error "
                "accepts any yaw.",
            ),
            Attribute(
                "oimppi:tightTolerance",
                "double2",
                "(0.05, 0.1)",
                "m, rad",
                "A stricter tolerance, in the same form; success within it is reported too.",
            ),
        ),
    ),
    Schema(
        "OimppiRobotAPI",
        "the root prim of the arm's articulation; exactly one in a scene",
        "The arm: a serial chain of PhysicsRevoluteJoints and PhysicsPrismaticJoints, each of which turns about or "
        "slides along its local z axis; its frame is that of the link that it moves. The base is at the world's "
        "origin, fixed to the world by a PhysicsFixedJoint. Position limits are those of UsdPhysics; the effort limit "
        "is the `physics:maxForce` of the angular or linear drive, and the velocity limit is `newton:velocityLimit` of "
        "NewtonJointAPI (in degrees per second, like all angles in UsdPhysics, or in metres per second). A limit that "
        "is not given is infinite; a sliding joint must have position limits.",
        (
            Attribute(
                "oimppi:startJoints",
                "double[]",
                "",
                "rad, m",
                "Joint positions at the start of an episode, from base to flange: in radians, or in metres for a "
                "sliding joint.",
            ),
        ),
    ),
    Schema(
        "OimppiToolAPI",
        "an Xform at the tip of the stick, below the robot's last link or a body welded to it; exactly one in a scene",
        "The tip of the tool, the stick that pushes the object; its z axis points out of the tool.",
        (Attribute("oimppi:radius", "double", "", "m", "Radius of the stick."),),
    ),
    Schema(
        "OimppiObjectAPI",
        "a rigid body; exactly one in a scene",
        "The object to be pushed. It must have a mass, at least one collider and a physics material, lie on the table, "
        "and be rotated about z only. Its coefficient of friction with the table, and with the tool, is the larger of "
        "the two materials' `physics:dynamicFriction`, as in MuJoCo; with the tool it may be zero.",
        (
            Attribute(
                "oimppi:limitSurfaceRadius",
                "double",
                "0",
                "m",
                "Largest torque of the friction between object and table about the centre of mass, divided by the "
                "largest force: the planner's model of how easily the object turns. 0 computes it from the shape, "
                "which rests on its corners.",
            ),
        ),
    ),
    Schema(
        "OimppiObstacleAPI",
        "a static prim with colliders on itself or below it; any number",
        "An obstacle, with which neither the arm nor the object may collide.",
    ),
    Schema(
        "OimppiTableAPI",
        "a static prim with a box collider on itself or below it; exactly one in a scene",
        "The surface that the object slides on: a box aligned with the world's axes, with its top at z = 0. The object "
        "must stay within the edges of its top.",
    ),
)


def write(folder: Path) -> None:
    """Writes ``generatedSchema.usda`` and ``plugInfo.json``, which USD reads, to ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "generatedSchema.usda").write_text(_schema_file())
    types = {
        schema.name.replace("Oimppi", "OimppiWarp"): {
            "schemaIdentifier": schema.name,
            "alias": {"UsdSchemaBase": schema.name},
            "autoGenerated": True,
            "bases": ["UsdAPISchemaBase"],
            "schemaKind": "singleApplyAPI",
        }
        for schema in SCHEMAS
    }
    plugin = {"Info": {"Types": types}, "Name": "oimppi", "ResourcePath": ".", "Root": ".", "Type": "resource"}
    (folder / "plugInfo.json").write_text(json.dumps({"Plugins": [plugin]}, indent=2) + "\n")


def _schema_file() -> str:
    lines = ['#usda 1.0\n(\n    doc = "Codeless API schemas of oimppi-warp. Written by tools/make_scenes.py."\n)\n']
    for schema in SCHEMAS:
        lines.append(f'class "{schema.name}" (\n    doc = "{schema.doc}"\n)\n{{')
        for a in schema.attributes:
            default = f" = {a.default}" if a.default else ""
            unit = f" [{a.unit}]" if a.unit else ""
            lines.append(f'    uniform {a.type} {a.name}{default} (\n        doc = "{a.doc}{unit}"\n    )')
        lines.append("}\n")
    return "\n".join(lines)


_HEAD = """# The scene schema

<!-- Written by tools/make_scenes.py from the schema itself; do not edit by hand. -->

A scene is a USD file, preferably in metres (`metersPerUnit = 1`), kilograms and z up; other units and y up are
converted when it is read (`docs/scene-check.md` lists everything that is converted or refused). Motion, collision, mass
and friction are described with the standard UsdPhysics schemas, so that other tools can read them too. Everything that
USD has no schema for is described with six API schemas of this package. They are codeless: `scenes/schema/` contains
their complete definition. The package registers it automatically, and other USD tools find it if `PXR_PLUGINPATH_NAME`
names that folder. The package's own attributes (`oimppi:...`) are in metres and radians and refer to the frame with z
up, whatever the stage's units; angles in UsdPhysics are in degrees.

Everything that collides or moves must have a role; otherwise the scene is refused, because the planner would not know
about it. A collider may be a `Cube`, `Sphere`, `Cylinder` or `Capsule`, or a `Mesh` that is convex or has
`physics:approximation` `convexHull`, `boundingCube` or `boundingSphere`. Other shapes must be cut into convex pieces,
like the letters in `scenes/objects/` are.

[`authoring.md`](authoring.md) shows how to write a scene with a command, by hand and in Python. The smallest one refers
to the shipped arm and objects:

```usda
#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Z"
)

def Xform "World" (
    prepend apiSchemas = ["OimppiTaskAPI"]
)
{
    double3 oimppi:goal = (0.5, 0.3, 3.14159)

    def "Robot" (
        prepend references = @scenes/robots/xarm6.usda@
    )
    {
    }

    def "Object" (
        prepend apiSchemas = ["PhysicsRigidBodyAPI", "OimppiObjectAPI"]
        prepend references = @scenes/objects/t_block.usda@
    )
    {
        double3 xformOp:translate = (0.3, -0.45, 0.025)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }

    def Cube "Table" (
        prepend apiSchemas = ["PhysicsCollisionAPI", "OimppiTableAPI"]
    )
    {
        double size = 1
        float3 xformOp:scale = (1.25, 1.6, 0.04)
        double3 xformOp:translate = (0.375, 0, -0.02)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
    }
}
```
"""


def page() -> str:
    """Returns the text of `docs/schema.md`."""
    lines = [_HEAD]
    for schema in SCHEMAS:
        lines += [f"## {schema.name}", "", f"On {schema.where}.", "", schema.doc, ""]
        if schema.attributes:
            lines += ["| attribute | type | unit | default | meaning |", "|---|---|---|---|---|"]
            for a in schema.attributes:
                default = f"`{a.default}`" if a.default else "required"
                lines.append(f"| `{a.name}` | `{a.type}` | {a.unit or '-'} | {default} | {a.doc} |")
            lines.append("")
    return "\n".join(lines)
