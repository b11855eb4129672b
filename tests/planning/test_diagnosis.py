"""A plan without a single finite sample stops the arm, and says which input or cost term did it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from support import outside_terms
from support.device import DEVICE
from support.small_tasks import observe, shipped

from oimppi_warp.config.settings import Config, ObjectLevel, RobotLevel
from oimppi_warp.config.settings import Mppi as MppiSettings
from oimppi_warp.planning.engines.cost_terms import CostTerm
from oimppi_warp.planning.factory import make_planner
from oimppi_warp.planning.plan import Plan
from oimppi_warp.planning.planner import Planner
from oimppi_warp.registries import COST_TERMS
from oimppi_warp.runtime.episode import Episode

SMALL = Config(
    robot=RobotLevel(optimizer=MppiSettings(samples=24, horizon=6)),
    object=ObjectLevel(optimizer=MppiSettings(samples=16, horizon=6)),
)


def make(config: Config = SMALL, **options) -> Planner:
    options = {"method": "mppi", "engine": "quasistatic", "device": DEVICE, "threads": 1} | options
    return make_planner(shipped("task01"), config, **options)


def planned(planner: Planner, **seen) -> Plan:
    planner.start(observe(planner.scene))
    return planner.plan(replace(observe(planner.scene), **seen))


@pytest.fixture
def broken() -> Iterator[None]:
    COST_TERMS.register("broken", CostTerm(outside_terms.broken, 2.0))
    yield
    COST_TERMS.unregister("broken")


@pytest.mark.parametrize("controls", ["tool", "joint"])
def test_the_cost_term_that_is_no_number_is_named(broken, controls):
    config = replace(SMALL, robot=replace(SMALL.robot, controls=controls))
    plan = planned(make(config))
    assert plan.problem.startswith("all 24 samples were lost: the cost term 'broken' is nan")
    assert plan.update.lost == 24
    assert not plan.command.any()


def test_a_weight_that_is_too_large_is_named_with_its_setting():
    plan = planned(make(replace(SMALL, cost=replace(SMALL.cost, w_height=1e36))))
    assert "the cost term 'height' is" in plan.problem
    assert "cost.w_height = 1e+36" in plan.problem


@pytest.mark.parametrize(
    ("spoil", "name"),
    [
        (lambda planner: planner.goal.__setitem__(0, np.nan), "the goal"),
        (
            lambda planner: setattr(planner, "set_reference", lambda pose: planner.track(np.full((1, 3), np.inf))),
            "the reference",
        ),
    ],
)
def test_the_input_that_is_no_number_is_named(spoil, name):
    planner = make()
    planner.start(observe(planner.scene))
    spoil(planner)
    problem = planner.plan(observe(planner.scene)).problem
    assert name in problem
    assert "is not finite" in problem


def test_physics_that_diverges_is_said_to(device: str):
    planner = make(replace(SMALL, robot=replace(SMALL.robot, controls="joint")), engine="newton", device="cpu")
    plan = planned(planner, joint_velocity=np.full(6, 1e12))
    assert "the physics of the engine 'newton' diverged" in plan.problem


def test_a_plan_with_finite_samples_has_no_problem():
    assert planned(make()).problem == ""


def test_a_run_says_why_the_arm_was_stopped(broken):
    config = replace(SMALL, episode=replace(SMALL.episode, max_sim_seconds=0.2))
    log = Episode(shipped("task01"), config, method="mppi", engine="quasistatic", device=DEVICE).run()
    problems = log.header["problems"]
    assert "the cost term 'broken'" in problems[0][1]
