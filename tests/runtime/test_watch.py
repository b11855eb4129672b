"""The watch over a real plant, with a plant and a clock of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support import small_tasks

from oimppi_warp.errors import HardwareError
from oimppi_warp.observation import Observation
from oimppi_warp.plants.plant import StopRules
from oimppi_warp.runtime.watch import QUIET, Watch


class Plant:
    """A real plant as far as the watch sees it."""

    rules = StopRules(pose_timeout=2.5, jump=0.1)

    def __init__(self) -> None:
        self.now, self.fault, self.blind = 10.0, "", ""
        self.fault_passes = True
        self.recovers, self.recovered = True, 0

    def recover(self) -> None:
        if not self.recovers:
            raise HardwareError("the error is still there")
        self.recovered += 1
        self.fault = ""


class Bench:
    """A watch, and observations for it."""

    def __init__(self, *, resume: bool = False, asked: list[bool] | None = None) -> None:
        self.plant = Plant()
        self.plant.rules = replace(Plant.rules, resume=resume)
        self.said: list[str] = []
        ask = None if asked is None else lambda: bool(asked and asked.pop(0))
        self.watch = Watch(self.plant, asked=ask, say=self.said.append)  # pyright: ignore
        self.seen = small_tasks.observe(small_tasks.shipped("lab01"))

    def step(self, *, age: float = 0.1, event: str = "none", late: bool = False, off: float = 0.0) -> str:
        """One control period: the object's pose has an age, and was detected some way off where it is believed."""
        self.plant.now += 0.05
        shifted = self.seen.object_pose + np.array([off, 0.0, 0.0])
        taken = self.plant.now - age
        observed: Observation = replace(self.seen, object_pose=shifted, object_time=taken)
        return self.watch.reason(observed, self.seen, event, late=late)  # pyright: ignore

    def steps(self, seconds: float, **options: float) -> list[str]:
        return [self.step(**options) for _ in range(round(seconds / 0.05))]  # pyright: ignore


def test_nothing_stops_an_arm_when_nothing_is_wrong():
    bench = Bench()
    assert not any(bench.steps(3.0))
    assert bench.step(event="rejected", off=0.05) == "", "a small contradiction is the estimator's business"
    assert bench.step(age=2.4) == ""
    assert bench.watch.stops == 0
    assert not bench.said


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"age": 2.6}, "the newest is 2.6 s old"),
        ({"age": float("nan")}, "no pose of the object"),
        ({"late": True}, "no plan was ready"),
        ({"event": "rejected", "off": 0.3}, "0.30 m from where it is believed"),
    ],
)
def test_what_stops_the_arm(options, reason):
    bench = Bench()
    assert reason in bench.step(**options)
    assert reason in bench.step(), "it stays at rest although the reason is gone"
    assert bench.watch.stops == 1
    assert len(bench.said) == 1
    assert bench.watch.given_up, "nobody can ask to go on"


def test_it_goes_on_by_itself_only_if_allowed_and_once_all_has_been_quiet():
    bench = Bench(resume=True)
    assert bench.step(late=True)
    quiet = bench.steps(QUIET + 0.2)
    assert quiet[0]
    assert not quiet[-1]
    assert sum(map(bool, quiet)) == pytest.approx(QUIET / 0.05, abs=1)
    assert bench.said[-1] == "the arm goes on"
    assert bench.step(late=True)
    assert bench.watch.stops == 2


def test_a_jump_counts_until_a_detection_agrees_again():
    bench = Bench(resume=True)
    assert bench.step(event="rejected", off=0.3)
    assert all(bench.steps(3.0)), "the last detection is still the one that jumped"
    assert bench.step(event="recovered")
    assert not bench.steps(QUIET + 0.2)[-1]


def test_somebody_has_to_ask_otherwise():
    asked: list[bool] = []
    bench = Bench(asked=asked)
    assert bench.step(late=True)
    assert not bench.watch.given_up
    assert all(bench.steps(3.0))
    asked.append(True)
    assert not bench.step()
    assert "press Enter" in bench.said[0]


def test_a_wish_from_before_the_stop_does_not_count():
    bench = Bench(asked=[True])
    assert not bench.step()
    assert bench.step(late=True)
    assert all(bench.steps(3.0))
    bench.watch.go_on()
    assert not bench.step()


def test_a_fault_of_the_plant_is_recovered_from_first():
    bench = Bench(resume=True)
    bench.plant.fault, bench.plant.recovers = "the cable is cut", False
    assert bench.step() == "the cable is cut"
    assert all(bench.steps(3.0))
    assert bench.plant.recovered == 0
    bench.plant.recovers = True
    after = bench.steps(2.0 * QUIET + 0.3)
    assert bench.plant.recovered == 1
    assert not after[-1]


def test_after_a_fault_that_does_not_pass_a_person_has_to_ask_even_with_resume():
    bench = Bench(resume=True, asked=[])
    bench.plant.fault, bench.plant.fault_passes = "somebody pressed stop", False
    assert bench.step()
    assert not bench.watch.given_up
    assert "press Enter" in bench.said[0]
    assert all(bench.steps(5.0))
    assert bench.plant.recovered == 0
    bench.watch.go_on()
    assert not bench.steps(QUIET + 0.2)[-1]
    assert bench.plant.recovered == 1
    alone = Bench(resume=True)
    alone.plant.fault, alone.plant.fault_passes = "somebody pressed stop", False
    assert alone.step()
    assert alone.watch.given_up


def test_a_worse_reason_during_a_stop_is_told_and_takes_a_person():
    bench = Bench(resume=True)
    assert bench.step(late=True)
    assert not bench.watch.given_up
    bench.plant.fault, bench.plant.fault_passes = "C31", False
    assert bench.step()
    assert "C31" in bench.said[-1]
    assert bench.watch.given_up
    assert bench.watch.stops == 1


def test_a_wish_while_the_reason_is_still_there_is_answered_and_forgotten():
    bench = Bench(asked=[])
    assert bench.step(late=True)
    bench.watch.go_on()
    assert bench.step(late=True)
    assert "cannot go on yet: no plan was ready" in bench.said[-1]
    assert all(bench.steps(5.0))


def test_a_wish_that_cannot_be_granted_is_answered():
    bench = Bench(asked=[])
    bench.plant.fault, bench.plant.recovers = "C31", False
    assert bench.step()
    bench.steps(QUIET + 0.1)
    bench.watch.go_on()
    assert bench.step()
    assert "cannot go on yet: the error is still there" in bench.said[-1]
    bench.plant.recovers = True
    assert all(bench.steps(2.0)), "it has to be asked for again"
