"""Base of the robot level engines whose stage costs are computed by the package's kernels."""

from __future__ import annotations

import numpy as np
import warp as wp

from oimppi_warp.geometry.kinematics import pack_arm
from oimppi_warp.kernels.costs.stage_costs import TERMS, terms_vector
from oimppi_warp.kernels.task import RobotTask
from oimppi_warp.observation import Observation
from oimppi_warp.planning.engines.cost_terms import weighted_terms
from oimppi_warp.planning.engines.dynamics import RobotDynamics, RolloutTask
from oimppi_warp.planning.engines.packing import environment, no_field, object_model, robot_weights, velocity_bound
from oimppi_warp.planning.stance import build_stance, no_stance
from oimppi_warp.planning.upright import no_upright


class ScoredDynamics(RobotDynamics):
    """An engine whose stage costs are those of ``kernels/costs`` and of the registered terms with a weight.

    Args:
        task: The task to plan.
    """

    def __init__(self, task: RolloutTask) -> None:
        super().__init__(task)
        device, scene, geometry = task.compute.device, task.scene, task.geometry
        added = weighted_terms(task.cost)
        self.terms = (*TERMS, *(term.name for term in added))
        self._extra = tuple((term.name, term.function) for term in added)
        self._terms_type = terms_vector(len(added))
        self._goal = task.compute.input(1, wp.vec3)
        self._model = object_model(geometry, tool_friction=scene.object.tool_friction)
        weights = robot_weights(scene, geometry, task.cost)
        weights.extra = wp.array([term.weight for term in added], dtype=float, device=device)
        packed = RobotTask()
        packed.arm = pack_arm(scene.robot, velocity_bound(scene, task.level), device)
        packed.upright = no_upright(device) if task.upright is None else task.upright.packed
        packed.model = self._model
        packed.environment = environment(scene, geometry, task.cost)
        packed.weights = weights
        packed.to_go = no_field(device) if task.to_go is None else task.to_go
        packed.yaw_length = task.yaw_length
        packed.stance = no_stance(device)
        if task.cost.w_stance > 0.0:
            packed.stance = build_stance(scene, geometry, task.cost.w_theta, device, threads=task.compute.threads)
        packed.goal = self._goal.array
        packed.reference = self.reference.array
        packed.waypoint = self.waypoint.array
        packed.dt = task.dt
        self._packed = packed

    def set_state(self, observation: Observation, goal: np.ndarray) -> None:
        """Sets the state to plan from, and the goal of the object's friction centre, shape [3] [m, m, rad]."""
        super().set_state(observation, goal)
        self._goal.host[0] = goal
