"""The cross-entropy method: elites, samples with a deviation, the fit, and that it plans."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import warp as wp
from support import reference
from support.device import BLOCK, DEVICE, ON_CPU, run, to_the_bit
from support.valley import FAR, ROOT, ROUND, TARGET, Valley, within_five_sigma

from oimppi_warp.config.settings import Cem as Settings
from oimppi_warp.kernels.optimizers.cem import make_refit, make_shift_deviation, select_elites
from oimppi_warp.kernels.optimizers.update import WeightStats
from oimppi_warp.planning.engines.dynamics import control_type
from oimppi_warp.planning.optimizers.cem import Cem

STATS: Any = WeightStats
COSTS = np.random.default_rng(2).gamma(2.0, 3.0, 300) + 40.0
BLOCKS = (1, 64, 256) if ON_CPU else (64, 256)


def make(settings: Settings, valley: Valley | None = None, *, seed: int = 3) -> Cem:
    cem = Cem(valley or Valley(np.full(2, FAR)), settings, seed=seed)
    cem.noise.host[0] = ROOT
    return cem


def improve(cem: Cem) -> None:
    run(cem.compute, *cem.improve)


def select(costs: np.ndarray, elites: int, *, block: int = BLOCK) -> tuple[np.ndarray, dict[str, float]]:
    """Weights of the costs, and what was found."""
    weights = wp.zeros(len(costs), dtype=float, device=DEVICE)
    stats = wp.zeros(1, dtype=STATS, device=DEVICE)
    inputs = [wp.array(costs.astype(np.float32), dtype=float, device=DEVICE), elites]
    wp.launch(select_elites, dim=block, inputs=inputs, outputs=[weights, stats], device=DEVICE, block_dim=block)
    found = stats.numpy()[0]
    return weights.numpy().astype(float), {name: found[name].item() for name in found.dtype.names}


def refit(
    controls: np.ndarray, perturbations: np.ndarray, weights: np.ndarray, old: np.ndarray, *, block: int = BLOCK
) -> tuple[np.ndarray, np.ndarray]:
    """Nominal and deviation [horizon, 2] after a fit with smoothing 0.25 and a least deviation of 0.1."""
    vec = control_type(2)
    nominal, deviation = (wp.array(rows.astype(np.float32), dtype=vec, device=DEVICE) for rows in old)
    inputs = [wp.array(rows.astype(np.float32), dtype=vec, device=DEVICE) for rows in (controls, perturbations)]
    inputs += [wp.array(weights.astype(np.float32), dtype=float, device=DEVICE), 0.25, 0.1]
    dim = (controls.shape[1], block)
    wp.launch(make_refit(2), dim=dim, inputs=inputs, outputs=[nominal, deviation], device=DEVICE, block_dim=block)
    return nominal.numpy(), deviation.numpy()


# Elites


@pytest.mark.parametrize("block", BLOCKS)
@pytest.mark.parametrize("elites", [1, 7, 300])
@pytest.mark.parametrize("offset", [0.0, -45.0, -400.0])
def test_the_elites_are_the_cheapest_samples(monkeypatch, block: int, elites: int, offset: float):
    monkeypatch.setattr(wp.config, "enable_cpu_blocks", True)
    costs = (COSTS + offset).astype(np.float32)
    weights, stats = select(costs, elites, block=block)
    np.testing.assert_allclose(weights, reference.elite_weights(costs, elites), rtol=1e-6)
    assert np.count_nonzero(weights) == elites
    assert stats["effective_samples"] == pytest.approx(elites, rel=1e-4)
    assert stats["min_cost"] == costs.min() and stats["lost"] == 0 and stats["temperature"] == 0.0


@pytest.mark.parametrize("block", BLOCKS)
def test_samples_that_cost_the_same_share_the_last_place(monkeypatch, block: int):
    monkeypatch.setattr(wp.config, "enable_cpu_blocks", True)
    costs = np.array([5.0, 1.0, 3.0, 3.0, 3.0, 9.0])
    weights, _ = select(costs, 2, block=block)
    np.testing.assert_allclose(weights, [0, 1 / 2, 1 / 6, 1 / 6, 1 / 6, 0], rtol=1e-6)
    np.testing.assert_allclose(weights, reference.elite_weights(costs, 2), rtol=1e-6)


@pytest.mark.parametrize("block", BLOCKS)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e31])
def test_a_sample_without_a_cost_is_no_elite(monkeypatch, block: int, bad: float):
    monkeypatch.setattr(wp.config, "enable_cpu_blocks", True)
    costs = COSTS.copy()
    costs[::2] = bad
    weights, stats = select(costs, 200, block=block)
    assert (weights[::2] == 0.0).all()
    np.testing.assert_allclose(weights[1::2], 1 / 150, rtol=1e-6)
    assert stats["lost"] == 150
    none, stats = select(np.full(8, bad), 3, block=block)
    assert (none == 0.0).all() and stats["lost"] == 8 and stats["effective_samples"] == 0.0


# The fit


@pytest.mark.parametrize("block", BLOCKS)
def test_the_fit_is_the_elites_mean_and_deviation_with_a_share_of_the_old(monkeypatch, block: int):
    monkeypatch.setattr(wp.config, "enable_cpu_blocks", True)
    random = np.random.default_rng(5)
    controls, perturbations = random.normal(size=(300, 6, 2)), 0.4 * random.normal(size=(300, 6, 2))
    perturbations[:, 2] *= 0.01  # so narrow that the least deviation holds it
    perturbations[:, 3] *= 20.0  # so wide that one does
    old = np.stack([random.normal(size=(6, 2)), random.uniform(0.2, 1.0, (6, 2))])
    weights = reference.elite_weights(COSTS, 30)
    found = refit(controls, perturbations, weights, old, block=block)
    expected = reference.elite_fit(controls, perturbations, weights, old, smoothing=0.25, least=0.1)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-6)
    assert (found[1][2] < 0.35).all() and (found[1][3] == 1.0).all()


def test_when_all_samples_are_lost_the_command_is_zero_and_the_deviation_whole():
    cem = make(Settings(samples=40, horizon=8), Valley(np.full(2, FAR), spoiled=40))
    cem.nominal.assign(np.ones((8, 2), dtype=np.float32))
    cem.deviation.fill_(0.3)
    improve(cem)
    np.testing.assert_array_equal(cem.nominal.numpy(), 0.0)
    np.testing.assert_array_equal(cem.deviation.numpy(), 1.0)
    assert cem.found().lost == 40 and np.isnan(cem.found().min_cost)


# Sampling and shift


def test_samples_have_the_deviations_of_their_steps():
    cem = make(Settings(samples=20000, horizon=4, knots=0, special_samples=False))
    deviation = np.array([[1.0, 1.0], [0.5, 1.0], [1.0, 0.2], [0.3, 0.3]])
    cem.deviation.assign(deviation.astype(np.float32))
    run(cem.compute, *cem.sample(3))
    noise = cem.controls.numpy().astype(float)
    for h in range(4):
        root = ROOT * deviation[h]
        within_five_sigma(np.cov(noise[:, h].T), root @ root.T, 20000)


def test_samples_are_clipped_and_the_special_ones_are_the_nominal_and_zero():
    cem = make(Settings(samples=500, horizon=8, knots=4), Valley(np.array([0.2, 0.05])))
    cem.nominal.assign(np.full((8, 2), 0.04, dtype=np.float32))
    run(cem.compute, *cem.sample(3))
    controls = cem.controls.numpy()
    np.testing.assert_array_equal(controls[0], np.full((8, 2), np.float32(0.04)))
    np.testing.assert_array_equal(controls[1], 0.0)
    assert (np.abs(controls) <= np.float32([0.2, 0.05])).all() and np.abs(controls[..., 1]).max() == np.float32(0.05)


@pytest.mark.parametrize("recovery", [0.0, 0.25, 1.0])
def test_deviations_move_on_with_the_horizon_and_recover(recovery: float, device: str):
    before = np.arange(1.0, 11.0).reshape(5, 2) / 10.0
    deviation = wp.array(before.astype(np.float32), dtype=control_type(2), device=device)
    wp.launch(make_shift_deviation(2), dim=1, inputs=[recovery], outputs=[deviation], device=device)
    expected = np.vstack([before[1:] + recovery * (1.0 - before[1:]), np.ones((1, 2))])
    np.testing.assert_allclose(deviation.numpy(), expected, rtol=1e-6)


def test_a_shift_takes_the_command_out_and_moves_the_deviations_on():
    cem = make(Settings(samples=100, horizon=8, recovery=0.0))
    improve(cem)
    nominal, deviation = cem.nominal.numpy().copy(), cem.deviation.numpy().copy()
    assert (deviation < 1.0).any()
    run(cem.compute, cem.shift)
    np.testing.assert_array_equal(cem.command.host[0], nominal[0])
    np.testing.assert_array_equal(cem.nominal.numpy()[:-1], nominal[1:])
    np.testing.assert_array_equal(cem.deviation.numpy()[:-1], deviation[1:])
    np.testing.assert_array_equal(cem.deviation.numpy()[-1], 1.0)


# The whole


def test_updates_find_the_bottom_of_a_valley_and_narrow_down():
    cem = make(Settings(samples=400, horizon=8, knots=0, iterations=30, least_deviation=0.05))
    cem.noise.host[0] = ROUND
    improve(cem)
    np.testing.assert_allclose(cem.nominal.numpy(), np.tile(TARGET, (8, 1)), atol=0.05)
    np.testing.assert_allclose(cem.deviation.numpy(), 0.05, atol=0.02)


@to_the_bit
def test_the_same_seed_gives_the_same_bits_also_after_a_reset():
    plans = []
    for cem, seed in ((make(Settings(samples=100, horizon=8), seed=s), s) for s in (5, 5, 6)):
        for again in (False, True):
            for _ in range(3):
                improve(cem)
                run(cem.compute, cem.shift)
            plans.append((seed, again, cem.nominal.numpy().copy()))
            cem.reset()
    np.testing.assert_array_equal(plans[0][2], plans[1][2])
    np.testing.assert_array_equal(plans[0][2], plans[2][2])
    assert np.abs(plans[0][2] - plans[4][2]).max() > 1e-3
