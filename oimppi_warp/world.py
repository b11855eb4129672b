"""A scene as physics: the Newton model that its USD file describes, and the MuJoCo model that Newton makes of that.

Newton's own USD import builds the model, so that what is simulated is what other USD tools read. What USD has no word
for is set here: velocity drives, gravity compensation, whose friction counts, how contacts give, what never collides.
"""

from __future__ import annotations

import gc
import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields
from functools import cached_property
from importlib.metadata import version
from itertools import combinations, product
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import BadZipFile

import numpy as np

from oimppi_warp.scene import PlanarPose, Scene

if TYPE_CHECKING:
    import mujoco
    import newton

DRIVE_GAIN = 200.0
"""Gain of a joint's velocity drive [N m s/rad]: the tool lags behind its command by some 5 ms."""

ARMATURE = 0.1
"""Inertia of a joint's motor and gear, seen at the joint [kg m^2]."""

MIN_FRICTION = 1e-4
"""As good as none; MuJoCo takes nothing below 1e-5."""

SOFT_ONSET = (0.0, 0.95, 0.0005, 0.5, 2.0)
"""MuJoCo's contact impedance ``solimp``: none at first touch, full at half a millimetre.

With MuJoCo's own (0.9 at first touch) a flat object that is pushed chatters: its corners leave the table and come back,
and the tool's sideways grip is lost in it. It then turns too far, and by another angle for every length of step.
"""

ROLES = ("other", "tool", "arm", "base", "object", "obstacle", "table")
"""What a shape is there for; a role's number is its place in this list."""


@dataclass(frozen=True, eq=False)
class NewtonModel:
    """A scene as a Newton model on the CPU, and where everything is in it.

    Attributes:
        model: The model, in one world; its ``joint_q`` holds the start of the episode.
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


@dataclass(frozen=True, eq=False)
class MujocoModel:
    """A scene as a MuJoCo model, and where everything is in it.

    Attributes:
        model: The compiled model; copy it before changing it.
        joint_qpos: Addresses of the arm's joint positions in ``qpos``, shape [dof].
        joint_qvel: Addresses of their velocities in ``qvel``, shape [dof].
        joint_drive: Indices of their velocity drives in ``ctrl``, shape [dof].
        object_qpos: Addresses of the object's pose in ``qpos`` (position, quaternion wxyz), shape [7].
        object_qvel: Addresses of its velocity in ``qvel`` (linear in the world's frame, angular in its own), shape [6].
        object_body: The object's body, shape [].
        link_bodies: Bodies of the arm's moving links, shape [dof].
        roles: Each geom's role, an index of :data:`ROLES`, shape [ngeom].
    """

    model: mujoco.MjModel
    joint_qpos: np.ndarray
    joint_qvel: np.ndarray
    joint_drive: np.ndarray
    object_qpos: np.ndarray
    object_qvel: np.ndarray
    object_body: np.ndarray
    link_bodies: np.ndarray
    roles: np.ndarray


class World:
    """A scene's physics, built when it is asked for.

    Attributes:
        scene: What it is built from.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    @cached_property
    def newton(self) -> NewtonModel:
        """The Newton model of the scene's USD file."""
        return _import_scene(self.scene)

    @cached_property
    def mujoco(self) -> MujocoModel:
        """The same for MuJoCo's C engine, as Newton's SolverMuJoCo translates it.

        It is kept in the cache by content, because importing Newton and MuJoCo Warp to make it anew takes two seconds.
        """
        from oimppi_warp.cache import cache_folder

        file = cache_folder() / f"mujoco-{_content(self.scene)}.npz"
        try:
            return _load(file)
        except (OSError, ValueError, KeyError, EOFError, BadZipFile):
            pass  # not there, or cut short: make it again
        made = _translate(self.newton)
        with suppress(OSError):  # a cache that cannot be written costs time, not the run
            _save(made, file)
        return made

    def link_transforms(self, joint_position: np.ndarray) -> np.ndarray:
        """Poses of the arm's moving links from Newton's forward kinematics (float32).

        Args:
            joint_position: Shape [dof] [rad].

        Returns:
            Position and quaternion xyzw of each link in the world's frame, shape [dof, 7].
        """
        built = self.newton
        import newton
        import warp as wp

        coords = built.model.joint_q.numpy().copy()
        coords[built.joint_coords] = joint_position
        state, still = built.model.state(), wp.zeros(built.model.joint_dof_count, dtype=float, device="cpu")
        newton.eval_fk(built.model, wp.array(coords, dtype=float, device="cpu"), still, state)
        return state.body_q.numpy()[built.link_bodies]


def planar_transform(pose: PlanarPose, height: float) -> np.ndarray:
    """A planar pose as a transform (position, quaternion xyzw), shape [7].

    Args:
        pose: (x, y, yaw).
        height: z [m].
    """
    x, y, yaw = pose
    return np.array([x, y, height, 0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)])


def planar_pose(transform: np.ndarray) -> np.ndarray:
    """A transform (position, quaternion xyzw) seen from above: (x, y, yaw), yaw within (-pi, pi], shape [3]."""
    x, y, _, qx, qy, qz, qw = transform
    return np.array([x, y, np.arctan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))])


def _import_scene(scene: Scene) -> NewtonModel:
    """Read a scene's file with Newton's USD import, and set what USD has no word for."""
    with _collector_paused():
        import newton
        from newton.solvers import SolverMuJoCo

    builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
    builder.rigid_gap = 0.0  # shapes that do not touch are of no interest
    SolverMuJoCo.register_custom_attributes(builder)
    found = builder.add_usd(str(scene.file), load_visual_shapes=False, enable_self_collisions=False)
    bodies, joints = found["path_body_map"], found["path_joint_map"]
    robot_joints = [joints[joint.path] for joint in scene.robot.joints]
    object_body = bodies[scene.object.path]
    free_joint = builder.joint_child.index(object_body)
    dofs = np.array([builder.joint_qd_start[joint] for joint in robot_joints])
    coords = np.array([builder.joint_q_start[joint] for joint in robot_joints])
    object_coords = builder.joint_q_start[free_joint] + np.arange(7)
    roles = _roles(scene, found["path_shape_map"], builder.shape_count)

    for dof in dofs:
        builder.joint_target_mode[dof] = int(newton.JointTargetMode.VELOCITY)
        builder.joint_target_ke[dof] = 0.0
        builder.joint_target_kd[dof] = DRIVE_GAIN
        builder.joint_armature[dof] = ARMATURE
    arm = [body for path, body in bodies.items() if path.startswith(scene.robot.path + "/")]
    builder.custom_attributes["mujoco:gravcomp"].values = dict.fromkeys(arm, 1.0)
    builder.custom_attributes["mujoco:geom_solimp"].values = dict.fromkeys(range(len(roles)), SOFT_ONSET)
    builder.shape_material_mu[:] = _friction(scene, roles).tolist()
    for a, b in _never_meet(roles):
        builder.add_shape_collision_filter_pair(a, b)
    for coord, position in zip(coords, scene.robot.start, strict=True):
        builder.joint_q[coord] = float(position)
    start = planar_transform(scene.start, scene.object.rest_height).tolist()
    builder.body_q[object_body] = tuple(start)
    for coord, value in zip(object_coords, start, strict=True):
        builder.joint_q[coord] = value

    return NewtonModel(
        model=builder.finalize(device="cpu"),
        joint_coords=coords,
        joint_dofs=dofs,
        link_bodies=np.array([bodies[link.path] for link in scene.robot.links]),
        object_body=object_body,
        object_coords=object_coords,
        object_dofs=builder.joint_qd_start[free_joint] + np.arange(6),
        roles=roles,
    )


def _roles(scene: Scene, shapes: dict[str, int], count: int) -> np.ndarray:
    """Each imported shape's role, from the prim that it was read from; shape [count]."""
    tool = scene.robot.tool_path.rsplit("/", 1)[0] + "/"
    on_links = [collider.path for link in scene.robot.links for collider in link.colliders]
    members = {
        "tool": [path for path in on_links if path.startswith(tool)],
        "arm": [path for path in on_links if not path.startswith(tool)],
        "base": [collider.path for collider in scene.robot.base.colliders],
        "object": [collider.path for collider in scene.object.colliders],
        "obstacle": [collider.path for obstacle in scene.obstacles for collider in obstacle.colliders],
        "table": [path for path in shapes if f"{path}/".startswith(f"{scene.table.path}/")],
    }
    roles = np.zeros(count, dtype=np.int64)
    for role, paths in members.items():
        roles[[shapes[path] for path in paths]] = ROLES.index(role)
    return roles


def _friction(scene: Scene, roles: np.ndarray) -> np.ndarray:
    """Each shape's coefficient of friction, such that each pair of shapes has the scene's; shape [shape].

    MuJoCo takes the larger coefficient of the two shapes in contact. The object's own is therefore as good as none, and
    its partner's says how it slides there: the tool's is ``tool_friction``, the others' ``friction``.
    """
    friction = np.full(len(roles), scene.object.friction)
    friction[roles == ROLES.index("tool")] = scene.object.tool_friction
    friction[roles == ROLES.index("object")] = MIN_FRICTION
    return friction


def _never_meet(roles: np.ndarray) -> list[tuple[int, int]]:
    """Pairs of shapes that do not collide: the robot with itself, and its base with what it stands on."""
    base, arm, tool, table = (
        np.flatnonzero(roles == ROLES.index(role)).tolist() for role in ("base", "arm", "tool", "table")
    )
    return [*combinations([*base, *arm, *tool], 2), *product(base, table)]


def _translate(built: NewtonModel) -> MujocoModel:
    """The MuJoCo model of a Newton model."""
    with _collector_paused():
        import mujoco
        from newton.solvers import SolverMuJoCo

        SolverMuJoCo.import_mujoco()
    solver = SolverMuJoCo(
        built.model,
        use_mujoco_cpu=True,
        integrator="implicitfast",
        cone="elliptic",
        impratio=1.0,  # with more, sliding contacts chatter
        enable_multiccd=True,  # without it, a cylinder or a mesh stands on one point and turns like a top
    )
    model = solver.mj_model
    dof_of = _first_world(solver.mjc_dof_to_newton_dof)
    body_of = _first_world(solver.mjc_body_to_newton)
    shape_of = _first_world(solver.mjc_geom_to_newton_shape)
    qvel = _places(dof_of, built.joint_dofs)
    joints = model.dof_jntid[qvel]
    # A velocity drive never makes up for what it lost while its force was limited: the tool would lag by centimetres.
    model.jnt_actfrclimited[joints] = 0
    object_body = _places(body_of, built.object_body)
    free_joint = model.body_jntadr[object_body]
    driven = np.where(model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT, model.actuator_trnid[:, 0], -1)
    return MujocoModel(
        model=model,
        joint_qpos=model.jnt_qposadr[joints],
        joint_qvel=qvel,
        joint_drive=_places(driven, joints),
        object_qpos=model.jnt_qposadr[free_joint] + np.arange(7),
        object_qvel=model.jnt_dofadr[free_joint] + np.arange(6),
        object_body=object_body,
        link_bodies=_places(body_of, built.link_bodies),
        roles=np.where(shape_of >= 0, built.roles[shape_of], 0),
    )


def _first_world(array: Any) -> np.ndarray:
    """The row of a Warp array [world, n] that belongs to the first world, shape [n]."""
    return array.numpy()[0]


def _places(values: np.ndarray, wanted: np.ndarray | int) -> np.ndarray:
    """Where each of ``wanted`` stands in ``values``, in the shape of ``wanted``."""
    return np.argmax(values == np.asarray(wanted)[..., None], axis=-1)


def _content(scene: Scene) -> str:
    """Hash of all that a scene's MuJoCo model is made from: its layers, what is set here, and who translates."""
    from pxr import Usd

    digest = hashlib.sha256(Path(__file__).read_bytes())
    stage = Usd.Stage.Open(str(scene.file))
    for layer in sorted(layer.realPath for layer in stage.GetUsedLayers() if not layer.anonymous):
        digest.update(Path(layer).read_bytes())
    pushed = scene.object
    digest.update(f"{pushed.friction} {pushed.tool_friction} {version('newton')} {version('mujoco')}".encode())
    return digest.hexdigest()[:24]


def _save(made: MujocoModel, file: Path) -> None:
    """Write a translated model to one file."""
    import mujoco

    compiled = np.zeros(mujoco.mj_sizeModel(made.model), dtype=np.uint8)
    mujoco.mj_saveModel(made.model, None, compiled)
    places = {field.name: getattr(made, field.name) for field in fields(made) if field.name != "model"}
    file.parent.mkdir(parents=True, exist_ok=True)
    partial = file.with_name(f"{file.name}.{os.getpid()}.part")
    with partial.open("wb") as stream:
        np.savez(stream, model=compiled, **places)
    partial.replace(file)


def _load(file: Path) -> MujocoModel:
    """Read what :func:`_save` wrote."""
    import mujoco

    with np.load(file) as saved:
        arrays = dict(saved)
    model = mujoco.MjModel.from_binary_path("model.mjb", {"model.mjb": arrays.pop("model").tobytes()})
    return MujocoModel(model=model, **arrays)


@contextmanager
def _collector_paused() -> Iterator[None]:
    """Import without garbage collection, and keep what was imported out of it for good.

    Newton and MuJoCo Warp make hundreds of thousands of objects that live to the end of the process; going through them
    costs a second on import and two at exit.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        if enabled:
            gc.enable()
