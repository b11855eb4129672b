"""Robot level on the paper's quasi-static model, fused into one kernel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from oimppi_warp.clearance import Geometry
from oimppi_warp.config import RobotCost, RobotLevel
from oimppi_warp.dynamics.base import control_type
from oimppi_warp.dynamics.object import object_model
from oimppi_warp.kernels.cost import TERMS, CostTerms, RobotWeights
from oimppi_warp.kernels.quasistatic import Surroundings, make_robot_rollout
from oimppi_warp.kinematics import pack_arm
from oimppi_warp.scene import Scene


@dataclass(frozen=True, eq=False)
class Trace:
    """What one control sequence leads to.

    Attributes:
        tips: Tool tip, shape [horizon + 1, 3] [m].
        poses: Object (friction centre), shape [horizon + 1, 3].
        terms: Weighted cost terms summed over the horizon, in the order of ``TERMS``.
    """

    tips: np.ndarray
    poses: np.ndarray
    terms: np.ndarray


class QuasistaticDynamics:
    """Arm, contact and object; controls are joint velocities [rad/s].

    Args:
        scene: The task.
        geometry: Its shapes.
        level: Settings of the robot level.
        cost: Its weights.
        dt: Control period [s].
        device: Warp device.
    """

    terms = TERMS

    def __init__(
        self, scene: Scene, geometry: Geometry, level: RobotLevel, cost: RobotCost, *, dt: float, device: str
    ) -> None:
        self.device = device
        self.size = scene.robot.dof
        robot_limits = np.array([joint.velocity_limit for joint in scene.robot.joints])
        self.bound = np.minimum(robot_limits, level.joint_velocity_limit)
        self._dt = dt
        self._contact_steps = level.contact_steps
        self._align_ahead = cost.align_ahead
        self._arm = pack_arm(scene.robot, self.bound, device)
        self._model = object_model(geometry, tool_friction=scene.object.tool_friction)
        self._model.clearance = geometry.obstruction  # the table's edge stops nothing
        self._surroundings = Surroundings()
        self._surroundings.obstacles = geometry.space
        self._surroundings.top = geometry.space_top
        self._surroundings.tool_radius = scene.robot.tool_radius
        size = geometry.size
        edge = (np.array(scene.table.lower) + size, np.array(scene.table.upper) - size)
        self._weights = _robot_weights(cost, edge)

        horizon = level.mppi.horizon
        self._kernel = make_robot_rollout(self.size)
        self._joints = wp.zeros(1, dtype=control_type(self.size), device=device)
        self._object = wp.zeros(1, dtype=wp.vec3, device=device)
        self._goal = wp.zeros(1, dtype=wp.vec3, device=device)
        self._reference = wp.zeros(horizon + 1 + cost.align_ahead, dtype=wp.vec3, device=device)
        self._no_terms = wp.zeros(0, dtype=CostTerms, device=device)
        self._no_poses = wp.zeros((0, 0), dtype=wp.vec3, device=device)
        self._trace_cost = wp.zeros(1, dtype=float, device=device)
        self._trace_terms = wp.zeros(1, dtype=CostTerms, device=device)
        self._trace_tips = wp.zeros((1, horizon + 1), dtype=wp.vec3, device=device)
        self._trace_poses = wp.zeros((1, horizon + 1), dtype=wp.vec3, device=device)

    @property
    def reference_length(self) -> int:
        """Number of poses that a reference must have."""
        return self._reference.shape[0]

    def set_state(self, joints: np.ndarray, pose: np.ndarray, goal: np.ndarray, reference: np.ndarray) -> None:
        """The state to plan from and what to plan for; object poses are of the friction centre.

        Args:
            joints: Joint positions, shape [dof] [rad].
            pose: The object, shape [3].
            goal: Where it should go, shape [3].
            reference: Where it should be at each step from now, shape [reference_length, 3].
        """
        self._joints.assign(np.asarray(joints, dtype=np.float32)[None])
        self._object.assign(np.asarray(pose, dtype=np.float32)[None])
        self._goal.assign(np.asarray(goal, dtype=np.float32)[None])
        self._reference.assign(np.asarray(reference, dtype=np.float32))

    def rollout(self, controls: wp.array, costs: wp.array) -> None:
        """Writes the cost of each joint velocity sequence; see :class:`oimppi_warp.dynamics.base.Dynamics`."""
        self._launch(controls, costs, self._no_terms, self._no_poses, self._no_poses)

    def trace(self, nominal: wp.array) -> Trace:
        """What one joint velocity sequence [horizon] leads to."""
        controls = nominal.reshape((1, nominal.shape[0]))
        self._launch(controls, self._trace_cost, self._trace_terms, self._trace_tips, self._trace_poses)
        tips, poses = self._trace_tips.numpy()[0], self._trace_poses.numpy()[0]
        return Trace(tips.astype(float), poses.astype(float), self._trace_terms.numpy()[0].astype(float))

    def _launch(self, controls: wp.array, costs: wp.array, terms: wp.array, tips: wp.array, poses: wp.array) -> None:
        inputs = [
            self._arm,
            self._model,
            self._surroundings,
            self._weights,
            self._joints,
            self._object,
            self._goal,
            self._reference,
            self._align_ahead,
            controls,
            self._dt,
            self._contact_steps,
        ]
        outputs = [costs, terms, tips, poses]
        wp.launch(self._kernel, dim=controls.shape[0], inputs=inputs, outputs=outputs, device=self.device)


def _robot_weights(cost: RobotCost, edge: tuple[np.ndarray, np.ndarray]) -> RobotWeights:
    weights = RobotWeights()
    for name, value in vars(cost).items():
        if name not in ("reach", "align_ahead"):
            setattr(weights, name, value)
    weights.reach_lower, weights.reach_upper = cost.reach
    weights.edge_lower, weights.edge_upper = wp.vec2(*edge[0]), wp.vec2(*edge[1])
    return weights
