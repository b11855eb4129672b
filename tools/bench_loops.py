"""Planners in closed loop with their own predictions, for the benchmark of plan times."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import warp as wp

from oimppi_warp.compute.step import Compute
from oimppi_warp.config.settings import Config
from oimppi_warp.observation import Observation, planar_transform
from oimppi_warp.planning.factory import make_planner
from oimppi_warp.planning.object_level import ObjectLevel
from oimppi_warp.planning.optimizers.optimizer import Optimizer
from oimppi_warp.planning.planner import Planner
from oimppi_warp.scene import Scene

WARM_UP = 3
"""Number of initial plans that are not timed."""
STAGES = ("sample", "rollout", "weigh", "update")
"""Stages of one update, in the order of ``Optimizer.improve``."""


@dataclass
class Timing:
    """Times of a repeated operation.

    Attributes:
        ms: Wall time of each repetition [ms].
        command_ms: For a planner, the part of it until the command is known [ms].
        stage_ms: Median time of each stage [ms]; ``other`` is the remainder of the median, mainly Python.
        problems: Reasons why the timing is invalid.
    """

    ms: list[float] = field(default_factory=list)
    command_ms: list[float] = field(default_factory=list)
    stage_ms: dict[str, float] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)

    @property
    def median(self) -> float:
        """Median wall time [ms]."""
        return statistics.median(self.ms)

    def figures(self) -> dict[str, Any]:
        """Return the timing's entries in the benchmark record."""
        stages = {name: round(ms, 3) for name, ms in self.stage_ms.items()}
        spread = {"p95_ms": round(float(np.quantile(self.ms, 0.95)), 3), "repeats": len(self.ms)}
        if self.command_ms:
            spread["command_ms"] = round(statistics.median(self.command_ms), 3)
        problems = {"problems": self.problems} if self.problems else {}
        return {"median_ms": round(self.median, 3)} | spread | ({"stage_ms": stages} if stages else {}) | problems


class PlannerLoop:
    """A planner in closed loop with its own predictions, so that plans with and without contact are timed.

    Args:
        scene: The task.
        config: All settings.
        method, engine, device, threads: As for :func:`oimppi_warp.planning.factory.make_planner`.
    """

    def __init__(
        self, scene: Scene, config: Config, *, method: str, engine: str, device: str, threads: int | None = None
    ) -> None:
        self.planner: Planner = make_planner(
            scene, config, method=method, engine=engine, device=device, threads=threads, seed=1
        )
        self.optimizer: Optimizer = self.planner.optimizer
        self.first = self.seen = first_observation(scene)
        self.stopped = ""
        self.command_ms = 0.0
        self.planner.warm_up()
        self.planner.start(self.first)

    def __call__(self) -> None:
        """Compute one plan, and move to the state it predicts."""
        began = time.perf_counter()
        plan = self.planner.plan(self.seen)
        self.command_ms = 1e3 * (time.perf_counter() - began)
        self.stopped = plan.problem
        if plan.problem:
            return
        joints = self.seen.joint_position + self.planner.config.control_period * plan.command
        pose = plan.object_poses[1]
        height = self.seen.object_transform[2]
        transform = planar_transform((pose[0], pose[1], pose[2]), height)
        self.seen = replace(self.seen, joint_position=joints, object_pose=pose, object_transform=transform)

    def problems(self) -> list[str]:
        """Return the problems of the latest plan."""
        if self.stopped:
            return [f"no plan was made: {self.stopped}"]
        update = self.optimizer.found()
        found = [f"{update.lost} samples have a cost that is not finite"] if update.lost else []
        return found + ([] if update.effective_samples > 0.999 else ["no effective samples"])

    def stages(self, repeats: int) -> dict[str, float]:
        """Return the median time of each stage of the robot level in the current state [ms]."""
        trace = self.planner.dynamics.trace(self.optimizer.nominal, self.optimizer.costs)
        launches = [*zip(STAGES, self.optimizer.improve, strict=False), ("trace", trace)]
        return {name: time_of(launch, repeats, self.planner.compute) for name, launch in launches}


class ObjectLoop:
    """The object level alone, in closed loop with its own predictions."""

    def __init__(self, scene: Scene, config: Config, *, device: str, threads: int | None = None) -> None:
        from oimppi_warp.geometry.fields import build_geometry, to_center

        self.compute = compute = Compute(device, threads=threads)
        geometry = build_geometry(scene, compute.device)
        start, goal = (to_center(geometry.surface, np.array(pose)) for pose in (scene.start, scene.goal))
        self.level = ObjectLevel(geometry, goal, config, compute=compute, seed=1)
        self.optimizer = self.level.optimizer
        self._step = compute.step(self.level.launches)
        self.pose = start

    def __call__(self) -> None:
        """Compute one plan, and move the object to the pose it predicts."""
        self.level.set_state(self.pose)
        self._step()
        self.pose = self.level.path.host[0, 1].astype(float)

    def problems(self) -> list[str]:
        """Return the problems of the latest plan."""
        update = self.optimizer.found()
        return [] if not update.lost and update.effective_samples > 0.999 else ["lost samples, or no effective samples"]

    def stages(self, repeats: int) -> dict[str, float]:
        """Return the median time of each stage in the current state [ms]."""
        names = (*STAGES, "trace", "shift")
        return {
            name: time_of(launch, repeats, self.compute)
            for name, launch in zip(names, self.level.launches, strict=False)
        }


def race(runners: dict[str, Callable[[], None]], repeats: int) -> dict[str, Timing]:
    """Time several operations in turns, so that other load on the machine affects all of them equally."""
    timings = {name: Timing() for name in runners}
    for step in range(WARM_UP + repeats):
        for name, run in runners.items():
            began = time.perf_counter()
            run()
            ms = 1e3 * (time.perf_counter() - began)
            if step >= WARM_UP:
                timings[name].ms.append(ms)
                if isinstance(run, PlannerLoop):
                    timings[name].command_ms.append(run.command_ms)
            if isinstance(run, PlannerLoop | ObjectLoop):
                timings[name].problems += [f"plan {step}: {problem}" for problem in run.problems()]
    for name, run in runners.items():
        if isinstance(run, PlannerLoop | ObjectLoop):
            stages = run.stages(max(min(repeats, 20), 3))
            timings[name].stage_ms = stages | {"other": max(timings[name].median - sum(stages.values()), 0.0)}
    return timings


def time_of(launch: Callable[[], None], repeats: int, compute: Compute) -> float:
    """Return the time of an operation [ms]: the median on the CPU, the mean of replays of its graph on a GPU.

    Launched one by one on a GPU, short kernels would be timed with Python, and the Newton engine's solver would wait
    for the host in each iteration.
    """
    if not compute.on_gpu:
        found = []
        for _ in range(repeats):
            began = time.perf_counter()
            launch()
            found.append(1e3 * (time.perf_counter() - began))
        return statistics.median(found)
    with wp.ScopedCapture(device=compute.device) as capture:
        launch()
    graph: Any = capture.graph
    wp.capture_launch(graph)
    wp.synchronize_device(compute.device)
    began = time.perf_counter()
    for _ in range(repeats):
        wp.capture_launch(graph)
    wp.synchronize_device(compute.device)
    return 1e3 * (time.perf_counter() - began) / repeats


def first_observation(scene: Scene) -> Observation:
    """Return an observation of the scene's start, as a plant would report it."""
    transform = planar_transform(scene.start, scene.object.rest_height)
    return Observation(0.0, scene.robot.start, np.zeros(scene.robot.dof), np.array(scene.start), transform)


def solves(engine: str, device: str, config: Config) -> bool:
    """Return whether planning with an engine pushes the T on the open table to a goal 15 cm away, in the simulator."""
    from oimppi_warp.record.metrics import summarize
    from oimppi_warp.runtime.episode import Episode
    from oimppi_warp.usd import load_scene

    scene = load_scene("task01")
    x, y, yaw = scene.goal
    scene = scene.with_start((x, y - 0.35, yaw - 0.6))
    episode = replace(config.episode, max_sim_seconds=15.0, tight=False)
    log = Episode(scene, replace(config, episode=episode), engine=engine, device=device, seed=0).run()
    return summarize(log).success
