"""Reads the table, the object and the obstacles, and reports prims without a role."""

from __future__ import annotations

import math

import numpy as np
from pxr import Gf, Sdf, Usd, UsdPhysics

from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.footprint import height_range, rotation_matrix
from oimppi_warp.scene import Collider, Obstacle, PlanarPose, PushedObject, Table
from oimppi_warp.usd.colliders import ALLOWED, collider_prims, read_colliders, volume_and_center
from oimppi_warp.usd.densities import derive_mass
from oimppi_warp.usd.frames import is_orthogonal, scales, transform
from oimppi_warp.usd.inertia import given_center, read_mass, unit_inertia
from oimppi_warp.usd.stage import SceneStage

FLOATING = 1e-3
"""Maximum distance of an object above or below the table's top in the file [m]."""

_WORLD = Gf.Matrix4d(1.0)


def read_table(stage: SceneStage) -> Table:
    """Reads the table: the prim with OimppiTableAPI, in the world frame.

    Raises:
        SceneError: There is no table or more than one, or it is not a level box with its top at z = 0.
    """
    prim = stage.single_prim("OimppiTableAPI", "table", "the box that the object slides on")
    allowed = "a Cube with CollisionAPI, aligned with the world's axes, with its top at z = 0"
    moving = _moving_parts(stage, prim, "table")
    colliders = read_colliders(stage, prim, _WORLD)
    tops = []
    for collider in colliders:
        half = _level_half(collider)
        if half is not None:
            center, top = collider.transform[:3], collider.transform[2] + half[2]
            if abs(top) < 1e-6:
                (x0, y0), (x1, y1) = (center - half)[:2].tolist(), (center + half)[:2].tolist()
                others = tuple(other for other in colliders if other is not collider)
                return Table(str(prim.GetPath()), (x0, y0), (x1, y1), 2.0 * float(half[2]), others)
            tops.append(f"{top:.4g} m")
    if moving or len(colliders) < len(list(collider_prims(prim))):
        return Table(str(prim.GetPath()), (0.0, 0.0), (0.0, 0.0))  # its mistakes are reported already
    found = f"; its level tops are at {', '.join(tops)}" if tops else ""
    raise stage.error(
        f"the table has no flat top at z = 0{found}",
        prim,
        allowed=allowed,
        fix="use a level box, and move it so that its top is at z = 0",
    )


def _level_half(collider: Collider) -> np.ndarray | None:
    """Returns world half extents of an axis-aligned box, shape [3] [m]; ``None`` for any other shape."""
    turned = np.abs(rotation_matrix(collider.transform[3:]))
    if collider.kind != "box" or not np.allclose(turned, np.round(turned), atol=1e-6):
        return None
    return np.round(turned) @ np.asarray(collider.size)


def read_object(stage: SceneStage) -> tuple[PushedObject, PlanarPose]:
    """Reads the object, the prim with OimppiObjectAPI, and its planar pose in the file (x [m], y [m], yaw [rad]).

    Raises:
        SceneError: There is no object or more than one, or it cannot move, has no mass, shape or friction, or does not
            lie on the table.
    """
    prim = stage.single_prim("OimppiObjectAPI", "object", "the rigid body to be pushed")
    if not prim.HasAPI(UsdPhysics.RigidBodyAPI) or not UsdPhysics.RigidBodyAPI(prim).GetRigidBodyEnabledAttr().Get():
        stage.collect(
            stage.error(
                "the object cannot move",
                prim,
                fix="apply PhysicsRigidBodyAPI to it, with physics:rigidBodyEnabled = true",
                allowed="an enabled rigid body",
            )
        )
    frame = object_frame(stage, prim)
    for part in nested_bodies(stage, prim):
        stage.collect(nested_error(stage, part))
    colliders = read_colliders(stage, prim, frame)
    mass = stage.attempt(math.nan, _object_mass, stage, prim, colliders)
    center, rest_height, friction, tool_friction = np.zeros(3), 0.0, math.nan, math.nan
    if not any(collider_prims(prim)):
        fix = "apply PhysicsCollisionAPI to this prim or to a shape below it"
        stage.collect(stage.error("the object has no collider", prim, allowed=ALLOWED, fix=fix))
    elif len(colliders) == len(list(collider_prims(prim))):
        rest_height = round(-float(height_range(colliders)[0]), 6)
        _check_resting(stage, prim, transform(frame), rest_height)
        center = center_of_mass(stage, prim, colliders)
    if colliders:
        friction, tool_friction = _frictions(stage, prim)
    pushed = PushedObject(
        path=str(prim.GetPath()),
        mass=mass,
        friction=friction,
        tool_friction=tool_friction,
        center_of_mass=center,
        colliders=colliders,
        rest_height=rest_height,
        unit_inertia=unit_inertia(prim, mass),
        limit_surface_radius=stage.attempt(None, limit_surface_radius, stage, prim),
    )
    pose = transform(frame)
    yaw = 2.0 * math.atan2(pose[5], pose[6])
    return pushed, (float(pose[0]), float(pose[1]), math.remainder(yaw, 2.0 * math.pi))


def read_obstacle(stage: SceneStage, prim: Usd.Prim) -> Obstacle:
    """Reads the obstacle at ``prim``, in the world frame.

    Raises:
        SceneError: It has no collider or an unsupported one, or part of it is a rigid body.
    """
    if not _moving_parts(stage, prim, "obstacle") and not any(collider_prims(prim)):
        raise stage.error(
            "the obstacle has no collider",
            prim,
            allowed=ALLOWED,
            fix="apply PhysicsCollisionAPI to this prim or to a shape below it",
        )
    return Obstacle(str(prim.GetPath()), read_colliders(stage, prim, _WORLD))


def check_roles(stage: SceneStage) -> None:
    """Notes every prim that collides or moves but has no role known to the planner.

    If there is no robot, object or table at all, nothing is noted: the unknown prim is the one that lacks the role.
    """
    roles = [stage.prims_with(f"Oimppi{role}API") for role in ("Robot", "Object", "Table", "Obstacle")]
    if not all(roles[:3]):
        return
    known = [prim.GetPath() for prims in roles for prim in prims]
    unknown: list[Sdf.Path] = []
    for prim in stage.prims():
        path = prim.GetPath()
        if any(path.HasPrefix(other) for other in (*known, *unknown)):
            continue
        if prim.HasAPI(UsdPhysics.CollisionAPI) or prim.HasAPI(UsdPhysics.RigidBodyAPI):
            unknown.append(path)
            mistake = stage.error(
                "this prim collides or moves but has no role in the task",
                prim,
                allowed="robot, object, obstacle or table",
                fix="apply OimppiObstacleAPI to it, or remove its physics schemas",
            )
            stage.collect(mistake)


def _object_mass(stage: SceneStage, prim: Usd.Prim, colliders: tuple[Collider, ...]) -> float:
    """Returns the object's mass [kg]: the one in the file, or the one that follows from its shapes' densities."""
    derive_mass(stage, prim, colliders)
    return read_mass(stage, prim)


def object_frame(stage: SceneStage, prim: Usd.Prim) -> Gf.Matrix4d:
    """Returns the object's world frame without scale, which belongs to its shapes: a scaled Cube may be a body."""
    frame = stage.frame(prim)
    if not is_orthogonal(frame) or scales(frame).min() < 1e-9 or frame.GetDeterminant() <= 0.0:
        raise stage.error(
            "the object is mirrored, sheared or scaled to zero",
            prim,
            allowed="translation, rotation, and scale along its own axes",
            fix="remove mirroring and uneven scale from the prim and its ancestors, and scale its shapes instead",
        )
    return frame.GetOrthonormalized()


def nested_bodies(stage: SceneStage, body: Usd.Prim) -> list[Usd.Prim]:
    """Returns the rigid bodies below a body's prim, whose shapes are no part of it."""
    return [part for part in stage.prims(body) if part != body and part.HasAPI(UsdPhysics.RigidBodyAPI)]


def nested_error(stage: SceneStage, part: Usd.Prim) -> SceneError:
    """Returns the error about a rigid body below the object's prim."""
    return stage.error(
        "the object contains another rigid body",
        part,
        allowed="one rigid body, with shapes below it",
        fix="remove PhysicsRigidBodyAPI from this prim to make it a part of the object, or move the prim elsewhere",
    )


def _check_resting(stage: SceneStage, prim: Usd.Prim, pose: np.ndarray, rest_height: float) -> None:
    """Checks that an object lies flat on the table, neither above nor inside it."""
    if abs(pose[3]) > 1e-4 or abs(pose[4]) > 1e-4:
        fix = "rotate it so that one of its axes points up; if its shapes are tilted within it, rotate them"
        stage.collect(stage.error("the object does not lie flat", prim, allowed="rotation about z only", fix=fix))
        return
    above = float(pose[2]) - rest_height
    if abs(above) > FLOATING:
        where = f"{above * 1000:.1f} mm above" if above > 0 else f"{-above * 1000:.1f} mm inside"
        fix = f"set its z to {rest_height:.4g} m"
        stage.collect(stage.error(f"the object is {where} the table", prim, allowed="on the table", fix=fix))


def center_of_mass(stage: SceneStage, prim: Usd.Prim, colliders: tuple[Collider, ...]) -> np.ndarray:
    """Returns the centre of mass in the body's frame, shape [3] [m]: physics:centerOfMass, or that of the colliders.

    The colliders are taken to have equal densities.
    """
    given = given_center(prim)
    if given is not None:
        return given * scales(stage.frame(prim))
    parts = [volume_and_center(collider) for collider in colliders]
    return np.average([c for _, c in parts], axis=0, weights=[volume for volume, _ in parts])


def limit_surface_radius(stage: SceneStage, prim: Usd.Prim) -> float | None:
    """Returns ``oimppi:limitSurfaceRadius`` of the object [m]; ``None`` if it is to follow from the shape.

    Raises:
        SceneError: It is not a finite number, or it is negative.
    """
    radius = float(stage.numbers(prim, "oimppi:limitSurfaceRadius", (), "a length, zero or more"))
    if not 0.0 <= radius < math.inf:
        raise stage.error(
            f"oimppi:limitSurfaceRadius is {radius:g}",
            prim,
            allowed="a length above zero, in metres; 0 computes it from the shape",
            fix="correct it, or leave it out",
        )
    return radius or None


def _frictions(stage: SceneStage, prim: Usd.Prim) -> tuple[float, float]:
    """Returns the object's friction coefficients with the table and with the tool."""
    tools = [tip.GetParent() for tip in stage.prims_with("OimppiToolAPI")]
    tables = stage.prims_with("OimppiTableAPI")
    own, table, tool = (largest_friction(stage, bodies) for bodies in ([prim], tables, tools))
    if own is None and (table is None or tool is None):
        fix = "bind a material with PhysicsMaterialAPI and a physics:dynamicFriction to its colliders"
        allowed = "a coefficient above zero with the table, zero or more with the tool"
        stage.collect(stage.error("the object has no friction", prim, allowed=allowed, fix=fix))
    with_table, with_tool = (float(np.maximum(own or 0.0, other or 0.0)) for other in (table, tool))
    if with_table <= 0.0 and not (own is None and table is None):
        fix = "give its material or the table's a physics:dynamicFriction above zero"
        allowed = "a coefficient above zero; only the friction with the tool may be zero"
        stage.collect(stage.error("the object has no friction with the table", prim, allowed=allowed, fix=fix))
    return with_table, with_tool


def largest_friction(stage: SceneStage, bodies: list[Usd.Prim]) -> float | None:
    """Returns the largest dynamic friction of the materials bound to the bodies' colliders; ``None`` without any.

    NaN if there are no bodies, or if a coefficient is invalid (the stage then has the mistake).
    """
    if not bodies:
        return math.nan
    shapes = [shape for body in bodies for shape in collider_prims(body)]
    found = [stage.attempt(math.nan, stage.friction, shape) for shape in shapes]
    return float(np.max(known)) if (known := [value for value in found if value is not None]) else None


def _moving_parts(stage: SceneStage, prim: Usd.Prim, noun: str) -> bool:
    """Notes every moving part of the table or an obstacle, and returns whether there is one."""
    moving = [part for part in stage.prims(prim) if part.HasAPI(UsdPhysics.RigidBodyAPI)]
    for part in moving:
        allowed = "static shapes: CollisionAPI without RigidBodyAPI"
        stage.collect(
            stage.error(
                f"the {noun} contains a rigid body",
                part,
                allowed=allowed,
                fix="remove PhysicsRigidBodyAPI from this prim, or the role's API schema from the prim that has it",
            )
        )
    return bool(moving)
