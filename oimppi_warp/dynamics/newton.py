"""Robot level on full physics: what the engines on Newton's model of a scene have in common.

An engine rolls out and leaves three arrays; their costs, the cheapest sample's trace and what several draws of the
world make of a cost are the same for all.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from oimppi_warp.clearance import Geometry, to_center
from oimppi_warp.compute import Compute, Launch
from oimppi_warp.config import RobotCost, RobotLevel
from oimppi_warp.dynamics.base import Trace, control_type
from oimppi_warp.dynamics.packing import no_field, object_model, robot_weights, surroundings, velocity_bound
from oimppi_warp.kernels.cost import TERMS, CostTerms
from oimppi_warp.kernels.geometry import PoseField
from oimppi_warp.kernels.stage import make_stage_costs, pick_trace
from oimppi_warp.kernels.uncertainty import combine_costs
from oimppi_warp.kinematics import pack_arm, tip_frame
from oimppi_warp.observation import Observation
from oimppi_warp.scene import Scene
from oimppi_warp.uncertainty import CERTAIN, Draws

SOFTEST_STEP = 0.005
"""Longest step of the physics [s] at which contacts set in as the plant's do."""


def contact_softness(step: float) -> tuple[float, float]:
    """How contacts give at a length of step: the time constant ``solref`` [s], and the depth [m] at which it is full.

    Contacts that set in within less than what an object moves in a step chatter, and chatter costs it its friction.
    The depth therefore grows with the square of the step. So a pushed T goes as far at steps of 17 ms as at 2.5 ms,
    within 4 % (tests/test_newton.py).
    """
    return max(0.02, 2.0 * step), 0.0005 * max(step / SOFTEST_STEP, 1.0) ** 2


class NewtonDynamics(ABC):
    """Arm, contact and object in Newton's model of the scene; controls are joint velocities [rad/s].

    Args:
        scene: The task.
        geometry: Its shapes.
        level: Settings of the robot level.
        cost: Its weights.
        dt: Control period [s].
        compute: Where to compute.
        draws: Worlds that the rollouts are in.
        to_go: Cost-to-go of the object [m], where its weight is not zero.

    Attributes:
        forces: lambda_2 and lambda_3 of the latest rollouts, [rollout, horizon] [N].
        tips, poses: Tool tip and object (friction centre) after each control step in them, [rollout, horizon].
    """

    terms: tuple[str, ...] = TERMS
    one_graph: bool

    def __init__(
        self,
        scene: Scene,
        geometry: Geometry,
        level: RobotLevel,
        cost: RobotCost,
        *,
        dt: float,
        compute: Compute,
        draws: Draws = CERTAIN,
        to_go: PoseField | None = None,
    ) -> None:
        self.compute = compute
        self.size = scene.robot.dof
        self.bound = velocity_bound(scene, level)
        self._scene = scene
        self._level = level
        self._dt = dt
        self._draws = draws
        self._surface = geometry.surface
        self._align_ahead = cost.align_ahead
        device = compute.device
        self._arm = pack_arm(scene.robot, self.bound, device)
        self._model = object_model(geometry, tool_friction=scene.object.tool_friction)
        self._surroundings = surroundings(scene, geometry, cost)
        self._weights = robot_weights(scene, geometry, cost)

        self._horizon = level.optimizer.horizon
        self._rollouts = level.optimizer.samples * draws.per_sample
        self._start_joints = compute.input(1, control_type(self.size))
        self._goal = compute.input(1, wp.vec3)
        self.reference = compute.input(self._horizon + 1 + cost.align_ahead, wp.vec3)
        self.guide = compute.input(1, wp.vec4)
        self._to_go = no_field(device) if to_go is None else to_go
        size = (self._rollouts, self._horizon)
        self.forces = wp.zeros(size, dtype=wp.vec2, device=device)
        self.tips = wp.zeros(size, dtype=wp.vec3, device=device)
        self.poses = wp.zeros(size, dtype=wp.vec3, device=device)
        self._lost = wp.zeros(self._rollouts, dtype=int, device=device)
        self._rolled = wp.zeros(self._rollouts, dtype=float, device=device)
        self._terms = wp.zeros(self._rollouts, dtype=CostTerms, device=device)
        self._trace_terms = compute.output(1, CostTerms)
        self._trace_tips = compute.output(self._horizon, wp.vec3)
        self._trace_poses = compute.output(self._horizon, wp.vec3)
        self._start = np.zeros(3), np.zeros(3)

    def paths(self, controls: wp.array, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`oimppi_warp.dynamics.base.RobotDynamics`; of a sample's rollouts the first is taken."""
        rollouts = np.asarray(samples) * self._draws.per_sample
        return self.tips.numpy()[rollouts], self._terms.numpy()[rollouts]

    @abstractmethod
    def simulate(self, controls: wp.array) -> Sequence[Launch]:
        """Prepares rolling out control sequences [sample, horizon], each in ``draws.per_sample`` rollouts.

        The launches fill ``forces``, ``_lost`` and the arrays that :meth:`states` returns.
        """

    @abstractmethod
    def states(self) -> tuple[wp.array, wp.array, Any]:
        """States after each control step, and their precision.

        Returns:
            Joint positions [rollout, horizon] of vectors [dof], the object (position, quaternion wxyz)
            [rollout, horizon] of vectors [7], and the type of their numbers.
        """

    def set_state(self, observation: Observation, goal: np.ndarray) -> None:
        """The state to plan from; see :class:`oimppi_warp.dynamics.base.RobotDynamics`."""
        self._start_joints.host[0] = observation.joint_position
        self._goal.host[0] = goal
        _, tip = tip_frame(self._scene.robot, observation.joint_position)
        self._start = tip, to_center(self._surface, observation.object_pose)

    def rollout(self, controls: wp.array, costs: wp.array) -> Launch:
        """Prepares the cost of each joint velocity sequence; see :class:`oimppi_warp.dynamics.base.Dynamics`.

        Args:
            controls: [sample, horizon] of vectors [dof], as many as the level has samples.
            costs: [sample], written.
        """
        draws = self._draws
        joints, objects, precision = self.states()
        inputs = [
            self._arm,
            self._model,
            self._surroundings,
            self._weights,
            wp.vec2(*self._surface.center),
            self._goal.array,
            self.reference.array,
            self.guide.array,
            self._to_go,
            self._align_ahead,
            controls,
            self._dt,
            self._start_joints.array,
            draws.per_sample,
            joints,
            objects,
            self.forces,
            self._lost,
        ]
        rolled = costs if draws.per_sample == 1 else self._rolled
        outputs = [rolled, self._terms, self.tips, self.poses]
        kernel = make_stage_costs(self._scene.robot.chain, precision)
        launches = [*self.simulate(controls), self.compute.launch_samples(kernel, self._rollouts, inputs, outputs)]
        if draws.per_sample > 1:
            inputs = [rolled, draws.per_sample, draws.worst]
            launches.append(self.compute.launch_samples(combine_costs, controls.shape[0], inputs, [costs]))

        def roll() -> None:
            for launch in launches:
                launch()

        return roll

    def trace(self, nominal: wp.array, costs: wp.array) -> Launch:
        """Prepares what the cheapest sample led to: to roll out the nominal too would take as long as the plan."""
        inputs = [costs, self._draws.per_sample, self._terms, self.tips, self.poses]
        outputs = [self._trace_terms.array, self._trace_tips.array, self._trace_poses.array]
        return self.compute.launch_blocks(pick_trace, None, inputs, outputs)

    def traced(self) -> Trace:
        """What the cheapest sample led to."""
        tip, pose = self._start
        tips = np.vstack([tip, self._trace_tips.host])
        poses = np.vstack([pose, self._trace_poses.host])
        return Trace(tips, poses, self._trace_terms.host[0].astype(float))
