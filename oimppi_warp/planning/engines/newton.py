"""Base of the robot level engines that roll out Newton's model of a scene, with full physics.

An engine rolls out and fills three arrays. All engines share how these are scored, how the cheapest sample's trace is
taken, and how the costs of several draws of the world are combined.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from oimppi_warp.compute.step import Launch, in_order
from oimppi_warp.geometry.fields import to_center
from oimppi_warp.kernels.rollouts.scoring import PhysicsOutcome, make_pick_trace, make_stage_costs
from oimppi_warp.kernels.rollouts.uncertainty import combine_costs
from oimppi_warp.observation import Observation
from oimppi_warp.planning.engines.dynamics import RolloutTask, Trace, control_type
from oimppi_warp.planning.engines.scored import ScoredDynamics

SOFTEST_STEP = 0.005
"""Longest physics step [s] at which contacts are as soft as the plant's."""


def contact_softness(step: float) -> tuple[float, float]:
    """Returns the softness of contacts for a step length: time constant ``solref`` [s], depth of full impedance [m].

    Contacts that reach full impedance within less than the distance an object moves in a step chatter, and a chattering
    object loses its friction. The depth therefore grows with the square of the step. A pushed T then moves as far with
    steps of 17 ms as with 2.5 ms, within 4 % (tests/planning/engines/test_newton.py).
    """
    return max(0.02, 2.0 * step), 0.0005 * max(step / SOFTEST_STEP, 1.0) ** 2


class NewtonDynamics(ScoredDynamics):
    """Arm, contact and object in Newton's model of the scene; controls are joint velocities.

    MuJoCo steps the arm (``x_r <- f_r + g_r u_r + h_r w_r``, equation 1) and the object (``x_o <- f_o + h_o w_o``,
    equation 2) under the contact forces between them and with the environment, friction included (equation 3). Forces
    act only in contact and nothing overlaps (equation 4), up to the softness of the contacts.

    Args:
        task: The task to plan.

    Attributes:
        forces: lambda_2 and lambda_3 of the latest rollouts, shape [rollout, horizon] of vectors [2] [N].
        tips: Position of the tool tip after each control step in them, shape [rollout, horizon] of vectors [3] [m].
        poses: Planar pose of the object's friction centre, likewise, shape [rollout, horizon] of vectors [3]
            [m, m, rad].
    """

    def __init__(self, task: RolloutTask) -> None:
        super().__init__(task)
        compute, device = task.compute, task.compute.device
        self._draws = task.draws
        self._horizon = task.level.optimizer.horizon
        self._rollouts = task.level.optimizer.samples * task.draws.per_sample
        self._start_joints = compute.input(1, control_type(self.size))
        size = (self._rollouts, self._horizon)
        self.forces = wp.zeros(size, dtype=wp.vec2, device=device)
        self.tips = wp.zeros(size, dtype=wp.vec3, device=device)
        self.poses = wp.zeros(size, dtype=wp.vec3, device=device)
        self._lost = wp.zeros(self._rollouts, dtype=int, device=device)
        self._rolled = wp.zeros(self._rollouts, dtype=float, device=device)
        self._terms = wp.zeros(self._rollouts, dtype=self._terms_type, device=device)
        self._trace_terms = compute.output(1, self._terms_type)
        self._trace_tips = compute.output(self._horizon, wp.vec3)
        self._trace_poses = compute.output(self._horizon, wp.vec3)

    def paths(self, controls: wp.array, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the traces of some samples of the latest rollouts, each from its first rollout.

        ``controls`` is not used. The tool tips, shape [n, horizon, 3] [m], leave out the current tip; see
        :class:`RobotDynamics`.
        """
        rollouts = np.asarray(samples) * self._draws.per_sample
        return self.tips.numpy()[rollouts], self._terms.numpy()[rollouts]

    @abstractmethod
    def simulate(self, controls: wp.array) -> Sequence[Launch]:
        """Prepares the rollouts of control sequences, ``draws.per_sample`` for each.

        The launches fill ``forces``, ``_lost`` and the arrays that :meth:`states` returns.

        Args:
            controls: Joint velocities, shape [sample, horizon] of vectors [dof] [rad/s; m/s for a prismatic joint].
        """

    @abstractmethod
    def states(self) -> tuple[wp.array, wp.array, Any]:
        """Returns the arrays that hold the states after each control step, and their precision.

        Returns:
            Joint positions, shape [rollout, horizon] of vectors [dof] [rad; m for a prismatic joint]; transforms of the
            object's own frame in the world (position [m], quaternion wxyz), shape [rollout, horizon] of vectors [7];
            and the type of their numbers, ``wp.float32`` or ``wp.float64``.
        """

    def set_state(self, observation: Observation, goal: np.ndarray) -> None:
        """Sets the state to plan from; see :class:`RobotDynamics`."""
        super().set_state(observation, goal)
        self._start_joints.host[0] = observation.joint_position

    def rollout(self, controls: wp.array, costs: wp.array) -> Launch:
        """Returns a launch that writes the cost of each joint velocity sequence; see :class:`Dynamics`.

        The launch also fills :attr:`forces`, :attr:`tips` and :attr:`poses`.

        Args:
            controls: Joint velocities, shape [sample, horizon] of vectors [dof] [rad/s; m/s for a prismatic joint]; as
                many samples as the level has.
            costs: Costs, shape [sample]; written.
        """
        draws = self._draws
        joints, objects, precision = self.states()
        outcome = PhysicsOutcome()
        outcome.forces, outcome.lost = self.forces, self._lost
        inputs = [self._packed, controls, draws.per_sample, self._start_joints.array, joints, objects, outcome]
        rolled = costs if draws.per_sample == 1 else self._rolled
        outputs = [rolled, self._terms, self.tips, self.poses]
        kernel = make_stage_costs(self.task.scene.robot.chain, precision, self._extra)
        launches = [*self.simulate(controls), self.compute.launch_samples(kernel, self._rollouts, inputs, outputs)]
        if draws.per_sample > 1:
            inputs = [rolled, draws.per_sample, draws.worst]
            launches.append(self.compute.launch_samples(combine_costs, controls.shape[0], inputs, [costs]))
        return in_order(launches)

    def trace(self, nominal: wp.array, costs: wp.array) -> Launch:
        """Prepares the trace of the cheapest sample; ``nominal`` is not used.

        Rolling out the nominal controls as well would double the time of a plan with batched worlds.
        """
        inputs = [costs, self._draws.per_sample, self._terms, self.tips, self.poses]
        outputs = [self._trace_terms.array, self._trace_tips.array, self._trace_poses.array]
        return self.compute.launch_blocks(make_pick_trace(len(self.terms)), None, inputs, outputs)

    def traced(self) -> Trace:
        """Returns the trace of the cheapest sample."""
        pose = to_center(self.task.geometry.surface, self.observation.object_pose)
        tips = np.vstack([self._tip(), self._trace_tips.host])
        poses = np.vstack([pose, self._trace_poses.host])
        return Trace(tips, poses, self._trace_terms.host[0].astype(float))
