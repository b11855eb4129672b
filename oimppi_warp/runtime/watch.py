"""Stops a real plant's arm when something is not as it should be, and decides when it goes on."""

from __future__ import annotations

import math
import select
import sys
from collections.abc import Callable

import numpy as np

from oimppi_warp.errors import HardwareError
from oimppi_warp.observation import Observation
from oimppi_warp.plants.plant import RealPlant
from oimppi_warp.runtime.estimator import Event

QUIET = 1.0
"""Time for which the reason of a stop must be gone before the arm goes on [s]."""


class Watch:
    """Decides in every control period whether the arm of a real plant may move.

    It is stopped at the plant's faults, when the object's pose is too old, when a detection is far from where the
    object is believed, and when no plan is ready in time. It goes on once the reason has been gone for :data:`QUIET`,
    by itself or after somebody has asked for it (:attr:`oimppi_warp.plants.plant.StopRules.resume`). Who asks while the
    reason is still there is told so, and has to ask again.

    Args:
        plant: The plant.
        asked: Whether somebody has asked to go on since the last call, for example on the terminal; ``None`` if nobody
            can. :meth:`go_on` asks as well.
        say: Receives the reason of each stop, and what happens then.

    Attributes:
        attended: Whether somebody can ask to go on; the viewer sets it.
        stops: Number of stops so far.
        given_up: Whether the arm is stopped and nobody can ask for it to go on.
    """

    def __init__(
        self, plant: RealPlant, *, asked: Callable[[], bool] | None = None, say: Callable[[str], None] | None = None
    ) -> None:
        self._plant, self._asked, self._say = plant, asked, say or (lambda _: None)
        self.attended = asked is not None
        self._reason = self._jumped = ""
        self._latest = self._tried = -math.inf  # times of the latest cause, and of the latest attempt to recover
        self._wish, self._passes = False, True
        self.stops = 0
        self.given_up = False

    def go_on(self) -> None:
        """Asks to go on after a stop, once its reason is gone; it may be called from any thread."""
        self._wish = True

    def reason(self, observation: Observation, known: Observation | None, event: Event, *, late: bool) -> str:
        """Returns why the arm must be at rest in the next control period; empty if it may move.

        Args:
            observation: The plant's latest observation.
            known: The same with the estimated pose of the object; ``None`` if there is none.
            event: What became of the latest detection.
            late: Whether the plan has expired and no new one is ready.
        """
        now = self._plant.now
        self._wish |= self._asked is not None and self._asked()
        stopped = bool(self._reason)
        alone = self._plant.rules.resume and self._passes
        if stopped and self._plant.fault and (alone or self._wish) and now - self._tried >= QUIET:
            self._recover(now)
        cause = self._plant.fault or self._cause(observation, known, event, late=late)
        if cause:
            self._latest = now
            self._passes &= not self._plant.fault or self._plant.fault_passes
            if not stopped:
                self._stop(cause, now)
            elif alone and not self._passes:  # something worse than what the arm was stopped for
                self._tell(cause)
            elif self._wish:
                self._say(f"the arm cannot go on yet: {cause}")
            self._wish = False
        elif stopped and (alone or self._wish) and now - self._latest >= QUIET:
            self._say("the arm goes on")
            self._reason, self._wish = "", False
        return self._reason

    def _stop(self, cause: str, now: float) -> None:
        self.stops += 1
        self._reason, self._tried = cause, now
        self._passes = not self._plant.fault or self._plant.fault_passes
        self._tell(cause)

    def _tell(self, cause: str) -> None:
        """Says why the arm is stopped and what happens then."""
        alone = self._plant.rules.resume and self._passes
        self.given_up = not alone and not self.attended
        after = "it goes on by itself once the reason is gone" if alone else "press Enter, or Go on in the viewer"
        self._say(f"the arm was stopped: {cause}\n  then:    {'the run ends' if self.given_up else after}")

    def _recover(self, now: float) -> None:
        """Asks the plant to get ready to move; what it says otherwise is its cause again."""
        self._tried = now
        try:
            self._plant.recover()
        except HardwareError as error:
            if self._wish:
                self._say(f"the arm cannot go on yet: {error}")
            self._wish = False

    def _cause(self, observation: Observation, known: Observation | None, event: Event, *, late: bool) -> str:
        """Returns what is wrong now, apart from the plant's own faults; empty if nothing is."""
        rules = self._plant.rules
        taken = observation.object_time
        age = math.inf if taken is None or math.isnan(taken) else self._plant.now - taken
        if age > rules.pose_timeout:
            found = f"the newest is {age:.1f} s old, at most {rules.pose_timeout:g} s is allowed"
            return f"no pose of the object: {self._plant.blind or found}"
        if event == "rejected" and known is not None:
            jump = float(np.hypot(*(observation.object_pose - known.object_pose)[:2]))
            if jump > rules.jump:
                self._jumped = (
                    f"the object was detected {jump:.2f} m from where it is believed\n"
                    "  to do:   see whether it was moved or mistaken; the next detections decide"
                )
        elif event in ("accepted", "recovered", "first"):
            self._jumped = ""
        if self._jumped:
            return self._jumped
        return "no plan was ready in time\n  to do:   plan with fewer samples, or close other programs" if late else ""


def enter_pressed() -> bool:
    """Returns whether Enter was pressed on the terminal since the last call; it does not wait."""
    if not select.select([sys.stdin], [], [], 0.0)[0]:
        return False
    return bool(sys.stdin.readline())
