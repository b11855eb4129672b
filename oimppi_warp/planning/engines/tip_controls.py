"""Velocities of the tip as the controls of an engine that takes joint velocities."""

from __future__ import annotations

import numpy as np
import warp as wp

from oimppi_warp.compute.step import Launch, in_order
from oimppi_warp.geometry.fields import to_center
from oimppi_warp.geometry.kinematics import pack_arm, tip_frame
from oimppi_warp.kernels.joint_controls import make_joint_controls
from oimppi_warp.observation import Observation
from oimppi_warp.planning.engines.dynamics import RobotDynamics, control_type
from oimppi_warp.planning.engines.packing import environment, object_model, tip_bound, velocity_bound


class TipControls:
    """An engine with velocities of the tip [m/s] as its controls, which a kernel converts to joint velocities.

    The conversion follows the arm's postures (``geometry/postures.py``) as the servo of the arm does, with the object
    where it is now. It has the part of the interface of :class:`RobotDynamics` that depends on the controls.

    Args:
        engine: The engine; its task has the upright arm.
    """

    size = 3

    def __init__(self, engine: RobotDynamics) -> None:
        task = engine.task
        assert task.upright is not None, "the task has no upright arm"
        self._engine = engine
        self.compute = task.compute
        self.bound = tip_bound(task.level)
        device, dof = self.compute.device, task.scene.robot.dof
        vec = control_type(dof)
        self._kernel = make_joint_controls(dof)
        self._world = [
            pack_arm(task.scene.robot, velocity_bound(task.scene, task.level), device),
            environment(task.scene, task.geometry, task.cost),
            task.upright.packed,
            object_model(task.geometry, tool_friction=task.scene.object.tool_friction),
        ]
        postures = task.upright.postures.joints.astype(np.float32)
        self._postures = wp.array(postures, dtype=vec, device=device)
        self._start_joints = self.compute.input(1, vec)
        self._start = self.compute.input(2, wp.vec3)  # the tip's position, and the object's pose
        self._joints = wp.zeros((task.level.optimizer.samples, task.level.optimizer.horizon), dtype=vec, device=device)

    def set_state(self, observation: Observation, goal: np.ndarray) -> None:
        """Sets the state to plan from; see :meth:`RobotDynamics.set_state`."""
        self._engine.set_state(observation, goal)
        task = self._engine.task
        self._start_joints.host[0] = observation.joint_position
        self._start.host[0] = tip_frame(task.scene.robot, observation.joint_position)[1]
        self._start.host[1] = to_center(task.geometry.surface, observation.object_pose)

    def rollout(self, controls: wp.array, costs: wp.array) -> Launch:
        """Returns a launch that writes the cost of each sequence of tip velocities, [sample, horizon] of vectors."""
        return in_order([self._convert(controls, self._joints), self._engine.rollout(self._joints, costs)])

    def trace(self, nominal: wp.array, costs: wp.array) -> Launch:
        """Returns a launch that writes the engine's trace; see :meth:`RobotDynamics.trace`."""
        joints = wp.zeros((1, nominal.shape[0]), dtype=self._joints.dtype, device=self.compute.device)
        convert = self._convert(nominal.reshape((1, nominal.shape[0])), joints)
        return in_order([convert, self._engine.trace(joints.reshape(nominal.shape[0]), costs)])

    def paths(self, controls: wp.array, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the traces of some samples of the latest rollout; see :meth:`RobotDynamics.paths`."""
        return self._engine.paths(self._joints, samples)

    def _convert(self, controls: wp.array, joints: wp.array) -> Launch:
        """Prepares the conversion to joint velocities, [sample, horizon] of vectors [dof]."""
        task = self._engine.task
        starts = [self._start_joints.array, self._start.array]
        inputs = [*self._world, self._postures, *starts, self._engine.waypoint.array, controls, task.dt]
        return self.compute.launch_samples(self._kernel, controls.shape[0], inputs, [joints])
