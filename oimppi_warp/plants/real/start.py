"""The way of a real arm to its start posture: asked for, checked, and slow."""

from __future__ import annotations

import math
import sys
import termios
import time
from typing import TYPE_CHECKING

import numpy as np

from oimppi_warp.errors import HardwareError
from oimppi_warp.physics.world import World
from oimppi_warp.plants.real.start_move import StartMove
from oimppi_warp.scene import Scene
from oimppi_warp.signals import check_interrupted

if TYPE_CHECKING:
    from oimppi_warp.plants.real.plant import ArmPlant

_SPEED = 0.25
"""Speed of the fastest joint, at full speed [rad/s]."""
_ACCELERATION = 0.5
"""Acceleration of the fastest joint [rad/s^2]."""
_THERE = 0.01
"""Distance of every joint from a posture at which the arm has arrived [rad]."""
_GAIN = 2.0
"""Rate at which deviations from the way are reduced [1/s]."""
_GET_THERE = 5.0
"""Time that the way may take beyond twice the planned one [s]."""
FIRST_POSE = 5.0
"""Time to wait for a pose of the object before the arm moves [s]."""
_OLDEST_AT_REST = 60.0
"""Age of a pose up to which the arm may move to its start: it may hide the object where it stands [s]."""


class StartProcedure:
    """Moves the arm of a plant to the scene's start posture.

    Args:
        plant: The plant.
        scene: The task.
    """

    def __init__(self, plant: ArmPlant, scene: Scene) -> None:
        self._plant, self._way = plant, StartMove(World(scene))
        self._start = np.asarray(scene.robot.start, dtype=float)
        self._pace = plant.speed * _SPEED

    def run(self, *, confirmed: bool) -> None:
        """Moves the arm, after a confirmation.

        Where the object is not seen, the arm may hide it, and where it seems to be in the tool, its pose is not exact:
        the tool is lifted first, straight up, wherever the object is.

        Args:
            confirmed: Whether nobody needs to be asked.

        Raises:
            HardwareError: The object is not seen, the way is not free, the answer is no, or a fault stops the arm.
        """
        plant, sight = self._plant, self._plant.sight
        if sight.agreed(oldest=_OLDEST_AT_REST, wait=FIRST_POSE) is None and not sight.ever:
            raise sight.error()
        degrees = math.degrees(float(np.abs(self._start - plant.joints()).max()))
        if not confirmed and not _ask(
            "The arm will lift its tool if need be, and move to its start posture (joints turn by up to "
            f"{degrees:.0f} degrees, at {math.degrees(self._pace):.0f} degrees/s). Then it pushes at "
            f"{100 * plant.speed:.0f} % of the usual speed. Is everybody out of its reach, and the emergency stop at "
            "hand?"
        ):
            raise HardwareError("the arm was not moved\n  to do:   confirm the move, or use --yes in a script")
        # Everything is looked at again: nobody knows how long the answer took.
        plant.check()
        pose = sight.agreed(oldest=_OLDEST_AT_REST, wait=FIRST_POSE)
        here = plant.joints()
        if pose is None or self._way.clearance(here, pose)[1] < 0.0:
            path = self._way.lift(here)
            plant.enable()
            self._follow(path)
            pose = sight.agreed(oldest=_OLDEST_AT_REST, wait=FIRST_POSE)
            if pose is None:
                raise sight.error()
            self._follow(self._way.path(plant.joints(), self._start, pose))
            return
        path = self._way.path(here, self._start, pose)
        plant.enable()
        self._follow(path)

    def _follow(self, path: np.ndarray) -> None:
        """Moves slowly through postures, shape [n, dof] [rad], and stops at the last one.

        Raises:
            HardwareError: A fault stopped the arm, it is not where the way begins, or it does not get to its end.
        """
        plant, pace = self._plant, self._pace
        if np.abs(path[0] - plant.joints()).max() > _THERE:
            raise HardwareError("the arm was moved meanwhile\n  to do:   let it stand still, and start again")
        knots = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(path, axis=0)).max(axis=1))])
        at, speed, target, period = 0.0, 0.0, path[0], plant.control_period
        until = time.monotonic() + 2.0 * knots[-1] / pace + _GET_THERE
        while True:
            check_interrupted()
            if time.monotonic() > until:
                raise HardwareError(
                    "the arm does not get to its start posture\n  to do:   see what holds it, or use a larger --speed"
                )
            if plant.fault:
                raise HardwareError(f"on the way to its start posture the arm was stopped: {plant.fault}")
            here = plant.joints()
            left = knots[-1] - at
            if left <= 0.0 and np.abs(path[-1] - here).max() < _THERE:
                break
            # What is left of an error is reduced in proportion to it.
            speed = min(speed + _ACCELERATION * period, pace, math.sqrt(max(2.0 * _ACCELERATION * left, 0.0)))
            ahead = min(at + speed * period, knots[-1])
            wanted = np.array([np.interp(ahead, knots, column) for column in path.T])
            velocity = (wanted - target) / period + _GAIN * (target - here)
            at, target = ahead, wanted
            plant.apply(np.clip(velocity, -1.2 * pace, 1.2 * pace))
            time.sleep(period)
        plant.apply(np.zeros_like(path[-1]))


def _ask(question: str) -> bool:
    """Asks a question on the terminal; without one, the answer is no."""
    if not sys.stdin.isatty():
        return False
    print(question, end=" [y/N] ", file=sys.stderr, flush=True)
    termios.tcflush(sys.stdin, termios.TCIFLUSH)  # an answer from before the question does not count
    return sys.stdin.readline().strip().lower() in ("y", "yes")
