"""The Newton model of a scene, built from the :class:`oimppi_warp.scene.Scene` alone.

It has the bodies, joints and shapes that Newton's own USD import makes of the scene's file, in the same order
(`tests/physics/test_physics_import.py` compares the two), and properties that USD cannot express: velocity drives,
gravity compensation, friction per pair of shapes, contact softness and collision filters.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import TYPE_CHECKING, Any

import numpy as np

from oimppi_warp.compute.device import start_warp
from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.footprint import collider_mesh, quaternion_product, rotation_matrix
from oimppi_warp.geometry.kinematics import touching_turret
from oimppi_warp.observation import planar_transform
from oimppi_warp.scene import Collider, Joint, Link, Robot, Scene

if TYPE_CHECKING:
    import newton

DRIVE_GAIN = 200.0
"""Gain of a joint's velocity drive [N m s/rad]: the tool lags behind its command by some 5 ms."""

ARMATURE = 0.1
"""Inertia of a joint's motor and gear, reflected to the joint [kg m^2]."""

SLIDE_GAIN, SLIDE_ARMATURE = 1500.0, 0.6
"""The same for a sliding joint [N s/m], [kg]: equal to those of a turning joint for a tool 0.4 m from its axis."""

MIN_FRICTION = 1e-4
"""Negligible coefficient of friction; MuJoCo accepts nothing below 1e-5."""

SOFT_ONSET = (0.0, 0.95, 0.0005, 0.5, 2.0)
"""MuJoCo's contact impedance ``solimp``: zero at first touch, full at half a millimetre.

With MuJoCo's default (0.9 at first touch) a pushed flat object chatters: its corners leave the table and come back, and
the tool loses its sideways grip. The object then turns too far, by an angle that depends on the step length.
"""

SOLVER_OPTIONS = {
    "integrator": "implicitfast",
    "cone": "elliptic",
    "impratio": 1.0,  # with more, sliding contacts chatter
    "enable_multiccd": True,  # without it, a cylinder or a mesh rests on one point and spins about it
}
"""Options of Newton's SolverMuJoCo with which a flat object slides correctly."""

WATER = 1000.0
"""Density of bodies without colliders, and of colliders before scaling to their body's mass [kg/m^3]."""

_KINDS = ("sphere", "box", "capsule", "cylinder", "mesh")
"""Kinds of shapes, in the order in which UsdPhysics lists them."""

ROLES = ("other", "tool", "arm", "base", "object", "obstacle", "table")
"""Roles of shapes; a role's number is its index in this list."""


@dataclass(frozen=True, eq=False)
class NewtonModel:
    """A scene as a Newton model, with the indices of joints and object in its first world.

    Attributes:
        model: The model; its ``joint_q`` holds the start of the episode. Of the poses in ``body_q``, only the object's
            is that of the start; ``newton.eval_fk`` computes the others.
        joint_coords: Indices of the arm's joints in ``joint_q``, from base to flange, shape [dof].
        joint_dofs: Their indices in ``joint_qd``, shape [dof].
        link_bodies: Bodies of the arm's moving links, shape [dof].
        object_body: The object's body.
        object_coords: Indices of its free joint in ``joint_q`` (position, quaternion xyzw), shape [7].
        object_dofs: Indices of its velocity in ``joint_qd`` (linear, angular; world frame), shape [6].
        roles: Each shape's role, an index of :data:`ROLES`, shape [shape_count].
    """

    model: newton.Model
    joint_coords: np.ndarray
    joint_dofs: np.ndarray
    link_bodies: np.ndarray
    object_body: int
    object_coords: np.ndarray
    object_dofs: np.ndarray
    roles: np.ndarray


def build_model(scene: Scene, *, worlds: int | None = None, device: str = "cpu") -> NewtonModel:
    """Builds the Newton model of a scene.

    Args:
        scene: The task.
        worlds: Number of identical batched worlds; ``None`` for a single one. Indices are those of the first.
        device: Warp device of the model.

    Raises:
        SceneError: A link of the robot has no more mass than the bodies welded to it.
    """
    start_warp()
    import newton
    from newton.solvers import SolverMuJoCo

    def new_builder() -> newton.ModelBuilder:
        made = newton.ModelBuilder(up_axis=newton.Axis.Z)
        SolverMuJoCo.register_custom_attributes(made)
        return made

    builder = new_builder()
    builder.rigid_gap = 0.0  # contacts of shapes that do not touch are not needed
    builder.gravity = _vector(scene.gravity)
    bodies, joints = _add_robot(builder, scene.robot)
    start = planar_transform(scene.start, scene.object.rest_height)
    object_body = builder.add_link(xform=_transform(start), label=scene.object.path)
    roles = _add_shapes(builder, _placed_shapes(scene, bodies, object_body))
    _set_robot_masses(builder, scene.robot, bodies)
    pushed = scene.object
    _set_mass(builder, object_body, pushed.mass, pushed.center_of_mass, pushed.unit_inertia)
    free_joint = builder.add_joint_free(object_body)
    builder.add_articulation([free_joint], label=scene.object.path)

    builder.custom_attributes["mujoco:gravcomp"].values = dict.fromkeys(bodies.values(), 1.0)
    builder.custom_attributes["mujoco:geom_solimp"].values = dict.fromkeys(range(len(roles)), SOFT_ONSET)
    builder.shape_material_mu[:] = _friction(scene, roles).tolist()
    turret = {bodies[part.path] for link in touching_turret(scene.robot) for part in (link, *link.welded)}
    sunk = np.isin(builder.shape_body, list(turret)) & (roles == ROLES.index("arm"))
    for a, b in _never_meet(roles, sunk):
        builder.add_shape_collision_filter_pair(a, b)
    coords = np.array([builder.joint_q_start[joint] for joint in joints])
    for coord, position in zip(coords, scene.robot.start, strict=True):
        builder.joint_q[coord] = float(position)
    found = {
        "joint_coords": coords,
        "joint_dofs": np.array([builder.joint_qd_start[joint] for joint in joints]),
        "link_bodies": np.array([bodies[link.path] for link in scene.robot.links]),
        "object_body": object_body,
        "object_coords": builder.joint_q_start[free_joint] + np.arange(7),
        "object_dofs": builder.joint_qd_start[free_joint] + np.arange(6),
        "roles": roles,
    }
    if worlds is not None:
        one, builder = builder, new_builder()
        builder.replicate(one, worlds)
    # A single world has few bodies: to check their inertia in Python saves compiling a kernel.
    builder.validate_inertia_detailed = worlds is None
    return NewtonModel(model=builder.finalize(device=device), **found)


def _add_robot(builder: newton.ModelBuilder, robot: Robot) -> tuple[dict[str, int], list[int]]:
    """Adds the robot's bodies and joints, base first, as one articulation.

    Returns:
        Its bodies by their paths, and the joints that move.
    """
    chain = (robot.base, *robot.links)
    parts = [part for link in chain for part in (link, *link.welded)]
    bodies = {part.path: builder.add_link(label=part.path) for part in parts}
    base = bodies[robot.base.path]
    mount = builder.add_joint_fixed(-1, base, label=f"{robot.base.path}/mount", collision_filter_parent=False)
    all_joints = [mount]
    moving: list[int] = []
    for number, link in enumerate(chain):
        if number:
            parent = bodies[chain[number - 1].path]
            moving.append(_add_joint(builder, robot.joints[number - 1], parent, bodies[link.path]))
            all_joints.append(moving[-1])
        for part in link.welded:
            all_joints.append(
                builder.add_joint_fixed(
                    bodies[link.path],
                    bodies[part.path],
                    parent_xform=_transform(part.transform),
                    label=f"{part.path}/weld",
                    collision_filter_parent=True,
                )
            )
    builder.add_articulation(all_joints, label=robot.path)
    return bodies, moving


def _add_joint(builder: newton.ModelBuilder, joint: Joint, parent: int, child: int) -> int:
    """Adds a joint with a velocity drive between two bodies."""
    import newton

    turns = joint.kind == "revolute"
    add = builder.add_joint_revolute if turns else builder.add_joint_prismatic
    return add(
        parent,
        child,
        parent_xform=_transform(joint.parent_transform),
        axis=newton.Axis.Z,
        target_ke=0.0,
        target_kd=DRIVE_GAIN if turns else SLIDE_GAIN,
        limit_lower=joint.lower,
        limit_upper=joint.upper,
        armature=ARMATURE if turns else SLIDE_ARMATURE,
        effort_limit=_limit(joint.effort_limit),
        velocity_limit=_limit(joint.velocity_limit),
        friction=joint.friction,
        damping=joint.damping,
        label=joint.path,
        collision_filter_parent=True,
        actuator_mode=newton.JointTargetMode.VELOCITY,
    )


def _placed_shapes(scene: Scene, bodies: dict[str, int], object_body: int) -> list[tuple[str, int, Collider]]:
    """Returns role, body (-1: the world) and collider, in the body's frame, of each shape of a scene.

    Shapes are grouped by kind, as in the lists of UsdPhysics that Newton's import goes through.
    """
    table, tool = scene.table, scene.robot.tool_path.rsplit("/", 1)[0] + "/"
    top = np.array([*np.add(table.lower, table.upper) / 2.0, -table.thickness / 2.0, 0.0, 0.0, 0.0, 1.0])
    half = (*(np.subtract(table.upper, table.lower) / 2.0).tolist(), table.thickness / 2.0)
    shapes = [("base", *each) for each in _by_body(scene.robot.base, bodies)]
    for link in scene.robot.links:
        shapes += [
            ("tool" if shape.path.startswith(tool) else "arm", body, shape) for body, shape in _by_body(link, bodies)
        ]
    shapes.append(("table", -1, Collider(table.path, "box", top, half)))
    shapes += [("table", -1, shape) for shape in table.others]
    shapes += [("object", object_body, shape) for shape in scene.object.colliders]
    shapes += [("obstacle", -1, shape) for obstacle in scene.obstacles for shape in obstacle.colliders]
    return sorted(shapes, key=lambda shape: _KINDS.index(shape[2].kind))


def _by_body(link: Link, bodies: dict[str, int]) -> Iterable[tuple[int, Collider]]:
    """Yields each collider of a link with its body, in that frame: the link's, or the welded one it lies below."""
    for collider in link.colliders:
        owners = [part for part in link.welded if f"{collider.path}/".startswith(f"{part.path}/")]
        owner = max(owners, key=lambda part: len(part.path), default=None)
        if owner is None:
            yield bodies[link.path], collider
        else:
            yield bodies[owner.path], _in_frame(owner.transform, collider)


def _in_frame(frame: np.ndarray, collider: Collider) -> Collider:
    """Expresses a collider in another frame: position [m] and quaternion xyzw in its current frame, shape [7]."""
    turn_back = frame[3:] * (-1.0, -1.0, -1.0, 1.0)
    position = rotation_matrix(frame[3:]).T @ (collider.transform[:3] - frame[:3])
    return replace(
        collider, transform=np.concatenate([position, quaternion_product(turn_back, collider.transform[3:])])
    )


def _add_shapes(builder: newton.ModelBuilder, shapes: list[tuple[str, int, Collider]]) -> np.ndarray:
    """Adds shapes with their roles and bodies; returns the roles, indices of :data:`ROLES`, shape [shape]."""
    hulls = []
    for _, body, collider in shapes:
        given: dict[str, Any] = {"xform": _transform(collider.transform), "label": collider.path}
        if collider.kind == "box":
            hx, hy, hz = collider.size
            builder.add_shape_box(body, hx=hx, hy=hy, hz=hz, **given)
        elif collider.kind == "sphere":
            builder.add_shape_sphere(body, radius=collider.size[0], **given)
        elif collider.kind == "mesh":
            hulls.append(builder.add_shape_mesh(body, mesh=_mesh(collider), **given))
        else:
            radius, half_height = collider.size
            add = builder.add_shape_capsule if collider.kind == "capsule" else builder.add_shape_cylinder
            add(body, radius=radius, half_height=half_height, **given)
    if hulls:  # after adding: the mass of a mesh is that of the volume its faces enclose
        builder.approximate_meshes("convex_hull", shape_indices=hulls)
    return np.array([ROLES.index(role) for role, _, _ in shapes])


def _mesh(collider: Collider) -> newton.Mesh:
    """Returns a mesh collider's surface, or its hull if it has no faces."""
    import newton

    points, faces = collider.vertices, collider.faces
    if points is None or faces is None:
        hull = collider_mesh(replace(collider, transform=np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])))
        points, faces = np.asarray(hull.vertices), np.asarray(hull.faces)
    return newton.Mesh(points.astype(np.float32), faces.astype(np.int32).flatten())


def _set_robot_masses(builder: newton.ModelBuilder, robot: Robot, bodies: dict[str, int]) -> None:
    """Sets the masses of the robot's bodies; a link's own mass is its total without the welded bodies."""
    for link in (robot.base, *robot.links):
        own = link.mass - sum(part.mass for part in link.welded)
        if not own > 0.0:
            parts = " and ".join(f"<{part.path}> of {part.mass:g} kg" for part in link.welded) or "nothing welded to it"
            raise SceneError(
                f"the link has a mass of {link.mass:g} kg, with {parts}",
                prim=link.path,
                allowed="more than the mass of the bodies welded to it",
                fix="give the link a larger mass; it includes that of the welded bodies",
            )
        for part, mass in ((link, own), *((part, part.mass) for part in link.welded)):
            _set_mass(builder, bodies[part.path], mass, part.center_of_mass, part.unit_inertia)


def _set_mass(
    builder: newton.ModelBuilder, body: int, mass: float, center: np.ndarray | None, unit_inertia: np.ndarray | None
) -> None:
    """Sets a body's mass [kg], centre of mass [3] [m] and unit inertia [3, 3] [m^2]; ``None``: from its shapes."""
    import warp as wp

    of_shapes = builder.body_mass[body]
    if unit_inertia is not None:
        inertia = mass * unit_inertia
    elif of_shapes > 0.0:
        inertia = np.array(builder.body_inertia[body]).reshape(3, 3) * (mass / of_shapes)
    else:  # no data: a sphere of the density of water
        inertia = 0.4 * mass * (mass / WATER * 3.0 / (4.0 * math.pi)) ** (2.0 / 3.0) * np.eye(3)
    builder.body_mass[body], builder.body_inv_mass[body] = mass, 1.0 / mass
    tensor: Any = wp.mat33(inertia)
    inverse: Any = wp.inverse(tensor)
    builder.body_inertia[body], builder.body_inv_inertia[body] = tensor, inverse
    if center is not None:
        builder.body_com[body] = _vector(center)


def _limit(value: float) -> float | None:
    """Returns a limit for Newton; ``None``, for Newton's default, if it is infinite."""
    return value if math.isfinite(value) else None


def _vector(values: Iterable[float]) -> Any:
    import warp as wp

    return wp.vec3(*map(float, values))


def _transform(values: np.ndarray) -> Any:
    import warp as wp

    return wp.transform(*map(float, values))


def _friction(scene: Scene, roles: np.ndarray) -> np.ndarray:
    """Returns each shape's coefficient of friction, such that each pair has the scene's; shape [shape].

    MuJoCo takes the larger coefficient of two shapes in contact. The object's is therefore made negligible, so that the
    other shape's applies: ``tool_friction`` for the tool, and ``friction`` for all others.
    """
    friction = np.full(len(roles), scene.object.friction)
    friction[roles == ROLES.index("tool")] = max(scene.object.tool_friction, MIN_FRICTION)
    friction[roles == ROLES.index("object")] = MIN_FRICTION
    return friction


def _never_meet(roles: np.ndarray, sunk: np.ndarray) -> list[tuple[int, int]]:
    """Returns pairs of shapes that do not collide: the robot with itself, and what stands on the table with the table.

    That is the robot's base, and the shapes marked in ``sunk``, of a turret with coarse shapes that reach into it.
    """
    base, arm, tool, table = (
        np.flatnonzero(roles == ROLES.index(role)).tolist() for role in ("base", "arm", "tool", "table")
    )
    return [*combinations([*base, *arm, *tool], 2), *product([*base, *np.flatnonzero(sunk).tolist()], table)]
