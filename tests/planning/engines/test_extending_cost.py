"""A cost term from outside the package: its value, what it does to plans, and that nothing is left of it."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from support import outside_terms, small_tasks
from support.device import DEVICE, run
from support.engines import device_of
from support.reference import RELATIVE_TOLERANCE

from oimppi_warp.config.presets import best
from oimppi_warp.errors import ConfigError
from oimppi_warp.kernels.costs.stage_costs import TERMS
from oimppi_warp.kernels.rollouts.quasistatic import make_robot_rollout
from oimppi_warp.planning.engines.cost_terms import CostTerm, weighted_terms
from oimppi_warp.planning.engines.dynamics import control_type
from oimppi_warp.planning.engines.newton_threads import NewtonThreads
from oimppi_warp.planning.engines.quasistatic import QuasistaticDynamics
from oimppi_warp.planning.factory import make_planner
from oimppi_warp.registries import COST_TERMS

STEPS = 12
WEIGHTS = {"high": 700.0, "off_line": 30.0}


@pytest.fixture
def added() -> Iterator[None]:
    """Two terms that count."""
    COST_TERMS.register("high", CostTerm(outside_terms.high, WEIGHTS["high"], "squared height above 5 cm [1/m^2]"))
    COST_TERMS.register("off_line", CostTerm(outside_terms.off_line, WEIGHTS["off_line"]))
    yield
    for name in WEIGHTS:
        COST_TERMS.unregister(name)


def twins(tips: np.ndarray) -> np.ndarray:
    """Both terms, weighted and summed over the horizon, of tips [sample, horizon, 3]; shape [sample, 2]."""
    tips = tips.astype(float)
    high = np.maximum(tips[..., 2] - outside_terms.SAFE, 0.0) ** 2
    off_line = np.abs(tips[..., 1] - outside_terms.LINE)
    return np.column_stack([WEIGHTS["high"] * high.sum(axis=1), WEIGHTS["off_line"] * off_line.sum(axis=1)])


def rolled(engine: type, samples: int = 6) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[str, ...]]:
    """Costs [sample], terms [sample, term], tips after each step [sample, horizon, 3], and the terms' names."""
    scene = small_tasks.shipped("task01")
    level = best("mppi").robot
    level = replace(level, optimizer=replace(level.optimizer, samples=samples, horizon=STEPS))
    device = device_of(engine)
    dynamics = engine(small_tasks.rollout_task(scene, level=level, device=device, threads=1))
    controls = np.random.default_rng(2).uniform(-0.6, 0.6, (samples, STEPS, 6)).astype(np.float32)
    packed = wp.array(controls, dtype=control_type(6), device=device)
    costs = wp.zeros(samples, dtype=float, device=device)
    rollout = dynamics.rollout(packed, costs)
    dynamics.set_state(
        small_tasks.observe(scene, joints=small_tasks.joints_at(scene.robot, (0.4, 0.1, 0.05))), np.array(scene.goal)
    )
    dynamics.reference.host[:] = np.array(scene.goal)
    run(dynamics.compute, rollout)
    tips, terms = dynamics.paths(packed, np.arange(samples))
    return costs.numpy(), terms, tips[:, -STEPS:], dynamics.terms


@pytest.mark.parametrize("engine", [QuasistaticDynamics, NewtonThreads])
def test_terms_from_outside_are_their_twins_and_the_others_stay_as_they_are(engine, request):
    before, terms_before, _, names = rolled(engine)
    assert names == TERMS
    request.getfixturevalue("added")
    costs, terms, tips, names = rolled(engine)
    assert names == (*TERMS, "high", "off_line")
    expected = twins(tips)
    assert (expected > 0.0).any(axis=0).all()
    np.testing.assert_allclose(terms[:, len(TERMS) :], expected, rtol=RELATIVE_TOLERANCE, atol=1e-5)
    np.testing.assert_allclose(terms[:, : len(TERMS)], terms_before, rtol=1e-5)
    np.testing.assert_allclose(costs, before + expected.sum(axis=1), rtol=RELATIVE_TOLERANCE)


def test_only_terms_whose_weights_are_not_zero_are_compiled(added):
    assert [term.name for term in weighted_terms(best("mppi").cost)] == ["high", "off_line"]
    settings = SimpleNamespace(extra={"high": 0.0, "off_line": 5.0})
    (left,) = weighted_terms(settings)  # type: ignore[arg-type]
    assert (left.name, left.weight, left.function) == ("off_line", 5.0, outside_terms.off_line)


def nominal(weight: float) -> tuple[np.ndarray, dict[str, float]]:
    """Tool tips [horizon + 1, 3] of the plan after some updates, and the terms of its cheapest sample."""
    COST_TERMS.register("off_line", CostTerm(outside_terms.off_line, weight))
    try:
        scene = small_tasks.shipped("task01")
        planner = make_planner(scene, best("mppi"), method="mppi", engine="quasistatic", device=DEVICE, seed=1)
        seen = small_tasks.observe(scene)
        planner.start(seen)
        plans = [planner.plan(seen) for _ in range(6)]
        assert plans[-1].terms.shape == (len(planner.dynamics.terms),)
        return plans[-1].tips, planner.samples(8).terms
    finally:
        COST_TERMS.unregister("off_line")


def test_its_weight_steers_the_plan_and_the_viewer_is_told():
    without, terms = nominal(0.0)
    assert "off_line" not in terms
    towards, terms = nominal(300.0)
    assert terms["off_line"] > 0.0
    off = [abs(tips[-1, 1] - outside_terms.LINE) for tips in (without, towards)]
    assert off[1] < off[0] - 0.03, off


def test_a_term_that_is_taken_out_leaves_nothing_behind(added):
    COST_TERMS.unregister("high")
    COST_TERMS.unregister("off_line")
    assert list(COST_TERMS) == []
    scene = small_tasks.shipped("task01")
    dynamics = QuasistaticDynamics(small_tasks.rollout_task(scene))
    assert dynamics.terms == TERMS
    assert dynamics._kernel is make_robot_rollout(scene.robot.chain, ())


BOTH = """
import json, sys
from support import outside_terms
from oimppi_warp.kernels.rollouts.quasistatic import make_robot_rollout
sets = {"none": (), "high": ("high",), "both": ("high", "off_line")}
found = {}
for name in sys.argv[1:]:
    kernel = make_robot_rollout("PP", tuple((term, getattr(outside_terms, term)) for term in sets[name]))
    found[name] = [kernel.module.name, kernel.module.get_module_hash().hex()]
print(json.dumps(found))
"""


def test_compiled_kernels_are_found_again_whatever_was_made_before():
    found = []
    for order in (("none", "high", "both"), ("both", "none", "high")):
        result = subprocess.run(
            [sys.executable, "-c", BOTH, *order],
            capture_output=True,
            text=True,
            check=True,
            cwd=Path(__file__).parents[2],
        )
        found.append(json.loads(result.stdout.splitlines()[-1]))
    assert found[0] == found[1]
    names = {key: name for key, (name, _) in found[0].items()}
    assert names["none"] == "oimppi_warp.kernels.robot_rollout_PP"
    assert names["high"].startswith("robot_rollout_PP_high_")
    assert names["both"].startswith("robot_rollout_PP_high_off_line_")


@pytest.mark.parametrize(
    ("name", "function", "message"),
    [
        ("tilt", outside_terms.high, "cost term 'tilt': the name cannot be used"),
        ("too-high", outside_terms.high, "cost term 'too-high': the name cannot be used"),
        ("two", outside_terms.two_arguments, r"found:   Stage, .*float"),
        ("plain", lambda s: 0.0, "found:   no wp.func, or one without arguments"),
    ],
)
def test_a_term_that_cannot_be_compiled_is_refused(name, function, message):
    COST_TERMS.register(name, CostTerm(function, 1.0))
    try:
        with pytest.raises(ConfigError, match=message):
            weighted_terms(best("mppi").cost)
    finally:
        COST_TERMS.unregister(name)


def test_a_weight_without_a_term_is_refused():
    settings = SimpleNamespace(extra={"nothing": 1.0})
    with pytest.raises(ConfigError, match="cost term 'nothing' does not exist"):
        weighted_terms(settings)  # type: ignore[arg-type]
