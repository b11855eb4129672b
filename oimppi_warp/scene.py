"""A task as data: what stands where, what is pushed, and where it should go.

A :class:`Scene` is read from USD by :func:`oimppi_warp.usd.load_scene`, is frozen, and is all that the planner and the
plant know of a task. SI units and radians; spatial transforms are arrays ``[7]`` (position, quaternion xyzw), planar
poses are ``(x, y, yaw)`` in the world frame (z up, origin at the centre of the arm's base, table top at z = 0).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

PlanarPose = tuple[float, float, float]
"""Planar pose (x [m], y [m], yaw [rad])."""

JointKind = Literal["revolute", "prismatic"]

_LETTERS: dict[JointKind, str] = {"revolute": "R", "prismatic": "P"}


@dataclass(frozen=True, eq=False)
class Collider:
    """One convex collision shape.

    Attributes:
        path: Prim path.
        kind: Type of shape; a mesh is taken as the convex hull of its vertices.
        transform: Pose of the shape in its body's frame (world frame for obstacles), shape [7].
        size: Box: half extents (3) [m]. Sphere: (radius,). Cylinder and capsule: (radius, half height of the straight
            part), along the shape's local z. Mesh: empty.
        vertices: Mesh vertices in the shape's frame, shape [n, 3] [m]; ``None`` for the other kinds.
    """

    path: str
    kind: Literal["box", "sphere", "cylinder", "capsule", "mesh"]
    transform: np.ndarray
    size: tuple[float, ...] = ()
    vertices: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Link:
    """A rigid link of the robot.

    Attributes:
        path: Prim path.
        mass: [kg].
        colliders: Shapes in the link's frame.
    """

    path: str
    mass: float
    colliders: tuple[Collider, ...]


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint that turns about its own local z axis, or slides along it.

    Wherever this package says rad, rad/s or N m of a joint, it is m, m/s or N for one that slides.

    Attributes:
        path: Prim path.
        parent_transform: Joint frame in the frame of the previous link (the base for the first joint), shape [7]; the
            link that the joint moves has this frame at position zero.
        lower, upper: Position limits [rad]; finite where it slides.
        velocity_limit: [rad/s].
        effort_limit: [N m].
        kind: ``"revolute"`` turns, ``"prismatic"`` slides.
    """

    path: str
    parent_transform: np.ndarray
    lower: float
    upper: float
    velocity_limit: float
    effort_limit: float
    kind: JointKind = "revolute"


@dataclass(frozen=True, eq=False)
class Robot:
    """A serial arm with a stick as its tool, base fixed at the world's origin: any chain of turning or sliding joints.

    Attributes:
        path: Prim path.
        base: The fixed base link; its shapes are in the world's frame.
        joints: The moving joints from base to flange, length dof.
        links: The link that each joint moves, length dof; bodies welded to the last one (the tool) count to it.
        tip: The tool's tip in the last link's frame, shape [7]; its z axis points out of the tool.
        tool_path: Prim path of the tip's prim.
        tool_radius: Radius of the stick [m].
        start: Joint positions at the start of an episode, shape [dof] [rad].
    """

    path: str
    base: Link
    joints: tuple[Joint, ...]
    links: tuple[Link, ...]
    tip: np.ndarray
    tool_path: str
    tool_radius: float
    start: np.ndarray

    @property
    def dof(self) -> int:
        """Number of moving joints."""
        return len(self.joints)

    @property
    def chain(self) -> str:
        """A letter for each joint, R where it turns and P where it slides: ``"RRRRRR"`` for the xArm6."""
        return "".join(_LETTERS[joint.kind] for joint in self.joints)


@dataclass(frozen=True, eq=False)
class PushedObject:
    """The object to be pushed: it slides on the table and is never held.

    Attributes:
        path: Prim path of the rigid body.
        mass: [kg].
        friction: Coulomb coefficient between object and table.
        tool_friction: Coulomb coefficient between object and tool.
        center_of_mass: In the body's frame, shape [3] [m].
        colliders: Shapes in the body's frame.
        rest_height: z of the body's frame when the object lies on the table [m].
    """

    path: str
    mass: float
    friction: float
    tool_friction: float
    center_of_mass: np.ndarray
    colliders: tuple[Collider, ...]
    rest_height: float


@dataclass(frozen=True, eq=False)
class Obstacle:
    """Something static that neither robot nor object may run into; colliders in the world frame."""

    path: str
    colliders: tuple[Collider, ...]


@dataclass(frozen=True)
class Table:
    """The table top at z = 0, a rectangle aligned with the world's axes.

    Attributes:
        path: Prim path.
        lower, upper: Corners (x, y) [m].
    """

    path: str
    lower: tuple[float, float]
    upper: tuple[float, float]


@dataclass(frozen=True)
class Tolerance:
    """When the object counts as being at its goal.

    Attributes:
        position: Distance to the goal [m].
        yaw: Absolute yaw error [rad]; infinite where yaw does not matter.
    """

    position: float
    yaw: float


@dataclass(frozen=True, eq=False)
class Scene:
    """One task.

    Attributes:
        file: The USD file it was read from.
        name: Its short name (the file's stem).
        title: One line about it.
        start: Where the object starts; ``starts`` lists the task's ten default ones, shape [n, 3].
        spread: Half widths of the box around ``start`` that a seed draws starts from: (position [m], yaw [rad]).
        goal: Where the object should go.
        tolerance, tight_tolerance: Success as the paper defines it, and a stricter one that is reported beside it.
    """

    file: Path
    name: str
    title: str
    robot: Robot
    object: PushedObject
    table: Table
    obstacles: tuple[Obstacle, ...]
    start: PlanarPose
    starts: np.ndarray
    spread: tuple[float, float]
    goal: PlanarPose
    tolerance: Tolerance
    tight_tolerance: Tolerance

    def with_start(self, start: PlanarPose) -> Scene:
        """The same task from another start; nothing is checked (see :func:`oimppi_warp.feasibility.check_task`)."""
        return replace(self, start=start)

    def with_goal(self, goal: PlanarPose) -> Scene:
        """The same task to another goal; nothing is checked (see :func:`oimppi_warp.feasibility.check_task`)."""
        return replace(self, goal=goal)
