"""Runs the viewer's control loop in its own thread; it produces pictures without waiting for their display.

User requests (pausing, another goal, other weights) are applied between two control steps. If a change requires a new
planner, it is prepared while the current one runs, and then continues from its latest state.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Generator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np

from oimppi_warp.observation import Observation, planar_transform
from oimppi_warp.plants.plant import MovablePlant, RealPlant, TruthfulPlant
from oimppi_warp.runtime.control import ControlStep
from oimppi_warp.runtime.episode import Episode, problem_of
from oimppi_warp.runtime.setup import Setup
from oimppi_warp.scene import PlanarPose
from oimppi_warp.view.picture import Picture

SAMPLED = 32
"""Number of sampled paths shown."""
_RATE = 40
"""Number of control steps over which the rate is measured."""


class Session:
    """Runs episodes that a user can watch and change.

    Args:
        setup: Setup of the first episode.
        speed: Maximum simulated seconds per second of wall time; infinity for no limit.

    Attributes:
        wanted: The setup requested last; the running episode adopts it as soon as it is ready.
        latest: The latest picture.
        speed: As above; may be changed at any time.
        paused: Whether the loop is paused; may be changed at any time.
        watched: Whether sampled paths should be computed.
        problem: Reason why the last request failed.
    """

    def __init__(self, setup: Setup, *, speed: float = 1.0) -> None:
        self.wanted = self._first = setup
        self.speed = speed
        self.paused = False
        self.watched = False
        self.problem = ""
        self._lock = threading.Lock()
        self._changed = self._fresh = False
        self._single = 0
        self._moved: np.ndarray | None = None
        self._knock: np.ndarray | None = None
        self._pending: Future[tuple[Episode, bool]] | None = None
        self._builder = ThreadPoolExecutor(1, thread_name_prefix="oimppi-builder")
        self._closing = threading.Event()
        self._times: deque[float] = deque(maxlen=_RATE)
        self._before = 0.0
        self._begin(setup.episode())
        self.latest = self._picture(None)
        self._thread = threading.Thread(target=self._loop, name="oimppi-control", daemon=True)

    def start(self) -> None:
        """Starts the control loop, unless it is already running."""
        if not self._thread.is_alive():
            self._thread.start()

    def close(self) -> None:
        """Stops the control loop."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join()
        if isinstance(self._episode.plant, RealPlant):
            self._episode.plant.close()
        self._builder.shutdown(cancel_futures=True)

    @property
    def running(self) -> Episode:
        """Returns the current episode."""
        return self._episode

    @property
    def over(self) -> bool:
        """Returns whether the episode has ended."""
        return self._over

    @property
    def real(self) -> bool:
        """Returns whether a real arm is moved."""
        return self._episode.watch is not None

    def go_on(self) -> None:
        """Asks a real arm to go on after a stop."""
        if self._episode.watch is not None:
            self._episode.watch.go_on()

    @property
    def rate(self) -> float:
        """Returns the recent rate of control steps [1/s]; 0 if there were none."""
        times = list(self._times)
        return (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 else 0.0

    def change(self, *, fresh: bool = False, **fields: Any) -> None:
        """Requests another setup, which takes effect as soon as its planner is ready.

        Args:
            fresh: Whether to restart from the beginning; otherwise the episode continues from its current state.
            **fields: As for :meth:`oimppi_warp.runtime.setup.Setup.changed`.
        """
        if self.real:
            self.problem = "a real arm carries out the task: to change it, stop the viewer and start again"
            return
        with self._lock:
            self.wanted = self.wanted.changed(**fields)
            self._changed = True
            self._fresh |= fresh

    def restart(self) -> None:
        """Restarts the episode from the beginning."""
        self.change(fresh=True)

    def step(self) -> None:
        """Requests a single control step while the session is paused."""
        with self._lock:
            self._single += 1

    def move_object(self, pose: PlanarPose) -> None:
        """Requests that the object be placed at another planar pose, at rest."""
        with self._lock:
            self._moved = planar_transform(pose, self.wanted.scene.object.rest_height)

    def knock(self, impulse: np.ndarray) -> None:
        """Requests an impulse on the object, in the world frame, shape [3] [N s]."""
        with self._lock:
            self._knock = impulse

    def _loop(self) -> None:
        try:
            self._run()
        finally:
            self._steps.close()
            self._over = True
            self.latest = replace(self.latest, status=self._status())

    def _run(self) -> None:
        due, said = time.perf_counter(), ()
        while not self._closing.is_set():
            self._apply_requests()
            with self._lock:
                active = not self._over and (not self.paused or self._single > 0)
                self._single = max(self._single - 1, 0) if active else 0
            if not active:
                self._times.clear()
                if (says := (self._status(), self.problem, self._episode)) != said:  # every new picture is drawn
                    self.latest = replace(self.latest, status=says[0], scene=self._episode.scene)
                    said = says
                self._closing.wait(0.02)
                due = time.perf_counter()
                continue
            said = ()
            try:
                step = next(self._steps, None)
            except FloatingPointError:
                self._episode.log.header["ended"], step = "diverged", None
            except Exception as error:  # for example from a third-party plant or method; shown in the page
                self.problem, step = str(error) or type(error).__name__, None
            self._over = step is None
            if step is None:
                continue
            self._times.append(time.perf_counter())
            self._last = self._episode.state_after(step)
            if step.plan is not None or problem_of(step):
                self._problem_of_step = problem_of(step)
            self._filtered = "" if step.filtered is None else step.filtered.reason
            self.latest = self._picture(step)
            if self._episode.log.header["mode"] == "lockstep":
                period = self._episode.config.control_period / self.speed
                due = max(due + period, time.perf_counter() - period)
                self._closing.wait(max(due - time.perf_counter(), 0.0))

    def _begin(self, episode: Episode) -> None:
        self._episode = episode
        self._steps: Generator[ControlStep] = episode.steps()
        if episode.watch is not None:
            episode.watch.attended = True
        self._over = False
        self._last: Observation | None = None
        self._problem_of_step = self._filtered = ""

    def _apply_requests(self) -> None:
        """Applies the pending requests that are ready."""
        with self._lock:
            if self._changed and self._pending is None:
                self._pending = self._builder.submit(_build, self.wanted, self._fresh)
                self._changed = self._fresh = False
            pending = self._pending if self._pending is not None and self._pending.done() else None
            moved, self._moved = self._moved, None
            knock, self._knock = self._knock, None
        if pending is not None:
            self._pending = None
            try:
                episode, fresh = pending.result()
            except Exception as error:
                self.problem = str(error) or type(error).__name__
            else:
                self.problem = ""
                state = self._state
                self._before = 0.0 if fresh else self._before + state.time
                if not fresh and isinstance(episode.plant, MovablePlant):
                    episode.plant.place(state.joint_position, state.object_transform)
                self._steps.close()
                self._begin(episode)
                self.latest = self._picture(None)
        plant = self._episode.plant
        if not isinstance(plant, MovablePlant):
            if moved is not None or knock is not None:
                self.problem = (
                    f"the plant {self._episode.spec.plant} does not support moving or pushing the object by hand"
                )
            return
        if moved is not None:
            plant.place(self._state.joint_position, moved)
            if self._over:
                self.change()
            self.latest = self._picture(None)
        if knock is not None:
            plant.knock(knock)

    @property
    def _state(self) -> Observation:
        """Returns the state of the running episode: the true one, the last estimate, or the start."""
        episode = self._episode
        if isinstance(episode.plant, TruthfulPlant):
            return episode.plant.truth()
        if self._last is not None:
            return self._last
        scene, joints = episode.scene, episode.scene.robot.start
        transform = planar_transform(scene.start, scene.object.rest_height)
        return Observation(0.0, joints, np.zeros_like(joints), np.array(scene.start), transform)

    def _picture(self, step: ControlStep | None) -> Picture:
        episode = self._episode
        truth, log, plant = self._state, episode.log, episode.plant
        picture = Picture(
            scene=episode.scene,
            time=self._before + truth.time,
            joints=truth.joint_position,
            object_transform=truth.object_transform,
            contact_points=plant.contact_points if isinstance(plant, MovablePlant) else np.zeros((0, 6)),
            kept_apart=np.zeros((0, 2, 3)) if step is None or step.filtered is None else step.filtered.nearest,
            status=self._status(),
        )
        if step is None or step.plan is None or step.plan.problem:
            return picture
        plan = step.plan
        picture = replace(
            picture,
            reference=plan.reference,
            tips=plan.tips,
            figures={
                "position error [m]": float(log["position_error"][-1]),
                "yaw error [rad]": float(log["yaw_error"][-1]),
                "clearance [mm]": 1e3 * float(log["clearance"][-1]),
                "cost": plan.update.min_cost,
                "effective samples": plan.update.effective_samples,
                "plan time [ms]": 1e3 * step.plan_seconds,
            },
        )
        if not self.watched or episode.log.header["mode"] == "realtime":  # in real time the planner is still busy
            return picture
        samples = episode.planner.samples(SAMPLED)
        return replace(picture, sampled=samples.tips, weights=samples.weights, terms=samples.terms)

    def _status(self) -> str:
        """Returns a one-line status message."""
        if self._over and self.real:
            return f"the run has ended ({self._episode.log.header['ended']}): to go on, start the viewer again"
        if self._over:
            return {
                "success": "goal reached: move the goal or the object, or press Reset",
                "object fell": "the object fell: press Reset",
                "time limit": "time limit reached: press Reset",
                "diverged": "the simulation diverged: press Reset",
            }.get(self._episode.log.header["ended"], "stopped")
        if self._pending is not None:
            return "preparing the requested change"
        if self.paused:
            return "paused"
        if self._problem_of_step:
            return f"stopped: {self._problem_of_step}"
        if self._filtered:
            return f"the safety filter changed the command, for: {self._filtered}"
        if self._episode.planner.repositioning:
            return "no progress: repositioning to push from elsewhere"
        if self._episode.planner.on_detour:
            return "no progress: pushing where a push is possible"
        return "pushing"


def _build(setup: Setup, fresh: bool) -> tuple[Episode, bool]:
    return setup.episode(), fresh
