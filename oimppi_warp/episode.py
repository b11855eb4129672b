"""The closed loop: a planner and a plant that share observations and commands, and the record of what happened."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from contextlib import closing
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from oimppi_warp.clearance import to_center
from oimppi_warp.compute import core_count
from oimppi_warp.config import Config
from oimppi_warp.control import Beat, lock_step, real_time
from oimppi_warp.estimator import Estimator
from oimppi_warp.feasibility import check_task
from oimppi_warp.kinematics import tip_frame
from oimppi_warp.lab import LabPlant
from oimppi_warp.log import EVENTS, EpisodeLog, to_json, versions
from oimppi_warp.methods import make_planner
from oimppi_warp.metrics import hold_steps, pose_error
from oimppi_warp.planner import Plan, Planner
from oimppi_warp.plant import SimulatedPlant
from oimppi_warp.run_spec import Mode
from oimppi_warp.scene import Scene
from oimppi_warp.world import World

_REFERENCE_EVERY = 10
"""CLOI's object plans are logged every so many steps."""
_FALLEN = 0.05
"""Depth of the object's frame below the table's top at which it has fallen off [m]."""
_SUBSTEP = 0.0025
"""Longest step of the plant's physics [s]; longer ones make a sliding object gain energy."""


@dataclass(frozen=True, eq=False)
class Setup:
    """All that makes an episode, as :class:`Episode` takes it."""

    scene: Scene
    config: Config
    method: str = "cloi"
    engine: str = "auto"
    device: str = "auto"
    threads: int | None = None
    seed: int = 0
    plant: str = "ideal"
    mode: Mode = "lockstep"

    def episode(self) -> Episode:
        """A new episode, ready to run."""
        return Episode(**vars(self))


class Episode:
    """One task, from start to success or time limit, in simulation.

    Args:
        scene: The task, with the start and the goal to use.
        config: All settings.
        method, engine, device, threads, seed: As for :func:`oimppi_warp.methods.make_planner`.
        plant: The simulated world as it is, or as a laboratory would know it and move it.
        mode: Whether the world waits for the planner, or the planner works beside it on the wall clock.

    Raises:
        SceneError: The task cannot be done: its start or goal is in an obstacle, off the table or out of reach.
    """

    def __init__(
        self,
        scene: Scene,
        config: Config,
        *,
        method: str = "cloi",
        engine: str = "auto",
        device: str = "auto",
        threads: int | None = None,
        seed: int = 0,
        plant: str = "ideal",
        mode: Mode = "lockstep",
    ) -> None:
        check_task(scene)
        self.scene = scene
        self.config = config
        if threads is None and mode == "realtime":
            threads = max(core_count() - 1, 1)  # one is left for the plant
        self.planner: Planner = make_planner(
            scene, config, method=method, engine=engine, device=device, threads=threads, seed=seed
        )
        self.planner.warm_up()
        period = config.control_period
        self.plant: SimulatedPlant | LabPlant
        if plant == "lab":
            self.plant = LabPlant(World(scene), config.lab, start=scene.start, control_period=period, seed=seed)
        else:
            substeps = math.ceil(period / _SUBSTEP - 1e-6)
            self.plant = SimulatedPlant(World(scene), start=scene.start, control_period=period, substeps=substeps)
        self._beats = self._loop(plant, mode)
        self._plans = 0
        self.log = EpisodeLog(
            {
                "scene": scene.name,
                "file": str(scene.file),
                "method": method,
                "engine": self.planner.engine,
                "engine_reason": self.planner.engine_reason,
                "threads": self.planner.compute.threads,
                "device": self.planner.compute.device,
                "preset": config.preset,
                "seed": seed,
                "plant": plant,
                "mode": mode,
                "config": to_json(asdict(config)),
                "start": list(scene.start),
                "goal": list(scene.goal),
                "tolerance": to_json(scene.tolerance),
                "tight_tolerance": to_json(scene.tight_tolerance),
                "hold_seconds": config.episode.hold_seconds,
                "control_period": config.control_period,
                "cost_terms": list(self.planner.dynamics.terms),
                "preplan_time_s": 0.0,
                "ended": "interrupted",
                "versions": versions(),
            }
        )

    def run(self, on_step: Callable[[EpisodeLog], None] | None = None) -> EpisodeLog:
        """Runs until the object has stayed within tolerance for the hold time, or the time is up.

        It ends early when the object tips over or falls off the table, on Ctrl-C, and when the plant diverges; the log
        is complete all the same.

        Args:
            on_step: Called after every control step with the log so far.

        Raises:
            RuntimeError: The episode was run before.
        """
        try:
            with closing(self.steps()) as steps:
                for _ in steps:
                    if on_step is not None:
                        on_step(self.log)
        except KeyboardInterrupt:
            self.log.header["ended"] = "interrupted"
            self.plant.apply(np.zeros(self.scene.robot.dof))
        except FloatingPointError:
            self.log.header["ended"] = "diverged"
        return self.log

    def steps(self) -> Generator[Beat]:
        """The same step by step: each control period as it has passed, until the episode ends.

        Raises:
            RuntimeError: The episode was run before.
            FloatingPointError: The plant diverged.
        """
        if len(self.log):
            raise RuntimeError("an episode runs once; make another one")
        settings = self.config.episode
        wanted = self.scene.tight_tolerance if settings.tight else self.scene.tolerance
        wanted_steps = hold_steps(settings.hold_seconds, self.config.control_period)
        held = 0
        try:
            for _ in range(round(settings.max_sim_seconds / self.config.control_period)):
                beat = next(self._beats)
                position_error, yaw_error = self._record(beat)
                yield beat
                if self.plant.tipped or self.plant.truth().object_transform[2] < -_FALLEN:
                    self.log.header["ended"] = "object fell"
                    break
                held = held + 1 if position_error <= wanted.position and yaw_error <= wanted.yaw else 0
                if held == wanted_steps:
                    self.log.header["ended"] = "success"
                    break
            else:
                self.log.header["ended"] = "time limit"
            self.plant.apply(np.zeros(self.scene.robot.dof))
        finally:
            self._beats.close()

    def _loop(self, plant: str, mode: Mode) -> Generator[Beat]:
        """The beats of plant and planner; the truth is good enough for the ideal plant in lock step alone."""
        dof = self.scene.robot.dof
        if mode == "realtime":
            estimator = Estimator(self.scene, self.config)
            return real_time(self.plant, self.planner, estimator, dof=dof, expires=self.config.episode.plan_expires)
        estimator = Estimator(self.scene, self.config) if plant == "lab" else None
        return lock_step(self.plant, self.planner, estimator, dof=dof)

    def _record(self, beat: Beat) -> tuple[float, float]:
        """Log a control step; returns the true distance [m] and angle [rad] of the object to its goal."""
        plan = beat.plan
        if plan is not None:
            self.log.header["preplan_time_s"] += beat.preplan_seconds
            ahead = self.planner.object_plan
            if self._plans == 0 and ahead is not None:
                self.log.add_reference(ahead)
            elif self.planner.method == "cloi" and self._plans % _REFERENCE_EVERY == 0:
                self.log.add_reference(plan.reference)
            self._plans += 1
        truth = self.plant.truth()
        position_error, yaw_error = pose_error(truth.object_pose, self.scene.goal)
        contacts, geometry = self.plant.contacts, self.planner.geometry
        row = {} if plan is None else _of_plan(plan)
        self.log.append(
            time=truth.time,
            joint_position=truth.joint_position,
            joint_velocity=truth.joint_velocity,
            command=beat.command,
            tool_position=tip_frame(self.scene.robot, truth.joint_position)[1],
            object_pose=truth.object_pose,
            estimated_pose=beat.estimate,
            detection=float(EVENTS.index(beat.event)),
            position_error=position_error,
            yaw_error=yaw_error,
            clearance=geometry.clearance_at(to_center(geometry.surface, truth.object_pose)),
            contact_tool_object=contacts.tool_object,
            contact_object_obstacle=contacts.object_obstacle,
            contact_robot_obstacle=contacts.robot_obstacle,
            plan_ms=1e3 * beat.plan_seconds,
            missed_deadline=float(beat.missed),
            stopped=float(beat.stopped),
            lag_ms=1e3 * beat.lag,
            **row,
        )
        return position_error, yaw_error


def _of_plan(plan: Plan) -> dict[str, Any]:
    """The columns that a new plan fills."""
    return {
        "object_plan_ms": 1e3 * plan.object_seconds,
        "effective_samples": plan.update.effective_samples,
        "object_effective_samples": plan.object_update.effective_samples if plan.object_update else np.nan,
        "min_cost": plan.update.min_cost,
        "cost_terms": plan.terms,
        "lost_samples": plan.update.lost,
    }
