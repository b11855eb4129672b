"""CLOI-MPPI, the paper's Algorithm 2: the object's motion is planned anew in every control step."""

from __future__ import annotations

import numpy as np

from oimppi_warp.compute.step import Compute, Stopwatch
from oimppi_warp.config.settings import Config
from oimppi_warp.kernels.rollouts.object import follow_path
from oimppi_warp.observation import Observation
from oimppi_warp.planning.object_level import ObjectLevel
from oimppi_warp.planning.optimizers.optimizer import Update
from oimppi_warp.planning.planner import Planner
from oimppi_warp.scene import Scene


class ClosedLoopPlanner(Planner):
    """CLOI-MPPI (Algorithm 2): the object plan is updated from every observation.

    Algorithm 2, with the code of each line::

        1     while not converged:                                Planner.plan, in every control step
        2, 3      (A) update W with Algorithm 1 and S_o               object_launches: ObjectLevel
        4             extract x_{t:t+H^o}^{o*} from the nominal       follow_path
        5, 6      (B) update U with Algorithm 1 and S                 Planner
        7, 8          apply u; shift; observe x_{t+1}                 Optimizer.shift, lock_step

    Both levels are one list of launches, which is one graph on CUDA.
    """

    method = "cloi"

    def __init__(self, scene: Scene, config: Config, *, engine: str, compute: Compute, seed: int) -> None:
        super().__init__(scene, config, engine=engine, compute=compute, seed=seed)
        self._object = ObjectLevel(self.geometry, self.goal, self.config, compute=self.compute, seed=2 * seed + 2)
        reference = self.dynamics.reference
        extract = self.compute.launch(
            follow_path, len(reference.host), [self._object.path.array, self.pace.array], [reference.array]
        )
        self._watch = Stopwatch(self.compute.device)
        self.object_launches = [*self._object.launches, extract, self._watch]
        self.object_one_graph = self._object.optimizer.one_graph

    def start(self, observation: Observation) -> float:
        """Prepares for an episode that begins with ``observation``; see :meth:`Planner.start`.

        Returns:
            Wall time of computing or reading the cost-to-go [s].
        """
        seconds = super().start(observation)
        self._object.optimizer.reset()
        return seconds + self._object.setup_seconds

    def set_reference(self, pose: np.ndarray) -> None:
        """Sets the object level's state; its plan becomes the reference within the step."""
        self._object.set_state(pose)

    def tracked(self) -> np.ndarray:
        """Returns the object plan of the latest step: planar poses of the friction centre, shape [n, 3] [m, m, rad]."""
        return self._object.path.host[0].astype(float)

    def to_go_from(self, pose: np.ndarray) -> float:
        """Returns the distance [m] that the object still has to travel from a planar pose, shape [3] [m, m, rad].

        A radian of yaw counts as the setting ``object.yaw_length``.
        """
        return self._object.to_go_from(pose)

    def object_statistics(self) -> Update | None:
        """Returns the statistics of the object level's latest update."""
        return self._object.optimizer.found()

    def object_finished(self) -> float:
        """Returns the ``time.perf_counter`` at which the object level finished the latest step; NaN if unknown."""
        return self._watch.take()
