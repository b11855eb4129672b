"""The Newton model that a scene's USD file describes.

Newton's own USD import builds it, so that what is simulated is what other USD tools read. What USD has no word for is
set here: velocity drives, gravity compensation, whose friction counts, how contacts give, what never collides.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import combinations, product
from typing import TYPE_CHECKING

import numpy as np

from oimppi_warp.device import start_warp
from oimppi_warp.kinematics import turning
from oimppi_warp.observation import planar_transform
from oimppi_warp.scene import Scene

if TYPE_CHECKING:
    import newton

DRIVE_GAIN = 200.0
"""Gain of a joint's velocity drive [N m s/rad]: the tool lags behind its command by some 5 ms."""

ARMATURE = 0.1
"""Inertia of a joint's motor and gear, seen at the joint [kg m^2]."""

SLIDE_GAIN, SLIDE_ARMATURE = 1500.0, 0.6
"""The same of a joint that slides [N s/m], [kg]: what the others are to a tool 0.4 m from their axis."""

MIN_FRICTION = 1e-4
"""As good as none; MuJoCo takes nothing below 1e-5."""

SOFT_ONSET = (0.0, 0.95, 0.0005, 0.5, 2.0)
"""MuJoCo's contact impedance ``solimp``: none at first touch, full at half a millimetre.

With MuJoCo's own (0.9 at first touch) a flat object that is pushed chatters: its corners leave the table and come back,
and the tool's sideways grip is lost in it. It then turns too far, and by another angle for every length of step.
"""

SOLVER_OPTIONS = {
    "integrator": "implicitfast",
    "cone": "elliptic",
    "impratio": 1.0,  # with more, sliding contacts chatter
    "enable_multiccd": True,  # without it, a cylinder or a mesh stands on one point and turns like a top
}
"""Options of Newton's SolverMuJoCo under which a flat object slides as it should."""

ROLES = ("other", "tool", "arm", "base", "object", "obstacle", "table")
"""What a shape is there for; a role's number is its place in this list."""


@dataclass(frozen=True, eq=False)
class NewtonModel:
    """A scene as a Newton model, and where everything is in its first world.

    Attributes:
        model: The model; its ``joint_q`` holds the start of the episode.
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


def import_scene(scene: Scene, *, worlds: int | None = None, device: str = "cpu") -> NewtonModel:
    """Reads a scene's file with Newton's USD import, and sets what USD has no word for.

    Args:
        scene: The task.
        worlds: Number of batched worlds, all alike; ``None`` for a single one. Indices are those of the first.
        device: Warp device of the model.
    """
    start_warp()
    with collector_paused():
        import newton
        from newton.solvers import SolverMuJoCo

        from oimppi_warp.usd.stage import SceneStage

    builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
    builder.rigid_gap = 0.0  # shapes that do not touch are of no interest
    SolverMuJoCo.register_custom_attributes(builder)
    found = builder.add_usd(SceneStage(scene.file).stage, load_visual_shapes=False, enable_self_collisions=False)
    bodies, joints = found["path_body_map"], found["path_joint_map"]
    robot_joints = [joints[joint.path] for joint in scene.robot.joints]
    object_body = bodies[scene.object.path]
    free_joint = builder.joint_child.index(object_body)
    dofs = np.array([builder.joint_qd_start[joint] for joint in robot_joints])
    coords = np.array([builder.joint_q_start[joint] for joint in robot_joints])
    object_coords = builder.joint_q_start[free_joint] + np.arange(7)
    roles = _roles(scene, found["path_shape_map"], builder.shape_count)

    for dof, turns in zip(dofs, turning(scene.robot), strict=True):
        builder.joint_target_mode[dof] = int(newton.JointTargetMode.VELOCITY)
        builder.joint_target_ke[dof] = 0.0
        builder.joint_target_kd[dof] = DRIVE_GAIN if turns else SLIDE_GAIN
        builder.joint_armature[dof] = ARMATURE if turns else SLIDE_ARMATURE
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

    free_dofs = builder.joint_qd_start[free_joint] + np.arange(6)
    if worlds is not None:
        one, builder = builder, newton.ModelBuilder(up_axis=newton.Axis.Z)
        SolverMuJoCo.register_custom_attributes(builder)
        builder.replicate(one, worlds)
    return NewtonModel(
        model=builder.finalize(device=device),
        joint_coords=coords,
        joint_dofs=dofs,
        link_bodies=np.array([bodies[link.path] for link in scene.robot.links]),
        object_body=object_body,
        object_coords=object_coords,
        object_dofs=free_dofs,
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


@contextmanager
def collector_paused() -> Iterator[None]:
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
