"""Converts a chain in Newton's builder to an arm, merging fixed links and aligning frames with the joint axes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from oimppi_warp.authoring.prims import Look, matrix_quat, z_to
from oimppi_warp.authoring.robots.arm import Arm, ArmJoint, ArmLink, Stick, Visual
from oimppi_warp.authoring.robots.chain import Chain
from oimppi_warp.authoring.robots.fitting import fit_collider
from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.footprint import rotation_matrix, transform_points
from oimppi_warp.scene import Collider
from oimppi_warp.usd.stage import MAX_LENGTH

if TYPE_CHECKING:
    import newton

ToolAxis = Literal["x", "y", "z", "-x", "-y", "-z"]
GREY = (0.7, 0.71, 0.73)
BASE_MASS = 1.0
"""Mass given to a base that has none; the base is fixed, so the value has no effect [kg]."""
_LONGEST = 5.0
"""Greatest length of an arm at a table [m]."""
_SHORTEST = 0.3
"""Size of an arm up to which its masses and shapes are judged like those of an arm of this size [m]."""
_FAR = 2.0
"""Largest distance of a link's shapes and of its centre of mass from its frame, relative to the arm's size."""
_HEAVY = 400.0
"""Largest mass of a link, divided by the cube of the arm's size [kg/m^3]."""
_ROUNDED = 1e-3
"""Relative error of principal moments that were rounded."""


class Articulation:
    """Links and joints in a Newton builder, looked up by their names.

    Args:
        builder: A builder filled by one of Newton's importers.
        bodies, joints: Indices of the links and of the joints in the builder, by name.
        file: Path of the source file, for error messages.
        base: Transform of the base in the world, shape [4, 4] [m]; ``None``: identity.
    """

    def __init__(
        self,
        builder: newton.ModelBuilder,
        *,
        bodies: Mapping[str, int],
        joints: Mapping[str, int],
        file: Path,
        base: np.ndarray | None = None,
    ) -> None:
        import newton

        self._builder, self._bodies, self._joints, self._file = builder, bodies, joints, file
        self._geo, self._collides = newton.GeoType, int(newton.ShapeFlags.COLLIDE_SHAPES)
        self._base = np.eye(4) if base is None else base
        self._names = {index: name for name, index in bodies.items()}

    def arm(self, chain: Chain, *, name: str, doc: str, length: float, radius: float, axis: ToolAxis) -> Arm:
        """Builds the arm for a chain, with a start of all zeros (see :func:`.start_pose.with_start`).

        Args:
            chain: Names of the links and joints of the arm.
            name: Name of the arm's root prim.
            doc: Description, written to the robot's file.
            length, radius: Dimensions of the stick [m].
            axis: Axis of the flange along which the stick points: x, y, z, -x, -y or -z.

        Raises:
            SceneError: A link has no mass or an impossible inertia, or a mesh is flat.
        """
        joints = [self._joints[joint] for joint in chain.joints]
        # The frame of each link relative to its body: at the joint, with z along the axis.
        own = [np.linalg.inv(self._base), *(matrix_of(self._builder.joint_X_c[j]) @ self._to_z(j) for j in joints)]
        placed = [self._placed(group) for group in chain.groups]
        made = []
        for number, joint in enumerate(joints):
            parent = placed[number][self._names[self._builder.joint_parent[joint]]]
            frame = np.linalg.inv(own[number]) @ parent @ matrix_of(self._builder.joint_X_p[joint]) @ self._to_z(joint)
            self._check_length(frame[:3, 3], f"joint {chain.joints[number]}")
            made.append(self._arm_joint(joint, frame, chain, number))
        mount = np.linalg.inv(own[-1]) @ placed[-1][chain.flange] @ _along(axis)
        whole = self._size(made, mount[:3, 3])
        links = []
        for where, frame in zip(placed, own, strict=True):
            # A base may stand on a large table.
            links.append(self._link(where, np.linalg.inv(frame), most=_FAR * whole * (1.0 if links else 10.0)))
            if len(links) > 1:
                self._check_mass(links[-1], list(where), whole)
        return Arm(
            name=name,
            doc=doc,
            base=_still(links[0]),
            joints=tuple(made),
            links=tuple(links[1:]),
            stick=Stick(length, radius, position=mount[:3, 3], turn=matrix_quat(mount[:3, :3])),
            start=(0.0,) * len(joints),
            look=Look(GREY, collide=True),
        )

    def _size(self, joints: list[ArmJoint], mount: np.ndarray) -> float:
        """Returns how far an arm extends with all its strokes [m].

        Raises:
            SceneError: It is too long for an arm at a table, even without its strokes.
        """
        whole = float(sum(np.linalg.norm(joint.position) for joint in joints[1:]) + np.linalg.norm(mount))
        if whole > _LONGEST:
            raise SceneError(
                f"the arm is {whole:.4g} m long",
                file=self._file,
                allowed=f"up to {_LONGEST:g} m from the first joint to the flange",
                fix="is the file in millimetres, or in other units than it states? convert its lengths to metres",
            )
        strokes = sum(max(abs(joint.lower), abs(joint.upper)) for joint in joints if joint.kind == "prismatic")
        return max(float(whole + np.linalg.norm(joints[0].position) + strokes), _SHORTEST)

    def _arm_joint(self, joint: int, frame: np.ndarray, chain: Chain, number: int) -> ArmJoint:
        import newton

        slides, limit = self._builder.joint_type[joint] == newton.JointType.PRISMATIC, chain.limits[number]
        return ArmJoint(
            frame[:3, 3],
            matrix_quat(frame[:3, :3]),
            limit.lower,
            limit.upper,
            limit.effort,
            limit.velocity,
            "prismatic" if slides else "revolute",
        )

    def _to_z(self, joint: int) -> np.ndarray:
        """Returns the rotation from a joint's frame to one whose z is the joint axis, 4 x 4."""
        axis = self._builder.joint_axis[self._builder.joint_qd_start[joint]]
        turn = np.eye(4)
        turn[:3, :3] = rotation_matrix(z_to(np.array(axis, dtype=float)))
        return turn

    def _placed(self, group: tuple[tuple[str, str], ...]) -> dict[str, np.ndarray]:
        """Returns the frames of a body and of everything fixed to it, in that body's frame, 4 x 4 each."""
        frames = {group[0][0]: np.eye(4)}
        for link, name in group[1:]:
            joint = self._joints[name]
            before, after = (matrix_of(each[joint]) for each in (self._builder.joint_X_p, self._builder.joint_X_c))
            frames[link] = frames[self._names[self._builder.joint_parent[joint]]] @ before @ np.linalg.inv(after)
        return frames

    def _link(self, placed: dict[str, np.ndarray], turn: np.ndarray, *, most: float) -> ArmLink:
        """Merges parts fixed to each other into one link, in a rotated frame.

        Args:
            placed: The frame of each part, shape [4, 4] [m].
            turn: The rotation.
            most: Largest distance of a part's collision shapes from its frame [m].
        """
        mass, first, second = 0.0, np.zeros(3), np.zeros((3, 3))
        shapes: list[Collider] = []
        visuals: list[Visual] = []
        for name, frame in placed.items():
            frame, body = turn @ frame, self._bodies[name]
            m = float(self._builder.body_mass[body])
            center = frame[:3, :3] @ np.array(self._builder.body_com[body], dtype=float) + frame[:3, 3]
            inertia = np.array(self._builder.body_inertia[body], dtype=float).reshape(3, 3)
            mass, first = mass + m, first + m * center
            second += frame[:3, :3] @ inertia @ frame[:3, :3].T + m * _shifted(center)
            for shape in self._builder.body_shapes[body]:
                if self._builder.shape_flags[shape] & self._collides:
                    self._check_units(shape, name, most)
                    shapes.append(self._collider(shape, frame, f"collider{len(shapes)}", name))
                else:
                    visuals += self._visual(shape, frame, f"part{len(visuals)}")
        center = first / max(mass, 1e-12)
        return ArmLink(mass, center, second - mass * _shifted(center), tuple(shapes), tuple(visuals))

    def _check_units(self, shape: int, link: str, most: float) -> None:
        """Raises SceneError if a collision shape is further from its link's frame than ``most`` [m]."""
        found = self._shape(shape, np.eye(4), "")
        if found is None:
            return
        if found.vertices is None:
            far = float(np.linalg.norm(found.transform[:3]) + max(found.size))
        else:
            far = float(np.linalg.norm(transform_points(found.transform, found.vertices), axis=1).max(initial=0.0))
        if far > most:
            raise SceneError(
                f"a collision shape of link {link} extends {far:.3g} m from the link's frame",
                file=self._file,
                allowed=f"up to {most:.3g} m, for an arm of this size",
                fix='is it in millimetres? then give its mesh scale="0.001 0.001 0.001"; else correct its size',
            )

    def _check_mass(self, link: ArmLink, parts: list[str], whole: float) -> None:
        """Checks the mass and the inertia of a link that moves.

        Args:
            link: The link.
            parts: Names of the link and of all that is fixed to it.
            whole: Size of the arm [m].

        Raises:
            SceneError: It has no mass, or a mass or an inertia that no body of such an arm has; the part with the
                mistake is named.
        """
        if link.mass <= 0.0:
            what, fix = f"link {parts[0]} has no mass", "give it a mass and an inertia"
            raise SceneError(what, file=self._file, allowed="a mass above zero [kg]", fix=fix)
        for part in parts:
            self._check_part(part, whole)
        if np.linalg.eigvalsh(link.inertia)[0] <= 0.0:
            what, allowed = f"link {parts[0]} has a physically impossible inertia", "principal moments above zero"
            raise SceneError(what, file=self._file, allowed=allowed, fix="give the correct inertia for its mass")

    def _check_part(self, part: str, whole: float) -> None:
        """Raises SceneError if the mass or the inertia of a part is in other units, or is one that no body has."""
        body = self._bodies[part]
        mass, center = float(self._builder.body_mass[body]), np.array(self._builder.body_com[body], dtype=float)
        inertia = np.array(self._builder.body_inertia[body], dtype=float).reshape(3, 3)
        moments, away = np.linalg.eigvalsh(inertia), float(np.linalg.norm(center))
        listed = ", ".join(f"{moment:.3g}" for moment in moments)
        if mass > _HEAVY * whole**3:
            what, allowed = (
                f"link {part} has a mass of {mass:g} kg",
                f"up to {_HEAVY * whole**3:.3g} kg, for an arm of {whole:.2g} m",
            )
            fix = "is it in grams? give it in kilograms"
        elif away > _FAR * whole:
            what, allowed = f"the centre of mass of link {part} is {away:.3g} m from its frame", "one in the link"
            fix = "is it in millimetres? give it in metres"
        elif moments[2] > mass * (_FAR * whole) ** 2:
            what = f"link {part} has a physically impossible inertia for its mass: {listed} kg m^2 with {mass:g} kg"
            allowed, fix = "moments of a body that is smaller than the arm", "give them in kg m^2"
        elif moments[0] < -_ROUNDED * moments[2] or moments[2] > (1.0 + _ROUNDED) * (moments[0] + moments[1]):
            what = f"link {part} has a physically impossible inertia: its principal moments are {listed} kg m^2"
            allowed, fix = "moments above zero, each at most the sum of the other two", "correct its inertia"
        else:
            return
        raise SceneError(what, file=self._file, allowed=allowed, fix=fix)

    def _collider(self, shape: int, frame: np.ndarray, name: str, link: str) -> Collider:
        """Returns a collision shape in a frame."""
        found = self._shape(shape, frame, name)
        if found is None:
            what = f"link {link} has a collision shape of an unsupported type"
            allowed = "boxes, spheres, cylinders, capsules and meshes"
            raise SceneError(what, file=self._file, allowed=allowed)
        self._check_length(np.concatenate([found.transform[:3], found.size or (1.0,)]), f"a shape of link {link}")
        if found.vertices is None:
            return found
        self._check_length(found.vertices, f"a mesh of link {link}")
        try:
            return fit_collider(name, transform_points(found.transform, found.vertices))
        except ValueError as error:
            raise SceneError(f"link {link}: {error}", file=self._file, allowed="solid collision meshes") from None

    def _check_length(self, values: np.ndarray, owner: str) -> None:
        """Raises SceneError if lengths [m] are not finite or too large."""
        if not (np.abs(values) < MAX_LENGTH).all():
            what = f"{owner} has a length of {float(np.abs(values).max()):g} m"
            raise SceneError(
                what, file=self._file, allowed=f"lengths below {MAX_LENGTH:g} m", fix="correct its numbers"
            )

    def _visual(self, shape: int, frame: np.ndarray, name: str) -> list[Visual]:
        """Returns a display shape in a frame; empty if its type is not supported."""
        found = self._shape(shape, frame, name)
        if found is None:
            return []
        r, g, b = (_linear(float(value)) for value in self._builder.shape_color[shape])
        faces = []
        if found.vertices is not None:
            faces = np.asarray(self._builder.shape_source[shape].indices).reshape(-1, 3).tolist()
        return [Visual(found, (r, g, b), faces)]

    def _shape(self, shape: int, frame: np.ndarray, name: str) -> Collider | None:
        """Returns a shape in a frame, a mesh with all its vertices; ``None`` if its type is not supported."""
        builder, geo = self._builder, self._geo
        frame = frame @ matrix_of(builder.shape_transform[shape])
        size = [float(value) for value in builder.shape_scale[shape]]
        kind = builder.shape_type[shape]
        at = np.array([*frame[:3, 3], *matrix_quat(frame[:3, :3])])
        if kind == geo.BOX:
            return Collider(name, "box", at, tuple(size))
        if kind == geo.SPHERE:
            return Collider(name, "sphere", at, (size[0],))
        if kind in (geo.CYLINDER, geo.CAPSULE):
            return Collider(name, "cylinder" if kind == geo.CYLINDER else "capsule", at, (size[0], size[1]))
        if builder.shape_source[shape] is None:
            return None
        points = np.asarray(builder.shape_source[shape].vertices, dtype=float) * size
        return Collider(name, "mesh", at, vertices=points)


def matrix_of(transform: object) -> np.ndarray:
    """Converts a Newton transform (position, quaternion xyzw) to a matrix, shape [4, 4]."""
    values = np.array(transform, dtype=float).ravel()
    frame = np.eye(4)
    frame[:3, :3] = rotation_matrix(values[3:] / np.linalg.norm(values[3:]))
    frame[:3, 3] = values[:3]
    return frame


def _still(base: ArmLink) -> ArmLink:
    """Returns the base with a mass and an inertia that a body has; as it is fixed, their values have no effect."""
    if base.mass > 0.0 and np.linalg.eigvalsh(base.inertia)[0] > 0.0:
        return base
    mass = base.mass if base.mass > 0.0 else BASE_MASS
    return replace(base, mass=mass, center=np.zeros(3), inertia=mass * np.eye(3))


def _linear(value: float) -> float:
    """Converts a colour value from sRGB, which Newton uses, to linear, which USD uses."""
    return value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4


def _shifted(center: np.ndarray) -> np.ndarray:
    """Returns the inertia about the origin of a unit point mass [m^2]."""
    return center @ center * np.eye(3) - np.outer(center, center)


def _along(axis: ToolAxis) -> np.ndarray:
    """Returns the rotation from z to an axis of the flange, 4 x 4."""
    direction = (-1.0 if axis[0] == "-" else 1.0) * np.eye(3)["xyz".index(axis[-1])]
    turn = np.eye(4)
    turn[:3, :3] = rotation_matrix(z_to(direction))
    return turn
