"""The MuJoCo model that Newton's SolverMuJoCo makes of a scene, cached by content.

Making it again would import Newton and MuJoCo Warp, which takes two seconds.
"""

from __future__ import annotations

import io
from contextlib import redirect_stdout, suppress
from dataclasses import dataclass, fields, replace
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any
from zipfile import BadZipFile

import numpy as np

from oimppi_warp.compute.cache import cache_folder, content_of_data, source_content, store_arrays, touch
from oimppi_warp.compute.loading import quick_compilation
from oimppi_warp.physics.newton_model import ROLES, SOLVER_OPTIONS, NewtonModel, build_model
from oimppi_warp.scene import Scene

if TYPE_CHECKING:
    import mujoco
    from newton.solvers import SolverMuJoCo

SENSED = ((("object",), ("obstacle", "base")), (("arm", "tool"), ("obstacle", "table")))
"""Pairs of moving and static roles whose contact forces are sensed: the paper's lambda_2 and lambda_3."""

_CONVERSION = "newton._src.solvers.mujoco.kernels"
"""Module of the kernels that convert to MuJoCo's model and state, through which Newton computes no gradients."""


@dataclass(frozen=True, eq=False)
class MujocoModel:
    """A scene as a MuJoCo model, with the addresses of joints and object in it.

    Attributes:
        model: The compiled model; copy it before changing it.
        joint_qpos: Addresses of the arm's joint positions in ``qpos``, shape [dof].
        joint_qvel: Addresses of their velocities in ``qvel``, shape [dof].
        joint_drive: Indices of their velocity drives in ``ctrl``, shape [dof].
        object_qpos: Addresses of the object's pose in ``qpos`` (position, quaternion wxyz), shape [7].
        object_qvel: Addresses of its velocity in ``qvel`` (linear in the world's frame, angular in its own), shape [6].
        object_body: Index of the object's body, shape [].
        link_bodies: Indices of the bodies of the arm's moving links, shape [dof].
        roles: Each geom's role, an index of :data:`ROLES`, shape [ngeom].
        sensors: Group of each contact force sensor, an index of :data:`SENSED`, shape [nsensor]; each has three
            numbers in ``sensordata``, a force [N]. Empty for a model without sensors.
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
    sensors: np.ndarray


def translate_scene(scene: Scene, *, sensing: bool) -> MujocoModel:
    """Returns the MuJoCo model of a scene, from the cache if possible; a model that has to be made is then cached.

    It does not depend on the start of object and arm: both are at zero in ``qpos0``.

    Args:
        scene: The task.
        sensing: Whether to add contact force sensors.
    """
    file = cache_folder() / f"mujoco-{_content(scene)}{'-sensing' if sensing else ''}.npz"
    try:
        return _load(file)
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        pass  # missing or truncated: make it again
    from newton.solvers import SolverMuJoCo  # noqa: F401  (its kernels must be known)

    with quick_compilation(without_gradients=[_CONVERSION]):  # Newton's kernels run once here
        made = _translate(build_model(_at_zero(scene)), sensing=sensing)
    with suppress(OSError):  # an unwritable cache costs time, but not the run
        _save(made, file)
    return made


def _translate(built: NewtonModel, *, sensing: bool) -> MujocoModel:
    """Makes the MuJoCo model of a Newton model."""
    import mujoco
    from newton.solvers import SolverMuJoCo

    with TemporaryDirectory() as folder, redirect_stdout(io.StringIO()):  # it prints the path that it saved to
        file = Path(folder) / "model.xml"
        solver = SolverMuJoCo(
            built.model, use_mujoco_cpu=True, save_to_mjcf=str(file) if sensing else None, **SOLVER_OPTIONS
        )
        specification = mujoco.MjSpec.from_file(str(file)) if sensing else None
    plain = map_model(solver, built)
    if specification is None:
        return plain
    sensors = _add_sensors(specification, plain)
    model = specification.compile()
    model.jnt_actfrclimited = plain.model.jnt_actfrclimited
    return replace(plain, model=model, sensors=sensors)


def map_model(solver: SolverMuJoCo, built: NewtonModel) -> MujocoModel:
    """Finds the joints and bodies of a Newton model in its solver's MuJoCo model, and lifts the arm's effort limits.

    Args:
        solver: The solver of the Newton model. The effort limits of the arm's joints are removed from its ``mj_model``.
        built: The Newton model. If it has many worlds, the first is looked up: all have the same MuJoCo model.

    Returns:
        The solver's ``mj_model`` itself, not a copy, and the addresses in it; ``sensors`` is empty.
    """
    import mujoco

    model = solver.mj_model
    dof_of = _first_world(solver.mjc_dof_to_newton_dof)
    body_of = _first_world(solver.mjc_body_to_newton)
    shape_of = _first_world(solver.mjc_geom_to_newton_shape)
    qvel = _indices_of(dof_of, built.joint_dofs)
    joints = model.dof_jntid[qvel]
    # A velocity drive never recovers the motion lost while its force was limited: the tool would lag by centimetres.
    model.jnt_actfrclimited[joints] = 0
    object_body = _indices_of(body_of, built.object_body)
    free_joint = model.body_jntadr[object_body]
    driven = np.where(model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT, model.actuator_trnid[:, 0], -1)
    return MujocoModel(
        model=model,
        joint_qpos=model.jnt_qposadr[joints],
        joint_qvel=qvel,
        joint_drive=_indices_of(driven, joints),
        object_qpos=model.jnt_qposadr[free_joint] + np.arange(7),
        object_qvel=model.jnt_dofadr[free_joint] + np.arange(6),
        object_body=object_body,
        link_bodies=_indices_of(body_of, built.link_bodies),
        roles=np.where(shape_of >= 0, built.roles[shape_of], 0),
        sensors=np.zeros(0, dtype=int),
    )


def _add_sensors(specification: mujoco.MjSpec, plain: MujocoModel) -> np.ndarray:
    """Adds a contact force sensor for each pair of a moving body and a static shape.

    Args:
        specification: Specification of the same model, to which they are added.
        plain: The model without them.

    Returns:
        Group of each sensor, an index of :data:`SENSED`, shape [sensor].
    """
    import mujoco

    model = plain.model
    moving = (  # the object, and everything attached to the arm's first link
        (mujoco.mjtObj.mjOBJ_BODY, int(plain.object_body)),
        (mujoco.mjtObj.mjOBJ_XBODY, int(plain.link_bodies[0])),
    )
    net_force = [1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), 3, 1]
    groups = []
    for group, ((kind, body), (_, still)) in enumerate(zip(moving, SENSED, strict=True)):
        for geom in np.flatnonzero(np.isin(plain.roles, [ROLES.index(role) for role in still])):
            specification.add_sensor(
                type=mujoco.mjtSensor.mjSENS_CONTACT,
                objtype=kind,
                objname=model.body(body).name,
                reftype=mujoco.mjtObj.mjOBJ_GEOM,
                refname=model.geom(geom).name,
                intprm=net_force,
            )
            groups.append(group)
    return np.array(groups, dtype=int)


def _first_world(array: Any) -> np.ndarray:
    """Returns the first world's row of a Warp array [world, n], shape [n]."""
    return array.numpy()[0]


def _indices_of(values: np.ndarray, wanted: np.ndarray | int) -> np.ndarray:
    """Returns the index in ``values`` of each of ``wanted``, in the shape of ``wanted``."""
    return np.argmax(values == np.asarray(wanted)[..., None], axis=-1)


def _at_zero(scene: Scene) -> Scene:
    """Returns the scene with the object at the origin and all joint positions zero."""
    robot = replace(scene.robot, start=np.zeros(scene.robot.dof))
    return replace(scene, robot=robot, start=(0.0, 0.0, 0.0))


def _content(scene: Scene) -> str:
    """Returns a hash of everything that determines the MuJoCo model: scene, options set here, package versions."""
    still = _at_zero(scene)
    sources = source_content("physics", "geometry", "observation.py")
    parts = (still.robot, still.object, still.table, still.obstacles, still.gravity)
    return content_of_data(sources, version("newton"), version("mujoco"), version("warp-lang"), *parts)


def _save(made: MujocoModel, file: Path) -> None:
    """Writes a translated model to one file."""
    import mujoco

    compiled = np.zeros(mujoco.mj_sizeModel(made.model), dtype=np.uint8)
    mujoco.mj_saveModel(made.model, None, compiled)
    places = {field.name: getattr(made, field.name) for field in fields(made) if field.name != "model"}
    store_arrays(file, {"model": compiled, **places})


def _load(file: Path) -> MujocoModel:
    """Reads a file written by :func:`_save`."""
    import mujoco

    with np.load(file) as saved:
        arrays = dict(saved)
    touch(file)
    model = mujoco.MjModel.from_binary_path("model.mjb", {"model.mjb": arrays.pop("model").tobytes()})
    return MujocoModel(model=model, **arrays)
