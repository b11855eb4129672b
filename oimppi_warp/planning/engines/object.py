"""Object level dynamics: the object moved by a virtual wrench, kept out of obstacles by projection."""

from __future__ import annotations

import time

import numpy as np
import warp as wp

from oimppi_warp.compute.step import Compute, Launch
from oimppi_warp.config.settings import ObjectCost, ObjectLevel
from oimppi_warp.geometry.fields import Geometry
from oimppi_warp.kernels.costs.stage_costs import ObjectWeights
from oimppi_warp.kernels.rollouts.object import end_at_goal, object_rollout
from oimppi_warp.planning.cost_to_go import build_to_go, to_go_at
from oimppi_warp.planning.engines.packing import fill_weights, no_field, object_model


class ObjectDynamics:
    """The paper's object model; controls are wrenches (f_x, f_y [N], torque [N m]).

    The object moves by ``x_o <- x_o + dt D w_o`` (equation 6), then out of obstacles.

    Args:
        geometry: Shapes of the scene.
        level: Settings of the object level.
        cost: Its weights.
        goal: Goal of the object's friction centre, shape [3] [m, m, rad].
        dt: Control period [s].
        compute: The device and its threads.

    Attributes:
        bound: The wrench that moves the object at its speed limit, shape [3] [N, N, N m].
        to_go: The cost-to-go [m], empty if it has no weight.
        path: The path that :meth:`trace` writes, planar poses of the friction centre, an output of shape
            [1, horizon + 1] of vectors [3] [m, m, rad].
        setup_seconds: Wall time of computing or reading the cost-to-go [s].
    """

    size = 3

    def __init__(
        self, geometry: Geometry, level: ObjectLevel, cost: ObjectCost, *, goal: np.ndarray, dt: float, compute: Compute
    ) -> None:
        self.compute = compute
        device = compute.device
        self._dt, self._yaw_length, self._goal_pose = dt, level.yaw_length, goal
        self._model = object_model(geometry, tool_friction=0.0, edge=True)
        # The wrench that moves the object at the speed limit: x' = D w.
        self.bound = np.asarray(level.speed_limit) * [1.0, 1.0, float(level.turn)] / geometry.surface.mobility
        self._weights = ObjectWeights()
        fill_weights(self._weights, cost)
        began = time.perf_counter()
        if cost.w_to_go > 0.0:
            self.to_go = build_to_go(
                geometry.clearance, goal, yaw_length=level.yaw_length, push_ring=cost.push_ring, device=device
            )
        else:
            self.to_go = no_field(device)
        self._read_to_go = self.to_go if cost.w_to_go > 0.0 else geometry.clearance  # a field of the same grid
        self._to_go_values = self.to_go.values.numpy()
        self.setup_seconds = time.perf_counter() - began
        self._step = level.speed_limit[0] * dt
        self._ends_at_goal = level.ends_at_goal
        self._start = compute.input(1, wp.vec3)
        self._goal = wp.array(goal[None].astype(np.float32), dtype=wp.vec3, device=device)
        self._unused = wp.zeros((0, 0), dtype=wp.vec3, device=device)
        self._trace_cost = wp.zeros(1, dtype=float, device=device)
        self.path = compute.output((1, level.optimizer.horizon + 1), wp.vec3)

    def set_state(self, pose: np.ndarray) -> None:
        """Sets the planar pose of the object's friction centre, shape [3] [m, m, rad]."""
        self._start.host[0] = pose

    def to_go_at(self, pose: np.ndarray) -> float | None:
        """Returns the cost-to-go [m] at a planar pose of the friction centre, shape [3] [m, m, rad].

        It is NaN if the pose is not finite, and ``None`` if the cost-to-go is not used.
        """
        return (
            None
            if self._to_go_values.size == 0
            else to_go_at(self.to_go, self._to_go_values, pose, self._goal_pose, self._yaw_length)
        )

    def rollout(self, controls: wp.array, costs: wp.array) -> Launch:
        """Returns a launch that writes the cost of each wrench sequence.

        See :class:`oimppi_warp.planning.engines.dynamics.Dynamics`.
        """
        return self.launch(controls, costs, self._unused)

    def trace(self, nominal: wp.array) -> list[Launch]:
        """Returns launches that write the poses along one wrench sequence, shape [horizon], to :attr:`path`.

        Close to the goal the path leads straight to it, with the setting ``object.ends_at_goal``.
        """
        launches = [self.launch(nominal.reshape((1, nominal.shape[0])), self._trace_cost, self.path.array)]
        if self._ends_at_goal:
            inputs = [self._goal, self._yaw_length, self._step]
            launches.append(self.compute.launch(end_at_goal, 1, inputs, [self.path.array]))
        return launches

    def launch(self, controls: wp.array, costs: wp.array, poses: wp.array) -> Launch:
        """Returns a launch that writes the costs of wrench sequences and, unless ``poses`` is empty, their poses.

        Shapes: ``controls`` [sample, horizon] of wrenches [3] about the friction centre, along the world's axes [N, N,
        N m], ``costs`` [sample], ``poses`` [sample, horizon + 1] of vectors [3] [m, m, rad], of the friction centre.
        """
        inputs = [
            self._model,
            self._weights,
            self._read_to_go,
            self._yaw_length,
            self._start.array,
            self._goal,
            controls,
            self._dt,
        ]
        return self.compute.launch_samples(object_rollout, controls.shape[0], inputs, [costs, poses])
