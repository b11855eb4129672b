"""MPPI on its own: what it draws, how it weighs, how it updates (equations 9 to 12)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import warp as wp
from scipy.interpolate import CubicSpline
from support.device import BLOCK, DEVICE, assert_same, run, to_the_bit
from support.reference import WEIGHT_TOLERANCE
from support.valley import FAR, ROOT, ROUND, TARGET, Valley, within_five_sigma

from oimppi_warp.config.settings import Mppi as Settings
from oimppi_warp.kernels.costs.stage_costs import TERMS, terms_vector
from oimppi_warp.kernels.optimizers.update import WeightStats, make_shift_nominal, make_update_nominal, weigh_samples
from oimppi_warp.kernels.rollouts.scoring import make_pick_trace
from oimppi_warp.planning.engines.dynamics import control_type
from oimppi_warp.planning.optimizers.mppi import Mppi
from oimppi_warp.planning.optimizers.optimizer import Update, noise_basis

STATS: Any = WeightStats


def make(settings: Settings, valley: Valley | None = None, *, seed: int = 3, root: np.ndarray = ROOT) -> Mppi:
    mppi = Mppi(valley or Valley(np.full(2, FAR)), settings, seed=seed)
    mppi.noise.host[0] = root
    return mppi


def improve(mppi: Mppi) -> Update:
    """One update."""
    run(mppi.compute, *mppi.improve)
    return mppi.found()


def drawn(
    settings: Settings, *, nominal: np.ndarray | None = None, bound: tuple[float, float] = (FAR, FAR), seed: int = 3
) -> np.ndarray:
    """The samples [K, horizon, 2] of one update around a nominal [horizon, 2]."""
    mppi = make(settings, Valley(np.array(bound)), seed=seed)
    if nominal is not None:
        mppi.nominal.assign(nominal.astype(np.float32))
    improve(mppi)
    return mppi.controls.numpy().astype(float)


# Sampling (equation 9)


@pytest.mark.parametrize("knots", [0, 2, 4])
def test_samples_have_the_nominal_as_mean_and_sigma_u_as_covariance_at_every_step(knots):
    settings = Settings(samples=20000, horizon=8, knots=knots, special_samples=False)
    nominal = np.linspace([-1.0, 2.0], [3.0, 0.5], 8)
    noise = drawn(settings, nominal=nominal) - nominal
    covariance = ROOT @ ROOT.T
    for h in range(8):
        assert (np.abs(noise[:, h].mean(axis=0)) < 5.0 * np.sqrt(np.diag(covariance) / 20000)).all()
        within_five_sigma(np.cov(noise[:, h].T), covariance, 20000)


@pytest.mark.parametrize("knots", [0, 4])
def test_the_noise_of_two_steps_is_related_as_their_knots_are(knots):
    settings = Settings(samples=20000, horizon=8, knots=knots, special_samples=False)
    first = drawn(settings)[:, :, 0]
    basis = noise_basis(8, knots)
    within_five_sigma(np.cov(first.T), ROOT[0, 0] ** 2 * basis @ basis.T, 20000)


def test_samples_are_clipped_to_the_bound():
    settings = Settings(samples=500, horizon=8, knots=4, special_samples=False)
    free, bounded = drawn(settings), drawn(settings, bound=(0.2, 0.05))
    assert np.abs(free).max() > 0.3
    np.testing.assert_allclose(bounded, np.clip(free, [-0.2, -0.05], [0.2, 0.05]), atol=1e-6)


def test_the_special_samples_are_the_nominal_and_zero():
    nominal = np.linspace([-1.0, 2.0], [3.0, 0.5], 8)
    special = drawn(Settings(samples=50, horizon=8, knots=4), nominal=nominal)
    np.testing.assert_allclose(special[0], nominal, rtol=1e-6)
    np.testing.assert_array_equal(special[1], 0.0)
    plain = drawn(Settings(samples=50, horizon=8, knots=4, special_samples=False), nominal=nominal)
    assert np.abs(plain[:2] - nominal).max() > 0.01
    assert_same(plain[2:], special[2:], cuda=1e-6)


def test_each_plan_draws_noise_of_its_own():
    mppi = make(Settings(samples=50, horizon=8, knots=0, special_samples=False))
    noise = []
    for _ in range(2):
        before = mppi.nominal.numpy().copy()
        improve(mppi)
        noise.append(mppi.controls.numpy() - before)
        run(mppi.compute, mppi.shift)
    assert abs(np.corrcoef(noise[0].ravel(), noise[1].ravel())[0, 1]) < 0.2


def test_the_updates_of_one_plan_draw_noise_of_their_own():
    settings = Settings(samples=50, horizon=8, knots=0, special_samples=False, temperature=1e9)
    once, twice = drawn(settings), drawn(replace(settings, iterations=2))
    correlation = np.corrcoef(once.ravel(), twice.ravel())[0, 1]
    assert abs(correlation) < 0.2


@pytest.mark.parametrize("knots", [2, 3, 6, 12])
def test_a_basis_of_knots_has_unit_variance_at_every_step(knots):
    basis = noise_basis(25, knots)
    assert basis.shape == (25, knots)
    np.testing.assert_allclose(np.linalg.norm(basis, axis=1), 1.0)


def test_a_basis_is_a_natural_cubic_spline_through_its_knots():
    spline = CubicSpline(np.arange(5.0), np.eye(5), bc_type="natural")(np.linspace(0.0, 4.0, 21))
    expected = spline / np.linalg.norm(spline, axis=1, keepdims=True)
    np.testing.assert_allclose(noise_basis(21, 5), expected, atol=1e-12)


def test_without_knots_the_noise_is_white():
    np.testing.assert_array_equal(noise_basis(7, 0), np.eye(7))


# Weights (equation 12)


def weigh(
    costs: np.ndarray, *, temperature: float = 0.5, fewest: float = 0.0, most: float = 0.0, calls: int = 1
) -> tuple[np.ndarray, dict[str, float]]:
    """Weights of the costs, and what was found, after some calls with the same costs."""
    weights = wp.zeros(len(costs), dtype=float, device=DEVICE)
    stats = wp.zeros(1, dtype=STATS, device=DEVICE)
    inputs = [wp.array(np.asarray(costs, dtype=np.float32), dtype=float, device=DEVICE), temperature, fewest, most]
    for _ in range(calls):
        wp.launch(weigh_samples, dim=BLOCK, inputs=inputs, outputs=[weights, stats], device=DEVICE, block_dim=BLOCK)
    found = stats.numpy()[0]
    return weights.numpy().astype(float), {name: found[name].item() for name in found.dtype.names}


def softmin(costs: np.ndarray, temperature: float) -> np.ndarray:
    """Equation 12; costs that are not finite weigh nothing."""
    weights = np.where(np.isfinite(costs), np.exp((np.min(costs[np.isfinite(costs)]) - costs) / temperature), 0.0)
    return weights / weights.sum()


COSTS = np.random.default_rng(1).gamma(2.0, 3.0, size=300) + 40.0


@pytest.mark.parametrize("temperature", [0.05, 0.5, 20.0])
def test_weights_are_the_softmin_of_the_costs(temperature):
    weights, stats = weigh(COSTS, temperature=temperature)
    expected = softmin(COSTS.astype(np.float32).astype(float), temperature)
    np.testing.assert_allclose(weights, expected, rtol=1e-4, atol=WEIGHT_TOLERANCE)
    assert stats["min_cost"] == pytest.approx(COSTS.min())
    assert stats["temperature"] == pytest.approx(temperature)
    assert stats["effective_samples"] == pytest.approx(1.0 / np.sum(expected**2), rel=1e-3)
    assert stats["lost"] == 0


@pytest.mark.parametrize("temperature", [1e-6, 0.5, 1e6])
def test_weights_sum_to_one(temperature):
    weights, stats = weigh(COSTS, temperature=temperature)
    assert weights.sum() == pytest.approx(1.0, abs=len(COSTS) * WEIGHT_TOLERANCE)
    assert (weights >= 0.0).all()
    assert 1.0 - 1e-6 <= stats["effective_samples"] <= len(COSTS) + 1e-2


def test_a_uniform_shift_of_all_costs_changes_nothing():
    exact = np.round(COSTS * 128.0) / 128.0  # so that float32 holds the shifted costs too
    assert_same(weigh(exact)[0], weigh(exact + 1024.0)[0], cuda=1e-6)
    plain, shifted = (make(Settings(samples=200, horizon=8), Valley(np.full(2, FAR), offset=x)) for x in (0.0, 100.0))
    for mppi in (plain, shifted):
        improve(mppi)
    np.testing.assert_allclose(plain.nominal.numpy(), shifted.nominal.numpy(), atol=1e-4)


def test_equal_costs_weigh_the_same():
    weights, stats = weigh(np.full(64, 7.0))
    np.testing.assert_allclose(weights, 1.0 / 64.0, rtol=1e-6)
    assert stats["effective_samples"] == pytest.approx(64.0)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e31])
def test_a_cost_that_is_not_finite_loses_its_sample_and_only_that(bad):
    spoiled = COSTS.copy()
    spoiled[[0, 17, 299]] = bad
    weights, stats = weigh(spoiled)
    assert (weights[[0, 17, 299]] == 0.0).all()
    kept = np.setdiff1d(np.arange(300), [0, 17, 299])
    np.testing.assert_allclose(weights[kept], weigh(COSTS[kept])[0], rtol=1e-5)
    assert stats["lost"] == 3
    assert stats["min_cost"] == pytest.approx(COSTS[kept].min())


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_when_all_samples_are_lost_the_command_is_zero(bad):
    mppi = make(Settings(samples=40, horizon=8), Valley(np.full(2, FAR), spoiled=40, spoil=bad))
    mppi.nominal.assign(np.ones((8, 2), dtype=np.float32))
    update = improve(mppi)
    assert update.lost == 40
    assert update.effective_samples == 0.0
    np.testing.assert_array_equal(mppi.nominal.numpy(), 0.0)
    np.testing.assert_array_equal(mppi.weights.numpy(), 0.0)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_an_adaptive_temperature_brings_the_effective_samples_within_their_bounds(scale):
    for temperature in (0.5, 0.5 * scale, 10.0 * scale):
        _, stats = weigh(COSTS * scale, temperature=temperature, fewest=15.0, most=30.0, calls=8)
        assert 15.0 <= stats["effective_samples"] <= 30.0


def test_a_temperature_within_its_bounds_is_left_alone():
    _, free = weigh(COSTS, temperature=2.0)
    few = free["effective_samples"]
    _, held = weigh(COSTS, temperature=2.0, fewest=0.5 * few, most=2.0 * few)
    assert held["temperature"] == pytest.approx(2.0)


def test_an_adaptive_temperature_outlives_a_plan_that_lost_all_samples(device: str):
    weights = wp.zeros(300, dtype=float, device=device)
    stats = wp.zeros(1, dtype=STATS, device=device)
    found = []
    for costs in (COSTS, np.full(300, np.nan), np.full(300, np.nan)):
        inputs = [wp.array(costs.astype(np.float32), dtype=float, device=device), 1.0, 15.0, 30.0]
        wp.launch(weigh_samples, dim=BLOCK, inputs=inputs, outputs=[weights, stats], device=device, block_dim=BLOCK)
        found.append(stats.numpy()[0]["temperature"].item())
    assert found[1:] == pytest.approx([found[0], found[0]])


# Update and shift (equation 11)


def test_the_update_is_the_nominal_plus_the_weighted_perturbations(device: str):
    random = np.random.default_rng(4)
    nominal, noise = random.normal(size=(6, 2)), random.normal(size=(50, 6, 2))
    weights = random.dirichlet(np.ones(50))
    out = wp.zeros(6, dtype=control_type(2), device=device)
    controls = wp.array((nominal + noise).astype(np.float32), dtype=control_type(2), device=device)
    inputs = [controls, wp.array(weights.astype(np.float32), dtype=float, device=device)]
    wp.launch(make_update_nominal(2), dim=(6, BLOCK), inputs=inputs, outputs=[out], device=device, block_dim=BLOCK)
    np.testing.assert_allclose(out.numpy(), nominal + np.einsum("k,khi->hi", weights, noise), atol=1e-5)


@pytest.mark.parametrize("repeat_last", [0, 1])
def test_a_shift_drops_the_first_control(repeat_last, device):
    before = np.arange(10.0).reshape(5, 2) + 1.0
    nominal = wp.array(before.astype(np.float32), dtype=control_type(2), device=device)
    counter = wp.zeros(1, dtype=int, device=device)
    taken = wp.zeros(1, dtype=control_type(2), device=device)
    wp.launch(make_shift_nominal(2), dim=1, inputs=[repeat_last], outputs=[nominal, counter, taken], device=device)
    np.testing.assert_array_equal(taken.numpy(), before[:1])
    np.testing.assert_array_equal(nominal.numpy(), [*before[1:], repeat_last * before[-1]])
    assert counter.numpy()[0] == 1


def test_a_horizon_of_one_step_can_be_shifted():
    mppi = make(Settings(samples=20, horizon=1, knots=0))
    improve(mppi)
    before = mppi.nominal.numpy().copy()
    run(mppi.compute, mppi.shift)
    np.testing.assert_array_equal(mppi.nominal.numpy(), before)


# The whole


def settled(valley: Valley) -> Mppi:
    """An MPPI after many updates of one plan."""
    settings = Settings(samples=400, horizon=8, knots=0, temperature=0.05, iterations=60)
    mppi = make(settings, valley, root=ROUND)
    improve(mppi)
    return mppi


def test_updates_find_the_bottom_of_a_valley():
    mppi = settled(Valley(np.full(2, FAR)))
    np.testing.assert_allclose(mppi.nominal.numpy(), np.tile(TARGET, (8, 1)), atol=0.08)


def test_a_bound_keeps_the_nominal_from_the_bottom():
    mppi = settled(Valley(np.full(2, 0.1)))
    np.testing.assert_allclose(mppi.nominal.numpy(), np.tile([0.1, -0.1], (8, 1)), atol=0.05)
    assert np.abs(mppi.nominal.numpy()).max() <= np.float32(0.1)


def test_a_plan_goes_on_without_its_lost_samples():
    mppi = settled(Valley(np.full(2, FAR), spoiled=150))
    assert (mppi.weights.numpy()[-150:] == 0.0).all()
    np.testing.assert_allclose(mppi.nominal.numpy(), np.tile(TARGET, (8, 1)), atol=0.1)


@to_the_bit
def test_the_same_seed_gives_the_same_bits_and_another_seed_others():
    settings = Settings(samples=100, horizon=8)
    plans = {}
    for name, seed in (("one", 5), ("same", 5), ("other", 6)):
        mppi = make(settings, seed=seed)
        for _ in range(5):
            improve(mppi)
            run(mppi.compute, mppi.shift)
        plans[name] = mppi.nominal.numpy().copy()
    np.testing.assert_array_equal(plans["one"], plans["same"])
    assert np.abs(plans["one"] - plans["other"]).max() > 1e-3


@to_the_bit
def test_after_a_reset_the_same_plans_are_made_again():
    mppi = make(Settings(samples=100, horizon=8))
    plans = []
    for _ in range(2):
        improve(mppi)
        run(mppi.compute, mppi.shift)
        improve(mppi)
        plans.append(mppi.nominal.numpy().copy())
        mppi.reset()
        np.testing.assert_array_equal(mppi.nominal.numpy(), 0.0)
    np.testing.assert_array_equal(plans[0], plans[1])


# Blocks


def test_threads_in_blocks_find_what_one_thread_finds(monkeypatch, device):
    monkeypatch.setattr(wp.config, "enable_cpu_blocks", True)
    random = np.random.default_rng(8)
    costs = wp.array(random.gamma(2.0, 3.0, 300).astype(np.float32), dtype=float, device=device)
    controls = wp.array(random.normal(size=(300, 5, 2)).astype(np.float32), dtype=control_type(2), device=device)
    tips = wp.array(random.normal(size=(300, 5, 3)).astype(np.float32), dtype=wp.vec3, device=device)
    terms = wp.array(random.normal(size=(300, len(TERMS))).astype(np.float32), dtype=terms_vector(), device=device)
    for few, many in ((0.0, 0.0), (5.0, 10.0)):
        found = []
        for block in (BLOCK, 64):
            weights = wp.zeros(300, dtype=float, device=device)
            stats = wp.zeros(1, dtype=STATS, device=device)
            nominal = wp.zeros(5, dtype=control_type(2), device=device)
            outputs = ((1, terms_vector()), (5, wp.vec3), (5, wp.vec3))
            best = [wp.zeros(n, dtype=kind, device=device) for n, kind in outputs]
            for kernel, dim, inputs, outputs in (
                (weigh_samples, block, [costs, 0.5, few, many], [weights, stats]),
                (make_update_nominal(2), (5, block), [controls, weights], [nominal]),
                (make_pick_trace(len(TERMS)), block, [costs, 1, terms, tips, tips], best),
            ):
                wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=device, block_dim=block)
            numbers = stats.numpy()[0]
            found.append([weights.numpy(), nominal.numpy(), [numbers[name] for name in numbers.dtype.names]])
            cheapest = int(np.argmin(costs.numpy()))
            np.testing.assert_array_equal(best[0].numpy()[0], terms.numpy()[cheapest])
            np.testing.assert_array_equal(best[1].numpy(), tips.numpy()[cheapest])
        for one, many_threads in zip(*found, strict=True):
            np.testing.assert_allclose(one, many_threads, rtol=1e-4, atol=1e-6)
