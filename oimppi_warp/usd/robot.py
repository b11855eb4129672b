"""Reads the arm: a chain of revolute or sliding joints, from a base fixed at the origin to a stick."""

from __future__ import annotations

import math

import numpy as np
from pxr import Gf, Sdf, Usd, UsdPhysics

from oimppi_warp.scene import Collider, Joint, JointKind, Link, Robot, Welded
from oimppi_warp.usd.colliders import read_colliders
from oimppi_warp.usd.frames import format_numbers, matrix, scales, transform
from oimppi_warp.usd.inertia import given_center, read_mass, unit_inertia
from oimppi_warp.usd.stage import MAX_LENGTH, SceneStage

_UNITS: dict[JointKind, str] = {"revolute": "rad", "prismatic": "m"}
_UNREAD = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
"""Placeholder for a frame with a mistake, so that reading can continue."""


def read_robot(scene: SceneStage) -> Robot:
    """Reads the scene's robot.

    Raises:
        SceneError: There is no robot or more than one, it is not a serial arm of joints about or along their local z
            axes with its base fixed at the origin, or its tool or start is invalid.
    """
    root = scene.single_prim("OimppiRobotAPI", "robot", "the root prim of the articulation")
    if not any(prim.HasAPI(UsdPhysics.ArticulationRootAPI) for prim in scene.prims(root)):
        scene.collect(
            scene.error(
                "the robot has no articulation root",
                root,
                fix="apply PhysicsArticulationRootAPI to it",
                allowed="PhysicsArticulationRootAPI on the robot or on a prim below it",
            )
        )
    tip_prim = scene.attempt(None, _tip, scene, root)
    radius = math.nan if tip_prim is None else scene.attempt(math.nan, _radius, scene, tip_prim)
    chain = _Chain(scene, root)
    joints, links = chain.walk()
    return Robot(
        path=str(root.GetPath()),
        base=chain.base,
        joints=joints,
        links=links,
        tip=_UNREAD if tip_prim is None else scene.attempt(_UNREAD, chain.in_last_link, tip_prim),
        tool_path="" if tip_prim is None else str(tip_prim.GetPath()),
        tool_radius=radius,
        start=scene.attempt(np.zeros(len(joints)), _start, scene, root, joints),
    )


def _radius(scene: SceneStage, tip: Usd.Prim) -> float:
    radius = float(scene.numbers(tip, "oimppi:radius", (), "the stick's radius [m]"))
    if not 0.0 < radius < math.inf:
        raise scene.error(
            f"oimppi:radius is {radius:g}", tip, allowed="more than zero [m]", fix="set it to the radius of the stick"
        )
    return radius


def _tip(scene: SceneStage, root: Usd.Prim) -> Usd.Prim:
    tip = scene.single_prim("OimppiToolAPI", "tool", "the Xform at the tip of the robot's stick")
    if not tip.GetPath().HasPrefix(root.GetPath()):
        raise scene.error(
            "the tool is not part of the robot",
            tip,
            allowed=f"a prim below <{root.GetPath()}>",
            fix="place the tip's Xform below the link that carries the stick",
        )
    return tip


def _start(scene: SceneStage, root: Usd.Prim, joints: tuple[Joint, ...]) -> np.ndarray:
    units = " or ".join(dict.fromkeys(_UNITS[joint.kind] for joint in joints))
    meaning = f"one position for each of the {len(joints)} joints [{units}]"
    start = scene.numbers(root, "oimppi:startJoints", (len(joints),), meaning)
    for joint, position in zip(joints, start, strict=True):
        if not joint.lower <= position <= joint.upper:
            unit = _UNITS[joint.kind]
            limits = f"{joint.lower:.4g} to {joint.upper:.4g} {unit}"
            what = f"oimppi:startJoints puts <{joint.path}> at {position:.4g} {unit}, beyond its limits"
            scene.collect(scene.error(what, root, allowed=limits, fix="correct oimppi:startJoints"))
    return start


def _position(frame: Gf.Matrix4d) -> str:
    """Formats a frame's position for a message."""
    return f"{format_numbers(np.round(np.array(frame.ExtractTranslation()), 4) + 0.0)} m"  # + 0: not -0


class _Chain:
    """The robot's bodies and joints, followed from its base."""

    def __init__(self, scene: SceneStage, root: Usd.Prim) -> None:
        self.scene = scene
        self.bodies = {p.GetPath(): p for p in scene.prims(root) if p.HasAPI(UsdPhysics.RigidBodyAPI)}
        joints = [UsdPhysics.Joint(prim) for prim in scene.prims(root) if prim.IsA(UsdPhysics.Joint)]
        self.joints = [joint for joint in joints if joint.GetJointEnabledAttr().Get()]
        mounts = [joint for joint in self.joints if self.ends(joint)[0] is None]
        if len(mounts) != 1 or not mounts[0].GetPrim().IsA(UsdPhysics.FixedJoint):
            raise scene.error(
                "the robot's base is not fixed to the world",
                root,
                fix="add one PhysicsFixedJoint with only physics:body1 set",
                allowed="exactly one joint to the world, a PhysicsFixedJoint",
            )
        base = self.ends(mounts[0])[1]
        frame = scene.body_frame(base)
        if not np.allclose(np.array(frame.ExtractTranslation()), 0.0, atol=1e-6):
            raise scene.error(
                f"the robot's base is at {_position(frame)}",
                base,
                allowed="at the world's origin",
                fix="move the base to the origin, and everything else by the same offset",
            )
        held, at = self.frames(mounts[0])
        placed = at.GetInverse() * held
        if not np.allclose(np.array(placed), np.array(frame), atol=1e-5):
            angle = (placed.ExtractRotation() * frame.ExtractRotation().GetInverse()).GetAngle()
            raise scene.error(
                f"the joint fixes the base at {_position(placed)}, rotated by {angle:.3g} deg from the base's own pose",
                mounts[0].GetPrim(),
                fix="set physics:localPos0 and physics:localRot0 to the base's position and rotation in the world, and "
                "physics:localPos1 and physics:localRot1 to zero and identity; or move the base",
                allowed=f"the base's own pose, at {_position(frame)}",
            )
        self.base_frame = frame
        self.base = self.link([(base, frame)])  # shapes of the fixed base are in the world's frame
        self.base_prim = base
        self.welded: list[tuple[Usd.Prim, Gf.Matrix4d]] = []
        self.reached: set[Sdf.Path] = set()

    def ends(self, joint: UsdPhysics.Joint) -> tuple[Usd.Prim | None, Usd.Prim]:
        """Returns the parent and the child body of a joint; the parent is ``None`` for the world.

        Raises:
            SceneError: The joint has no child, or connects something that is not a rigid body of the robot.
        """
        found: list[Usd.Prim | None] = []
        for relation in (joint.GetBody0Rel(), joint.GetBody1Rel()):
            targets = relation.GetTargets()
            if targets and targets[0] not in self.bodies:
                what = f"the joint connects <{targets[0]}>, which is not a rigid body of the robot"
                raise self.scene.error(
                    what,
                    joint.GetPrim(),
                    allowed=", ".join(f"<{path}>" for path in self.bodies),
                    fix="set physics:body0 and physics:body1 to links of the robot",
                )
            found.append(self.bodies[targets[0]] if targets else None)
        parent, child = found
        if child is None:
            raise self.scene.error(
                "the joint moves nothing",
                joint.GetPrim(),
                allowed="a link as physics:body1",
                fix="set physics:body1, or remove the joint",
            )
        return parent, child

    def frames(self, joint: UsdPhysics.Joint) -> tuple[Gf.Matrix4d, Gf.Matrix4d]:
        """Returns a joint's frame in its parent body and in its child body.

        Raises:
            SceneError: A frame has numbers that are too large or not finite.
        """
        before = matrix(joint.GetLocalPos0Attr().Get(), joint.GetLocalRot0Attr().Get())
        after = matrix(joint.GetLocalPos1Attr().Get(), joint.GetLocalRot1Attr().Get())
        if not (np.abs([np.array(before), np.array(after)]) < MAX_LENGTH).all():
            allowed = f"finite numbers, and lengths below {MAX_LENGTH:g} m"
            what = "the joint's frames are too far away or not finite"
            raise self.scene.error(
                what, joint.GetPrim(), allowed=allowed, fix="correct physics:localPos0 and physics:localPos1"
            )
        return before, after

    def walk(self) -> tuple[tuple[Joint, ...], tuple[Link, ...]]:
        """Returns the moving joints and the link that each moves, from base to flange.

        Raises:
            SceneError: The arm branches, has a loop or no moving joint, or a body is welded to its base.
        """
        joints, links = [], []
        body: Usd.Prim | None = self.base_prim
        while body is not None:
            group, moving = self.weld(body)
            if joints:
                links.append(self.link(group))
            elif len(group) > 1:
                raise self.scene.error(
                    "a body is welded to the robot's base",
                    group[1][0],
                    allowed="a base without welded bodies",
                    fix="make its shapes part of the base",
                )
            if len(moving) > 1:
                names = " and ".join(f"<{joint.GetPath()}>" for joint in moving)
                raise self.scene.error(
                    f"the arm branches: {names}",
                    body,
                    allowed="a serial arm",
                    fix="remove the joints of all branches but one",
                )
            self.welded = group
            body = None
            if moving:
                if self.ends(moving[0])[0] != group[0][0]:
                    prim = moving[0].GetPrim()
                    raise self.scene.error(
                        "the moving joint is attached to a welded body",
                        prim,
                        allowed="moving joints on links only",
                        fix="attach the joint to the link that the body is welded to",
                    )
                unread = Joint(str(moving[0].GetPath()), _UNREAD, -math.inf, math.inf, math.inf, math.inf)
                joints.append(self.scene.attempt(unread, self.joint, moving[0]))
                body = self.ends(moving[0])[1]
        if not joints:
            raise self.scene.error(
                "the robot has no moving joints",
                self.base_prim,
                allowed="at least one joint that moves a link",
                fix="set physics:body0 and physics:body1 of its joints, from the base outwards",
            )
        return tuple(joints), tuple(links)

    def weld(self, body: Usd.Prim) -> tuple[list[tuple[Usd.Prim, Gf.Matrix4d]], list[UsdPhysics.Joint]]:
        """Finds everything that moves as one with a body.

        Returns:
            The body and all bodies welded to it, each with its frame in the first body's, and the moving joints whose
            parent is one of them.
        """
        group, moving = [(body, Gf.Matrix4d(1.0))], []
        self.visit(body)
        for part, placed in group:  # the list grows during iteration
            for joint in self.joints:
                parent, child = self.ends(joint)
                if parent != part:
                    continue
                if joint.GetPrim().IsA(UsdPhysics.FixedJoint):
                    self.visit(child)
                    before, after = self.frames(joint)
                    group.append((child, after.GetInverse() * before * placed))
                else:
                    moving.append(joint)
        return group, moving

    def visit(self, body: Usd.Prim) -> None:
        """Marks a body of the chain as visited.

        Raises:
            SceneError: It was visited before, since two joints move it.
        """
        if body.GetPath() in self.reached:
            raise self.scene.error(
                "the link has two parent joints", body, allowed="a serial arm", fix="remove one of these joints"
            )
        self.reached.add(body.GetPath())

    def link(self, group: list[tuple[Usd.Prim, Gf.Matrix4d]]) -> Link:
        """Merges bodies welded together, as :meth:`weld` returns them, into one link in the frame of the first."""
        colliders: list[Collider] = []
        bodies: list[Welded] = []
        for body, placed in group:
            # Shapes are read in the body's own frame, expressed in the link's.
            colliders += read_colliders(self.scene, body, placed.GetInverse() * self.scene.body_frame(body))
            mass = self.scene.attempt(0.0, read_mass, self.scene, body)
            center, inertia = given_center(body), unit_inertia(body, mass)
            bodies.append(Welded(str(body.GetPath()), transform(placed), mass, center, inertia))
        first, *welded = bodies
        center, inertia = _in_frame(group[0][1], first)
        mass = sum(body.mass for body in bodies)
        return Link(first.path, mass, tuple(colliders), center, inertia, tuple(welded))

    def joint(self, joint: UsdPhysics.Joint) -> Joint:
        """Reads a moving joint.

        Raises:
            SceneError: Its type, axis, frame, limits or losses are not allowed.
        """
        scene, prim = self.scene, joint.GetPrim()
        turns, slides = UsdPhysics.RevoluteJoint(prim), UsdPhysics.PrismaticJoint(prim)
        if not (turns or slides):
            allowed = "PhysicsRevoluteJoint or PhysicsPrismaticJoint"
            raise scene.error(
                f"the joint is of type {prim.GetTypeName()}",
                prim,
                allowed=allowed,
                fix="change its type; a PhysicsFixedJoint welds a body to the link before it",
            )
        axis = (turns or slides).GetAxisAttr().Get()
        if axis != UsdPhysics.Tokens.z:
            raise scene.error(
                f"the joint {'turns about' if turns else 'slides along'} its {axis} axis",
                prim,
                allowed="physics:axis = Z",
                fix="rotate the frames of the joint and of its links so that z is its axis",
            )
        before, after = self.frames(joint)
        if self.ends(joint)[0] == self.base_prim:
            before = before * self.base_frame
        if not np.allclose(np.array(after), np.eye(4), atol=1e-6):
            raise scene.error(
                "the joint's frame differs from that of the link that it moves",
                prim,
                allowed="physics:localPos1 = (0, 0, 0) and physics:localRot1 = (1, 0, 0, 0)",
                fix="move the link's frame to the joint, and keep its shapes and mass in place in the world",
            )
        kind, drive, inward = ("revolute", "angular", math.radians) if turns else ("prismatic", "linear", float)
        unit = "deg" if turns else "m"  # as in the file
        lower = scene.number(prim, "physics:lowerLimit", -math.inf)
        upper = scene.number(prim, "physics:upperLimit", math.inf)
        if not lower < upper:
            raise scene.error(
                f"the lower limit ({lower:.4g} {unit}) is not below the upper limit ({upper:.4g} {unit})",
                prim,
                allowed="a lower limit below the upper one",
                fix=f"set physics:lowerLimit and physics:upperLimit, in {'degrees' if turns else 'metres'}",
            )
        if slides and not max(abs(lower), abs(upper)) < MAX_LENGTH:
            fix = "set physics:lowerLimit and physics:upperLimit, in metres"
            raise scene.error("the sliding joint has unlimited travel", prim, allowed="finite limits", fix=fix)
        driven = prim.HasAPI(UsdPhysics.DriveAPI, drive)
        effort = scene.number(prim, f"drive:{drive}:physics:maxForce", math.inf) if driven else math.inf
        speed = scene.number(prim, "newton:velocityLimit", math.inf)
        force = "N m" if turns else "N"
        limits = ((f"drive:{drive}:physics:maxForce", effort, force), ("newton:velocityLimit", speed, f"{unit}/s"))
        for name, value, of in limits:
            if value <= 0.0:
                fix = "set it to the joint's real limit, or remove it if the joint has none"
                raise scene.error(f"{name} is {value:g} {of}", prim, allowed=f"more than zero [{of}]", fix=fix)
        friction, damping = (scene.number(prim, f"newton:{name}", 0.0) for name in ("friction", "damping"))
        losses = (("newton:friction", friction, force), ("newton:damping", damping, f"{force} s/{unit}"))
        for name, value, of in losses:
            if not 0.0 <= value < math.inf:
                allowed = f"a finite number, zero or more [{of}]"
                raise scene.error(f"{name} is {value:g} {of}", prim, allowed=allowed, fix="correct it, or remove it")
        return Joint(
            str(prim.GetPath()),
            transform(before),
            inward(lower),
            inward(upper),
            inward(speed),
            effort,
            kind,
            friction,
            math.degrees(damping) if turns else damping,  # per degree, as everywhere in USD
        )

    def in_last_link(self, prim: Usd.Prim) -> np.ndarray:
        """Returns a prim's position [m] and quaternion xyzw in the frame of the last link, shape [7].

        Raises:
            SceneError: The prim is not below the last link or a body welded to it, or it is scaled.
        """
        for body, placed in self.welded:
            if prim.GetPath().HasPrefix(body.GetPath()):
                local = self.scene.frame(prim) * self.scene.body_frame(body).GetInverse()
                if not np.allclose(scales(local), 1.0, atol=1e-5):
                    break
                return transform(local * placed)
        raise self.scene.error(
            "the tool is not on the robot's last link, or it is scaled",
            prim,
            allowed=f"on {self.welded[0][0].GetPath()}, unscaled",
            fix="place the tip's Xform below that link, or below a body welded to it",
        )


def _in_frame(frame: Gf.Matrix4d, body: Welded) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Transforms a body's centre of mass and unit inertia to the frame in which its own frame is given."""
    center, inertia = body.center_of_mass, body.unit_inertia
    if frame == Gf.Matrix4d(1.0):
        return center, inertia
    turn = np.array(frame.ExtractRotationMatrix()).T
    return (
        None if center is None else turn @ center + np.array(frame.ExtractTranslation()),
        None if inertia is None else turn @ inertia @ turn.T,
    )
