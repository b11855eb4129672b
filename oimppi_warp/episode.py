"""The closed loop: a planner and a plant that share observations and commands, and the record of what happened."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict

import numpy as np

from oimppi_warp.clearance import to_center
from oimppi_warp.config import Config, Method
from oimppi_warp.feasibility import check_task
from oimppi_warp.kinematics import tip_frame
from oimppi_warp.log import EpisodeLog, to_json, versions
from oimppi_warp.methods import make_planner
from oimppi_warp.metrics import hold_steps, pose_error
from oimppi_warp.observation import Observation
from oimppi_warp.planner import Planner
from oimppi_warp.plant import SimulatedPlant
from oimppi_warp.scene import Scene, Tolerance
from oimppi_warp.world import World

_REFERENCE_EVERY = 10
"""CLOI's object plans are logged every so many steps."""
_FALLEN = 0.05
"""Depth of the object's frame below the table's top at which it has fallen off [m]."""
_SUBSTEP = 0.0025
"""Longest step of the plant's physics [s]; longer ones make a sliding object gain energy."""


class Episode:
    """One task, from start to success or time limit, in simulation.

    Args:
        scene: The task, with the start and the goal to use.
        config: All settings.
        method, engine, device, threads, seed: As for :func:`oimppi_warp.methods.make_planner`.

    Raises:
        SceneError: The task cannot be done: its start or goal is in an obstacle, off the table or out of reach.
    """

    def __init__(
        self,
        scene: Scene,
        config: Config,
        *,
        method: Method = "cloi",
        engine: str = "auto",
        device: str = "auto",
        threads: int | None = None,
        seed: int = 0,
    ) -> None:
        check_task(scene)
        self.scene = scene
        self.config = config
        self.planner: Planner = make_planner(
            scene, config, method=method, engine=engine, device=device, threads=threads, seed=seed
        )
        self.planner.warm_up()
        period = config.control_period
        substeps = math.ceil(period / _SUBSTEP - 1e-6)
        self.plant = SimulatedPlant(World(scene), start=scene.start, control_period=period, substeps=substeps)
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
        if len(self.log):
            raise RuntimeError("an episode runs once; make another one")
        settings = self.config.episode
        wanted = self.scene.tight_tolerance if settings.tight else self.scene.tolerance
        wanted_steps = hold_steps(settings.hold_seconds, self.config.control_period)
        held = 0
        try:
            observation = self.plant.observe()
            self.log.header["preplan_time_s"] = self.planner.start(observation)
            for _ in range(round(settings.max_sim_seconds / self.config.control_period)):
                observation, arrived = self._step(observation, wanted)
                if on_step is not None:
                    on_step(self.log)
                if self.plant.tipped or observation.object_transform[2] < -_FALLEN:
                    self.log.header["ended"] = "object fell"
                    break
                held = held + 1 if arrived else 0
                if held == wanted_steps:
                    self.log.header["ended"] = "success"
                    break
            else:
                self.log.header["ended"] = "time limit"
            self.plant.apply(np.zeros(self.scene.robot.dof))
        except KeyboardInterrupt:
            self.log.header["ended"] = "interrupted"
            self.plant.apply(np.zeros(self.scene.robot.dof))
        except FloatingPointError:
            self.log.header["ended"] = "diverged"
        return self.log

    def _step(self, observation: Observation, wanted: Tolerance) -> tuple[Observation, bool]:
        """One control step: plan, apply, observe, log; returns whether the object is within tolerance."""
        began = time.perf_counter()
        plan = self.planner.plan(observation)
        plan_seconds = time.perf_counter() - began
        step = len(self.log)
        if (self.planner.method == "cloi" and step % _REFERENCE_EVERY == 0) or (
            self.planner.method == "soi" and step == 0
        ):
            self.log.add_reference(plan.reference)

        self.plant.apply(plan.command)
        after = self.plant.observe()
        position_error, yaw_error = pose_error(after.object_pose, self.scene.goal)
        contacts = self.plant.contacts
        geometry = self.planner.geometry
        self.log.append(
            time=after.time,
            joint_position=after.joint_position,
            joint_velocity=after.joint_velocity,
            command=plan.command,
            tool_position=tip_frame(self.scene.robot, after.joint_position)[1],
            object_pose=after.object_pose,
            position_error=position_error,
            yaw_error=yaw_error,
            clearance=geometry.clearance_at(to_center(geometry.surface, after.object_pose)),
            contact_tool_object=contacts.tool_object,
            contact_object_obstacle=contacts.object_obstacle,
            contact_robot_obstacle=contacts.robot_obstacle,
            plan_ms=1e3 * plan_seconds,
            object_plan_ms=1e3 * plan.object_seconds,
            effective_samples=plan.update.effective_samples,
            object_effective_samples=plan.object_update.effective_samples if plan.object_update else np.nan,
            min_cost=plan.update.min_cost,
            cost_terms=plan.terms,
            lost_samples=plan.update.lost,
        )
        return after, position_error <= wanted.position and yaw_error <= wanted.yaw
