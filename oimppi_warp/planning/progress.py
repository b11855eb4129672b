"""Following an object plan by progress: the reference begins at the object's current pose. Not in the paper.

The paper's SOI reads its plan by time. An object that was delayed or pushed off the plan is then given poses that it
cannot reach. Here a cost-to-go is built from the plan, in which a metre along the plan costs half of a metre elsewhere,
and the reference is the path down that field from the object's pose: along the plan, or back onto it, around obstacles.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from oimppi_warp.compute.step import Compute, Slot, using_gpu
from oimppi_warp.config.settings import Config
from oimppi_warp.geometry.fields import Geometry
from oimppi_warp.geometry.footprint import wrap_angle
from oimppi_warp.kernels.fields import cost_to_go
from oimppi_warp.kernels.geometry import PoseField
from oimppi_warp.kernels.rollouts.object import follow_path
from oimppi_warp.planning.cost_to_go import build_to_go, to_go_at

_STRIDE = 3.0
"""Number of steps of the plan, at most, between the poses of it that are followed."""
_SPACING = 0.031
"""Distance between these poses, at most, a radian counted as ``object.yaw_length`` [m]. With longer gaps, the path down
the cost-to-go would turn back to the pose that it comes from."""


class PlanFollower:
    """Reference of the robot level, read from an object plan by progress.

    Args:
        geometry: Limit surface and distance fields of the scene.
        config: All settings.
        goal: Goal of the friction centre, shape [3] [m, m, rad].
        reference: The robot level's reference, which the launches write: planar poses [m, m, rad], shape [n].
        pace: Number of steps along the path per control step, an input of shape [1].
        compute: Device, and number of CPU threads.

    Attributes:
        launches: Launches that compute the reference from the object's pose, in every control step.
    """

    def __init__(
        self,
        geometry: Geometry,
        config: Config,
        *,
        goal: np.ndarray,
        reference: Slot,
        pace: Slot,
        compute: Compute,
    ) -> None:
        self._clearance = geometry.clearance
        self._config = config
        self._goal = goal
        self._device = compute.device
        self._to_go = PoseField()
        self._to_go.values = wp.zeros_like(self._clearance.values)
        self._to_go.origin, self._to_go.inv_step = self._clearance.origin, self._clearance.inv_step
        self._to_go.inv_yaw_step = self._clearance.inv_yaw_step
        self._to_go_values = self._to_go.values.numpy()
        self._start = compute.input(1, wp.vec3)
        self._path = compute.output((1, len(reference.host)), wp.vec3)
        level = config.object
        step = level.speed_limit[0] * config.control_period
        self._stride = min(_STRIDE, _SPACING / step)
        self._plan = wp.zeros(int((level.plan_steps + 1) / self._stride) + 2, dtype=wp.vec3, device=self._device)
        goal_array = wp.array(goal[None].astype(np.float32), dtype=wp.vec3, device=self._device)
        inputs = [self._to_go, self._plan, self._start.array, goal_array, level.yaw_length, step]
        self.launches = [
            compute.launch_blocks(cost_to_go.descend, None, inputs, [self._path.array]),
            compute.launch(follow_path, len(reference.host), [self._path.array, pace.array], [reference.array]),
        ]

    def set_plan(self, path: np.ndarray, *, arrived: bool, bound: PoseField | None) -> None:
        """Sets the object plan to follow.

        Args:
            path: The object plan, poses [n, 3]. One that does not reach the goal is not followed.
            arrived: Whether it leads to the goal.
            bound: The cost-to-go to the goal alone, if known; it saves time.
        """
        kept = _spaced(path, self._stride) if arrived else self._goal[None]
        padded = kept[np.minimum(np.arange(len(self._plan)), len(kept) - 1)]
        with using_gpu:
            found = build_to_go(
                self._clearance,
                kept,
                yaw_length=self._config.object.yaw_length,
                push_ring=self._config.object_cost.push_ring,
                bound=bound,
                device=self._device,
            )
            wp.copy(self._to_go.values, found.values)
            self._to_go_values = found.values.numpy()
            self._plan.assign(padded.astype(np.float32))

    def set_state(self, pose: np.ndarray) -> None:
        """Sets the pose from which the reference begins: that of the friction centre, shape [3] [m, m, rad]."""
        self._start.host[0] = pose

    def tracked(self) -> np.ndarray:
        """Returns the reference of the latest step: planar poses of the friction centre, shape [n, 3] [m, m, rad]."""
        return self._path.host[0].astype(float)

    def to_go_from(self, pose: np.ndarray) -> float:
        """Returns the cost-to-go [m] at a planar pose of the friction centre, shape [3] [m, m, rad].

        A metre along the plan counts as half a metre, except close to the goal, where it is the straight distance.
        """
        return to_go_at(self._to_go, self._to_go_values, pose, self._goal, self._config.object.yaw_length)


def _spaced(path: np.ndarray, stride: float) -> np.ndarray:
    """Returns every ``stride``-th pose of a path, shape [n, 3], counted from its end; between poses, it is linear."""
    return poses_at(path, np.arange(len(path) - 1.0, -1e-9, -stride)[::-1])


def poses_at(path: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Returns the poses of a path [n, 3] at fractional indices [m], shape [m, 3]; between poses, it is linear."""
    before = np.floor(at).astype(int)
    way = path[np.minimum(before + 1, len(path) - 1)] - path[before]
    way[:, 2] = wrap_angle(way[:, 2])
    return path[before] + (at - before)[:, None] * way
