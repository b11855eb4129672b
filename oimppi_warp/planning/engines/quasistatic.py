"""Robot level on the paper's quasi-static model, fused into one kernel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import warp as wp

from oimppi_warp.compute.step import Launch, in_order
from oimppi_warp.geometry.fields import to_center
from oimppi_warp.kernels.rollouts.quasistatic import make_robot_rollout, make_upright_rollout
from oimppi_warp.kernels.rollouts.uncertainty import Draw, combine_costs
from oimppi_warp.observation import Observation
from oimppi_warp.planning.engines.dynamics import RolloutTask, Trace, control_type
from oimppi_warp.planning.engines.scored import ScoredDynamics
from oimppi_warp.planning.engines.uncertainty import CERTAIN, Draws


class QuasistaticDynamics(ScoredDynamics):
    """Arm, contact and object; controls are joint velocities [rad/s] or, with an upright arm, tip velocities [m/s].

    Args:
        task: The task to plan.
    """

    # Share of task 02's starts with the preset ``best`` (``docs/results.md``).
    known_success: ClassVar[Mapping[str, float]] = {"cloi": 1.0, "soi": 1.0, "mppi": 1.0}
    takes_tip_velocities = True
    one_graph = True

    def __init__(self, task: RolloutTask) -> None:
        super().__init__(task)
        compute, device, horizon = task.compute, task.compute.device, task.level.optimizer.horizon
        self._draws = task.draws
        self._worlds = _pack(task.draws, device)
        self._nominal_world = _pack(CERTAIN, device)
        if self.upright is None:
            self._kernel = make_robot_rollout(task.scene.robot.chain, self._extra)
            self._arm = compute.input(1, control_type(self.size))
        else:
            self._kernel = make_upright_rollout(self._extra)
            self._arm = compute.input(1, wp.vec3)
        self._object = compute.input(1, wp.vec3)
        self._no_terms = wp.zeros(0, dtype=self._terms_type, device=device)
        self._no_poses = wp.zeros((0, 0), dtype=wp.vec3, device=device)
        self._trace_cost = wp.zeros(1, dtype=float, device=device)
        self._trace_terms = compute.output(1, self._terms_type)
        self._trace_tips = compute.output((1, horizon + 1), wp.vec3)
        self._trace_poses = compute.output((1, horizon + 1), wp.vec3)

    def set_state(self, observation: Observation, goal: np.ndarray) -> None:
        """Sets the state to plan from; see :class:`RobotDynamics`."""
        super().set_state(observation, goal)
        self._arm.host[0] = observation.joint_position if self.upright is None else self._tip()
        self._object.host[0] = to_center(self.task.geometry.surface, observation.object_pose)

    def rollout(self, controls: wp.array, costs: wp.array) -> Launch:
        """Returns a launch that writes the cost of each control sequence; see :class:`Dynamics`."""
        if self._draws.per_sample == 1:
            return self.launch(controls, costs, self._no_terms, self._no_poses, self._no_poses, self._worlds)
        rolled = wp.zeros(controls.shape[0] * self._draws.per_sample, dtype=float, device=self.compute.device)
        roll = self.launch(controls, rolled, self._no_terms, self._no_poses, self._no_poses, self._worlds)
        inputs = [rolled, self._draws.per_sample, self._draws.worst]
        return in_order([roll, self.compute.launch_samples(combine_costs, controls.shape[0], inputs, [costs])])

    def trace(self, nominal: wp.array, costs: wp.array) -> Launch:
        """Prepares the rollout of the nominal in the nominal world."""
        controls = nominal.reshape((1, nominal.shape[0]))
        outputs = (self._trace_terms.array, self._trace_tips.array, self._trace_poses.array)
        return self.launch(controls, self._trace_cost, *outputs, self._nominal_world)

    def traced(self) -> Trace:
        """Returns the trace of the nominal."""
        tips, poses, terms = self._trace_tips.host[0], self._trace_poses.host[0], self._trace_terms.host[0]
        return Trace(tips.astype(float), poses.astype(float), terms.astype(float))

    def paths(self, controls: wp.array, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the traces of some samples, rolled out again; see :class:`RobotDynamics`."""
        device, count, steps = self.compute.device, len(samples), controls.shape[1] + 1
        again = wp.array(controls.numpy()[samples], dtype=controls.dtype, device=device)
        costs = wp.zeros(count, dtype=float, device=device)
        terms = wp.zeros(count, dtype=self._terms_type, device=device)
        tips, poses = (wp.zeros((count, steps), dtype=wp.vec3, device=device) for _ in range(2))
        self.launch(again, costs, terms, tips, poses, self._nominal_world)()
        return tips.numpy(), terms.numpy()

    def launch(
        self, controls: wp.array, costs: wp.array, terms: wp.array, tips: wp.array, poses: wp.array, worlds: wp.array
    ) -> Launch:
        """Prepares costs [rollout] of controls [sample, horizon], and terms, tips and poses unless these are empty.

        ``worlds`` are packed draws; there are as many rollouts as costs.
        """
        inputs = [
            self._packed,
            worlds,
            costs.shape[0] // controls.shape[0],
            self.task.level.contact_steps,
            self._arm.array,
            self._object.array,
            controls,
        ]
        return self.compute.launch_samples(self._kernel, costs.shape[0], inputs, [costs, terms, tips, poses])


def _pack(draws: Draws, device: str) -> wp.array:
    """Packs draws for the kernels."""
    packed = np.zeros(draws.count, dtype=Draw.numpy_dtype())  # pyright: ignore
    packed["force"] = draws.friction * draws.mass
    packed["tool_friction"] = draws.tool_friction
    packed["pose"] = draws.pose
    packed["tool"] = draws.tool
    return wp.array(packed, dtype=Draw, device=device)
