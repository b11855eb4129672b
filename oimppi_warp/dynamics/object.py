"""Object level: the object moved by a virtual wrench, kept out of obstacles by projection (equations 5 and 6)."""

from __future__ import annotations

import time

import numpy as np
import warp as wp

from oimppi_warp.clearance import Geometry
from oimppi_warp.config import ObjectCost, ObjectLevel
from oimppi_warp.kernels.cost import ObjectWeights
from oimppi_warp.kernels.geometry import PoseField
from oimppi_warp.kernels.object import object_rollout
from oimppi_warp.kernels.pushing import ObjectModel
from oimppi_warp.navigation import build_to_go


def object_model(geometry: Geometry, *, tool_friction: float, slack: float = 0.0) -> ObjectModel:
    """The pushed object as the kernels read it."""
    model = ObjectModel()
    model.force = geometry.surface.force
    model.radius = geometry.surface.radius
    model.tool_friction = tool_friction
    model.top = geometry.top
    model.clearance = geometry.clearance
    model.body = geometry.body
    model.slack = slack
    return model


class ObjectDynamics:
    """The paper's object model on one device; controls are wrenches (f_x, f_y [N], torque [N m]).

    Args:
        geometry: Shapes of the scene.
        level: Settings of the object level.
        cost: Its weights.
        goal: Where the object should go: pose [3] of its friction centre.
        dt: Control period [s].
        device: Warp device.

    Attributes:
        setup_seconds: Wall time of making or reading the cost-to-go [s].
    """

    size = 3

    def __init__(
        self, geometry: Geometry, level: ObjectLevel, cost: ObjectCost, *, goal: np.ndarray, dt: float, device: str
    ) -> None:
        self.device = device
        self._dt = dt
        self._model = object_model(geometry, tool_friction=0.0)
        # The wrench that moves the object at the speed limit, by x' = D w.
        resistance = geometry.surface.force * np.array([1.0, 1.0, geometry.surface.radius**2])
        self.bound = resistance * np.asarray(level.speed_limit) * [1.0, 1.0, float(level.turn)]
        self._weights = ObjectWeights()
        for name, value in vars(cost).items():
            if name != "reach":
                setattr(self._weights, name, value)
        self._weights.reach_lower, self._weights.reach_upper = cost.reach
        began = time.perf_counter()
        if cost.w_to_go > 0.0:
            self._to_go = build_to_go(
                geometry.clearance, goal, yaw_length=level.yaw_length, reach=cost.reach, device=device
            )
        else:
            self._to_go = PoseField()
            self._to_go.values = wp.zeros((0, 0, 0), dtype=float, device=device)
        self.setup_seconds = time.perf_counter() - began
        self._start = wp.zeros(1, dtype=wp.vec3, device=device)
        self._goal = wp.array(goal[None].astype(np.float32), dtype=wp.vec3, device=device)
        self._unused = wp.zeros((0, 0), dtype=wp.vec3, device=device)
        self._trace_cost = wp.zeros(1, dtype=float, device=device)
        self._trace = wp.zeros((1, level.mppi.horizon + 1), dtype=wp.vec3, device=device)

    def set_state(self, pose: np.ndarray) -> None:
        """Where the object is: pose [3] of its friction centre."""
        self._start.assign(np.asarray(pose, dtype=np.float32)[None])

    def rollout(self, controls: wp.array, costs: wp.array) -> None:
        """Writes the cost of each wrench sequence; see :class:`oimppi_warp.dynamics.base.Dynamics`."""
        self._launch(controls, costs, self._unused)

    def trace(self, nominal: wp.array) -> np.ndarray:
        """The poses [horizon + 1, 3] that one wrench sequence [horizon] leads through."""
        self._launch(nominal.reshape((1, nominal.shape[0])), self._trace_cost, self._trace)
        return self._trace.numpy()[0].astype(float)

    def _launch(self, controls: wp.array, costs: wp.array, poses: wp.array) -> None:
        inputs = [self._model, self._weights, self._to_go, self._start, self._goal, controls, self._dt]
        wp.launch(object_rollout, dim=controls.shape[0], inputs=inputs, outputs=[costs, poses], device=self.device)
