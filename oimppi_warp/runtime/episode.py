"""Episodes: the closed loop of planner and plant, from start to success or time limit, and its record."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator
from contextlib import closing, nullcontext, suppress
from dataclasses import asdict, replace
from functools import partial
from importlib.metadata import version
from typing import Any

import numpy as np

from oimppi_warp.compute.device import core_count
from oimppi_warp.compute.loading import await_loaded
from oimppi_warp.config.fields import about
from oimppi_warp.config.overrides import validate
from oimppi_warp.config.run_spec import RunSpec
from oimppi_warp.config.settings import Config
from oimppi_warp.errors import ConfigError
from oimppi_warp.geometry.feasibility import check_task
from oimppi_warp.geometry.fields import ExactClearance
from oimppi_warp.geometry.kinematics import tip_frame
from oimppi_warp.observation import Observation, planar_transform
from oimppi_warp.planning.early_kernels import loading_early, setup_kernels
from oimppi_warp.planning.factory import make_planner
from oimppi_warp.planning.plan import Plan
from oimppi_warp.planning.resolve import entries_used, resolve
from oimppi_warp.plants.drive import Drive
from oimppi_warp.plants.factory import make_plant
from oimppi_warp.plants.plant import (
    ContactPlant,
    JudgingPlant,
    MovablePlant,
    Plant,
    RealPlant,
    StreamingPlant,
    TruthfulPlant,
    has_own_world,
    has_tipped,
    is_real,
    latency_of,
)
from oimppi_warp.plants.safety_filter import SafetyFilter
from oimppi_warp.priority import real_time_priority, without_pauses
from oimppi_warp.record.log import EVENTS, EpisodeLog, to_json, versions
from oimppi_warp.record.metrics import hold_steps, pose_error
from oimppi_warp.registries import PLANTS
from oimppi_warp.runtime.control import ControlStep, lock_step, real_time
from oimppi_warp.runtime.estimator import Estimator
from oimppi_warp.runtime.watch import Watch, enter_pressed
from oimppi_warp.scene import Scene
from oimppi_warp.signals import check_interrupted

_REFERENCE_EVERY = 10
"""Interval at which object plans that change in every step are logged, in steps."""
_LONGEST_LATENCY = 1.0
"""Longest latency of a plant that can be planned for [s]."""
_FALLEN = 0.05
"""Depth of the object's frame below the table's top beyond which the object has fallen off [m]."""


class Episode:
    """One task, from start to success or time limit.

    Args:
        scene: The task, with the start and the goal to use.
        config: All settings.
        spec: The options of the run.
        plant: A plant, or the name of one, to use instead of that in ``spec``. The planner adopts its control period.
        report: Called with what is being done while engines are timed (``engine="auto"``).
        **options: Fields of ``spec`` to change, for example ``method="soi"`` or ``seed=3``.

    Attributes:
        scene: As given.
        spec: The options of the run, with engine, device and threads resolved (never ``auto``).
        config: The settings as resolved for this task.
        plant: The plant.
        planner: The planner.
        log: The record so far.
        watch: What stops the arm of a real plant; ``None`` in simulation.

    Raises:
        SceneError: The task cannot be done: its start or goal is in an obstacle, off the table or out of reach.
        ConfigError: An option or a setting cannot be used.
        DeviceError: The device does not exist.
    """

    def __init__(
        self,
        scene: Scene,
        config: Config,
        spec: RunSpec | None = None,
        *,
        plant: Plant | str | None = None,
        report: Callable[[str], None] = lambda _: None,
        **options: Any,
    ) -> None:
        if isinstance(plant, str):
            options["plant"], plant = plant, None
        spec = (spec or RunSpec()).changed(**options)
        check_task(scene)
        validate(config)
        if any(config.episode.tolerance):
            scene = scene.with_tolerance(*config.episode.tolerance)
        if is_real(PLANTS.get_checked(spec.plant) if plant is None else plant):
            spec = replace(spec, mode="realtime")
        if spec.threads is None and spec.mode == "realtime":
            spec = replace(spec, threads=max(core_count() - 1, 1))  # one is left for the plant
        self.scene = scene
        # In a first run, these kernels are compiled while Newton's are, and while fields are computed.
        with loading_early(scene, config, spec):
            self.plant: Plant = make_plant(scene, config, spec) if plant is None else plant
            try:
                self._make(scene, config, spec, passed=plant is not None, report=report)
            except BaseException:
                if isinstance(self.plant, RealPlant):
                    self.plant.close()
                raise

    def _make(
        self,
        scene: Scene,
        config: Config,
        spec: RunSpec,
        *,
        passed: bool,
        report: Callable[[str], None],
    ) -> None:
        """Makes everything else, once there is a plant."""
        await_loaded(setup_kernels(scene, config))
        check_plant(self.plant, spec, passed=passed)
        if has_own_world(self.plant):
            x, y, yaw = map(float, self.plant.observe().object_pose)
            scene = scene.with_start((x, y, yaw))
        if isinstance(self.plant, RealPlant):
            found = self.plant.surveyed(scene)
            if found is not scene:
                check_task(found)
            scene = found
        self.scene = scene
        if isinstance(self.plant, RealPlant):
            config = self.plant.limited(config)
        resolved = resolve(config, scene, control_period=self.plant.control_period)
        self.config = config = validate(resolved.config)
        self._clearance = ExactClearance(scene)
        self.planner = make_planner(scene, config, spec, report=report)
        if spec.engine != "auto":  # which has warmed up the engine that it chose
            self.planner.warm_up()
        self.spec = replace(
            spec,
            engine=self.planner.engine,
            device=self.planner.compute.name,
            threads=self.planner.compute.threads,
            plant=type(self.plant).__name__ if passed else spec.plant,
        )
        self._drive = Drive(self.plant, scene.robot.dof, config.safety)
        self._guard = SafetyFilter(scene, config.safety, config.control_period) if config.safety.filter else None
        self.watch: Watch | None = None
        if isinstance(self.plant, RealPlant):
            asked = enter_pressed if sys.stdin is not None and sys.stdin.isatty() else None
            self.watch = Watch(self.plant, asked=asked, say=partial(print, file=sys.stderr))
        self._control_steps = self._loop()
        self._plans = 0
        self._sideways: np.ndarray | None = None
        self._problem = ""
        self.log = EpisodeLog(
            {
                "scene": scene.name,
                "file": str(scene.file),
                **asdict(self.spec),
                "engine_reason": self.planner.engine_reason,
                "preset": config.preset,
                "config": to_json(asdict(config)),
                "requested": {name: [change.asked, change.reason] for name, change in resolved.changes.items()},
                "start": list(scene.start),
                "goal": list(scene.goal),
                "tolerance": to_json(scene.tolerance),
                "tight_tolerance": to_json(scene.tight_tolerance),
                "exact_tolerance": to_json(scene.exact_tolerance),
                "hold_seconds": config.episode.hold_seconds,
                "control_period": config.control_period,
                "cost_terms": list(self.planner.dynamics.terms),
                "scores": list(self.plant.verdict.scores) if isinstance(self.plant, JudgingPlant) else [],
                "preplan_time_s": 0.0,
                "ended": "interrupted",
                "problems": [],
                "filtered": {},
                "versions": versions() | _packages(spec, config),
            }
        )

    def run(self, on_step: Callable[[EpisodeLog], None] | None = None) -> EpisodeLog:
        """Runs until the object has stayed within tolerance for the hold time, or the time is up.

        A :class:`oimppi_warp.plants.plant.JudgingPlant` decides itself when the task is done. The episode ends early
        when the object tips over or falls off the table, on Ctrl-C, and when the plant diverges; the log is complete in
        these cases too.

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
        except FloatingPointError:
            self.log.header["ended"] = "diverged"
        return self.log

    def steps(self) -> Generator[ControlStep]:
        """Runs the episode step by step: yields each control period once it has passed, until the episode ends.

        This is ``while not converged`` of Algorithm 2, line 1, and of Algorithm 3, line 10.

        Raises:
            RuntimeError: The episode was run before.
            FloatingPointError: The plant diverged.
        """
        if len(self.log):
            raise RuntimeError("this episode has already run; make a new one to run again")
        settings = self.config.episode
        wanted = self.scene.tolerance
        if settings.tight:
            wanted = wanted.strictest(self.scene.tight_tolerance)
        if settings.exact:
            wanted = wanted.strictest(self.scene.exact_tolerance)
        wanted_steps = hold_steps(settings.hold_seconds, self.config.control_period)
        held = 0
        real = isinstance(self.plant, RealPlant)
        with (
            real_time_priority() if real else nullcontext(),
            without_pauses() if self.spec.mode == "realtime" else nullcontext(),
        ):
            try:
                for index in range(round(settings.max_sim_seconds / self.config.control_period)):
                    check_interrupted()
                    self._knock(index * self.config.control_period)
                    step = next(self._control_steps)
                    position_error, yaw_error = self._record(step)
                    yield step
                    if self.watch is not None and self.watch.given_up:
                        self.log.header["ended"] = "stopped"
                        break
                    if isinstance(self.plant, TruthfulPlant) and has_fallen(self.plant.truth()):
                        self.log.header["ended"] = "object fell"
                        break
                    if isinstance(self.plant, JudgingPlant):
                        verdict = self.plant.verdict
                        if verdict.success or verdict.over:
                            self.log.header["ended"] = "success" if verdict.success else "time limit"
                            break
                        continue
                    held = held + 1 if position_error <= wanted.position and yaw_error <= wanted.yaw else 0
                    if held == wanted_steps:
                        self.log.header["ended"] = "success"
                        break
                else:
                    self.log.header["ended"] = "time limit"
            finally:  # stop the arm first, however the episode ended
                if isinstance(self.plant, RealPlant):
                    self.plant.close()
                else:
                    with suppress(Exception):
                        self._drive.stop()
                self._control_steps.close()

    def _loop(self) -> Generator[ControlStep]:
        """Returns the control steps of plant and planner; a plant that reports the exact state needs no estimator."""
        dof, guard = self.scene.robot.dof, self._guard
        if self.spec.mode == "realtime":
            estimator = Estimator(self.scene, self.config)
            expires = self.config.episode.plan_expires
            return real_time(
                self._drive, self.planner, estimator, dof=dof, expires=expires, guard=guard, watch=self.watch
            )
        behind = self.plant.observe().object_time is not None or self._drive.latency > 0.0
        estimator = Estimator(self.scene, self.config) if behind else None
        return lock_step(self._drive, self.planner, estimator, dof=dof, guard=guard)

    def _knock(self, time: float) -> None:
        """Knocks the object as the run's option ``knock`` says, in the control period that begins at ``time`` [s]."""
        if self.spec.knock is None or not isinstance(self.plant, MovablePlant):
            return
        begin, force, duration = self.spec.knock
        period = self.config.control_period
        share = min(time + period, begin + duration) - max(time, begin)
        if share <= 0.0:
            return
        if self._sideways is None:  # the direction is kept during the knock
            state = self.plant.truth() if isinstance(self.plant, TruthfulPlant) else self.plant.observe()
            if not np.isfinite(state.object_pose).all():
                return
            ahead = np.array(self.scene.goal[:2]) - state.object_pose[:2]
            self._sideways = np.array([-ahead[1], ahead[0], 0.0]) / max(float(np.hypot(*ahead)), 1e-9)
        self.plant.knock(force * share * self._sideways)

    def state_after(self, step: ControlStep) -> Observation:
        """Returns the state after a control step: the exact one or, if the plant does not know it, the estimate.

        While there is no estimate, it has the pose that was detected last, or that of the start.
        """
        if isinstance(self.plant, TruthfulPlant):
            return self.plant.truth()
        known = (step.estimate, step.observed.object_pose, np.array(self.scene.start))
        x, y, yaw = next(pose for pose in known if np.isfinite(pose).all())
        transform = planar_transform((x, y, yaw), self.scene.object.rest_height)
        return replace(step.observed, object_pose=np.array([x, y, yaw]), object_transform=transform)

    def _record(self, step: ControlStep) -> tuple[float, float]:
        """Logs a control step; returns the object's distance [m] and angle [rad] to its goal."""
        plan = step.plan
        if plan is not None:
            self.log.header["preplan_time_s"] += step.preplan_seconds
            ahead = self.planner.object_plan
            if self._plans == 0 and ahead is not None:
                self.log.add_reference(ahead)
            elif plan.object_update is not None and self._plans % _REFERENCE_EVERY == 0:
                self.log.add_reference(plan.reference)
            self._plans += 1
        filtered = step.filtered.reason if step.filtered is not None else ""
        if filtered:
            counts = self.log.header["filtered"]
            counts[filtered] = counts.get(filtered, 0) + 1
        problem = problem_of(step)
        if problem and problem != self._problem:
            self.log.header["problems"].append([len(self.log), problem])
        if problem or plan is not None:
            self._problem = problem
        truth = self.state_after(step)
        position_error, yaw_error = pose_error(truth.object_pose, self.scene.goal)
        forces = {}
        if isinstance(self.plant, ContactPlant):
            contacts = self.plant.contacts
            forces = {
                "contact_tool_object": contacts.tool_object,
                "contact_object_obstacle": contacts.object_obstacle,
                "contact_robot_obstacle": contacts.robot_obstacle,
            }
        judged = {}
        if isinstance(self.plant, JudgingPlant):
            verdict = self.plant.verdict
            judged = {"done": float(verdict.success), "scores": np.array(list(verdict.scores.values()))}
        row = {} if plan is None else _of_plan(plan)
        self.log.append(
            time=truth.time,
            joint_position=truth.joint_position,
            joint_velocity=truth.joint_velocity,
            command=step.command,
            planned_command=np.full(self.scene.robot.dof, np.nan) if step.planned is None else step.planned,
            tool_position=tip_frame(self.scene.robot, truth.joint_position)[1],
            object_pose=truth.object_pose,
            estimated_pose=step.estimate,
            detection=float(EVENTS.index(step.event)),
            position_error=position_error,
            yaw_error=yaw_error,
            clearance=self._clearance.at(truth.object_pose),
            plan_ms=1e3 * step.plan_seconds,
            missed_deadline=float(step.missed),
            stopped=float(step.stopped),
            lag_ms=1e3 * step.lag,
            sent=step.sent,
            limited=float(step.limited),
            filtered=float(bool(filtered)),
            joint_acceleration=step.peak_acceleration,
            joint_jerk=step.peak_jerk,
            **forces,
            **judged,
            **row,
        )
        return position_error, yaw_error


def check_plant(plant: Plant, spec: RunSpec, *, passed: bool) -> None:
    """Checks that a plant can do what a run asks for.

    Args:
        plant: The plant.
        spec: The options of the run.
        passed: Whether the plant was passed by the caller, instead of being made by its name.

    Raises:
        ConfigError: It cannot.
    """
    period: Any = getattr(plant, "control_period", None)
    usable = isinstance(period, int | float | np.floating) and not isinstance(period, bool)
    bounds = about(Config.__dataclass_fields__["control_period"])
    if not (usable and bounds.low <= float(period) <= bounds.high):
        given = "no control_period" if period is None else f"a control_period of {period}"
        allowed = f"the duration of a command in seconds, {bounds.low:g} to {bounds.high:g}, such as 0.05"
        raise ConfigError(f"the plant {type(plant).__name__} has {given}\n  allowed: {allowed}")
    needed = {"observe": "observe(), which returns an Observation"}
    if not isinstance(plant, StreamingPlant):
        needed["apply"] = "apply(joint_velocity), which moves the arm for one control period"
    for name, method in needed.items():
        if not callable(getattr(plant, name, None)):
            raise ConfigError(f"the plant {type(plant).__name__} has no method {name}\n  to do:   add {method}")
    if isinstance(plant, RealPlant) and spec.mode != "realtime":
        raise ConfigError(
            f"the plant {type(plant).__name__} is a real arm, which runs in real time only\n"
            '  to do:   --mode realtime (mode="realtime")'
        )
    if spec.friction is not None and passed:
        raise ConfigError("friction: a plant that is passed has its own friction\n  to do:   pass its name instead")
    if spec.knock is not None and not isinstance(plant, MovablePlant):
        raise ConfigError(
            f"knock: the plant {type(plant).__name__} cannot be knocked\n"
            "  allowed: a plant with the methods of MovablePlant (place, knock, contact_points)"
        )
    if not 0.0 <= latency_of(plant) <= _LONGEST_LATENCY:
        raise ConfigError(f"the plant has a latency of {latency_of(plant):g} s\n  allowed: 0 to {_LONGEST_LATENCY:g} s")


def has_fallen(state: Observation) -> bool:
    """Returns whether the object has tipped over or fallen off the table."""
    return has_tipped(state.object_transform) or bool(state.object_transform[2] < -_FALLEN)


def problem_of(step: ControlStep) -> str:
    """Returns why the arm was stopped in a control step, by watch, planner or safety filter; empty if it was not."""
    if step.halted:
        return step.halted
    if step.plan is not None and step.plan.problem:
        return step.plan.problem
    return "" if step.filtered is None else step.filtered.problem


def _packages(spec: RunSpec, config: Config) -> dict[str, str]:
    """Returns the versions of installed packages whose entries a run uses."""
    names = {registry.package_of(name) for registry, name in entries_used(spec, config)}
    return {name: version(name) for name in sorted(names) if name}


def _of_plan(plan: Plan) -> dict[str, Any]:
    """Returns the columns that a new plan fills."""
    ahead = plan.reference[:2]
    return {
        "reference_pose": ahead[-1] if len(ahead) else np.full(3, np.nan),
        "object_plan_ms": 1e3 * plan.object_seconds,
        "effective_samples": plan.update.effective_samples,
        "object_effective_samples": plan.object_update.effective_samples if plan.object_update else np.nan,
        "min_cost": plan.update.min_cost,
        "cost_terms": plan.terms,
        "lost_samples": plan.update.lost,
    }
