"""A loop that moves a simulated lab's arm in real time, and checks of how it comes to rest."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from support import small_tasks

from oimppi_warp.config.presets import lab
from oimppi_warp.observation import Observation
from oimppi_warp.planning.plan import Plan
from oimppi_warp.plants.drive import Drive
from oimppi_warp.plants.real.plant import ArmPlant
from oimppi_warp.plants.realtime_lab import RealTimeLab
from oimppi_warp.runtime.control import ControlStep, real_time
from oimppi_warp.runtime.estimator import Estimator
from oimppi_warp.runtime.watch import Watch

REST = 0.25
"""Time within which the arm is at rest after whatever happens [s]."""
TURN = np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.0])


class Repeats:
    """A planner whose every plan is the same command."""

    def __init__(self, command: np.ndarray) -> None:
        self.command = command

    def start(self, observation: Observation) -> float:
        return 0.0

    def plan(self, observation: Observation) -> Plan:
        return Plan(self.command, np.nan, lambda: None)  # pyright: ignore


class Pushing:
    """The control loop with a plant, in a thread; the planner turns the arm's base at a constant speed.

    Attributes:
        steps: What happened so far.
        said: What the watch said.
        stuck: Seconds that the next step takes longer, as with a viewer that hangs.
    """

    def __init__(self, plant: ArmPlant) -> None:
        scene, config = small_tasks.shipped("lab01"), lab()
        self.steps: list[ControlStep] = []
        self.said: list[str] = []
        self.stuck = 0.0
        self.watch = Watch(plant, say=self.said.append)
        drive = Drive(plant, scene.robot.dof, config.safety)
        loop = real_time(drive, Repeats(TURN), Estimator(scene, config), dof=6, expires=0.25, watch=self.watch)
        self._loop, self._open = loop, True
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        for step in self._loop:
            self.steps.append(step)
            time.sleep(self.stuck)
            self.stuck = 0.0
            if not self._open:
                break
        self._loop.close()

    def __enter__(self) -> Pushing:
        return self

    def __exit__(self, *_: object) -> None:
        self._open = False
        self._thread.join()


def stops(made: RealTimeLab, pushing: Pushing, message: str, *, within: float = REST) -> None:
    """Checks that the arm comes to rest in time, and that the loop says why."""
    assert time_to_rest(made) < within
    wait_until(lambda: bool(pushing.said))
    assert message in pushing.said[0]
    assert "to do:" in pushing.said[0]
    wait_until(lambda: bool(pushing.steps[-1].halted))
    assert pushing.steps[-1].stopped
    assert not np.any(pushing.steps[-1].command) or np.abs(pushing.steps[-1].command).max() < 0.2
    assert pushing.watch.stops == 1


def begun(made: RealTimeLab) -> None:
    wait_until(lambda: speed(made) > 0.15)
    time.sleep(0.5)  # until it is clear what the arm does


def speed(made: RealTimeLab) -> float:
    """Speed of the fastest joint, by the simulation itself [rad/s]."""
    return float(np.abs(made.state()[1]).max())


def wait_until(reached: Callable[[], bool], seconds: float = 15.0) -> float:
    """Waits for something; the time that it took [s]."""
    began = time.monotonic()
    while not reached():
        if time.monotonic() > began + seconds:
            raise AssertionError(f"not within {seconds:g} s")
        time.sleep(0.002)
    return time.monotonic() - began


def time_to_rest(made: RealTimeLab) -> float:
    """Time that the arm takes to come to rest, by how far it moves at its largest speed [s].

    The simulation stands still where this machine is too slow, so that the result does not depend on that.
    """
    joints, largest = made.state()[0], np.full(6, 0.05)
    until, last = time.monotonic() + 10.0, time.monotonic()
    while time.monotonic() < last + 0.3:
        assert time.monotonic() < until, "the arm does not stop"
        largest = np.maximum(largest, np.abs(made.state()[1]))
        if speed(made) > 1e-3:
            last = time.monotonic()
        time.sleep(0.002)
    return float((np.abs(made.state()[0] - joints) / largest).max())


def forces(log: Path) -> list[float]:
    """Largest forces that a lab printed [N]: tool and object, object and obstacles, arm and obstacles."""
    line = next(line for line in log.read_text().splitlines() if line.startswith("The largest forces"))
    return [float(word) for word, unit in zip(line.split(), line.split()[1:], strict=False) if unit == "N"]
