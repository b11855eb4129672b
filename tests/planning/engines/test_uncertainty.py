"""Several draws of the world: how they are made, and what becomes of their costs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from support import small_tasks
from support.device import DEVICE

from oimppi_warp.config.presets import best
from oimppi_warp.config.settings import Uncertainty
from oimppi_warp.kernels.rollouts.uncertainty import combine_costs
from oimppi_warp.planning.engines.uncertainty import CERTAIN, draw
from oimppi_warp.planning.factory import make_planner


def combined(costs: np.ndarray, worst: int) -> np.ndarray:
    """What the costs [sample, draw] become."""
    samples, draws = costs.shape
    out = wp.zeros(samples, dtype=float, device=DEVICE)
    rolled = wp.array(costs.ravel().astype(np.float32), dtype=float, device=DEVICE)
    wp.launch(combine_costs, dim=samples, inputs=[0, rolled, draws, worst], outputs=[out], device=DEVICE)
    return out.numpy()


@pytest.mark.parametrize("worst", [1, 2, 3, 5])
def test_a_cost_is_the_mean_of_the_worst(worst):
    costs = np.random.default_rng(0).gamma(2.0, 3.0, (40, 5))
    costs[3] = 7.0  # equal ones count each
    expected = np.sort(costs, axis=1)[:, -worst:].mean(axis=1)
    np.testing.assert_allclose(combined(costs, worst), expected, rtol=1e-5)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e31])
def test_a_rollout_without_a_cost_loses_its_sample(bad):
    costs = np.ones((3, 4))
    costs[1, 2] = bad
    found = combined(costs, 4)
    assert np.isfinite(found[[0, 2]]).all() and not np.isfinite(found[1])


def test_without_uncertainty_there_is_the_world_as_it_is():
    assert draw(Uncertainty(), samples=100, seed=0) is CERTAIN


@pytest.mark.parametrize(("measure", "worst"), [("mean", 8), ("worst", 1), ("cvar", 2)])
def test_draws_have_the_spread_that_was_asked_for(measure, worst):
    asked = Uncertainty(draws=8, shared=False, measure=measure, tail=0.25)
    draws = draw(asked, samples=500, seed=1)
    assert (draws.count, draws.per_sample, draws.worst) == (4000, 8, worst)
    for factor, spread in ((draws.friction, asked.friction), (draws.tool_friction, asked.friction), (draws.mass, 0.1)):
        assert (factor > 0.0).all()
        assert np.log(factor).std() == pytest.approx(spread, rel=0.05)
    np.testing.assert_allclose(draws.pose.std(axis=0), asked.pose, rtol=0.06)
    np.testing.assert_allclose(draws.tool.std(axis=0), asked.tool, rtol=0.06)


def test_shared_draws_are_as_many_as_each_sample_meets():
    draws = draw(Uncertainty(draws=4), samples=500, seed=1)
    assert draws.count == draws.per_sample == 4
    again = draw(Uncertainty(draws=4), samples=500, seed=1)
    np.testing.assert_array_equal(draws.pose, again.pose)
    assert (draw(Uncertainty(draws=4), samples=500, seed=2).pose != draws.pose).any()


@pytest.mark.parametrize("shared", [True, False])
def test_a_robust_plan_heeds_the_worst_draw(shared, device):
    """The same samples cost at least as much in the worst draw as on the average, and more for some."""
    scene = small_tasks.shipped("task02")
    found = {}
    for measure in ("mean", "worst"):
        config = best("mppi")
        asked = Uncertainty(draws=3, shared=shared, measure=measure)
        mppi = replace(config.robot.optimizer, samples=64)
        planner = make_planner(
            scene,
            replace(config, robot=replace(config.robot, optimizer=mppi, uncertainty=asked)),
            method="mppi",
            engine="quasistatic",
            device=device,
        )
        planner.plan(small_tasks.observe(scene))
        found[measure] = planner.optimizer.costs.numpy()
    assert (found["worst"] >= found["mean"] - 1e-3).all()
    assert (found["worst"] > found["mean"] + 1e-3).any()
