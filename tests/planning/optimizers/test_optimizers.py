"""Optimizers as a registry: chosen by their names at either level, one from outside the package included."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from support import small_tasks

from oimppi_warp.compute.step import Launch
from oimppi_warp.config.fields import ExtraWeights, setting
from oimppi_warp.config.overrides import changed, extra_weights, from_record, options, set_option, settings_of, validate
from oimppi_warp.config.presets import best
from oimppi_warp.config.settings import Config, Mppi, Sampling
from oimppi_warp.errors import ConfigError
from oimppi_warp.kernels.optimizers.update import WeightStats
from oimppi_warp.planning.cloi import ClosedLoopPlanner
from oimppi_warp.planning.factory import make_planner
from oimppi_warp.planning.optimizers.cem import Cem
from oimppi_warp.planning.optimizers.optimizer import Optimizer, make_optimizer, wrapped_seed
from oimppi_warp.record.log import to_json
from oimppi_warp.record.metrics import pose_error
from oimppi_warp.registries import COST_TERMS, OPTIMIZERS
from oimppi_warp.runtime.episode import Episode
from oimppi_warp.runtime.request import SettingsRequest

SHARED = [item.name for item in fields(Sampling) if item.name != "kind"]


# Chosen by name


@pytest.mark.parametrize(("level", "kind"), list(product(["robot", "object"], ["mppi", "cem"])))
def test_an_optimizer_is_chosen_by_its_name_and_brings_its_settings(level: str, kind: str):
    config = set_option(best(), f"{level}.optimizer={kind}")
    found = options(config)
    assert found[f"{level}.optimizer"] == kind
    assert (f"{level}.optimizer.temperature" in found) == (kind == "mppi")
    assert (f"{level}.optimizer.elites" in found) == (kind == "cem")
    assert {name for name, value in options(best()).items() if found.get(name) != value} <= {
        f"{level}.optimizer{end}" for end in ("", ".temperature", ".effective_samples")
    }


def test_another_optimizer_keeps_what_all_have():
    config = set_option(set_option(best("soi"), "object.optimizer.iterations=3"), "object.optimizer=cem")
    for name in SHARED:
        expected = 3 if name == "iterations" else getattr(best("soi").object.optimizer, name)
        assert getattr(config.object.optimizer, name) == expected
    assert set_option(config, "object.optimizer=cem") == config
    assert options(set_option(config, "object.optimizer=mppi"))["object.optimizer.iterations"] == 3


def test_an_optimizer_that_does_not_exist_is_answered_with_those_that_do():
    with pytest.raises(ConfigError, match=r"robot\.optimizer=cen: .*does not exist\n  allowed: mppi, cem\n.*mean cem"):
        set_option(best(), "robot.optimizer=cen")
    with pytest.raises(ConfigError, match="optimizer 'nothing' does not exist"):
        validate(replace(best(), robot=replace(best().robot, optimizer=Sampling(kind="nothing"))))


def test_a_setting_of_another_optimizer_says_which_one_is_chosen():
    with pytest.raises(ConfigError, match=r"the optimizer mppi has no such setting\n(.|\n)*robot\.optimizer=NAME"):
        set_option(best(), "robot.optimizer.elites=0.1")
    assert SettingsRequest(
        "best",
        (
            "robot.optimizer=cem",
            "robot.optimizer.elites=0.1",
        ),
    ).config("cloi")


def test_an_optimizer_refuses_settings_of_another():
    dynamics, _, _ = small_tasks.object_level(small_tasks.shipped("task01"))
    with pytest.raises(ConfigError, match="optimizer 'cem': its settings are of the type Mppi"):
        make_optimizer(dynamics, Mppi(kind="cem"), seed=0)


# What CEM does


@pytest.mark.parametrize("scene", [pytest.param("task01", marks=pytest.mark.slow), "point01"])
def test_cem_pushes_the_object_nearer_to_its_goal_than_an_arm_that_stands_still(scene: str, device: str):
    loaded = small_tasks.shipped(scene)
    config = best("cloi")
    for option in ("robot.optimizer=cem", "object.optimizer=cem", "episode.max_sim_seconds=9", "episode.tight=false"):
        config = set_option(config, option)
    for level in ("robot", "object"):
        config = set_option(config, f"{level}.optimizer.samples=400")
    episode = Episode(loaded, config, method="cloi", engine="quasistatic", device=device, seed=1)
    assert isinstance(episode.planner.optimizer, Cem)
    assert isinstance(episode.planner, ClosedLoopPlanner) and isinstance(episode.planner._object.optimizer, Cem)
    log = episode.run()
    still = pose_error(np.array(loaded.start), loaded.goal)
    assert log["position_error"][-1] < still[0] - 0.05
    assert log.header["config"]["robot"]["optimizer"]["kind"] == "cem"


# One from outside the package


@dataclass(frozen=True)
class SearchSettings(Sampling):
    """Random search."""

    spread: float = setting(1.0, "Factor on the noise of random search.", low=0.1, high=5.0)


class RandomSearch(Optimizer):
    """The cheapest sample becomes the nominal."""

    Settings = SearchSettings

    def __init__(self, dynamics, settings, *, seed):
        super().__init__(dynamics, settings, seed=seed)
        self.spread = settings.spread

    def sample(self, seed: int) -> Sequence[Launch]:
        def widen() -> None:
            self.noise.host[:] *= self.spread

        return [widen, *super().sample(seed)]

    def update(self) -> Sequence[Launch]:
        def take() -> None:
            costs = self.costs.numpy()
            best = int(np.nanargmin(costs))
            self.nominal.assign(self.controls.numpy()[best])
            self.weights.assign(np.eye(len(costs), dtype=np.float32)[best])
            stats = np.zeros(1, dtype=WeightStats.numpy_dtype())
            stats["min_cost"], stats["effective_samples"] = costs[best], 1.0
            stats["lost"] = np.count_nonzero(~np.isfinite(costs))
            self.stats.array.assign(stats)

        return [take]


@pytest.fixture
def search() -> Iterator[str]:
    """Random search, registered for as long as a test runs."""
    OPTIMIZERS.register("search", RandomSearch)
    yield "search"
    OPTIMIZERS.unregister("search")


def test_an_optimizer_from_outside_is_chosen_set_and_plans(search: str, device: str):
    config = SettingsRequest(
        "best",
        (
            "robot.optimizer=search",
            "robot.optimizer.spread=2",
            "object.optimizer=search",
        ),
    ).config("cloi")
    assert config.robot.optimizer == SearchSettings(
        kind="search", samples=1200, horizon=25, least_noise=0.1, spread=2.0
    )
    assert settings_of(config)["robot.optimizer.spread"].help == "Factor on the noise of random search."
    assert "search" in settings_of(best())["robot.optimizer"].allowed
    assert changed(config, best()) == {
        "robot.optimizer": "mppi",
        "robot.optimizer.spread": 1.0,
        "object.optimizer": "mppi",
    }
    with pytest.raises(ConfigError, match=r"0\.1 to 5"):
        set_option(config, "robot.optimizer.spread=9")
    for level in ("robot", "object"):
        config = set_option(config, f"{level}.optimizer.samples=200")
    config = set_option(config, "robot.controls=joint")
    scene = small_tasks.shipped("task01")
    planner = make_planner(scene, config, method="cloi", engine="quasistatic", device=device, seed=1)
    seen = small_tasks.observe(scene)
    planner.start(seen)
    plan = planner.plan(seen)
    assert isinstance(planner.optimizer, RandomSearch)
    assert plan.update.min_cost == planner.optimizer.costs.numpy().min()
    assert np.abs(plan.command).max() > 0.0
    cheapest = planner.optimizer.controls.numpy()[int(np.argmin(planner.optimizer.costs.numpy()))]
    np.testing.assert_array_equal(plan.command, cheapest[0].astype(float))


def test_an_optimizer_that_was_removed_is_no_longer_there(search: str):
    chosen = set_option(best(), f"robot.optimizer={search}")
    OPTIMIZERS.unregister(search)
    with pytest.raises(ConfigError, match="optimizer 'search' does not exist"):
        validate(chosen)
    with pytest.raises(ConfigError, match="does not exist"):
        set_option(best(), "robot.optimizer=search")


def test_settings_that_are_no_sampling_based_optimizers_are_refused():
    OPTIMIZERS.register("odd", SimpleNamespace(Settings=Config))
    try:
        with pytest.raises(ConfigError, match="Sampling"):
            set_option(best(), "robot.optimizer=odd")
    finally:
        OPTIMIZERS.unregister("odd")


@pytest.mark.parametrize("kind", ["mppi", "cem"])
def test_every_shipped_optimizer_is_documented_with_its_settings(kind: str):
    optimizer = OPTIMIZERS[kind]
    assert issubclass(optimizer, Optimizer) and inspect.getdoc(optimizer) and inspect.getdoc(optimizer.Settings)
    assert optimizer.Settings().kind == kind


# Seeds


def test_small_seeds_are_themselves_and_others_wrap_to_signed_32_bits():
    for seed in (0, 1, 104729, 2**31 - 1):
        assert wrapped_seed(seed) == seed
    assert wrapped_seed(2**31) == -(2**31)
    assert wrapped_seed(2**32 - 1) == -1
    many = np.random.default_rng(0).integers(0, 2**33 + 2**31, 2000).tolist() + [2**33, 2**32, 2**34]
    for seed in many:
        assert -(2**31) <= wrapped_seed(seed) < 2**31
        wp.int32(wrapped_seed(seed))


def test_seeds_that_differ_in_their_highest_bit_alone_give_other_noise():
    for seed in (0, 5, 2**31 - 1):
        assert wrapped_seed(2 * seed + 1) != wrapped_seed(2 * (seed + 2**31) + 1)


# Weights of cost terms from outside


@pytest.fixture
def term() -> Iterator[str]:
    """A cost term from outside, registered for as long as a test runs."""
    COST_TERMS.register("calm", SimpleNamespace(weight=3.0, about="Weight of calm, which the test asks for."))
    yield "calm"
    COST_TERMS.unregister("calm")


def test_the_weight_of_a_term_from_outside_is_a_setting(term: str):
    assert options(best())["cost.extra.calm"] == 3.0
    assert settings_of(best())["cost.extra.calm"].help == "Weight of calm, which the test asks for."
    config = validate(set_option(best(), "cost.extra.calm=5"))
    assert config.cost.extra == {"calm": 5.0} == extra_weights(config.cost)
    assert extra_weights(best().cost) == {"calm": 3.0}
    assert hash(config) != hash(best()) and config != best()
    assert from_record(to_json(asdict(config))) == config
    with pytest.raises(ConfigError, match="number, >= 0"):
        set_option(best(), "cost.extra.calm=-1")


def test_the_weight_of_a_term_that_does_not_exist_is_refused():
    with pytest.raises(ConfigError, match="the setting does not exist"):
        set_option(best(), "cost.extra.calm=5")
    unknown = replace(best(), cost=replace(best().cost, extra={"calm": 5.0}))
    with pytest.raises(ConfigError, match="cost term 'calm' does not exist"):
        validate(unknown)


def test_extra_weights_compare_and_hash_by_value_and_cannot_be_changed():
    one, same = ExtraWeights({"b": 1.0, "a": 2.0}), ExtraWeights({"a": 2.0, "b": 1.0})
    assert one == same and hash(one) == hash(same) and list(one) == ["a", "b"]
    with pytest.raises(TypeError):
        one["a"] = 3.0  # pyright: ignore[reportIndexIssue]
