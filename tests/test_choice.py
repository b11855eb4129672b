"""Which engine is taken, on made-up machines."""

from __future__ import annotations

import pytest
import tasks

from oimppi_warp import choice as module
from oimppi_warp.choice import choose
from oimppi_warp.methods import make_planner
from oimppi_warp.presets import best


@pytest.fixture
def known(monkeypatch):
    """An engine that is good, one that is better, and what each was asked."""
    table = {("good", "cloi"): 0.8, ("better", "cloi"): 0.9, ("better", "soi"): 0.1, ("good", "soi"): 0.7}
    monkeypatch.setattr(module, "KNOWN_SUCCESS", table)


def machine(**seconds: float):
    """How long a plan takes with each engine, and which were asked."""
    asked: list[str] = []

    def plan_seconds(engine: str) -> float:
        asked.append(engine)
        return seconds[engine]

    return plan_seconds, asked


def test_the_most_successful_engine_that_keeps_up_is_taken(known):
    plan_seconds, asked = machine(good=0.01, better=0.04)
    choice = choose("cloi", 0.05, plan_seconds)
    assert (choice.engine, asked) == ("better", ["better"])
    assert choice.reason == "a plan takes 40 ms of 50 ms"


def test_success_is_the_methods_own(known):
    plan_seconds, asked = machine(good=0.01, better=0.01)
    assert choose("soi", 0.05, plan_seconds).engine == "good"
    assert asked == ["good"]


def test_an_engine_that_is_too_slow_gives_way(known):
    plan_seconds, _ = machine(good=0.01, better=0.4)
    choice = choose("cloi", 0.05, plan_seconds)
    assert choice.engine == "good"
    assert choice.reason == "a plan takes 10 ms of 50 ms, with better 400 ms"


def test_where_none_keeps_up_the_fastest_is_taken_and_that_is_said(known):
    plan_seconds, _ = machine(good=0.2, better=0.4)
    choice = choose("cloi", 0.05, plan_seconds)
    assert choice.engine == "good"
    assert choice.reason == "none keeps up; with this one a plan takes 200 ms of 50 ms"


def test_a_planner_knows_its_engine_and_why():
    scene = tasks.shipped("task01")
    asked = make_planner(scene, best("mppi"), method="mppi", engine="quasistatic", device="cpu")
    assert (asked.engine, asked.engine_reason) == ("quasistatic", "")
    chosen = make_planner(scene, best("mppi"), method="mppi", engine="auto", device="cpu")
    assert chosen.engine in ("quasistatic", "newton")
    assert "ms" in chosen.engine_reason


def test_timing_an_engine_leaves_no_trace_in_its_plans():
    scene = tasks.shipped("task01")
    seen = tasks.observe(scene)
    commands = []
    for engine in ("auto", "quasistatic"):
        planner = make_planner(scene, best("mppi"), method="mppi", engine=engine, device="cpu", seed=3)
        planner.start(seen)
        commands.append(planner.plan(seen).command.tolist())
    assert commands[0] == commands[1]
