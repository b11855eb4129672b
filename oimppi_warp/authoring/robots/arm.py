"""A robot described as data: a chain of links and joints with a stick at its end.

Units are metres, radians and kilograms; joints turn about or slide along their local +z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from oimppi_warp.authoring.prims import COLLIDER, Color, Look, Vector, z_to
from oimppi_warp.geometry.footprint import transform_points
from oimppi_warp.scene import Collider, Joint, JointKind, Link, Robot

NOT_TURNED = (0.0, 0.0, 0.0, 1.0)
"""The identity quaternion."""


@dataclass(frozen=True, eq=False)
class Visual:
    """Geometry used for display only.

    Attributes:
        shape: Shape in the link's frame; its path is the name of its prim.
        color: Linear red, green and blue, each from 0 to 1.
        faces: Vertex indices of each face if the shape is a mesh; otherwise empty.
    """

    shape: Collider
    color: Color
    faces: Sequence[Sequence[int]] = ()


@dataclass(frozen=True, eq=False)
class ArmLink:
    """A rigid link.

    Attributes:
        mass: Mass [kg].
        center: Centre of mass in the link's frame [m].
        inertia: Inertia about the centre of mass, in the link's axes, shape [3, 3] [kg m^2].
        colliders: Shapes in the link's frame; a collider's path is the name of its prim.
        visuals: Display geometry; if empty, the colliders or a separate skin file are displayed.
    """

    mass: float
    center: Vector
    inertia: np.ndarray
    colliders: tuple[Collider, ...] = ()
    visuals: tuple[Visual, ...] = ()


@dataclass(frozen=True)
class ArmJoint:
    """A joint: its frame in the parent link's frame, and its limits.

    Attributes:
        position: Origin of the joint frame [m].
        turn: Orientation, as a quaternion xyzw.
        lower, upper: Position limits [rad; m for a prismatic joint].
        effort: Effort limit [N m; N for a prismatic joint].
        velocity: Velocity limit [rad/s; m/s for a prismatic joint].
        kind: ``"revolute"`` or ``"prismatic"``.
    """

    position: Vector
    turn: Vector
    lower: float
    upper: float
    effort: float
    velocity: float
    kind: JointKind = "revolute"


@dataclass(frozen=True)
class Stick:
    """The tool: a round stick that points along z of its mounting frame.

    Attributes:
        length, radius: Length and radius [m].
        mass: Mass [kg].
        position: Position of the stick's base in the last link's frame [m].
        turn: Orientation of the stick in that frame, as a quaternion xyzw.
        friction: Coulomb friction coefficient; that of a pair of shapes is the larger of their coefficients.
    """

    length: float
    radius: float = 0.008
    mass: float = 0.05
    position: Vector = (0.0, 0.0, 0.0)
    turn: Vector = NOT_TURNED
    friction: float = 0.3

    @property
    def mount(self) -> np.ndarray:
        """Returns the stick's base in the last link's frame: position [m] and quaternion xyzw, shape [7]."""
        return np.array([*self.position, *self.turn])


@dataclass(frozen=True)
class Arm:
    """A serial robot with a stick.

    Attributes:
        name: Name of its root prim.
        doc: Description.
        base: The link fixed at the world's origin.
        joints: From base to flange.
        links: The link moved by each joint.
        stick: The tool.
        start: Joint positions at the start of an episode.
        look: Display style of the colliders; hidden by default, as a skin is drawn instead.
    """

    name: str
    doc: str
    base: ArmLink
    joints: tuple[ArmJoint, ...]
    links: tuple[ArmLink, ...]
    stick: Stick
    start: tuple[float, ...]
    look: Look = COLLIDER

    def robot(self) -> Robot:
        """Converts the arm to the planner's :class:`oimppi_warp.scene.Robot`."""
        root = f"/{self.name}"
        tip = transform_points(self.stick.mount, np.array([0.0, 0.0, self.stick.length]))[0]
        return Robot(
            path=root,
            base=Link(f"{root}/base", self.base.mass, self.base.colliders),
            joints=tuple(
                Joint(
                    f"{root}/joints/joint{number}",
                    np.array([*joint.position, *joint.turn]),
                    joint.lower,
                    joint.upper,
                    joint.velocity,
                    joint.effort,
                    joint.kind,
                )
                for number, joint in enumerate(self.joints, start=1)
            ),
            links=tuple(
                Link(f"{root}/link{number}", link.mass, link.colliders)
                for number, link in enumerate(self.links, start=1)
            ),
            tip=np.array([*tip, *self.stick.turn]),
            tool_path=f"{root}/tool/tip",
            tool_radius=self.stick.radius,
            start=np.array(self.start, dtype=float),
        )


def capsule_between(name: str, a: Vector, b: Vector, radius: float) -> Collider:
    """Creates a capsule from the two ends of its axis [m]."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    return Collider(name, "capsule", np.array([*(a + b) / 2, *z_to(b - a)]), (radius, float(np.linalg.norm(b - a)) / 2))
