"""A URDF's chain as an arm: read by Newton, what is fixed together made one link, frames turned to the joints' axes."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pxr import Tf

from oimppi_warp.authoring.arm import Arm, ArmJoint, ArmLink, Stick
from oimppi_warp.authoring.fitting import fitted
from oimppi_warp.authoring.prims import Look, matrix_quat, z_to
from oimppi_warp.authoring.urdf import Chain
from oimppi_warp.errors import SceneError
from oimppi_warp.footprint import rotation_matrix
from oimppi_warp.newton_model import collector_paused
from oimppi_warp.scene import Collider

ToolAxis = Literal["x", "y", "z", "-x", "-y", "-z"]
GREY = (0.7, 0.71, 0.73)
BASE_MASS = 1.0
"""Mass of a base that has none: it stands fast, and no matter [kg]."""


def arm_of(chain: Chain, *, name: str, length: float, radius: float, axis: ToolAxis) -> Arm:
    """The arm, its start still all zeros (:func:`oimppi_warp.authoring.start.with_start` finds one).

    Args:
        chain: The chain in the URDF.
        name: Name of its root prim.
        length, radius: Of the stick [m].
        axis: Axis of the flange that the stick points along.

    Raises:
        SceneError: A mesh is missing or flat, or a link has no mass.
    """
    read = _Read(chain)
    turned = [np.eye(4), *(read.to_z(joint) for joint in chain.joints)]
    placed = [read.placed(group) for group in chain.groups]
    links = [read.link(where, np.linalg.inv(turn)) for where, turn in zip(placed, turned, strict=True)]
    for link, group in zip(links[1:], chain.groups[1:], strict=True):
        if link.mass <= 0.0:
            fix = "give it <inertial> with <mass> and <inertia>"
            raise SceneError(f"link {group[0][0]} has no mass", file=chain.file, allowed="more than zero", fix=fix)
    joints = []
    for number, joint in enumerate(chain.joints):
        parent, frame = read.joint(joint)
        frame = np.linalg.inv(turned[number]) @ placed[number][parent] @ frame @ turned[number + 1]
        limit = chain.limits[number]
        joints.append(
            ArmJoint(
                frame[:3, 3],
                matrix_quat(frame[:3, :3]),
                limit["lower"],
                limit["upper"],
                limit["effort"],
                limit["velocity"],
                "prismatic" if read.slides(joint) else "revolute",
            )
        )
    mount = np.linalg.inv(turned[-1]) @ placed[-1][chain.flange] @ _along(axis)
    return Arm(
        name=name,
        doc=f"{Tf.MakeValidIdentifier(chain.name)} with a stick of {length:g} m, from {chain.file.name}",
        base=links[0] if links[0].mass > 0.0 else ArmLink(BASE_MASS, np.zeros(3), 0.01 * np.eye(3), links[0].colliders),
        joints=tuple(joints),
        links=tuple(links[1:]),
        stick=Stick(length, radius, position=mount[:3, 3], turn=matrix_quat(mount[:3, :3])),
        start=(0.0,) * len(joints),
        look=Look(GREY, collide=True),
    )


class _Read:
    """A URDF in Newton's builder, looked up by the names of links and joints."""

    def __init__(self, chain: Chain) -> None:
        with collector_paused():
            import newton
        self._file = chain.file
        self._builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
        self._geo, self._collides = newton.GeoType, int(newton.ShapeFlags.COLLIDE_SHAPES)
        try:
            self._builder.add_urdf(chain.text)
        except Exception as error:  # whatever the reader of a mesh raises
            fix = "meshes may be STL, OBJ or PLY"
            raise SceneError(f"it cannot be read ({error})", file=chain.file, allowed="a URDF", fix=fix) from error
        self._bodies = {label.rpartition("/")[2]: index for index, label in enumerate(self._builder.body_label)}
        self._joints = {label.rpartition("/")[2]: index for index, label in enumerate(self._builder.joint_label)}

    def joint(self, name: str) -> tuple[str, np.ndarray]:
        """The link that a joint stands on, and its frame there, 4 x 4."""
        index = self._joints[name]
        parent = self._builder.body_label[self._builder.joint_parent[index]]
        return parent.rpartition("/")[2], _matrix(self._builder.joint_X_p[index])

    def slides(self, name: str) -> bool:
        """Whether a joint slides."""
        import newton

        return self._builder.joint_type[self._joints[name]] == newton.JointType.PRISMATIC

    def to_z(self, name: str) -> np.ndarray:
        """The turn from a joint's frame to one whose z is its axis, 4 x 4."""
        axis = self._builder.joint_axis[self._builder.joint_qd_start[self._joints[name]]]
        turn = np.eye(4)
        turn[:3, :3] = rotation_matrix(z_to(np.array(axis, dtype=float)))
        return turn

    def placed(self, group: tuple[tuple[str, str], ...]) -> dict[str, np.ndarray]:
        """Frames of a link and of all that is fixed to it, in the frame of that link, 4 x 4 each."""
        frames = {group[0][0]: np.eye(4)}
        for link, joint in group[1:]:
            parent, frame = self.joint(joint)
            frames[link] = frames[parent] @ frame
        return frames

    def link(self, placed: dict[str, np.ndarray], turn: np.ndarray) -> ArmLink:
        """Parts that are fixed to each other as one link, their frames seen from one that is turned."""
        mass, first, second, shapes = 0.0, np.zeros(3), np.zeros((3, 3)), []
        for name, frame in placed.items():
            frame, body = turn @ frame, self._bodies[name]
            m = float(self._builder.body_mass[body])
            center = frame[:3, :3] @ np.array(self._builder.body_com[body], dtype=float) + frame[:3, 3]
            inertia = np.array(self._builder.body_inertia[body], dtype=float).reshape(3, 3)
            mass, first = mass + m, first + m * center
            second += frame[:3, :3] @ inertia @ frame[:3, :3].T + m * _shifted(center)
            for shape in self._builder.body_shapes[body]:
                if self._builder.shape_flags[shape] & self._collides:
                    shapes.append(self._collider(shape, frame, f"collider{len(shapes)}", name))
        center = first / max(mass, 1e-12)
        inertia = second - mass * _shifted(center)
        if mass > 0.0 and np.linalg.eigvalsh(inertia)[0] <= 0.0:
            name = next(iter(placed))
            fix = "correct its <inertia>"
            raise SceneError(
                f"link {name} has an inertia that no body has", file=self._file, allowed="above zero", fix=fix
            )
        return ArmLink(mass, center, inertia, tuple(shapes))

    def _collider(self, shape: int, frame: np.ndarray, name: str, link: str) -> Collider:
        """A collision shape on a frame."""
        builder, geo = self._builder, self._geo
        frame = frame @ _matrix(builder.shape_transform[shape])
        size = [float(value) for value in builder.shape_scale[shape]]
        kind = builder.shape_type[shape]
        at = np.array([*frame[:3, 3], *matrix_quat(frame[:3, :3])])
        if kind == geo.BOX:
            return Collider(name, "box", at, tuple(size))
        if kind == geo.SPHERE:
            return Collider(name, "sphere", at, (size[0],))
        if kind in (geo.CYLINDER, geo.CAPSULE):
            return Collider(name, "cylinder" if kind == geo.CYLINDER else "capsule", at, (size[0], size[1]))
        points = np.asarray(builder.shape_source[shape].vertices, dtype=float) * size
        try:
            return fitted(name, points @ frame[:3, :3].T + frame[:3, 3])
        except ValueError as error:
            raise SceneError(f"link {link}: {error}", file=self._file, allowed="solid collision meshes") from None


def _matrix(transform: object) -> np.ndarray:
    """A transform of Newton's (position, quaternion xyzw) as a 4 x 4 matrix."""
    values = np.array(transform, dtype=float).ravel()
    frame = np.eye(4)
    frame[:3, :3] = rotation_matrix(values[3:] / np.linalg.norm(values[3:]))
    frame[:3, 3] = values[:3]
    return frame


def _shifted(center: np.ndarray) -> np.ndarray:
    """Inertia of a unit of mass at a point, about the origin [m^2]."""
    return center @ center * np.eye(3) - np.outer(center, center)


def _along(axis: ToolAxis) -> np.ndarray:
    """The turn from z to an axis of the flange, 4 x 4."""
    direction = (-1.0 if axis[0] == "-" else 1.0) * np.eye(3)["xyz".index(axis[-1])]
    turn = np.eye(4)
    turn[:3, :3] = rotation_matrix(z_to(direction))
    return turn
