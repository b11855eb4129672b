"""Writes a robot as a USD articulation, and its display geometry as a layer beside it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import trimesh
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics

from oimppi_warp.authoring.prims import (
    COLLIDER,
    Look,
    apply_api,
    attribute,
    bind_physics,
    box,
    capsule,
    cylinder,
    mass_properties,
    matrix_quat,
    mesh,
    new_stage,
    physics_material,
    quat,
    set_pose,
    sphere,
    vec3,
)
from oimppi_warp.authoring.robots.arm import NOT_TURNED, Arm, ArmJoint
from oimppi_warp.geometry.footprint import rotation_matrix, transform_points
from oimppi_warp.geometry.kinematics import link_frames
from oimppi_warp.physics.newton_model import DRIVE_GAIN, SLIDE_GAIN
from oimppi_warp.scene import Collider

FRICTION = 0.3
"""Coulomb coefficient of an arm and of its stick."""


def write(arm: Arm, file: Path, *, skin: str = "") -> None:
    """Writes a robot's file.

    Args:
        arm: The robot.
        file: The USD file.
        skin: Name of a file beside it with the display geometry; empty: the colliders are drawn.
    """
    stage = new_stage(file, arm.name, arm.doc)
    root = stage.GetDefaultPrim()
    UsdPhysics.ArticulationRootAPI.Apply(root)
    apply_api(root, "OimppiRobotAPI")
    material = physics_material(stage, f"/{arm.name}/ArmMaterial", FRICTION)
    for name, link in zip(_link_names(arm), (arm.base, *arm.links), strict=True):
        prim = UsdGeom.Xform.Define(stage, f"/{arm.name}/{name}").GetPrim()
        UsdPhysics.RigidBodyAPI.Apply(prim)
        mass_properties(prim, link.mass, link.center, link.inertia)
        for collider in link.colliders:
            look = COLLIDER if link.visuals else arm.look
            _write_collider(stage, f"{prim.GetPath()}/{collider.path}", collider, look)
    bind_physics(root, material)
    _write_tool(stage, arm)
    _write_joints(stage, arm)
    _write_collision_group(stage, arm.name)
    _pose_links(stage, arm)
    if skin:
        stage.GetRootLayer().subLayerPaths.append(f"./{skin}")
    stage.Save()


def write_visuals(arm: Arm, file: Path) -> bool:
    """Writes the links' display geometry to a layer of its own, the skin that :func:`write` refers to.

    Returns:
        Whether there is any display geometry; if not, no file is written.
    """
    links = dict(zip(_link_names(arm), (arm.base, *arm.links), strict=True))
    if not any(link.visuals for link in links.values()):
        return False
    stage = new_stage(file, arm.name, f"Looks of {arm.name}")
    for name, link in links.items():
        for visual in link.visuals:
            path, look = f"/{arm.name}/{name}/skin/{visual.shape.path}", Look(visual.color)
            UsdGeom.Scope.Define(stage, f"/{arm.name}/{name}/skin")
            if visual.faces:
                points = transform_points(visual.shape.transform, np.asarray(visual.shape.vertices))
                mesh(stage, path, points, visual.faces, look)
            else:
                _write_collider(stage, path, visual.shape, look)
    stage.Save()
    return True


def _link_names(arm: Arm) -> list[str]:
    return ["base", *(f"link{number}" for number in range(1, len(arm.links) + 1))]


def _write_collider(stage: Usd.Stage, path: str, shape: Collider, look: Look) -> None:
    center, turn = shape.transform[:3], shape.transform[3:]
    orientation = None if np.allclose(turn, NOT_TURNED) else turn
    if shape.kind == "capsule":
        radius, half = shape.size
        along = rotation_matrix(turn)[:, 2] * half
        capsule(stage, path, center - along, center + along, radius, look)
    elif shape.kind == "cylinder":
        radius, half = shape.size
        cylinder(stage, path, center, radius, 2.0 * half, look, orientation)
    elif shape.kind == "sphere":
        sphere(stage, path, center, shape.size[0], look)
    elif shape.kind == "box":
        box(stage, path, center, 2.0 * np.array(shape.size), look, orientation)
    else:
        hull = trimesh.convex.convex_hull(np.asarray(shape.vertices))
        mesh(stage, path, transform_points(shape.transform, hull.vertices), hull.faces.tolist(), look)


def _write_tool(stage: Usd.Stage, arm: Arm) -> None:
    path, stick = f"/{arm.name}/tool", arm.stick
    tool = UsdGeom.Xform.Define(stage, path).GetPrim()
    UsdPhysics.RigidBodyAPI.Apply(tool)
    across = stick.mass * (stick.length**2 / 12 + stick.radius**2 / 4)
    inertia = np.diag([across, across, stick.mass * stick.radius**2 / 2])
    mass_properties(tool, stick.mass, (0.0, 0.0, stick.length / 2), inertia)
    ends = (0.0, 0.0, stick.radius), (0.0, 0.0, stick.length - stick.radius)
    capsule(stage, f"{path}/collider", *ends, stick.radius, arm.look)
    bind_physics(tool, physics_material(stage, f"/{arm.name}/ToolMaterial", stick.friction))
    tip = UsdGeom.Xform.Define(stage, f"{path}/tip").GetPrim()
    set_pose(tip, (0.0, 0.0, stick.length))
    apply_api(tip, "OimppiToolAPI")
    attribute(tip, "oimppi:radius", Sdf.ValueTypeNames.Double, stick.radius)


def _write_joints(stage: Usd.Stage, arm: Arm) -> None:
    UsdGeom.Scope.Define(stage, f"/{arm.name}/joints")
    _fixed(stage, arm.name, "mount", None, "base")
    for number, joint in enumerate(arm.joints, start=1):
        _write_joint(stage, arm.name, number, joint)
    weld = _fixed(stage, arm.name, "weld", f"link{len(arm.links)}", "tool")
    if not np.allclose(arm.stick.mount, (0.0, 0.0, 0.0, *NOT_TURNED)):
        weld.CreateLocalPos0Attr(vec3(arm.stick.position))
        weld.CreateLocalRot0Attr(quat(arm.stick.turn))
        weld.CreateLocalPos1Attr(Gf.Vec3f(0.0))
        weld.CreateLocalRot1Attr(Gf.Quatf(1.0))


def _write_joint(stage: Usd.Stage, root: str, number: int, joint: ArmJoint) -> None:
    turns = joint.kind == "revolute"
    schema, drive_name, outward, gain = (
        (UsdPhysics.RevoluteJoint, "angular", math.degrees, math.radians(DRIVE_GAIN))
        if turns
        else (UsdPhysics.PrismaticJoint, "linear", float, SLIDE_GAIN)
    )
    made = schema.Define(stage, f"/{root}/joints/joint{number}")
    made.CreateBody0Rel().SetTargets([f"/{root}/{'base' if number == 1 else f'link{number - 1}'}"])
    made.CreateBody1Rel().SetTargets([f"/{root}/link{number}"])
    made.CreateAxisAttr(UsdPhysics.Tokens.z)
    made.CreateLocalPos0Attr(vec3(joint.position))
    made.CreateLocalRot0Attr(quat(joint.turn))
    made.CreateLocalPos1Attr(Gf.Vec3f(0.0))
    made.CreateLocalRot1Attr(Gf.Quatf(1.0))
    if math.isfinite(joint.lower):
        made.CreateLowerLimitAttr(outward(joint.lower))
    if math.isfinite(joint.upper):
        made.CreateUpperLimitAttr(outward(joint.upper))
    drive = UsdPhysics.DriveAPI.Apply(made.GetPrim(), drive_name)
    drive.CreateTypeAttr(UsdPhysics.Tokens.force)
    drive.CreateStiffnessAttr(0.0)
    drive.CreateDampingAttr(gain)
    drive.CreateTargetVelocityAttr(0.0)
    drive.CreateMaxForceAttr(joint.effort)
    apply_api(made.GetPrim(), "NewtonJointAPI")
    attribute(made.GetPrim(), "newton:velocityLimit", Sdf.ValueTypeNames.Float, outward(joint.velocity))


def _fixed(stage: Usd.Stage, root: str, name: str, parent: str | None, child: str) -> UsdPhysics.FixedJoint:
    joint = UsdPhysics.FixedJoint.Define(stage, f"/{root}/joints/{name}")
    if parent is not None:
        joint.CreateBody0Rel().SetTargets([f"/{root}/{parent}"])
    joint.CreateBody1Rel().SetTargets([f"/{root}/{child}"])
    return joint


def _write_collision_group(stage: Usd.Stage, root: str) -> None:
    """Excludes collisions of the robot with itself, as its shapes overlap at the joints."""
    group = UsdPhysics.CollisionGroup.Define(stage, f"/{root}/ArmCollisions")
    group.GetCollidersCollectionAPI().CreateIncludesRel().SetTargets([f"/{root}"])
    group.CreateFilteredGroupsRel().SetTargets([group.GetPath()])


def _pose_links(stage: Usd.Stage, arm: Arm) -> None:
    """Writes the poses of the links at the start, and the start positions themselves."""
    rotations, positions = link_frames(arm.robot(), np.array(arm.start))
    turn = rotation_matrix(arm.stick.mount[3:])
    frames = [(np.eye(3), np.zeros(3)), *zip(rotations, positions, strict=True)]
    frames.append((rotations[-1] @ turn, positions[-1] + rotations[-1] @ np.asarray(arm.stick.position)))
    for name, (rotation, position) in zip([*_link_names(arm), "tool"], frames, strict=True):
        set_pose(stage.OverridePrim(f"/{arm.name}/{name}"), position, matrix_quat(rotation))
    start = [float(position) for position in arm.start]
    attribute(stage.OverridePrim(f"/{arm.name}"), "oimppi:startJoints", Sdf.ValueTypeNames.DoubleArray, start)
