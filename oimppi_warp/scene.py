"""Tasks as data: robot, obstacles, pushed object, start and goal.

A :class:`Scene` is read from USD by :func:`oimppi_warp.usd.load_scene`. Planner, plant, viewer and caches use no other
description of a task. A scene and its arrays are immutable. ``dataclasses.replace`` and the ``with_`` methods return a
changed copy, and everything that is built from this copy reflects the change:

    heavy = replace(scene, object=replace(scene.object, mass=5.0), obstacles=())

Units are SI units and radians. Spatial transforms are arrays ``[7]`` (position, quaternion xyzw). Planar poses are
``(x, y, yaw)`` of a body's frame in the world frame (z up, origin at the centre of the arm's base, table top at z = 0).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Literal

import numpy as np

from oimppi_warp.errors import SceneError

PlanarPose = tuple[float, float, float]
"""Planar pose (x [m], y [m], yaw [rad])."""

JointKind = Literal["revolute", "prismatic"]

_LETTERS: dict[JointKind, str] = {"revolute": "R", "prismatic": "P"}


class _ReadOnly:
    """Base of dataclasses whose arrays are stored as read-only copies, since caches rely on unchanged arrays."""

    def __post_init__(self) -> None:
        for field in fields(self):  # pyright: ignore[reportArgumentType]
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                value = value.copy()
                value.setflags(write=False)
                object.__setattr__(self, field.name, value)


@dataclass(frozen=True, eq=False)
class Collider(_ReadOnly):
    """One convex collision shape.

    Attributes:
        path: Prim path.
        kind: Type of shape; a mesh collides as the convex hull of its vertices.
        transform: Position [m] and quaternion xyzw of the shape in the frame of its body (in the world frame for
            obstacles), shape [7].
        size: Dimensions [m]. Box: half extents along x, y and z. Sphere: (radius,). Cylinder and capsule: (radius, half
            length of the straight part), with the axis along the shape's z. Mesh: empty.
        vertices: Vertices of a mesh in the shape's frame, shape [n, 3] [m]; ``None`` for the other kinds.
        faces: Triangles of a mesh as indices into ``vertices``, shape [m, 3]; they enclose the material, which may be
            hollow. ``None`` for a solid hull, as for an open surface, and for the other kinds.
    """

    path: str
    kind: Literal["box", "sphere", "cylinder", "capsule", "mesh"]
    transform: np.ndarray
    size: tuple[float, ...] = ()
    vertices: np.ndarray | None = None
    faces: np.ndarray | None = None

    def scaled(self, factor: float) -> Collider:
        """Returns the shape with its dimensions and its distance from the body's origin multiplied by a factor."""
        return replace(
            self,
            transform=np.concatenate([factor * self.transform[:3], self.transform[3:]]),
            size=tuple(factor * length for length in self.size),
            vertices=None if self.vertices is None else factor * self.vertices,
        )


@dataclass(frozen=True, eq=False)
class Welded(_ReadOnly):
    """A body that is welded to a link, such as the tool. The link's colliders and mass include those of the body.

    Attributes:
        path: Prim path; those colliders of the link whose paths are below this path belong to the body.
        transform: The body's frame in the link's frame: position [m] and quaternion xyzw, shape [7].
        mass: Mass [kg].
        center_of_mass: Centre of mass in the body's frame, shape [3] [m]; ``None`` for that of the body's colliders.
        unit_inertia: Rotational inertia about the centre of mass, divided by the mass, in the axes of the body's frame,
            shape [3, 3] [m^2]; ``None`` for that of the body's colliders at uniform density.
    """

    path: str
    transform: np.ndarray
    mass: float
    center_of_mass: np.ndarray | None = None
    unit_inertia: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Link(_ReadOnly):
    """A rigid link of the robot.

    Attributes:
        path: Prim path.
        mass: Mass, including that of welded bodies [kg].
        colliders: Shapes in the link's frame, including those of welded bodies.
        center_of_mass: Centre of mass of the link without welded bodies, in the link's frame, shape [3] [m]; ``None``
            for that of the link's colliders.
        unit_inertia: Rotational inertia of the link without welded bodies about its centre of mass, divided by its
            mass, in the axes of the link's frame, shape [3, 3] [m^2]; ``None`` for that of the link's colliders at
            uniform density.
        welded: Bodies that are welded to the link.
    """

    path: str
    mass: float
    colliders: tuple[Collider, ...]
    center_of_mass: np.ndarray | None = None
    unit_inertia: np.ndarray | None = None
    welded: tuple[Welded, ...] = ()


@dataclass(frozen=True, eq=False)
class Joint(_ReadOnly):
    """A joint that rotates about, or slides along, the z axis of its own frame.

    Wherever this package gives rad, rad/s or N m for a joint, the units for a prismatic joint are m, m/s and N.

    Attributes:
        path: Prim path.
        parent_transform: The joint's frame in the frame of the previous link (the base for the first joint): position
            [m] and quaternion xyzw, shape [7]. At joint position zero, it is also the frame of the link that the joint
            moves.
        lower, upper: Position limits [rad]; those of a prismatic joint are finite.
        velocity_limit: Velocity limit [rad/s].
        effort_limit: Torque limit [N m].
        kind: ``"revolute"`` or ``"prismatic"``.
        friction: Torque of dry friction in the joint [N m].
        damping: Torque of viscous friction in the joint, divided by the velocity [N m s/rad].
    """

    path: str
    parent_transform: np.ndarray
    lower: float
    upper: float
    velocity_limit: float
    effort_limit: float
    kind: JointKind = "revolute"
    friction: float = 0.0
    damping: float = 0.0

    @property
    def name(self) -> str:
        """Returns the last part of :attr:`path`."""
        return self.path.rpartition("/")[2]


@dataclass(frozen=True, eq=False)
class Robot(_ReadOnly):
    """A serial arm of revolute or prismatic joints, with a stick as its tool and its base fixed at the world's origin.

    Attributes:
        path: Prim path.
        base: The fixed base link; its shapes are in the world frame.
        joints: The moving joints from base to flange, length dof.
        links: The link that each joint moves, length dof; the last link includes the tool, which is welded to it.
        tip: Frame of the tool's tip in the last link's frame: position [m] and quaternion xyzw, shape [7]; its z axis
            points out of the tool.
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
        """Returns the number of moving joints."""
        return len(self.joints)

    @property
    def chain(self) -> str:
        """Returns one letter per joint, R if it turns and P if it slides: ``"RRRRRR"`` for the xArm6."""
        return "".join(_LETTERS[joint.kind] for joint in self.joints)


@dataclass(frozen=True, eq=False)
class PushedObject(_ReadOnly):
    """The object to be pushed, which slides on the table and is never grasped.

    Attributes:
        path: Prim path of the rigid body.
        mass: Mass [kg].
        friction: Coulomb friction coefficient between object and table.
        tool_friction: Coulomb friction coefficient between object and tool.
        center_of_mass: Centre of mass in the body's frame, shape [3] [m].
        colliders: Shapes in the body's frame.
        rest_height: z of the body's frame when the object rests on the table [m].
        unit_inertia: Rotational inertia about the centre of mass, divided by the mass, in the axes of the body's frame,
            shape [3, 3] [m^2]; ``None`` for that of the colliders at uniform density. Inertia and rest height depend on
            the colliders: with new colliders, also set ``unit_inertia=None`` and the new ``rest_height``.
        limit_surface_radius: Largest torque of friction between object and table about the centre of mass, divided by
            the largest force [m]; ``None``: computed from the colliders
            (:func:`oimppi_warp.geometry.footprint.limit_surface`).
    """

    path: str
    mass: float
    friction: float
    tool_friction: float
    center_of_mass: np.ndarray
    colliders: tuple[Collider, ...]
    rest_height: float
    unit_inertia: np.ndarray | None = None
    limit_surface_radius: float | None = None

    def scaled(self, factor: float) -> PushedObject:
        """Returns the object with all lengths multiplied by a factor, and with the same mass."""
        return replace(
            self,
            center_of_mass=factor * self.center_of_mass,
            colliders=tuple(collider.scaled(factor) for collider in self.colliders),
            rest_height=factor * self.rest_height,
            unit_inertia=None if self.unit_inertia is None else factor**2 * self.unit_inertia,
            limit_surface_radius=None if self.limit_surface_radius is None else factor * self.limit_surface_radius,
        )


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A static body with which neither robot nor object may collide.

    Attributes:
        path: Prim path.
        colliders: Shapes in the world frame.
    """

    path: str
    colliders: tuple[Collider, ...]

    @property
    def center(self) -> np.ndarray:
        """Returns the mean of the origins of the colliders, in the world frame, shape [3] [m]."""
        return np.mean([collider.transform[:3] for collider in self.colliders], axis=0)

    def moved(self, by: PlanarPose) -> Obstacle:
        """Returns the obstacle moved along the table.

        Args:
            by: Displacement along x and y [m], and rotation about the vertical through :attr:`center` [rad].
        """
        x, y, turn = by
        center = self.center
        return replace(self, colliders=tuple(_carried(shape, center, (x, y), turn) for shape in self.colliders))


@dataclass(frozen=True)
class Table:
    """The table: a box whose top is at z = 0 and whose sides are aligned with the world's axes.

    Attributes:
        path: Prim path.
        lower, upper: Corners of the top with the smallest and the largest x and y [m].
        thickness: Height of the box [m].
        others: Other colliders of the table, such as its legs, in the world frame; the planner ignores them.
    """

    path: str
    lower: tuple[float, float]
    upper: tuple[float, float]
    thickness: float = 0.04
    others: tuple[Collider, ...] = ()


@dataclass(frozen=True)
class Tolerance:
    """Largest errors with which the object still counts as being at its goal.

    Attributes:
        position: Largest distance between object and goal [m].
        yaw: Largest absolute yaw error [rad]; infinite if every yaw is allowed.
    """

    position: float
    yaw: float

    def strictest(self, other: Tolerance) -> Tolerance:
        """Returns the tolerance that is met where both are met."""
        return Tolerance(min(self.position, other.position), min(self.yaw, other.yaw))


EXACT = Tolerance(0.005, 0.02)
"""The exact tolerance, the same for all scenes; where a scene allows every yaw, so does it."""


@dataclass(frozen=True, eq=False)
class Scene(_ReadOnly):
    """One task.

    Attributes:
        file: The USD file from which the scene was read; after that, the file is used for its appearance only.
        name: Short name: the file's name without extension.
        title: One-line description.
        robot: The robot.
        object: The object to be pushed.
        table: The table.
        obstacles: The obstacles.
        start: Planar start pose of the object (x [m], y [m], yaw [rad]).
        starts: Listed start poses of the object (x [m], y [m], yaw [rad]), shape [n, 3].
        spread: Half widths of the box around ``start`` from which seeds draw starts: (position [m], yaw [rad]).
        goal: Planar goal pose of the object (x [m], y [m], yaw [rad]).
        tolerance: Tolerance for success.
        tight_tolerance: Stricter tolerance, for which success is reported as well.
        gravity: Acceleration due to gravity in the world frame, used by the plant [m/s^2]; planners assume 9.81 m/s^2
            downwards.
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
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)

    def with_start(self, start: PlanarPose) -> Scene:
        """Returns the task with another start pose; see ``feasibility.check_task`` to check the result."""
        return replace(self, start=start)

    def with_goal(self, goal: PlanarPose) -> Scene:
        """Returns the task with another goal pose; see ``feasibility.check_task`` to check the result."""
        return replace(self, goal=goal)

    def with_tolerance(self, position: float, yaw: float) -> Scene:
        """Returns the task with another tolerance [m, rad]; where every yaw is allowed, it still is."""
        return replace(self, tolerance=Tolerance(position, self._allowed_yaw(yaw)))

    @property
    def exact_tolerance(self) -> Tolerance:
        """Returns :data:`EXACT`, with any yaw where the task allows every yaw."""
        return Tolerance(EXACT.position, self._allowed_yaw(EXACT.yaw))

    def _allowed_yaw(self, yaw: float) -> float:
        return yaw if math.isfinite(self.tolerance.yaw) else math.inf

    def with_obstacle(self, obstacle: Obstacle) -> Scene:
        """Returns the task with an obstacle added; an obstacle with the same path is replaced."""
        others = {each.path: each for each in self.obstacles} | {obstacle.path: obstacle}
        return replace(self, obstacles=tuple(others.values()))

    def without_obstacle(self, path: str) -> Scene:
        """Returns the task without one of its obstacles, given by the obstacle's prim path.

        Raises:
            SceneError: There is no obstacle with that path.
        """
        gone = self.obstacle(path)
        return replace(self, obstacles=tuple(each for each in self.obstacles if each is not gone))

    def with_obstacle_moved(self, path: str, by: PlanarPose) -> Scene:
        """Returns the task with an obstacle moved; see ``feasibility.check_task`` to check the result.

        Args:
            path: The obstacle's prim path.
            by: Displacement and rotation; see :meth:`Obstacle.moved`.

        Raises:
            SceneError: There is no obstacle with that path.
        """
        return self.with_obstacle(self.obstacle(path).moved(by))

    def obstacle(self, path: str) -> Obstacle:
        """Returns the obstacle with a prim path.

        Raises:
            SceneError: There is no obstacle with that path.
        """
        for each in self.obstacles:
            if each.path == path:
                return each
        raise SceneError(
            f"there is no obstacle <{path}>",
            file=self.file,
            allowed=", ".join(f"<{each.path}>" for each in self.obstacles) or "none, as the scene has no obstacles",
            fix="give the path of one of the scene's obstacles",
        )


def _carried(shape: Collider, center: np.ndarray, by: tuple[float, float], turn: float) -> Collider:
    """Returns a shape after a rotation about the vertical through a point, and a translation along the table.

    Args:
        shape: The shape, with its transform in the world frame.
        center: The point, shape [3] [m].
        by: Translation along x and y [m].
        turn: Rotation [rad].
    """
    c, s = math.cos(turn), math.sin(turn)
    x, y = shape.transform[:2] - center[:2]
    half_c, half_s = math.cos(turn / 2.0), math.sin(turn / 2.0)
    qx, qy, qz, qw = shape.transform[3:]
    position = (center[0] + c * x - s * y + by[0], center[1] + s * x + c * y + by[1], shape.transform[2])
    turned = (
        half_c * qx - half_s * qy,
        half_c * qy + half_s * qx,
        half_c * qz + half_s * qw,
        half_c * qw - half_s * qz,
    )
    return replace(shape, transform=np.array([*position, *turned]))
