"""The xArm6 with its pushing stick, as a USD articulation.

Figures: UFACTORY's published description (`xarm_ros2`) for the chain, limits and inertials; the collision capsules are
least-squares fits to the vendor's surfaces (mean error 2-6 mm). Metres, radians, kilograms; joint axes are local +z.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import scene_skin
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics

from oimppi_warp.authoring.prims import (
    COLLIDER,
    apply_api,
    attribute,
    bind_physics,
    capsule,
    cylinder,
    mass_properties,
    matrix_quat,
    new_stage,
    physics_material,
    place,
    quat,
    vec3,
)

HALF_PI = math.pi / 2

JOINTS = [
    # xyz in the parent's frame, roll, lower, upper, effort
    ((0.0, 0.0, 0.267), 0.0, -2 * math.pi, 2 * math.pi, 50.0),
    ((0.0, 0.0, 0.0), -HALF_PI, -2.059, 2.0944, 50.0),
    ((0.0535, -0.2845, 0.0), 0.0, -3.927, 0.19198, 32.0),
    ((0.0775, 0.3425, 0.0), -HALF_PI, -2 * math.pi, 2 * math.pi, 32.0),
    ((0.0, 0.0, 0.0), HALF_PI, -1.69297, math.pi, 32.0),
    ((0.076, 0.097, 0.0), -HALF_PI, -2 * math.pi, 2 * math.pi, 20.0),
]

INERTIALS = [
    # mass, centre of mass, (ixx, iyy, izz, ixy, ixz, iyz) in the link's frame; base first
    (2.7, (0, 0, 0.09103), (0.00494875, 0.00494174, 0.002219, -3.5e-6, 1.25e-5, 1.67e-6)),
    (2.3814, (0.00022, 0.02951, -0.0124), (0.0058562, 0.0050316, 0.003536652, -1.79e-5, 3.55e-6, -0.000888336)),
    (2.2675, (0.03881, -0.22783, 0.03496), (0.028315776, 0.0058, 0.0273447, 0.005, 0.00066546, -0.0045741)),
    (1.875, (0.07041, 0.11631, 0.0107), (0.0063483, 0.00379758, 0.00595768, -0.0015397, 0.00096858, 0.00186567)),
    (1.3192, (-0.00018, 0.01798, -0.02291), (0.004896, 0.00445694, 0.00134332, -6.925e-6, -1.418e-5, -0.00023186)),
    (1.33854, (0.0651, 0.03096, 0.00315), (0.00146378, 0.00184192, 0.002333524, -0.000450624, 2.84306e-4, 1.30866e-4)),
    (0.17, (0, -0.00677, -0.01098), (9.3e-5, 5.87e-5, 0.000132, 0, 0, -3.6e-6)),
]

CAPSULES = [
    # ax ay az bx by bz radius, link frames; base first
    [(0.0007, 0.0004, 0.0204, -0.0001, -0.0003, 0.125, 0.0482)],
    [
        (-0.0006, -0.0024, -0.0859, 0.0004, -0.0148, 0.0023, 0.0454),
        (0.0001, -0.0115, -0.0013, -0.0003, 0.0431, 0.0001, 0.0485),
    ],
    [
        (0.0019, 0.013, 0.0911, -0.0125, -0.1103, 0.0869, 0.034),
        (0.0024, -0.1099, 0.0767, -0.0006, -0.1075, 0.0017, 0.0454),
        (-0.0012, -0.1222, 0.0102, 0.0025, -0.2359, -0.0135, 0.0411),
        (0.0433, -0.2844, -0.0325, 0.0552, -0.2849, 0.038, 0.0419),
    ],
    [
        (-0.0052, -0.0102, 0.0823, 0.039, 0.0494, 0.0935, 0.0308),
        (0.0781, 0.0836, 0.0118, 0.0773, 0.0824, 0.0684, 0.0423),
        (0.0779, 0.0837, -0.0001, 0.0775, 0.1411, 0.0004, 0.0425),
    ],
    [
        (0.0018, 0.0062, -0.1481, -0.0018, -0.0025, -0.1516, 0.0401),
        (0.0012, 0.0452, -0.1094, 0.0, 0.0704, -0.062, 0.026),
        (-0.0002, 0.0543, -0.0021, -0.0003, 0.0294, 0.0003, 0.0382),
    ],
    [
        (-0.0029, -0.0008, 0.0219, 0.0035, 0.0019, 0.0207, 0.0377),
        (0.0607, 0.0213, 0.0094, 0.0381, -0.0071, 0.0219, 0.0264),
        (0.0759, -0.0058, 0.0002, 0.0758, 0.0448, -0.0001, 0.0381),
    ],
    [(-0.0028, 0.0081, -0.0175, 0.0028, -0.0101, -0.0169, 0.0299)],
]

VELOCITY_LIMIT = 3.14  # rad/s
DRIVE_GAIN = 200.0  # N m s/rad: the arm's own controller follows a velocity closely
TOOL_LENGTH, TOOL_RADIUS, TOOL_MASS = 0.175, 0.008, 0.05
TOOL_FRICTION = 0.3
ARM_FRICTION = 0.3
BASE_RADIUS, BASE_HEIGHT = 0.09, 0.06  # the base with its plug: what an object on the table must stay away from

# Tool down, tip at (0.300, -0.200, 0.050).
START = (-0.588, -0.11, -0.51, 0.0, 0.62, 0.0)


def link_frames(q: tuple[float, ...]) -> list[np.ndarray]:
    """Pose of the base and the six links for joint positions ``q`` [rad], as 4 x 4 matrices."""
    frames = [np.eye(4)]
    for (xyz, roll, *_), angle in zip(JOINTS, q, strict=True):
        c, s, cr, sr = math.cos(angle), math.sin(angle), math.cos(roll), math.sin(roll)
        step = np.eye(4)
        step[:3, :3] = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]]) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        step[:3, 3] = xyz
        frames.append(frames[-1] @ step)
    return frames


def pose_links(stage: Usd.Stage, robot: str, q: tuple[float, ...]) -> None:
    """Write the link poses that belong to joint positions ``q`` [rad], and ``q`` as the robot's start."""
    frames = link_frames(q)
    flange = frames[-1]
    frames.append(flange)
    for name, frame in zip([*_link_names(), "tool"], frames, strict=True):
        place(stage.OverridePrim(f"{robot}/{name}"), frame[:3, 3], matrix_quat(frame[:3, :3]))
    attribute(stage.OverridePrim(robot), "oimppi:startJoints", Sdf.ValueTypeNames.DoubleArray, list(q))


def _link_names() -> list[str]:
    return ["base", *(f"link{i}" for i in range(1, 7))]


def write(file: Path) -> None:
    """Write the robot's file."""
    stage = new_stage(
        file, "XArm6", "UFACTORY xArm6 with a stick for pushing. Written by tools/make_scenes.py; do not edit by hand."
    )
    root = stage.GetDefaultPrim()
    UsdPhysics.ArticulationRootAPI.Apply(root)
    apply_api(root, "OimppiRobotAPI")
    material = physics_material(stage, "/XArm6/ArmMaterial", ARM_FRICTION)

    for index, name in enumerate(_link_names()):
        prim = UsdGeom.Xform.Define(stage, f"/XArm6/{name}").GetPrim()
        UsdPhysics.RigidBodyAPI.Apply(prim)
        mass, center, (ixx, iyy, izz, ixy, ixz, iyz) = INERTIALS[index]
        mass_properties(prim, mass, center, np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]))
        for number, (ax, ay, az, bx, by, bz, radius) in enumerate(CAPSULES[index]):
            capsule(stage, f"{prim.GetPath()}/collider{number}", (ax, ay, az), (bx, by, bz), radius, COLLIDER)
    foot = (0.0, 0.0, BASE_HEIGHT / 2)
    cylinder(stage, "/XArm6/base/foot", foot, BASE_RADIUS, BASE_HEIGHT, COLLIDER)
    bind_physics(root, material)
    _write_tool(stage)
    _write_joints(stage)
    _write_collision_group(stage)
    pose_links(stage, "/XArm6", START)
    scene_skin.write(file.with_name("xarm6_skin.usda"), TOOL_LENGTH, TOOL_RADIUS)
    stage.GetRootLayer().subLayerPaths.append("./xarm6_skin.usda")
    stage.Save()


def _write_tool(stage: Usd.Stage) -> None:
    tool = UsdGeom.Xform.Define(stage, "/XArm6/tool").GetPrim()
    UsdPhysics.RigidBodyAPI.Apply(tool)
    across = TOOL_MASS * (TOOL_LENGTH**2 / 12 + TOOL_RADIUS**2 / 4)
    inertia = np.diag([across, across, TOOL_MASS * TOOL_RADIUS**2 / 2])
    mass_properties(tool, TOOL_MASS, (0.0, 0.0, TOOL_LENGTH / 2), inertia)
    ends = (0.0, 0.0, TOOL_RADIUS), (0.0, 0.0, TOOL_LENGTH - TOOL_RADIUS)
    capsule(stage, "/XArm6/tool/collider", *ends, TOOL_RADIUS, COLLIDER)
    bind_physics(tool, physics_material(stage, "/XArm6/ToolMaterial", TOOL_FRICTION))
    tip = UsdGeom.Xform.Define(stage, "/XArm6/tool/tip").GetPrim()
    place(tip, (0.0, 0.0, TOOL_LENGTH))
    apply_api(tip, "OimppiToolAPI")
    attribute(tip, "oimppi:radius", Sdf.ValueTypeNames.Double, TOOL_RADIUS)


def _write_joints(stage: Usd.Stage) -> None:
    UsdGeom.Scope.Define(stage, "/XArm6/joints")
    _fixed(stage, "mount", None, "base")
    for number, (xyz, roll, lower, upper, effort) in enumerate(JOINTS, start=1):
        joint = UsdPhysics.RevoluteJoint.Define(stage, f"/XArm6/joints/joint{number}")
        parent = "base" if number == 1 else f"link{number - 1}"
        joint.CreateBody0Rel().SetTargets([f"/XArm6/{parent}"])
        joint.CreateBody1Rel().SetTargets([f"/XArm6/link{number}"])
        joint.CreateAxisAttr(UsdPhysics.Tokens.z)
        joint.CreateLocalPos0Attr(vec3(xyz))
        joint.CreateLocalRot0Attr(quat((math.sin(roll / 2), 0.0, 0.0, math.cos(roll / 2))))
        joint.CreateLocalPos1Attr(Gf.Vec3f(0.0))
        joint.CreateLocalRot1Attr(Gf.Quatf(1.0))
        joint.CreateLowerLimitAttr(math.degrees(lower))
        joint.CreateUpperLimitAttr(math.degrees(upper))
        drive = UsdPhysics.DriveAPI.Apply(joint.GetPrim(), "angular")
        drive.CreateTypeAttr(UsdPhysics.Tokens.force)
        drive.CreateStiffnessAttr(0.0)
        drive.CreateDampingAttr(math.radians(DRIVE_GAIN))
        drive.CreateTargetVelocityAttr(0.0)
        drive.CreateMaxForceAttr(effort)
        apply_api(joint.GetPrim(), "NewtonJointAPI")
        attribute(joint.GetPrim(), "newton:velocityLimit", Sdf.ValueTypeNames.Float, math.degrees(VELOCITY_LIMIT))
    _fixed(stage, "weld", "link6", "tool")


def _fixed(stage: Usd.Stage, name: str, parent: str | None, child: str) -> None:
    joint = UsdPhysics.FixedJoint.Define(stage, f"/XArm6/joints/{name}")
    if parent is not None:
        joint.CreateBody0Rel().SetTargets([f"/XArm6/{parent}"])
    joint.CreateBody1Rel().SetTargets([f"/XArm6/{child}"])


def _write_collision_group(stage: Usd.Stage) -> None:
    """The arm does not collide with itself: its capsules overlap at the joints."""
    group = UsdPhysics.CollisionGroup.Define(stage, "/XArm6/ArmCollisions")
    group.GetCollidersCollectionAPI().CreateIncludesRel().SetTargets(["/XArm6"])
    group.CreateFilteredGroupsRel().SetTargets([group.GetPath()])
