"""The Newton engine on the CPU: Newton's model of a scene, rolled out by MuJoCo's C threads and scored in place."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import Any

import numpy as np
import warp as wp

from oimppi_warp.compute.step import Launch
from oimppi_warp.geometry.footprint import rotation_matrix
from oimppi_warp.kernels.rollouts.threads import make_expand_controls, read_forces
from oimppi_warp.observation import Observation, planar_pose, planar_transform
from oimppi_warp.physics.mujoco_model import MujocoModel
from oimppi_warp.physics.newton_model import MIN_FRICTION, ROLES
from oimppi_warp.physics.world import World
from oimppi_warp.planning.engines.dynamics import RolloutTask, control_type
from oimppi_warp.planning.engines.newton import NewtonDynamics, contact_softness
from oimppi_warp.planning.engines.uncertainty import Draws
from oimppi_warp.scene import Scene


class NewtonThreads(NewtonDynamics):
    """Rollouts on MuJoCo's C threads; see :class:`oimppi_warp.planning.engines.newton.NewtonDynamics`.

    MuJoCo's states and sensor readings are scored in place. Every plan begins with the same solver state, so that plans
    do not depend on earlier ones.

    Attributes:
        model: The model of the first draw.
    """

    one_graph = False

    def __init__(self, task: RolloutTask) -> None:
        import mujoco
        from mujoco import rollout

        super().__init__(task)
        draws, level, threads = task.draws, task.level, task.compute.threads
        mapped = World(task.scene).mujoco_sensing
        self._map = mapped
        step = task.dt / level.substeps
        models = [model_in_draw(mapped, task.scene, draws, i, step=step) for i in range(draws.count)]
        self.model = models[0]
        self._models = [models[r % draws.count] for r in range(self._rollouts)]
        self._threads = rollout.Rollout(nthread=threads if threads > 1 else 0)
        self._data = [mujoco.MjData(self.model) for _ in range(threads)]

        steps = self._horizon * level.substeps
        full = mujoco.mjtState.mjSTATE_FULLPHYSICS
        width = mujoco.mj_stateSize(self.model, full)
        begin = np.zeros(width)
        mujoco.mj_getState(self.model, self._data[0], begin, full)
        self._first = np.tile(begin, (self._rollouts, 1))
        self._warm_start = np.zeros((self._rollouts, self.model.nv))
        self._drives = np.zeros((self._rollouts, steps, self.model.nu))
        self._states = np.zeros((self._rollouts, steps, width))
        self._sensed = np.zeros((self._rollouts, steps, self.model.nsensordata))
        self._joints = wp.zeros(1, dtype=control_type(self.size), device="cpu")

    def set_state(self, observation: Observation, goal: np.ndarray) -> None:
        """Sets the state to plan from; see :class:`oimppi_warp.planning.engines.dynamics.RobotDynamics`."""
        super().set_state(observation, goal)
        self._joints.numpy()[0] = observation.joint_position
        qpos, qvel = 1, 1 + self.model.nq  # the time comes first
        self._first[:, qpos + self._map.joint_qpos] = observation.joint_position
        self._first[:, qvel + self._map.joint_qvel] = observation.joint_velocity
        for r, error in enumerate(self._draws.pose):
            transform = observation.object_transform
            if error.any():
                seen = planar_pose(transform) + error
                transform = planar_transform((seen[0], seen[1], seen[2]), transform[2])
            self._first[r :: self._draws.count, qpos + self._map.object_qpos] = transform[[0, 1, 2, 6, 3, 4, 5]]

    def simulate(self, controls: wp.array) -> Sequence[Launch]:
        """Prepares rolling out; see :class:`oimppi_warp.planning.engines.newton.NewtonDynamics`."""
        substeps, dt = self.task.level.substeps, self.task.dt
        drive = wp.array(self._map.joint_drive, dtype=int, device="cpu")
        expand = self.compute.launch_samples(
            make_expand_controls(self.size),
            self._rollouts,
            [controls, self._draws.per_sample, self._joints, self._packed.arm, dt, substeps, drive],
            [wp.array(self._drives, dtype=wp.float64, device="cpu", copy=False)],
        )
        sensed = wp.array(self._sensed, dtype=wp.float64, device="cpu", copy=False)
        group = wp.array(self._map.sensors, dtype=int, device="cpu")
        times = _view(self._states[:, -1, 0], wp.float64)
        end = (self._horizon - 0.5 / substeps) * dt
        feel = self.compute.launch_samples(
            read_forces, self._rollouts, [sensed, group, substeps, times, end], [self.forces, self._lost]
        )
        return [expand, self._roll, feel]

    def states(self) -> tuple[wp.array, wp.array, Any]:
        """Returns the states after each step; see :class:`oimppi_warp.planning.engines.newton.NewtonDynamics`."""
        substeps = self.task.level.substeps
        after = self._states[:, substeps - 1 :: substeps]
        parts = []
        for places in (self._map.joint_qpos, self._map.object_qpos):
            begin = 1 + int(places[0])  # the time comes first
            parts.append(
                _view(after[:, :, begin : begin + len(places)], wp.types.vector(length=len(places), dtype=wp.float64))
            )
        return parts[0], parts[1], wp.float64

    def _roll(self) -> None:
        """Runs all rollouts on MuJoCo's threads."""
        self._threads.rollout(
            self._models,
            self._data,
            self._first,
            self._drives,
            skip_checks=True,
            nstep=self._states.shape[1],
            initial_warmstart=self._warm_start,
            state=self._states,
            sensordata=self._sensed,
        )


def _view(array: np.ndarray, dtype: Any) -> wp.array:
    """Wraps a NumPy array as a Warp array over the same memory; its last axis forms vectors, if ``dtype`` is one."""
    dimensions = array.ndim - (dtype is not wp.float64)
    return wp.array(
        ptr=array.__array_interface__["data"][0],
        dtype=dtype,
        shape=array.shape[:dimensions],
        strides=array.strides[:dimensions],
        device="cpu",
    )


def model_in_draw(mapped: MujocoModel, scene: Scene, draws: Draws, index: int, *, step: float) -> Any:
    """Returns a copy of the scene's MuJoCo model with a step length [s] and the parameters of one of the draws."""
    import mujoco

    model = copy(mapped.model)
    model.opt.timestep = step
    model.geom_solref[:, 0], model.geom_solimp[:, 2] = contact_softness(step)
    tool, pushed = (mapped.roles == ROLES.index(role) for role in ("tool", "object"))
    model.geom_friction[~tool & ~pushed, 0] *= draws.friction[index]
    model.geom_friction[tool, 0] = max(scene.object.tool_friction * draws.tool_friction[index], MIN_FRICTION)
    body = int(mapped.object_body)
    model.body_mass[body] *= draws.mass[index]
    model.body_inertia[body] *= draws.mass[index]
    across = rotation_matrix(scene.robot.tip[3:]) @ np.append(draws.tool[index], 0.0)
    model.geom_pos[tool] += across
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model
