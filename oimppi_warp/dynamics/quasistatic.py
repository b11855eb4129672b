"""Robot level on the paper's quasi-static model, fused into one kernel."""

from __future__ import annotations

import numpy as np
import warp as wp

from oimppi_warp.clearance import Geometry, to_center
from oimppi_warp.compute import Compute, Launch
from oimppi_warp.config import RobotCost, RobotLevel
from oimppi_warp.dynamics.base import Trace, control_type
from oimppi_warp.dynamics.packing import no_field, object_model, robot_weights, surroundings, velocity_bound
from oimppi_warp.kernels.cost import TERMS, CostTerms
from oimppi_warp.kernels.geometry import PoseField
from oimppi_warp.kernels.quasistatic import make_robot_rollout
from oimppi_warp.kernels.uncertainty import Draw, combine_costs
from oimppi_warp.kinematics import pack_arm
from oimppi_warp.observation import Observation
from oimppi_warp.scene import Scene
from oimppi_warp.uncertainty import CERTAIN, Draws


class QuasistaticDynamics:
    """Arm, contact and object; controls are joint velocities [rad/s].

    Args:
        scene: The task.
        geometry: Its shapes.
        level: Settings of the robot level.
        cost: Its weights.
        dt: Control period [s].
        compute: Where to compute.
        draws: Worlds that the rollouts are in.
        to_go: Cost-to-go of the object [m], where its weight is not zero.
    """

    terms: tuple[str, ...] = TERMS
    one_graph: bool = True

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
        device = compute.device
        self._dt = dt
        self._contact_steps = level.contact_steps
        self._align_ahead = cost.align_ahead
        self._surface = geometry.surface
        self._arm = pack_arm(scene.robot, self.bound, device)
        self._model = object_model(geometry, tool_friction=scene.object.tool_friction)
        self._model.clearance = geometry.obstruction  # the table's edge stops nothing
        self._surroundings = surroundings(scene, geometry, cost)
        self._weights = robot_weights(scene, geometry, cost)
        self._draws = draws
        self._worlds = _pack(draws, device)
        self._nominal_world = _pack(CERTAIN, device)

        horizon = level.optimizer.horizon
        self._kernel = make_robot_rollout(scene.robot.chain)
        self._joints = compute.input(1, control_type(self.size))
        self._object = compute.input(1, wp.vec3)
        self._goal = compute.input(1, wp.vec3)
        self.reference = compute.input(horizon + 1 + cost.align_ahead, wp.vec3)
        self.guide = compute.input(1, wp.vec4)
        self._to_go = no_field(device) if to_go is None else to_go
        self._no_terms = wp.zeros(0, dtype=CostTerms, device=device)
        self._no_poses = wp.zeros((0, 0), dtype=wp.vec3, device=device)
        self._trace_cost = wp.zeros(1, dtype=float, device=device)
        self._trace_terms = compute.output(1, CostTerms)
        self._trace_tips = compute.output((1, horizon + 1), wp.vec3)
        self._trace_poses = compute.output((1, horizon + 1), wp.vec3)

    def set_state(self, observation: Observation, goal: np.ndarray) -> None:
        """The state to plan from; see :class:`oimppi_warp.dynamics.base.RobotDynamics`."""
        self._joints.host[0] = observation.joint_position
        self._object.host[0] = to_center(self._surface, observation.object_pose)
        self._goal.host[0] = goal

    def rollout(self, controls: wp.array, costs: wp.array) -> Launch:
        """Prepares the cost of each joint velocity sequence; see :class:`oimppi_warp.dynamics.base.Dynamics`."""
        if self._draws.per_sample == 1:
            return self.launch(controls, costs, self._no_terms, self._no_poses, self._no_poses, self._worlds)
        rolled = wp.zeros(controls.shape[0] * self._draws.per_sample, dtype=float, device=self.compute.device)
        roll = self.launch(controls, rolled, self._no_terms, self._no_poses, self._no_poses, self._worlds)
        inputs = [rolled, self._draws.per_sample, self._draws.worst]
        combine = self.compute.launch_samples(combine_costs, controls.shape[0], inputs, [costs])

        def roll_and_combine() -> None:
            roll()
            combine()

        return roll_and_combine

    def trace(self, nominal: wp.array, costs: wp.array) -> Launch:
        """Prepares what the nominal leads to in the world as it was given."""
        controls = nominal.reshape((1, nominal.shape[0]))
        outputs = (self._trace_terms.array, self._trace_tips.array, self._trace_poses.array)
        return self.launch(controls, self._trace_cost, *outputs, self._nominal_world)

    def traced(self) -> Trace:
        """What the nominal leads to."""
        tips, poses, terms = self._trace_tips.host[0], self._trace_poses.host[0], self._trace_terms.host[0]
        return Trace(tips.astype(float), poses.astype(float), terms.astype(float))

    def paths(self, controls: wp.array, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rolls some samples out again; see :class:`oimppi_warp.dynamics.base.RobotDynamics`."""
        device, count, steps = self.compute.device, len(samples), controls.shape[1] + 1
        again = wp.array(controls.numpy()[samples], dtype=controls.dtype, device=device)
        costs = wp.zeros(count, dtype=float, device=device)
        terms = wp.zeros(count, dtype=CostTerms, device=device)
        tips, poses = (wp.zeros((count, steps), dtype=wp.vec3, device=device) for _ in range(2))
        self.launch(again, costs, terms, tips, poses, self._nominal_world)()
        return tips.numpy(), terms.numpy()

    def launch(
        self, controls: wp.array, costs: wp.array, terms: wp.array, tips: wp.array, poses: wp.array, worlds: wp.array
    ) -> Launch:
        """Prepares costs [rollout], and where there is room terms, tips and poses, of controls [sample, horizon].

        ``worlds`` are packed draws; there are as many rollouts as costs.
        """
        inputs = [
            self._arm,
            self._model,
            self._surroundings,
            self._weights,
            worlds,
            costs.shape[0] // controls.shape[0],
            self._joints.array,
            self._object.array,
            self._goal.array,
            self.reference.array,
            self.guide.array,
            self._to_go,
            self._align_ahead,
            controls,
            self._dt,
            self._contact_steps,
        ]
        return self.compute.launch_samples(self._kernel, costs.shape[0], inputs, [costs, terms, tips, poses])


def _pack(draws: Draws, device: str) -> wp.array:
    """Draws as the kernels read them."""
    packed = np.zeros(draws.count, dtype=Draw.numpy_dtype())  # pyright: ignore
    packed["force"] = draws.friction * draws.mass
    packed["tool_friction"] = draws.tool_friction
    packed["pose"] = draws.pose
    packed["tool"] = draws.tool
    return wp.array(packed, dtype=Draw, device=device)
