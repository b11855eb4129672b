"""Scenes with one mistake each, what is said of it, and the edits that make them."""

from __future__ import annotations

import math
from collections.abc import Callable

from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics

ROBOT, TIP, START = "/World/Robot", "/World/Robot/tool/tip", "oimppi:startJoints"


def prim(stage: Usd.Stage, path: str) -> Usd.Prim:
    return stage.GetPrimAtPath(path)


def put(path: str, name: str, value: object) -> Callable[[Usd.Stage], object]:
    """Set an attribute that is there."""
    return lambda stage: prim(stage, path).GetAttribute(name).Set(value)


def drop(path: str, schema: str) -> Callable[[Usd.Stage], object]:
    """Take an API schema away."""
    return lambda stage: prim(stage, path).RemoveAppliedSchema(schema)


def add(path: str, schema: str) -> Callable[[Usd.Stage], object]:
    """Apply an API schema."""
    return lambda stage: prim(stage, path).AddAppliedSchema(schema)


def without(path: str) -> Callable[[Usd.Stage], object]:
    """Switch a prim off."""
    return lambda stage: prim(stage, path).SetActive(False)


def block(path: str, name: str) -> Callable[[Usd.Stage], object]:
    """Take the value of an attribute away."""
    return lambda stage: prim(stage, path).GetAttribute(name).Block()


def second_robot(stage: Usd.Stage) -> None:
    other = stage.DefinePrim("/World/Robot2")
    other.GetReferences().AddInternalReference("/World/Robot")


def collider(define: Callable[[Usd.Stage, str], UsdGeom.Gprim]) -> Callable[[Usd.Stage], object]:
    """One more obstacle, made by ``define``."""

    def change(stage: Usd.Stage) -> None:
        gprim = define(stage, "/World/Obstacles/Extra")
        UsdPhysics.CollisionAPI.Apply(gprim.GetPrim())
        gprim.GetPrim().AddAppliedSchema("OimppiObstacleAPI")

    return change


def hollow_mesh(stage: Usd.Stage, path: str) -> UsdGeom.Gprim:
    """Three faces of a tetrahedron."""
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr([Gf.Vec3f(0, 0, 0), Gf.Vec3f(1, 0, 0), Gf.Vec3f(0, 1, 0), Gf.Vec3f(0, 0, 1)])
    mesh.CreateFaceVertexCountsAttr([3, 3, 3])
    mesh.CreateFaceVertexIndicesAttr([0, 2, 1, 0, 1, 3, 0, 3, 2])
    return mesh


def cut_mesh(stage: Usd.Stage, path: str) -> UsdGeom.Gprim:
    mesh = hollow_mesh(stage, path)
    UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr("convexDecomposition")
    return mesh


def hull_with(face: tuple[int, ...], count: int = 3) -> Callable[[Usd.Stage, str], UsdGeom.Gprim]:
    """The hull of a mesh with one face."""

    def define(stage: Usd.Stage, path: str) -> UsdGeom.Gprim:
        mesh = UsdGeom.Mesh(hollow_mesh(stage, path).GetPrim())
        mesh.CreateFaceVertexCountsAttr([count])
        mesh.CreateFaceVertexIndicesAttr(list(face))
        UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr("convexHull")
        return mesh

    return define


def far_mesh(stage: Usd.Stage, path: str) -> UsdGeom.Gprim:
    mesh = UsdGeom.Mesh(hull_with((0, 1, 2))(stage, path).GetPrim())
    mesh.CreatePointsAttr([Gf.Vec3f(0, 0, math.inf), Gf.Vec3f(1, 0, 0), Gf.Vec3f(0, 1, 0), Gf.Vec3f(0, 0, 1)])
    return mesh


def flat_hull(stage: Usd.Stage, path: str) -> UsdGeom.Gprim:
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr([Gf.Vec3f(0, 0, 0), Gf.Vec3f(1, 0, 0), Gf.Vec3f(0, 1, 0), Gf.Vec3f(1, 1, 0)])
    UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr("convexHull")
    return mesh


def uneven_sphere(stage: Usd.Stage, path: str) -> UsdGeom.Gprim:
    sphere = UsdGeom.Sphere.Define(stage, path)
    sphere.AddScaleOp().Set(Gf.Vec3f(0.1, 0.1, 0.2))
    return sphere


def mirrored_box(stage: Usd.Stage, path: str) -> UsdGeom.Gprim:
    cube = UsdGeom.Cube.Define(stage, path)
    cube.AddScaleOp().Set(Gf.Vec3f(0.1, 0.1, -0.1))
    return cube


def sheared_box(stage: Usd.Stage, path: str) -> UsdGeom.Gprim:
    cube = UsdGeom.Cube.Define(stage, path)
    matrix = Gf.Matrix4d(1.0)
    matrix.SetRow3(1, Gf.Vec3d(0.5, 1.0, 0.0))
    cube.AddTransformOp().Set(matrix)
    return cube


def object_to(x: float, y: float, z: float = 0.025) -> Callable[[Usd.Stage], object]:
    return put("/World/Object", "xformOp:translate", Gf.Vec3d(x, y, z))


def goal_to(x: float, y: float, yaw: float) -> Callable[[Usd.Stage], object]:
    return put("/World", "oimppi:goal", Gf.Vec3d(x, y, yaw))


def tilt_object(stage: Usd.Stage) -> None:
    UsdGeom.Xformable(prim(stage, "/World/Object")).AddRotateXOp().Set(10.0)


def scaled(path: str, *scale: float) -> Callable[[Usd.Stage], object]:
    """Scale a body."""
    return lambda stage: UsdGeom.Xformable(prim(stage, path)).AddScaleOp().Set(Gf.Vec3f(*scale))


def move_robot(stage: Usd.Stage) -> None:
    xform = UsdGeom.Xformable(prim(stage, ROBOT))
    xform.AddTranslateOp().Set(Gf.Vec3d(0.1, 0.0, 0.0))


def joint_of_type(name: str) -> Callable[[Usd.Stage], object]:
    return lambda stage: prim(stage, f"{ROBOT}/joints/joint1").SetTypeName(name)


def slide_without_end(stage: Usd.Stage) -> None:
    joint_of_type("PhysicsPrismaticJoint")(stage)
    prim(stage, f"{ROBOT}/joints/joint1").GetAttribute("physics:upperLimit").Set(math.inf)


def starts_as_pairs(stage: Usd.Stage) -> None:
    world = Sdf.CreatePrimInLayer(stage.GetRootLayer(), "/World")
    Sdf.AttributeSpec(world, "oimppi:starts", Sdf.ValueTypeNames.Double2Array).default = [Gf.Vec2d(0.3, -0.4)]


def no_friction(stage: Usd.Stage) -> None:
    for path in ("/World/Object/Material", "/World/Materials/Table"):
        UsdPhysics.MaterialAPI(prim(stage, path)).GetDynamicFrictionAttr().Set(0.0)


def loose_ball(stage: Usd.Stage) -> None:
    ball = UsdGeom.Sphere.Define(stage, "/World/Ball").GetPrim()
    UsdPhysics.RigidBodyAPI.Apply(ball)
    UsdPhysics.CollisionAPI.Apply(ball)


def lid(stage: Usd.Stage) -> None:
    UsdPhysics.RigidBodyAPI.Apply(UsdGeom.Sphere.Define(stage, "/World/Object/lid").GetPrim())


def branch(stage: Usd.Stage) -> None:
    joint = UsdPhysics.RevoluteJoint.Define(stage, f"{ROBOT}/joints/extra")
    joint.CreateBody0Rel().SetTargets([f"{ROBOT}/link2"])
    joint.CreateBody1Rel().SetTargets([f"{ROBOT}/tool"])


def loop(stage: Usd.Stage) -> None:
    joint = UsdPhysics.FixedJoint.Define(stage, f"{ROBOT}/joints/extra")
    joint.CreateBody0Rel().SetTargets([f"{ROBOT}/tool"])
    joint.CreateBody1Rel().SetTargets([f"{ROBOT}/link6"])


def far_reference(stage: Usd.Stage) -> None:
    prim(stage, "/World/Obstacles").GetReferences().AddReference("./nowhere.usda")


def typed(path: str, name: str, kind: Sdf.ValueTypeName, value: object) -> Callable[[Usd.Stage], object]:
    """Set an attribute of another type than its schema's."""

    def change(stage: Usd.Stage) -> None:
        spec = Sdf.CreatePrimInLayer(stage.GetRootLayer(), path)
        Sdf.AttributeSpec(spec, name, kind).default = value

    return change


def relation_as_attribute(stage: Usd.Stage) -> None:
    path = f"{ROBOT}/joints/joint2"
    prim(stage, path).GetRelationship("physics:body1").ClearTargets(True)
    joint = UsdPhysics.RevoluteJoint.Define(stage, "/World/Joint")
    spec = stage.GetRootLayer().GetPrimAtPath(joint.GetPath())
    Sdf.AttributeSpec(spec, "physics:body1", Sdf.ValueTypeNames.String).default = "link2"


def order(*names: str) -> Callable[[Usd.Stage], object]:
    """The order of the operations that place the object."""
    return put("/World/Object", "xformOpOrder", names)


def crooked_table(stage: Usd.Stage) -> None:
    table = UsdGeom.Xformable(prim(stage, "/World/Table"))
    turn = table.AddRotateZOp()
    turn.Set(30.0)
    translate, scale, _ = table.GetOrderedXformOps()
    table.SetXformOpOrder([translate, turn, scale])


def far_joint(stage: Usd.Stage) -> None:
    UsdPhysics.Joint(prim(stage, f"{ROBOT}/joints/joint4")).GetLocalPos0Attr().Set(Gf.Vec3f(1e30, 0, 0))


def to_a_stranger(stage: Usd.Stage) -> None:
    joint = UsdPhysics.Joint(prim(stage, f"{ROBOT}/joints/joint4"))
    joint.GetBody1Rel().SetTargets(["/World/Object"])


def to_nothing(stage: Usd.Stage) -> None:
    UsdPhysics.Joint(prim(stage, f"{ROBOT}/joints/joint4")).GetBody1Rel().SetTargets([])


def welded_base(stage: Usd.Stage) -> None:
    part = UsdGeom.Xform.Define(stage, f"{ROBOT}/part").GetPrim()
    UsdPhysics.RigidBodyAPI.Apply(part)
    joint = UsdPhysics.FixedJoint.Define(stage, f"{ROBOT}/joints/extra")
    joint.CreateBody0Rel().SetTargets([f"{ROBOT}/base"])
    joint.CreateBody1Rel().SetTargets([part.GetPath()])


def tool_elsewhere(stage: Usd.Stage) -> None:
    drop(TIP, "OimppiToolAPI")(stage)
    add(f"{ROBOT}/link3", "OimppiToolAPI")(stage)
    attribute = prim(stage, f"{ROBOT}/link3").CreateAttribute("oimppi:radius", Sdf.ValueTypeNames.Double)
    attribute.Set(0.008)


def tool_outside(stage: Usd.Stage) -> None:
    drop(TIP, "OimppiToolAPI")(stage)
    tip = UsdGeom.Xform.Define(stage, "/World/Tip").GetPrim()
    tip.AddAppliedSchema("OimppiToolAPI")
    tip.CreateAttribute("oimppi:radius", Sdf.ValueTypeNames.Double).Set(0.008)


MISTAKES = {
    "no unit": (lambda s: s.ClearMetadata("metersPerUnit"), "the unit of length is not given", "1 for metres"),
    "no axis": (lambda s: s.ClearMetadata("upAxis"), "the up axis is not given", '"Z" for z'),
    "no length": (lambda s: UsdGeom.SetStageMetersPerUnit(s, 0.0), "metersPerUnit is 0", "above zero"),
    "no weight": (lambda s: UsdPhysics.SetStageKilogramsPerUnit(s, -1.0), "kilogramsPerUnit is -1", "above zero"),
    "a missing reference": (far_reference, "nowhere.usda", "to do:"),
    "a mass in words": (
        typed("/World/Object", "physics:mass", Sdf.ValueTypeNames.String, "heavy"),
        "physics:mass is of type string",
        "allowed: float",
    ),
    "a relation that is none": (
        relation_as_attribute,
        "physics:body1 is not a relationship",
        "as defined by its schema",
    ),
    "an unknown operation": (order("xformOp:translate", "xformOp:spin"), "lists xformOp:spin", "xformOp attributes"),
    "an operation that is none": (order("kind"), "xformOpOrder lists kind", "xformOp attributes"),
    "an object nowhere": (object_to(math.nan, 0.0), "too large or not finite", "below 1000 m"),
    "an obstacle on the moon": (
        put("/World/Obstacles/Cube", "xformOp:translate", Gf.Vec3d(4e8, 0, 0)),
        "too large or not finite",
        "</World/Obstacles/Cube>",
    ),
    "a joint far away": (far_joint, "frames are too far away or not finite", "below 1000 m"),
    "a joint to something else": (to_a_stranger, "which is not a rigid body of the robot", "</World/Object>"),
    "a joint to nothing": (to_nothing, "the joint moves nothing", "a link as physics:body1"),
    "a base of two parts": (welded_base, "welded to the robot's base", "a base without welded bodies"),
    "a tool on the elbow": (tool_elsewhere, "not on the robot's last link", "/World/Robot/link6"),
    "a tool apart": (tool_outside, "not part of the robot", "a prim below </World/Robot>"),
    "an endless goal": (put("/World", "oimppi:goal", Gf.Vec3d(0.5, 0.3, math.inf)), "not finite", "yaw [rad]"),
    "a start at infinity": (
        put("/World", "oimppi:starts", [Gf.Vec3d(0.3, -0.45, 0), Gf.Vec3d(math.inf, 0, 0)]),
        "oimppi:starts[1] is not finite",
        "yaw [rad]",
    ),
    "a tight tolerance of nothing": (
        put("/World", "oimppi:tightTolerance", Gf.Vec2d(0.05, -1)),
        "oimppi:tightTolerance is (0.05, -1)",
        "above zero",
    ),
    "a body that is switched off": (
        lambda s: UsdPhysics.RigidBodyAPI(prim(s, "/World/Object")).CreateRigidBodyEnabledAttr(False),
        "the object cannot move",
        "PhysicsRigidBodyAPI",
    ),
    "a crooked table": (crooked_table, "has no flat top at z = 0", "a Cube with CollisionAPI"),
    "a table that moves": (
        add("/World/Table", "PhysicsRigidBodyAPI"),
        "the table contains a rigid body",
        "static shapes",
    ),
    "a link of no size": (put(f"{ROBOT}/link2/collider0", "radius", 0.0), "radius is 0 m", "more than zero"),
    "no speed": (put(f"{ROBOT}/joints/joint2", "newton:velocityLimit", 0.0), "is 0 deg/s", "more than zero"),
    "no task": (drop("/World", "OimppiTaskAPI"), "the scene has no task", "apply OimppiTaskAPI"),
    "no robot": (without(ROBOT), "the scene has no robot", "OimppiRobotAPI"),
    "two robots": (second_robot, "the scene has 2 robots", "</World/Robot2>"),
    "no object": (drop("/World/Object", "OimppiObjectAPI"), "the scene has no object", "OimppiObjectAPI"),
    "two objects": (add("/World/Obstacles/Cube", "OimppiObjectAPI"), "the scene has 2 objects", "on one of them"),
    "no table": (without("/World/Table"), "the scene has no table", "OimppiTableAPI"),
    "no tool": (drop(TIP, "OimppiToolAPI"), "the scene has no tool", "tip of the robot's stick"),
    "no goal": (block("/World", "oimppi:goal"), "oimppi:goal is missing", "(x [m], y [m], yaw [rad])"),
    "an infinite goal": (goal_to(math.inf, 0, 0), "not finite", "</World>"),
    "a goal that is not a number": (goal_to(math.nan, 0, 0), "oimppi:goal", "nan"),
    "starts of two numbers": (starts_as_pairs, "oimppi:starts is", "a list of (x [m], y [m], yaw [rad])"),
    "a negative spread": (put("/World", "oimppi:spread", Gf.Vec2d(-0.1, 0)), "oimppi:spread", "zero or more"),
    "no tolerance": (put("/World", "oimppi:tolerance", Gf.Vec2d(0, 0.5)), "oimppi:tolerance is (0, 0.5)", "above zero"),
    "no start of the arm": (block(ROBOT, START), "oimppi:startJoints is missing", "each of the 6 joints"),
    "five joint positions": (put(ROBOT, START, [0.0] * 5), "oimppi:startJoints is", "each of the 6 joints"),
    "a start beyond a limit": (
        put(ROBOT, START, [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]),
        "joint3> at 1 rad, beyond its limits",
        "-3.927 to 0.192 rad",
    ),
    "a stick without a radius": (put(TIP, "oimppi:radius", 0.0), "oimppi:radius is 0", "more than zero"),
    "no articulation": (drop(ROBOT, "PhysicsArticulationRootAPI"), "no articulation root", "apply"),
    "a loose base": (without(f"{ROBOT}/joints/mount"), "not fixed to the world", "PhysicsFixedJoint"),
    "a base elsewhere": (move_robot, "base is at (0.1, 0, 0) m", "world's origin"),
    "a ball joint": (joint_of_type("PhysicsSphericalJoint"), "PhysicsSphericalJoint", "or PhysicsPrismaticJoint"),
    "a joint that slides without end": (slide_without_end, "unlimited travel", "in metres"),
    "a joint about x": (put(f"{ROBOT}/joints/joint2", "physics:axis", "X"), "about its X axis", "physics:axis = Z"),
    "a shifted joint": (
        put(f"{ROBOT}/joints/joint2", "physics:localPos1", Gf.Vec3f(0, 0, 0.1)),
        "differs from that of the link that it moves",
        "physics:localPos1 = (0, 0, 0)",
    ),
    "crossed limits": (
        put(f"{ROBOT}/joints/joint2", "physics:lowerLimit", 200.0),
        "the lower limit (200 deg) is not below the upper limit (120 deg)",
        "physics:upperLimit, in degrees",
    ),
    "a branching arm": (branch, "the arm branches", "a serial arm"),
    "an arm that closes a loop": (loop, "two parent joints", "</World/Robot/link6>"),
    "a link without mass": (drop(f"{ROBOT}/link3", "PhysicsMassAPI"), "the body has no mass", "physics:mass"),
    "an object without mass": (drop("/World/Object", "PhysicsMassAPI"), "the body has no mass", "physics:mass"),
    "a negative mass": (put("/World/Object", "physics:mass", -1.0), "the mass is -1 kg", "a finite mass above zero"),
    "a body below the object": (lid, "the object contains another rigid body", "</World/Object/lid>"),
    "an object without collider": (without("/World/Object/shape"), "the object has no collider", "PhysicsCollisionAPI"),
    "an object that cannot move": (drop("/World/Object", "PhysicsRigidBodyAPI"), "cannot move", "PhysicsRigidBodyAPI"),
    "an object without friction": (no_friction, "has no friction", "physics:dynamicFriction"),
    "a negative limit surface": (
        put("/World/Object", "oimppi:limitSurfaceRadius", -0.1),
        "oimppi:limitSurfaceRadius is -0.1",
        "above zero, in metres",
    ),
    "negative friction": (
        lambda s: UsdPhysics.MaterialAPI(prim(s, "/World/Object/Material")).GetDynamicFrictionAttr().Set(-0.5),
        "physics:dynamicFriction is -0.5",
        "zero or more",
    ),
    "a size that rounding swallows": (put("/World/Obstacles/Cube", "size", 1e-30), "1e-31 m thick", "2e-06 m or more"),
    "a negative size": (put("/World/Obstacles/Cube", "size", -1.0), "size is -1 m", "more than zero"),
    "a floating object": (object_to(0.3, -0.45, 0.055), "30.0 mm above the table", "set its z to 0.025 m"),
    "a sunken object": (object_to(0.3, -0.45, 0.02), "5.0 mm inside the table", "set its z to 0.025 m"),
    "a tilted object": (tilt_object, "does not lie flat", "about z only"),
    "a scaled link": (scaled(f"{ROBOT}/link3", 2, 2, 2), "is scaled by (2, 2, 2)", "scale its shapes"),
    "a mirrored link": (scaled(f"{ROBOT}/link3", -1, 1, 1), "is scaled by (1, 1, 1) and mirrored", "scale its shapes"),
    "a joint that is slowed": (
        typed(f"{ROBOT}/joints/joint2", "newton:damping", Sdf.ValueTypeNames.Float, -0.1),
        "newton:damping is -0.1 N m s/deg",
        "a finite number, zero or more [N m s/deg]",
    ),
    "a mirrored object": (scaled("/World/Object", 1, 1, -1), "mirrored", "scale its shapes"),
    "an object scaled to nothing": (scaled("/World/Object", 1, 1, 0), "scaled to zero", "along its own axes"),
    "an empty obstacle": (drop("/World/Obstacles/Cube", "PhysicsCollisionAPI"), "the obstacle has no collider", "Cube"),
    "a moving obstacle": (
        add("/World/Obstacles/Cube", "PhysicsRigidBodyAPI"),
        "the obstacle contains a rigid body",
        "static",
    ),
    "something without a role": (loose_ball, "no role in the task", "</World/Ball>"),
    "a hollow mesh": (collider(hollow_mesh), "is none, but the mesh is not a closed convex surface", "convexHull"),
    "a mesh to be cut": (collider(cut_mesh), "physics:approximation is convexDecomposition", "oimppi scene import"),
    "a mesh with a hole": (
        collider(hull_with((0, 1, 7))),
        "refer to points that do not exist",
        "below the number of points",
    ),
    "a mesh of lines": (collider(hull_with((0, 1), 2)), "have fewer than 3 corners", "3 or more"),
    "a mesh at infinity": (
        collider(far_mesh),
        "points that are too far away or not finite",
        "allowed: finite coordinates below",
    ),
    "a flat mesh": (collider(flat_hull), "the 4 points of the mesh span no volume", "a solid shape"),
    "a cone": (collider(UsdGeom.Cone.Define), "the collider's type is Cone", "allowed: Cube, Sphere"),
    "an ellipsoid": (collider(uneven_sphere), "a non-uniform scale", "the same scale"),
    "a mirrored box": (collider(mirrored_box), "zero or negative", "a positive scale"),
    "a sheared box": (collider(sheared_box), "sheared", "along its own axes"),
    "a table that is not flat": (
        put("/World/Table", "xformOp:translate", Gf.Vec3d(0.375, 0, 0)),
        "has no flat top at z = 0; its level tops are at 0.02 m",
        "aligned with the world's axes",
    ),
}


IMPOSSIBLE = {
    "a goal in an obstacle": (goal_to(0.5, 0.1, 0), "goal (0.5, 0.1, 0)", "obstacle </World/Obstacles/Cube>"),
    "a goal in the base": (goal_to(0.1, 0.1, 0), "goal (0.1, 0.1, 0)", "overlaps the robot's base"),
    "a goal off the table": (goal_to(0.05, 0.68, 3), "goal (0.05, 0.68, 3)", "not wholly on the table"),
    "a goal out of reach": (goal_to(0.8, 0.3, 0), "out of reach", "up to 0.72 m"),
    "a start in an obstacle": (object_to(0.5, 0.0), "start (0.5, 0, 0)", "obstacle </World/Obstacles/Cube>"),
    "a start in the base": (object_to(0.1, 0.05), "start (0.1, 0.05, 0)", "overlaps the robot's base"),
    "a start off the table": (object_to(0.3, -0.7), "start (0.3, -0.7, 0)", "not wholly on the table"),
    "a start out of reach": (object_to(0.75, -0.4), "out of reach", "0.86 m from the arm's base"),
    "a tool in the object": (object_to(0.3, -0.22), "the tool touches the object", "oimppi:startJoints"),
    "a tool below the table": (put(ROBOT, START, [0.0] * 6), "below the table", "above z = 0"),
}


def walls(stage: Usd.Stage) -> None:
    """A corridor around the object, narrower than what a drawn start needs."""
    for i, y in enumerate((-0.35, -0.60)):
        cube = UsdGeom.Cube.Define(stage, f"/World/Obstacles/Wall{i}")
        cube.CreateSizeAttr(1.0)
        cube.AddTranslateOp().Set(Gf.Vec3d(0.3, y, 0.05))
        cube.AddScaleOp().Set(Gf.Vec3f(1.0, 0.02, 0.1))
        UsdPhysics.CollisionAPI.Apply(cube.GetPrim())
        cube.GetPrim().AddAppliedSchema("OimppiObstacleAPI")


def vast(stage: Usd.Stage) -> None:
    """A gantry and a table of 80 m, for the point robot."""
    for name in ("joint1", "joint2"):
        joint = UsdPhysics.PrismaticJoint(prim(stage, f"{ROBOT}/joints/{name}"))
        joint.GetLowerLimitAttr().Set(-40.0)
        joint.GetUpperLimitAttr().Set(40.0)
    put("/World/Table", "xformOp:scale", Gf.Vec3d(80.0, 80.0, 0.04))(stage)


def barrier(gap: float):
    """A wall across the table of task01, with one gap of this width."""

    def change(stage: Usd.Stage) -> None:
        for name, left, right in (("A", -0.25, -0.05), ("B", 0.05, 0.44), ("C", 0.44 + gap, 1.0)):
            cube = UsdGeom.Cube.Define(stage, f"/World/Obstacles/{name}")
            cube.CreateSizeAttr(1.0)
            cube.AddTranslateOp().Set(Gf.Vec3d((left + right) / 2, -0.02, 0.05))
            cube.AddScaleOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(right - left, 0.14, 0.1))
            UsdPhysics.CollisionAPI.Apply(cube.GetPrim())
            cube.GetPrim().AddAppliedSchema("OimppiObstacleAPI")

    return change
