"""Control loop of planner, estimator and plant: in lock step, or in real time on the wall clock.

In both modes each control period yields one :class:`ControlStep`. In lock step the world is paused while the planner
runs. In real time the planner runs in parallel with the plant and computes the command that is due at the next step,
from the state predicted for that time. A late plan is used one step later. Meanwhile the previous command is held, and
when it has expired the arm is stopped.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from oimppi_warp.errors import ObservationError
from oimppi_warp.observation import Observation, check_shapes
from oimppi_warp.planning.plan import Plan
from oimppi_warp.plants.drive import Drive
from oimppi_warp.plants.plant import Plant, RealPlant
from oimppi_warp.plants.safety_filter import Filtered, SafetyFilter
from oimppi_warp.priority import lower_priority
from oimppi_warp.runtime.estimator import Estimator, Event
from oimppi_warp.runtime.watch import Watch

_CLOCK_PERIODS = 10
"""Number of control periods after which the clock of a plant in lock step is checked."""
_CLOCK_ERROR = 0.2
"""Share by which the clock may be off then: a simulator's steps need not divide the control period."""


class SupportsPlanning(Protocol):
    """The methods that the loop needs of a planner."""

    def start(self, observation: Observation) -> float:
        """Prepares for an episode that begins with ``observation``; returns the wall time of planning before it [s]."""
        ...

    def plan(self, observation: Observation) -> Plan:
        """Returns the plan for the control step that begins with ``observation``."""
        ...


class PlanExecutor(Protocol):
    """An executor in which the planner runs, like :class:`concurrent.futures.Executor`."""

    def submit(self, work: Callable[[Observation], _TimedPlan], observation: Observation, /) -> Future[_TimedPlan]:
        """Starts making a plan."""
        ...


@dataclass(frozen=True, eq=False)
class ControlStep:
    """One control period that has passed.

    Attributes:
        command: Joint velocities that the plant was given, as :class:`Drive` limits them, shape [dof] [rad/s].
        plan: The plan that took effect in this period; ``None`` if there was no new one.
        plan_seconds: Wall time of that plan [s].
        preplan_seconds: Wall time of planning before the first plan [s]; 0 except in the step of that plan.
        observed: The plant's observation at the end of the period.
        estimate: Estimated planar pose of the object at the end of the period, shape [3] [m, m, rad]; NaN if there is
            none.
        event: Result of processing a detection in this period, one of :data:`oimppi_warp.record.log.EVENTS`.
        missed: Whether a plan was due but not ready.
        stopped: Whether the arm was stopped: the last plan had expired, nothing could be planned, or no command kept
            the bounds of the safety filter.
        lag: Delay of the loop behind the wall clock [s].
        limited: Whether the change of the command was scaled down to the limits of acceleration and jerk.
        filtered: The command as the safety filter let it pass; ``None`` without a filter.
        peak_acceleration, peak_jerk: See :class:`oimppi_warp.plants.drive.Drive`.
        sent: Time on the wall clock at which the command was sent, since the first [s]; NaN in lock step.
        halted: Why the arm of a real plant had to be at rest; empty if it might move.
        planned: The command before the filter and the limits, shape [dof] [rad/s].
    """

    command: np.ndarray
    plan: Plan | None
    plan_seconds: float
    preplan_seconds: float
    observed: Observation
    estimate: np.ndarray
    event: Event
    missed: bool = False
    stopped: bool = False
    lag: float = 0.0
    limited: bool = False
    filtered: Filtered | None = None
    peak_acceleration: float = math.nan
    peak_jerk: float = math.nan
    sent: float = math.nan
    halted: str = ""
    planned: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class _TimedPlan:
    """A plan with its wall time and, for the first plan, the wall time of the planning before it [s]."""

    plan: Plan
    seconds: float
    preplan_seconds: float


class _TimedPlanner:
    """Runs the planner with timing, and starts it with the first observation."""

    def __init__(self, planner: SupportsPlanning) -> None:
        self._planner = planner
        self.started = False

    def plan(self, observation: Observation) -> _TimedPlan:
        preplan = 0.0 if self.started else self._planner.start(observation)
        self.started = True
        began = time.perf_counter()
        plan = self._planner.plan(observation)
        return _TimedPlan(plan, time.perf_counter() - began, preplan)


def lock_step(
    drive: Drive,
    planner: SupportsPlanning,
    estimator: Estimator | None,
    *,
    dof: int,
    guard: SafetyFilter | None = None,
) -> Generator[ControlStep]:
    """Yields an endless sequence of control steps in which the plant waits for the planner.

    Each step applies ``u`` and observes ``x_{t+1}``: Algorithm 2, lines 7 and 8, and Algorithm 3, lines 13 and 14.

    Args:
        drive: The plant to move, behind its limits.
        planner: The planner.
        estimator: Estimator of the object's pose; ``None`` for a plant without latency that reports its exact state.
        dof: Number of joints.
        guard: Filter of the commands.

    Raises:
        ObservationError: An array that the plant reports has the wrong length, or its time does not advance by its
            control period.
    """
    plant, timed_planner, command = drive.plant, _TimedPlanner(planner), np.zeros(dof)
    observation = _observed(plant, dof)
    known = _known(estimator, observation)
    began, periods = observation.time, 0
    while True:
        timed_plan, lost = None, known is None and timed_planner.started
        if known is None:
            command = np.zeros(dof)
        else:
            if estimator is not None and np.isfinite(known.joint_position).all():
                known = estimator.predict(known, drive.pending())
            timed_plan = timed_planner.plan(known)
            command = timed_plan.plan.command
        planned, filtered = command, filtered_command(guard, drive, observation, command)
        command = drive.apply(filtered.joint_velocity)
        observation = _observed(plant, dof)
        periods += 1
        if periods == _CLOCK_PERIODS:
            _check_clock(plant, observation.time - began)
        known = _known(estimator, observation)
        step = _control_step(drive, command, timed_plan, observation, known, estimator)
        stopped = step.stopped or lost or filtered.stopped
        yield replace(step, stopped=stopped, filtered=filtered, planned=planned)


def real_time(
    drive: Drive,
    planner: SupportsPlanning,
    estimator: Estimator,
    *,
    dof: int,
    expires: float,
    guard: SafetyFilter | None = None,
    watch: Watch | None = None,
    clock: Callable[[], float] = time.perf_counter,
    sleep: Callable[[float], None] = time.sleep,
    executor: PlanExecutor | None = None,
) -> Generator[ControlStep]:
    """Yields an endless sequence of control steps on the wall clock.

    Args:
        drive: The plant to move, behind its limits; sending it a command takes less than a control period.
        planner: The planner, which runs in a separate thread.
        estimator: Estimator of the object's pose.
        dof: Number of joints.
        expires: Time for which a command is held when the next plan is late [s].
        guard: Filter of the commands.
        watch: Decides whether the arm of a real plant may move.
        clock, sleep: Functions of the wall clock [s].
        executor: Executor that the planner runs in; ``None``: a single thread.
    """
    plant, period = drive.plant, drive.control_period
    timed_planner, still = _TimedPlanner(planner), np.zeros(dof)
    command, age = still, 0
    planned = halted = False
    job: Future[_TimedPlan] | None = None
    observation = _observed(plant, dof)
    known = estimator.update(observation)
    own = ThreadPoolExecutor(1, "oimppi-planner", lower_priority) if executor is None else None
    pool = executor or own
    assert pool is not None
    due = began = clock()
    try:
        while True:
            timed_plan, missed, stopped = None, False, False
            if watch is not None and clock() - due > period:
                # Somebody held up the loop: a real arm has stopped by itself, and plans from before are out of date.
                drive.rest()
                command, planned, due = still, False, clock()
                if job is not None:
                    job.result()
                    job = None
            if job is not None and job.done():
                timed_plan, job = job.result(), None
                command, age, planned = timed_plan.plan.command, 0, True
                halted = bool(timed_plan.plan.problem)
            elif planned:
                missed, age = True, age + 1
                if age * period > expires + 1e-9:
                    command, stopped = still, True
            reason = "" if watch is None else watch.reason(observation, known, estimator.event, late=stopped)
            if reason:
                command, stopped = still, True
            at_rest = reason and not np.any(drive.command)  # then the filter must not move the arm either
            filtered = Filtered(command) if at_rest else filtered_command(guard, drive, observation, command)
            if job is None and known is not None:
                # Commands that are already decided are executed before those of the plan requested here.
                pending = [*drive.pending(), (period, drive.allowed(filtered.joint_velocity))]
                job = pool.submit(timed_planner.plan, estimator.predict(known, pending))
            at = clock() - began
            sent = drive.apply(filtered.joint_velocity)
            due += period
            left = due - clock()
            if left > 0.0:
                sleep(left)
            else:  # late: unlike a real world, the simulated one was paused, so restart the clock
                due -= left
            observation = _observed(plant, dof)
            known = estimator.update(observation)
            step = _control_step(drive, sent, timed_plan, observation, known, estimator)
            stopped = stopped or halted or filtered.stopped
            yield replace(
                step,
                missed=missed,
                stopped=stopped,
                lag=max(-left, 0.0),
                filtered=filtered,
                sent=at,
                halted=reason,
                planned=command,
            )
    finally:
        if isinstance(plant, RealPlant):
            plant.close()  # before anything that takes time
        if own is not None:
            own.shutdown(wait=True, cancel_futures=True)


def _check_clock(plant: Plant, passed: float) -> None:
    """Raises ObservationError unless about as much time [s] has passed for the plant as its control periods take."""
    wanted = _CLOCK_PERIODS * plant.control_period
    if not abs(passed - wanted) <= _CLOCK_ERROR * wanted:
        raise ObservationError(
            f"the plant {type(plant).__name__}: its time advanced by {passed:.3g} s in {_CLOCK_PERIODS} control "
            f"periods of {plant.control_period:g} s\n"
            f"  allowed: about {wanted:g} s\n"
            "  to do:   let each command move the plant for one control period, and observe() return the time after it"
        )


def _observed(plant: Plant, dof: int) -> Observation:
    """Returns a plant's observation after checking its shapes."""
    observation = plant.observe()
    check_shapes(observation, dof)
    return observation


def filtered_command(
    guard: SafetyFilter | None, drive: Drive, observation: Observation, command: np.ndarray
) -> Filtered:
    """Returns a command as the filter lets it pass, for where the arm will be when the command takes effect.

    Args:
        guard: The filter; ``None``: every command passes.
        drive: The plant behind its limits, which will be sent the command.
        observation: The plant's latest observation.
        command: Joint velocities, shape [dof] [rad/s; m/s for a prismatic joint].
    """
    if guard is None:
        return Filtered(command)
    joints = observation.joint_position + sum(duration * velocity for duration, velocity in drive.pending())
    filtered = guard.project(joints, drive.allowed(command), drive.command)
    return filtered if filtered.reason else Filtered(command)  # the drive notes that it limits the change


def _known(estimator: Estimator | None, observation: Observation) -> Observation | None:
    """Returns the estimated observation, or an exact one that the estimator rejects: the planner says why."""
    known = observation if estimator is None else estimator.update(observation)
    return observation if known is None and observation.object_time is None else known


def _control_step(
    drive: Drive,
    command: np.ndarray,
    timed_plan: _TimedPlan | None,
    observed: Observation,
    known: Observation | None,
    estimator: Estimator | None,
) -> ControlStep:
    return ControlStep(
        command=command,
        plan=None if timed_plan is None else timed_plan.plan,
        plan_seconds=math.nan if timed_plan is None else timed_plan.seconds,
        preplan_seconds=0.0 if timed_plan is None else timed_plan.preplan_seconds,
        observed=observed,
        estimate=np.full(3, np.nan) if known is None else known.object_pose,
        event="none" if estimator is None else estimator.event,
        stopped=timed_plan is not None and bool(timed_plan.plan.problem),
        limited=drive.limited,
        peak_acceleration=drive.peak_acceleration,
        peak_jerk=drive.peak_jerk,
    )
