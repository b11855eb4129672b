"""The Newton engine on Warp's devices: as many Newton worlds as rollouts, stepped together.

It is made for CUDA, where a whole plan is one graph. On Warp's CPU device it runs on one thread and takes seconds;
there it serves as the reference for the other engines.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from oimppi_warp.compute.device import free_memory
from oimppi_warp.compute.step import Launch
from oimppi_warp.errors import DeviceError, SceneError
from oimppi_warp.geometry.footprint import rotation_matrix
from oimppi_warp.kernels.rollouts.worlds import (
    Places,
    Transform,
    feel_contacts,
    make_drive_worlds,
    make_place_worlds,
    take_forces,
)
from oimppi_warp.observation import Observation
from oimppi_warp.physics.mujoco_model import SENSED, map_model
from oimppi_warp.physics.newton_model import MIN_FRICTION, ROLES, SOLVER_OPTIONS, NewtonModel, build_model
from oimppi_warp.planning.engines.dynamics import RolloutTask, control_type
from oimppi_warp.planning.engines.newton import NewtonDynamics, contact_softness
from oimppi_warp.planning.engines.uncertainty import Draws
from oimppi_warp.scene import Scene

_POINTS = 8
"""Largest number of contact points of two convex shapes."""
_LIMIT_ROWS = 24
"""Constraint rows beside those of contacts: joint limits, and some headroom."""
SCRATCH_PER_CONTACT = 6640
"""Temporary memory of MuJoCo Warp's convex collisions per contact that a world has room for [B]; measured."""


class NewtonWorlds(NewtonDynamics):
    """Rollouts in batched Newton worlds; see :class:`oimppi_warp.planning.engines.newton.NewtonDynamics`.

    The worlds are Newton's. MuJoCo Warp steps them directly on the solver's data, since ``SolverMuJoCo.step`` would
    copy Newton's state in and out at every physics step.

    Args:
        task: The task to plan.
        contacts: Capacity for contact points per world, averaged over the worlds; ``None``: estimated from the scene.

    Attributes:
        solver: Newton's solver.

    Raises:
        DeviceError: The device has too little free memory for so many worlds.
        SceneError: In :meth:`check`, if a world ran out of memory for contacts or constraints.
    """

    one_graph = True

    def __init__(self, task: RolloutTask, *, contacts: int | None = None) -> None:
        super().__init__(task)
        from newton.solvers import SolverMuJoCo

        mujoco, self._mujoco_warp = SolverMuJoCo.import_mujoco()
        compute, device, level = task.compute, task.compute.device, task.level
        worlds = self._rollouts
        built = build_model(task.scene, worlds=worlds, device=device)
        _change(built, task.scene, task.draws, worlds)
        contacts = contact_room(built.roles) if contacts is None else contacts
        self.solver = SolverMuJoCo(
            built.model, nconmax=contacts, njmax=3 * contacts + _LIMIT_ROWS, separate_worlds=True, **SOLVER_OPTIONS
        )
        _check_memory(worlds * contacts, worlds, device)
        self._map = map_model(self.solver, built)
        model = self.solver.mjw_model
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)  # forces are read off the constraints
        model.jnt_actfrclimited.assign(self._map.model.jnt_actfrclimited.astype(bool))
        step = task.dt / level.substeps
        model.opt.timestep.fill_(step)
        time_constant, depth = contact_softness(step)
        for array, place, value in ((model.geom_solref, 0, time_constant), (model.geom_solimp, 2, depth)):
            values = array.numpy().copy()
            values[..., place] = value
            array.assign(values)

        vec = control_type(self.size)
        size = (worlds, self._horizon)
        self._seen = [compute.input(1, vec), compute.input(1, vec), compute.input(1, Transform)]
        self._joints = wp.zeros(size, dtype=vec, device=device)
        self._objects = wp.zeros(size, dtype=Transform, device=device)
        self._sensed = wp.zeros((worlds, self._horizon * level.substeps), dtype=wp.vec2, device=device)
        self._overflows = compute.output(1, int)

    def set_state(self, observation: Observation, goal: np.ndarray) -> None:
        """Sets the state to plan from; see :class:`oimppi_warp.planning.engines.dynamics.RobotDynamics`."""
        super().set_state(observation, goal)
        joints, velocities, pushed = self._seen
        joints.host[0] = observation.joint_position
        velocities.host[0] = observation.joint_velocity
        pushed.host[0] = observation.object_transform[[0, 1, 2, 6, 3, 4, 5]]

    def simulate(self, controls: wp.array) -> Sequence[Launch]:
        """Prepares rolling out; see :class:`oimppi_warp.planning.engines.newton.NewtonDynamics`."""
        launch, device, worlds, substeps = (
            self.compute.launch,
            self.compute.device,
            self._rollouts,
            self.task.level.substeps,
        )
        model, data = self.solver.mjw_model, self.solver.mjw_data
        places = Places()
        places.joint_qpos, places.joint_qvel, places.drive = (
            wp.array(each, dtype=int, device=device)
            for each in (self._map.joint_qpos, self._map.joint_qvel, self._map.joint_drive)
        )
        places.object_qpos = int(self._map.object_qpos[0])
        errors = wp.array(self._draws.pose.astype(np.float32), dtype=wp.vec3, device=device)
        state = [slot.array for slot in self._seen]
        place = launch(
            make_place_worlds(self.size),
            worlds,
            [*state, errors, places],
            [data.qpos, data.qvel, data.qacc_warmstart, data.overflow],
        )
        group = wp.array(_groups(self._map.roles), dtype=int, device=device)
        contact = data.contact

        def step() -> None:
            with wp.ScopedDevice(device):
                self._mujoco_warp.step(model, data)

        step()  # loads the solver's kernels, as none should be loaded while a graph is captured
        launches: list[Launch] = [self._sensed.zero_, self._overflows.array.zero_, place]
        for h in range(self._horizon + 1):
            inputs = [h, controls, self._draws.per_sample, self._packed.arm, self.task.dt, places, data.qpos]
            launches.append(
                launch(make_drive_worlds(self.size), worlds, inputs, [data.ctrl, self._joints, self._objects])
            )
            for s in range(substeps if h < self._horizon else 0):
                inputs = [h * substeps + s, data.nacon, contact.geom, contact.worldid, contact.efc_address]
                inputs += [data.efc.force, group]
                launches += [step, launch(feel_contacts, data.naconmax, inputs, [self._sensed])]
        inputs = [self._sensed, substeps, data.qpos, data.overflow]
        outputs = [self.forces, self._lost, self._overflows.array]
        return [*launches, launch(take_forces, worlds, inputs, outputs)]

    def states(self) -> tuple[wp.array, wp.array, Any]:
        """Returns the states after each step; see :class:`oimppi_warp.planning.engines.newton.NewtonDynamics`."""
        return self._joints, self._objects, wp.float32

    def check(self) -> None:
        """Checks that the worlds had enough memory.

        Raises:
            SceneError: A world ran out of memory for contacts or constraints.
        """
        bits = int(self._overflows.host[0]) & _grave_overflows()
        if bits:
            data = self.solver.mjw_data
            raise SceneError(
                "the Newton engine ran out of contact memory: this scene needs more than the "
                f"{data.naconmax // data.nworld} contact points and {data.njmax} constraint rows reserved per world "
                f"(overflow flags {bits:#x})",
                file=self.task.scene.file,
                fix="use --engine quasistatic, or simplify the collision shapes",
            )


def contact_room(roles: np.ndarray) -> int:
    """Estimates the contact points per world: the object flat on the table and against obstacles, the arm on both.

    Args:
        roles: Each shape's role, shape [shape].
    """
    counts = {role: int(np.sum(roles == i)) for i, role in enumerate(ROLES)}
    still = counts["obstacle"] + counts["base"]
    pushed = counts["object"] * (1 + min(still, 3) + counts["tool"])
    arm = (counts["arm"] + counts["tool"]) * 2
    return _POINTS * pushed + arm


def _check_memory(contacts: int, worlds: int, device: str) -> None:
    """Raises DeviceError if there is too little memory for the temporary arrays of a step, nearly all that it takes."""
    needed, free = contacts * SCRATCH_PER_CONTACT, free_memory(device)
    if needed > free:
        raise DeviceError(
            f"robot.optimizer.samples={worlds}: the Newton engine needs {needed / 1e9:.1f} GB more on {device}, where "
            f"{free / 1e9:.1f} GB are free\n  allowed: at most {worlds * free // needed} samples"
        )


def _change(built: NewtonModel, scene: Scene, draws: Draws, worlds: int) -> None:
    """Sets the parameters of each world of a Newton model to those of its draw."""
    if draws.count == 1:
        return
    model = built.model
    which = np.arange(worlds) % draws.count
    roles = built.roles
    tool, pushed = (roles == ROLES.index(role) for role in ("tool", "object"))

    friction = model.shape_material_mu.numpy().reshape(worlds, -1).copy()
    friction[:, ~tool & ~pushed] *= draws.friction[which, None]
    of_tool = np.maximum(scene.object.tool_friction * draws.tool_friction[which], MIN_FRICTION)
    friction[:, tool] = of_tool[:, None]
    model.shape_material_mu.assign(friction.ravel())

    factor = draws.mass[which].astype(np.float32)
    for array, power in ((model.body_mass, 1), (model.body_inertia, 1), (model.body_inv_mass, -1),
                         (model.body_inv_inertia, -1)):  # fmt: skip
        values = array.numpy().copy()
        grouped = values.reshape(worlds, -1, *values.shape[1:])
        grouped[:, built.object_body] *= (factor**power).reshape(-1, *[1] * (grouped.ndim - 2))
        array.assign(values)

    across = np.column_stack([draws.tool[which], np.zeros(worlds)]) @ rotation_matrix(scene.robot.tip[3:]).T
    transforms = model.shape_transform.numpy().copy()
    transforms.reshape(worlds, -1, 7)[:, tool, :3] += across[:, None]
    model.shape_transform.assign(transforms)


def _groups(roles: np.ndarray) -> np.ndarray:
    """Returns the group of each pair of geoms, an index of :data:`SENSED` or -1, shape [geom, geom]."""
    groups = np.full((len(roles), len(roles)), -1)
    for index, (moving, still) in enumerate(SENSED):
        a, b = (np.isin(roles, [ROLES.index(role) for role in names]) for names in (moving, still))
        groups[(a[:, None] & b) | (b[:, None] & a)] = index
    return groups


def _grave_overflows() -> int:
    """Returns the overflow bits that mean lost contacts or constraints; a solver that stopped early is not one."""
    from mujoco_warp import OverflowType

    return int(OverflowType.ALL & ~(OverflowType.ITERATIONS | OverflowType.LS_ITERATIONS))
