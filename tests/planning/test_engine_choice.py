"""Which engine is taken, on made-up machines, and on this one where no engine keeps up."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import pytest
from support import small_tasks

from oimppi_warp.config.presets import best
from oimppi_warp.errors import ConfigError
from oimppi_warp.planning.engine_choice import choose_engine
from oimppi_warp.planning.engines import newton
from oimppi_warp.planning.factory import make_planner
from oimppi_warp.registries import ENGINES


@dataclass(frozen=True)
class Known:
    """What is known of an engine that nobody makes."""

    known_success: dict[str, float] = field(default_factory=dict)
    slower_than: frozenset[str] = frozenset()


@pytest.fixture
def add(monkeypatch) -> Iterator[dict[str, Known]]:
    """The only engines there are: filled in by the test, by name."""

    class Engines(dict):
        def loadable(self):
            return self.items()

    engines: dict[str, Known] = Engines()
    monkeypatch.setattr("oimppi_warp.planning.engine_choice.ENGINES", engines)
    yield engines


class Machine:
    """Planners whose plans take given times by a clock of their own, and what was asked of them.

    Args:
        **seconds: What one plan after the other takes with each engine; the last time holds for all that follow [s].
    """

    def __init__(self, monkeypatch, **seconds: float | tuple[float, ...]) -> None:
        self.seconds = {name: each if isinstance(each, tuple) else (each,) for name, each in seconds.items()}
        self.now = 0.0
        self.made: list[str] = []
        self.timed: dict[str, int] = {}
        monkeypatch.setattr(time, "perf_counter", lambda: self.now)

    def make(self, engine: str) -> Machine.Planner:
        self.made.append(engine)
        self.timed[engine] = 0
        return Machine.Planner(self, engine)

    @dataclass
    class Planner:
        machine: Machine
        engine: str

        def warm_up(self) -> None:
            self.machine.now += 100.0

        def rehearse(self) -> None:
            plan = self.machine.timed[self.engine]
            seconds = self.machine.seconds[self.engine]
            self.machine.now += seconds[min(plan, len(seconds) - 1)]
            self.machine.timed[self.engine] += 1


def test_the_most_successful_engine_that_keeps_up_is_taken(add, monkeypatch):
    add |= {"good": Known({"cloi": 0.8}), "better": Known({"cloi": 0.9})}
    machine = Machine(monkeypatch, good=0.01, better=0.04)
    choice = choose_engine("cloi", 0.05, machine.make)
    assert (choice.engine, choice.planner.engine, machine.made) == ("better", "better", ["better"])
    assert machine.timed == {"better": 3}
    assert choice.reason == "a plan takes 40 ms of the 50 ms available"


def test_success_is_the_methods_own(add, monkeypatch):
    add |= {"good": Known({"cloi": 0.8, "soi": 0.7}), "better": Known({"cloi": 0.9, "soi": 0.1})}
    machine = Machine(monkeypatch, good=0.01, better=0.01)
    assert choose_engine("soi", 0.05, machine.make).engine == "good"
    assert machine.made == ["good"]


def test_of_equals_the_one_that_is_slower_than_others_comes_last(add, monkeypatch):
    add |= {"slow": Known({"cloi": 0.9}, frozenset({"fast"})), "fast": Known({"cloi": 0.9})}
    machine = Machine(monkeypatch, slow=0.04, fast=0.01)
    assert choose_engine("cloi", 0.05, machine.make).engine == "fast"
    assert machine.made == ["fast"]


def test_an_engine_that_is_too_slow_gives_way_after_one_plan(add, monkeypatch):
    add |= {"good": Known({"cloi": 0.8}), "better": Known({"cloi": 0.9}, frozenset({"good"}))}
    machine = Machine(monkeypatch, good=0.01, better=0.4)
    choice = choose_engine("cloi", 0.05, machine.make)
    assert choice.engine == "good"
    assert machine.timed == {"better": 1, "good": 3}
    assert choice.reason == "a plan takes 10 ms of the 50 ms available; with better, 400 ms"


def test_timing_stops_at_the_first_plan_beyond_the_period(add, monkeypatch):
    add |= {"only": Known({"cloi": 0.9})}
    machine = Machine(monkeypatch, only=(0.01, 0.06, 0.01))
    choice = choose_engine("cloi", 0.05, machine.make)
    assert machine.timed == {"only": 2}
    assert choice.reason == "no engine keeps up; with this one, a plan takes 60 ms of the 50 ms available"


def test_it_is_said_what_is_being_done_before_it_is_done(add, monkeypatch):
    add |= {"good": Known({"cloi": 0.8}), "better": Known({"cloi": 0.9})}
    machine = Machine(monkeypatch, good=0.01, better=0.4)
    said: list[tuple[str, int]] = []
    choose_engine("cloi", 0.05, machine.make, report=lambda doing: said.append((doing, sum(machine.timed.values()))))
    assert said == [
        ("--engine auto: loading the engine better", 0),
        ("--engine auto: warming up with a plan of better", 0),
        ("--engine auto: timing plan 1 of 3 of better", 0),
        ("--engine auto: loading the engine good", 1),
        ("--engine auto: warming up with a plan of good", 1),
        *((f"--engine auto: timing plan {number} of 3 of good", number) for number in (1, 2, 3)),
    ]


def test_an_engine_that_is_known_to_be_slower_is_not_tried_after_one_that_is_too_slow(add, monkeypatch):
    add |= {"fast": Known({"cloi": 0.95}), "slow": Known({"cloi": 0.9}, frozenset({"fast"}))}
    machine = Machine(monkeypatch, fast=0.7)
    choice = choose_engine("cloi", 0.05, machine.make)
    assert (choice.engine, machine.made, machine.timed) == ("fast", ["fast"], {"fast": 1})
    assert choice.reason == (
        "no engine keeps up; with this one, a plan takes 700 ms of the 50 ms available, and slow is known to be slower"
    )


def test_where_none_keeps_up_the_fastest_is_taken_and_that_is_said(add, monkeypatch):
    add |= {"good": Known({"cloi": 0.8}), "better": Known({"cloi": 0.9})}
    machine = Machine(monkeypatch, good=0.2, better=0.4)
    choice = choose_engine("cloi", 0.05, machine.make)
    assert (choice.engine, choice.planner.engine) == ("good", "good")
    assert machine.timed == {"better": 1, "good": 1}
    assert choice.reason == "no engine keeps up; with this one, a plan takes 200 ms of the 50 ms available"


def test_an_engine_that_nobody_has_measured_is_not_tried(add, monkeypatch):
    add |= {"known": Known({"cloi": 0.5}), "unknown": Known(), "plain": object()}  # type: ignore[dict-item]
    machine = Machine(monkeypatch, known=0.2)
    assert choose_engine("cloi", 0.05, machine.make).engine == "known"
    assert machine.made == ["known"]
    # A method that nobody has measured takes the engines that are known with others.
    assert choose_engine("mine", 0.05, machine.make).engine == "known"
    assert machine.made == ["known", "known"]
    del add["known"]
    with pytest.raises(ConfigError, match=r"no engine has a known success rate\n.*unknown, plain"):
        choose_engine("soi", 0.05, machine.make)


def test_shipped_engines_are_known_for_every_method_that_was_measured():
    assert set(ENGINES["quasistatic"].known_success) == {"mppi", "soi", "cloi"}
    assert "quasistatic" in ENGINES["newton"].slower_than
    figures = [share for name in ("quasistatic", "newton") for share in ENGINES[name].known_success.values()]
    assert all(0.0 < share <= 1.0 for share in figures)


def test_a_planner_knows_its_engine_and_why(device: str):
    scene = small_tasks.shipped("task01")
    asked = make_planner(scene, best("mppi"), method="mppi", engine="quasistatic", device=device)
    assert (asked.engine, asked.engine_reason) == ("quasistatic", "")
    chosen = make_planner(scene, best("mppi"), method="mppi", engine="auto", device=device)
    assert chosen.engine in ("quasistatic", "newton")
    assert "ms" in chosen.engine_reason


def test_a_quasistatic_plan_that_takes_too_long_makes_no_newton_planner(monkeypatch):
    def refuse(*_: object) -> None:
        raise AssertionError("a Newton engine was made")

    monkeypatch.setattr(newton.NewtonDynamics, "__init__", refuse)
    config = best("cloi")
    config = replace(
        config,
        robot=replace(config.robot, optimizer=replace(config.robot.optimizer, samples=20000)),
        control_period=0.01,
    )
    planner = make_planner(small_tasks.shipped("task01"), config, method="cloi", engine="auto", device="cpu")
    assert planner.engine == "quasistatic"
    assert planner.engine_reason.startswith("no engine keeps up") and planner.engine_reason.endswith(
        "newton is known to be slower"
    )


def test_timing_an_engine_leaves_no_trace_in_its_plans():
    scene = small_tasks.shipped("task01")
    seen = small_tasks.observe(scene)
    commands = []
    for engine in ("auto", "quasistatic"):
        planner = make_planner(scene, best("mppi"), method="mppi", engine=engine, device="cpu", seed=3)
        planner.start(seen)
        commands.append(planner.plan(seen).command.tolist())
    assert commands[0] == commands[1]
