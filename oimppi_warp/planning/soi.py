"""SOI-MPPI, the paper's Algorithm 3: the object's motion is planned once, before the robot moves."""

from __future__ import annotations

import time

import numpy as np
import warp as wp

from oimppi_warp.compute.step import Compute
from oimppi_warp.config.settings import Config
from oimppi_warp.geometry.fields import from_center, to_center
from oimppi_warp.kernels.fields import cost_to_go
from oimppi_warp.observation import Observation
from oimppi_warp.planning.object_level import ObjectLevel, distance
from oimppi_warp.planning.planner import Planner
from oimppi_warp.planning.progress import PlanFollower
from oimppi_warp.scene import Scene

_ARRIVED = 0.01
"""Distance from the goal at which the object plan has converged [m]; a radian counts as ``object.yaw_length``."""


class SequentialPlanner(Planner):
    """SOI-MPPI (Algorithm 3): one object plan to the goal before the robot moves, then tracked.

    Algorithm 3, with the code of each line::

        1, 2      (A) set x_0^o as observed                           start
        3             while not converged:                            plan_object
        4                 update W with Algorithm 1 and S_o               ObjectLevel
        5, 6              simulate W to obtain x_{t+1}^o; shift W         ObjectLevel
        7             extract x_{0:H}^{o*}                            plan_object
        8 to 10   (B) while not converged:                            Planner.plan, in every control step
        11                extract the segment x_{t:t+H^r}^{o*}            set_reference
        12                update U with Algorithm 1 and S                 Planner
        13, 14            apply u; shift; observe x_{t+1}                 Optimizer.shift, lock_step

    With ``reference="time"`` the segment begins at the pose planned for the current time, as in the paper. With
    ``reference="progress"`` it begins at the object's pose (:class:`PlanFollower`), which is not in the paper.
    """

    method = "soi"

    def __init__(self, scene: Scene, config: Config, *, engine: str, compute: Compute, seed: int) -> None:
        super().__init__(scene, config, engine=engine, compute=compute, seed=seed)
        # (A) runs before the robot moves, hence as a separate step, with its own inputs and outputs.
        alone = Compute(compute.name, threads=compute.threads)
        self._object = ObjectLevel(self.geometry, self.goal, self.config, compute=alone, seed=2 * seed + 2)
        self._object_step = alone.step(self._object.launches, one_graph=self._object.optimizer.one_graph)
        self._path = self.goal[None]
        self._time = 0
        self._follower: PlanFollower | None = None
        if config.reference == "progress":
            self._follower = PlanFollower(
                self.geometry,
                config,
                goal=self.goal,
                reference=self.dynamics.reference,
                pace=self.pace,
                compute=compute,
            )
            self.object_launches = self._follower.launches

    @property
    def object_plan(self) -> np.ndarray:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Returns the object plan made at the start: planar poses of the object's frame, shape [n, 3] [m, m, rad]."""
        return from_center(self.geometry.surface, self._path)

    def warm_up(self) -> None:
        """Compiles and loads every kernel, so that the first plan is as fast as the others."""
        super().warm_up()
        self._improve(self._path[0])
        wp.load_module(cost_to_go, device="cpu")

    def start(self, observation: Observation) -> float:
        """Plans the object's motion from its observed pose to the goal: part (A) of Algorithm 3.

        It makes ``object.plans`` plans, and takes the best of them.

        Returns:
            Wall time of planning and of computing or reading the cost-to-go [s].
        """
        super().start(observation)
        began = time.perf_counter()
        self._object.optimizer.reset()
        self._time = 0
        pose = to_center(self.geometry.surface, observation.object_pose)
        plans = [self.plan_object(pose) for _ in range(self.config.object.plans)]
        self._path, arrived = min(plans, key=lambda plan: (not plan[1], sum(map(self._object.to_go_from, plan[0]))))
        if self._follower is not None:
            self._follower.set_plan(self._path, arrived=arrived, bound=self._object.to_go)
        return time.perf_counter() - began + self._object.setup_seconds

    def plan_object(self, pose: np.ndarray) -> tuple[np.ndarray, bool]:
        """Returns a new object plan from a pose to the goal, shape [n, 3], and whether it converged.

        All poses are planar poses of the friction centre [m, m, rad]. These are lines 3 to 7 of Algorithm 3. The last
        pose is the goal itself in either case.
        """
        self._object.optimizer.forget()
        path, converged = [pose], False
        while not converged and len(path) <= self.config.object.plan_steps:
            path.append(self._improve(path[-1])[1])
            converged = distance(path[-1], self.goal, self.config.object.yaw_length) < _ARRIVED
        return np.array([*path, self.goal]), converged

    def _improve(self, pose: np.ndarray) -> np.ndarray:
        """Updates the wrenches from a pose, shape [3]; returns the path under the new nominal, shape [horizon + 1, 3].

        All poses are planar poses of the friction centre [m, m, rad]. These are lines 4 to 6 of Algorithm 3: update,
        simulate, shift.
        """
        self._object.set_state(pose)
        self._object_step()
        return self._object.path.host[0].astype(float)

    def set_reference(self, pose: np.ndarray) -> None:
        """Extracts the segment to track, from the current time or from the object's pose (Algorithm 3, line 11)."""
        if self._follower is not None:
            self._follower.set_state(pose)
            return
        self.track(self._path[self._time :])
        self._time = min(self._time + 1, len(self._path) - 1)

    def tracked(self) -> np.ndarray:
        """Returns the reference of the latest step: planar poses of the friction centre, shape [n, 3] [m, m, rad]."""
        return super().tracked() if self._follower is None else self._follower.tracked()

    def to_go_from(self, pose: np.ndarray) -> float:
        """Returns the distance [m] that the object still has to travel from a planar pose, shape [3] [m, m, rad].

        A radian of yaw counts as the setting ``object.yaw_length``.
        """
        return super().to_go_from(pose) if self._follower is None else self._follower.to_go_from(pose)

    def to_goal_from(self, pose: np.ndarray) -> float:
        """Returns the distance [m] to the goal from a planar pose, shape [3], without regard to the object plan."""
        return self._object.to_go_from(pose)
