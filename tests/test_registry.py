"""Registries: what is shipped, installed and registered, and what is said where an entry cannot be had."""

from __future__ import annotations

from importlib.metadata import EntryPoint

import pytest
from support.outside_terms import high
from support.small_tasks import shipped

from oimppi_warp.bench.runner import BenchError, _check_known_elsewhere
from oimppi_warp.bench.suite import load_suite
from oimppi_warp.bench.trial import make_trials
from oimppi_warp.config.overrides import set_option, validate
from oimppi_warp.config.presets import best
from oimppi_warp.config.run_spec import RunSpec
from oimppi_warp.errors import ConfigError
from oimppi_warp.planning.engines.cost_terms import CostTerm
from oimppi_warp.planning.resolve import entries_used, resolve
from oimppi_warp.registries import COST_TERMS
from oimppi_warp.registry import Registry


@pytest.fixture
def colors() -> Registry[int]:
    return Registry("color", "nowhere.colors", {"red": "oimppi_warp.config.run_spec:LARGEST_SEED"})


def test_names_are_listed_in_the_order_in_which_they_were_added(colors: Registry[int]):
    colors.register("blue", 2)
    assert list(colors) == ["red", "blue"] and len(colors) == 2
    assert (colors["red"], colors["blue"]) == (2**32 - 1, 2)
    assert colors.is_local("blue") and not colors.is_local("red")
    colors.unregister("blue")
    colors.unregister("red")  # what is shipped stays
    assert list(colors) == ["red"]


def test_a_name_that_does_not_exist_is_answered_with_those_that_do(colors: Registry[int]):
    with pytest.raises(
        ConfigError, match=r"color 'rad' does not exist\n  allowed: auto, red\n  to do:   did you mean red"
    ):
        colors.check("rad", "auto")
    with pytest.raises(KeyError):
        colors["rad"]


def test_a_package_that_cannot_be_imported_is_named_and_hinders_nobody_else(colors: Registry[int]):
    colors.__dict__["_installed"] = {"broken": EntryPoint("broken", "no_such_module:thing", "nowhere.colors")}
    assert list(colors) == ["red", "broken"]
    with pytest.raises(ConfigError, match=r"color 'broken' of the package .* cannot be loaded: No module named"):
        colors["broken"]
    assert list(colors.loadable()) == [("red", 2**32 - 1)]


def test_a_run_names_every_entry_that_it_uses():
    config = set_option(best(), "object.optimizer=cem")
    used = [(registry.kind, name) for registry, name in entries_used(RunSpec(method="soi"), config)]
    assert used == [("method", "soi"), ("plant", "ideal"), ("optimizer", "mppi"), ("optimizer", "cem")]
    assert ("engine", "newton") in [(r.kind, n) for r, n in entries_used(RunSpec(engine="newton"), config)]


def test_trials_with_a_term_of_this_process_are_not_sent_to_another(tmp_path):
    (tmp_path / "mine.toml").write_text('tasks = ["task01"]\nmethods = ["mppi"]\ntrials = 1\n')
    trials, _ = make_trials(load_suite(tmp_path / "mine.toml"))
    plain = trials[0].key
    _check_known_elsewhere(trials)
    COST_TERMS.register("high", CostTerm(high, weight=3.0))
    try:
        assert trials[0].key != plain  # it counts, and so it is another trial
        with pytest.raises(BenchError, match="the cost term high was registered in this process"):
            _check_known_elsewhere(trials)
    finally:
        COST_TERMS.unregister("high")


def test_a_term_that_weighs_nothing_is_in_no_key_and_in_no_record(tmp_path):
    (tmp_path / "mine.toml").write_text('tasks = ["task01"]\nmethods = ["mppi"]\ntrials = 1\n')
    trials, _ = make_trials(load_suite(tmp_path / "mine.toml"))
    plain = trials[0].key
    COST_TERMS.register("high", CostTerm(high))
    try:
        assert trials[0].key == plain
        assert dict(resolve(best(), shipped("task01")).config.cost.extra) == {}
        off = set_option(best(), "cost.extra.high=0")
    finally:
        COST_TERMS.unregister("high")
    assert validate(off) == off  # nor does it hinder where it is not known


def test_a_term_cannot_weigh_less_than_nothing():
    with pytest.raises(ConfigError, match="to reward something, let the function return a negative cost"):
        CostTerm(high, weight=-1.0)
