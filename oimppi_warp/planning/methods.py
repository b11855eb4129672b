"""MPPI, SOI and CLOI: who replans when, and what the robot tracks (the paper's Algorithms 1 to 3).

All three are one robot-level MPPI that tracks a reference of object poses; they differ in where the reference comes
from. MPPI's is the goal itself, SOI's a plan made once before the robot moves, CLOI's a plan renewed every step.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import warp as wp

from oimppi_warp.compute.step import Compute, Launch, Stopwatch
from oimppi_warp.config.overrides import validate
from oimppi_warp.config.run_spec import RunSpec
from oimppi_warp.config.settings import Config
from oimppi_warp.geometry.fields import from_center, to_center
from oimppi_warp.kernels.fields import cost_to_go
from oimppi_warp.kernels.geometry import PoseField
from oimppi_warp.kernels.rollouts.object import follow_path
from oimppi_warp.observation import Observation
from oimppi_warp.planning.cost_to_go import build_to_go
from oimppi_warp.planning.engine_choice import choose
from oimppi_warp.planning.object_level import ObjectLevel, distance
from oimppi_warp.planning.optimizers.optimizer import Update
from oimppi_warp.planning.resolve import resolve
from oimppi_warp.planning.robot_level import Planner
from oimppi_warp.registries import METHODS
from oimppi_warp.scene import Scene

_ARRIVED = 0.01
"""Distance from the goal, turning counted, at which SOI's object plan is complete [m]."""
_EVERY = 3
"""Poses of SOI's plan are followed in steps of so many."""


class SequentialPlanner(Planner):
    """SOI-MPPI (Algorithm 3): one object plan to the goal before the robot moves, then tracked.

    By time, the reference is the plan as it was made. By progress, it leads on from where the object is on the plan.
    Where a push went astray, it leads a free way back, down a cost-to-go that is made once, with the plan.
    """

    method = "soi"

    def __init__(self, scene: Scene, config: Config, *, engine: str, compute: Compute, seed: int) -> None:
        super().__init__(scene, config, engine=engine, compute=compute, seed=seed)
        # Its plan is made before the robot moves: a step of its own, with inputs and outputs of its own.
        alone = Compute(compute.device, threads=compute.threads)
        self._object = ObjectLevel(self.geometry, self.goal, self.config, compute=alone, seed=2 * seed + 2)
        self._object_step = alone.step(self._object.launches, one_graph=self._object.mppi.one_graph)
        self._path = self.goal[None]
        self._step_of_path = 0
        if config.reference == "progress":
            self.object_launches = self._follow_plan()

    @property
    def object_plan(self) -> np.ndarray:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The object's whole way as it was planned at the start, poses [n, 3]."""
        return from_center(self.geometry.surface, self._path)

    def warm_up(self) -> None:
        """Compiles and loads every kernel, so that the first plan is as fast as the others."""
        super().warm_up()
        self._improve(self._path[0])
        wp.load_module(cost_to_go, device="cpu")

    def start(self, observation: Observation) -> float:
        """Plans the object's whole way; returns the wall time that took, the cost-to-go included [s]."""
        super().start(observation)
        began = time.perf_counter()
        self._object.mppi.reset()
        self._step_of_path = 0
        self._path, arrived = self._whole_way(to_center(self.geometry.surface, observation.object_pose))
        if self.config.reference == "progress":
            level = self.config.object
            # A plan that did not arrive leads nowhere: the plain cost-to-go leads then.
            way = self._path[::-_EVERY][::-1] if arrived else self.goal[None]
            found = build_to_go(
                self.geometry.clearance,
                way,
                yaw_length=level.yaw_length,
                reach=self.config.object_cost.reach,
                bound=self._object.to_go,
                device=self.compute.device,
            )
            wp.copy(self._to_go.values, found.values)
            self._to_go_values = found.values.numpy()
            plan = way[np.minimum(np.arange(len(self._plan)), len(way) - 1)]
            self._plan.assign(plan.astype(np.float32))
        return time.perf_counter() - began + self._object.setup_seconds

    def _follow_plan(self) -> list[Launch]:
        """Prepares reading the reference by progress: from where the object is, along the plan or back to it."""
        clearance, level = self.geometry.clearance, self.config.object
        self._to_go = PoseField()
        self._to_go.values = wp.zeros_like(clearance.values)
        self._to_go_values = self._to_go.values.numpy()
        self._to_go.origin, self._to_go.inv_step = clearance.origin, clearance.inv_step
        self._to_go.inv_yaw_step = clearance.inv_yaw_step
        self._start = self.compute.input(1, wp.vec3)
        reference = self.dynamics.reference
        self._way = self.compute.output((1, len(reference.host)), wp.vec3)
        goal = wp.array(self.goal[None].astype(np.float32), dtype=wp.vec3, device=self.compute.device)
        step = level.speed_limit[0] * self.config.control_period
        self._plan = wp.zeros(level.plan_steps // _EVERY + 2, dtype=wp.vec3, device=self.compute.device)
        inputs = [self._to_go, self._plan, self._start.array, goal, level.yaw_length, step]
        down = self.compute.launch(cost_to_go.follow_down, 1, inputs, [self._way.array])
        hand_over = self.compute.launch(follow_path, len(reference.host), [self._way.array], [reference.array])
        return [down, hand_over]

    def _whole_way(self, pose: np.ndarray) -> tuple[np.ndarray, bool]:
        """The object's way to the goal as the object level would drive it in closed loop, and whether it arrived.

        Its last pose is the exact goal in any case.
        """
        way, arrived = [pose], False
        while not arrived and len(way) <= self.config.object.plan_steps:
            way.append(self._improve(way[-1])[1])
            arrived = distance(way[-1], self.goal, self.config.object.yaw_length) < _ARRIVED
        return np.array([*way, self.goal]), arrived

    def _improve(self, pose: np.ndarray) -> np.ndarray:
        """One update of the object plan from a pose [3], and the path [horizon + 1, 3] that it then takes."""
        self._object.set_state(pose)
        self._object_step()
        return self._object.path.host[0].astype(float)

    def set_reference(self, pose: np.ndarray) -> None:
        """Reads the plan from the object's pose on, or from this time on."""
        if self.config.reference == "progress":
            self._start.host[0] = pose
            return
        self.track(self._path[self._step_of_path :])
        self._step_of_path = min(self._step_of_path + 1, len(self._path) - 1)

    def tracked(self) -> np.ndarray:
        """Returns the reference that was tracked in the latest step, shape [n, 3]."""
        return self._way.host[0].astype(float) if self.config.reference == "progress" else self._tracked


class ClosedLoopPlanner(Planner):
    """CLOI-MPPI (Algorithm 2): the object plan is renewed from every observation."""

    method = "cloi"

    def __init__(self, scene: Scene, config: Config, *, engine: str, compute: Compute, seed: int) -> None:
        super().__init__(scene, config, engine=engine, compute=compute, seed=seed)
        self._object = ObjectLevel(self.geometry, self.goal, self.config, compute=self.compute, seed=2 * seed + 2)
        reference = self.dynamics.reference
        hand_over = self.compute.launch(follow_path, len(reference.host), [self._object.path.array], [reference.array])
        self._watch = Stopwatch(self.compute.device)
        self.object_launches = [*self._object.launches, hand_over, self._watch]
        self.object_one_graph = self._object.mppi.one_graph

    def start(self, observation: Observation) -> float:
        """Prepares for an episode that begins with ``observation``; returns the wall time of the cost-to-go [s]."""
        self._object.mppi.reset()
        return super().start(observation) + self._object.setup_seconds

    def set_reference(self, pose: np.ndarray) -> None:
        """Tells the object level where the object is; its plan becomes the reference within the step."""
        self._object.set_state(pose)

    def tracked(self) -> np.ndarray:
        """Returns the object plan of the latest step, shape [n, 3]."""
        return self._object.path.host[0].astype(float)

    def _object_update(self) -> Update | None:
        return self._object.mppi.found()

    def _object_done(self) -> float:
        return self._watch.take()

    def _to_go_from(self, pose: np.ndarray) -> float:
        return self._object.to_go_from(pose)


def make_planner(scene: Scene, config: Config, spec: RunSpec | None = None, **options: Any) -> Planner:
    """Makes a planner for a scene.

    Args:
        scene: The task.
        config: All settings.
        spec: Who plans, with which engine, where; of the engine ``"auto"`` a few plans are timed.
        **options: Fields of ``spec`` to change, for example ``method="soi"``.

    Raises:
        ConfigError: Unknown method or engine, or a setting that cannot be used.
        DeviceError: The device is not there.
    """
    spec = (spec or RunSpec()).changed(**options)
    config = resolve(validate(config), scene).config
    kind = METHODS.get_checked(spec.method)

    def make(engine: str) -> Planner:
        compute = Compute(spec.device, threads=spec.threads)
        return kind(scene, config, engine=engine, compute=compute, seed=spec.seed)

    if spec.engine != "auto":
        return make(spec.engine)
    choice = choose(spec.method, config.control_period, make)
    choice.planner.engine_reason = choice.reason
    return choice.planner
