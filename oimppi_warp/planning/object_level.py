"""The object level: plans the object's motion as if a wrench could be applied to it directly."""

from __future__ import annotations

import math

import numpy as np

from oimppi_warp.compute.step import Compute
from oimppi_warp.config.settings import Config
from oimppi_warp.geometry.fields import Geometry
from oimppi_warp.geometry.footprint import wrap_angle
from oimppi_warp.planning.engines.object import ObjectDynamics
from oimppi_warp.planning.optimizers.optimizer import make_optimizer


class ObjectLevel:
    """An optimizer over the object alone; all poses are of the object's friction centre.

    It solves ``min over w_o of sum_h l_o(x_o)``, where the object moves by equation 6 and keeps out of obstacles,
    ``phi_2 >= 0`` (equation 13, without its terminal cost l_f).

    Attributes:
        launches: Launches that update the nominal wrenches once and compute the resulting path.
        path: That path, planar poses [m, m, rad], as an output of shape [horizon + 1].
        to_go: The cost-to-go; ``None`` if the level does not use it.
        setup_seconds: Wall time of computing or reading the cost-to-go [s].
    """

    def __init__(self, geometry: Geometry, goal: np.ndarray, config: Config, *, compute: Compute, seed: int) -> None:
        self._dynamics = ObjectDynamics(
            geometry, config.object, config.object_cost, goal=goal, dt=config.control_period, compute=compute
        )
        self.optimizer = make_optimizer(self._dynamics, config.object.optimizer, seed=seed)
        self._level = config.object
        self._largest_noise = np.diag(config.object.noise * self._dynamics.bound)
        self._goal = goal
        self.path = self._dynamics.path
        self.to_go = self._dynamics.to_go if config.object_cost.w_to_go > 0.0 else None
        self.launches = [*self.optimizer.improve, *self._dynamics.trace(self.optimizer.nominal), self.optimizer.shift]
        self.setup_seconds = self._dynamics.setup_seconds

    def set_state(self, pose: np.ndarray) -> None:
        """Sets the planar pose of the object's friction centre, shape [3] [m, m, rad]."""
        share = 1.0
        if self._level.noise_range > 0.0:
            left = distance(pose, self._goal, self._level.yaw_length)
            share = min(max(left / self._level.noise_range, 0.1), 1.0)
        self.optimizer.noise.host[0] = share * self._largest_noise
        self._dynamics.set_state(pose)

    def to_go_from(self, pose: np.ndarray) -> float:
        """Returns the cost-to-go [m] at a planar pose of the friction centre, shape [3] [m, m, rad].

        Without a cost-to-go, it is the straight distance to the goal.
        """
        to_go = self._dynamics.to_go_at(pose)
        return distance(pose, self._goal, self._level.yaw_length) if to_go is None else to_go


def distance(a: np.ndarray, b: np.ndarray, yaw_length: float) -> float:
    """Returns the straight distance of two planar poses [m, m, rad]; a radian of yaw counts as ``yaw_length`` [m]."""
    x, y, yaw = (b - a).tolist()
    return math.hypot(x, y, yaw_length * wrap_angle(yaw))
