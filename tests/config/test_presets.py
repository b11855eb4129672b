"""Presets, and settings changed by name."""

from __future__ import annotations

from dataclasses import replace

import pytest

from oimppi_warp import registries
from oimppi_warp.config.overrides import options, set_option, validate
from oimppi_warp.config.presets import PRESETS, best, paper, paper_printed
from oimppi_warp.config.settings import Config
from oimppi_warp.errors import ConfigError

METHODS: tuple[str, ...] = ("mppi", "soi", "cloi")


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("method", METHODS)
def test_every_preset_is_valid_for_every_method(preset: str, method: str):
    config = PRESETS[preset](method)
    assert validate(config) is config
    assert config.preset == preset


NOISE = ("optimizer.knots", "optimizer.special_samples", "optimizer.effective_samples", "optimizer.temperature")
NOT_PRINTED = {
    "robot": (*NOISE, "joint_velocity_limit", "noise_space", "tool_noise"),
    "object": (*NOISE, "noise", "speed_limit"),
    "cost": ("w_d", "w_theta", "w_reference", "w_ee", "r_0", "w_align", "w_height"),
    "object_cost": ("w_d", "w_theta", "w_f"),
}
"""Settings whose values the paper does not print; only these may differ between ``paper`` and ``paper-printed``."""


@pytest.mark.parametrize("preset", PRESETS)
def test_a_method_from_outside_begins_with_the_settings_of_cloi(preset: str):
    registries.METHODS.register("somebody_elses", object())
    try:
        assert PRESETS[preset]("somebody_elses") == PRESETS[preset]("cloi")
    finally:
        registries.METHODS.unregister("somebody_elses")


def test_paper_has_the_papers_samples_and_horizons():
    for method, robot_horizon, object_horizon in (("mppi", 25, None), ("soi", 25, 90), ("cloi", 15, 60)):
        config = paper_printed(method)
        assert config.robot.optimizer.samples == config.object.optimizer.samples == 1200
        assert config.robot.optimizer.horizon == robot_horizon
        assert object_horizon is None or config.object.optimizer.horizon == object_horizon


def test_paper_samples_as_equation_9_prints_it():
    config = paper_printed("cloi")
    assert config.robot.noise_space == "joint"
    assert config.robot.joint_noise**2 == pytest.approx(0.1, rel=0.01)
    assert (config.robot.optimizer.knots, config.robot.optimizer.iterations) == (0, 1)
    assert not config.robot.optimizer.special_samples
    assert config.reference == "time"


@pytest.mark.parametrize("method", ["mppi", "soi", "cloi"])
def test_paper_differs_from_what_is_printed_only_where_the_paper_prints_nothing(method: str):
    printed, found = options(paper_printed(method)), options(paper(method))
    different = {name for name in printed if printed[name] != found[name]}
    assert different <= {f"{group}.{name}" for group, names in NOT_PRINTED.items() for name in names}


def test_a_setting_is_changed_by_its_dotted_name_and_nothing_else_is():
    before = options(best())
    after = options(set_option(best(), "cost.w_align=2.5"))
    assert after["cost.w_align"] == 2.5
    assert {name for name in before if before[name] != after[name]} <= {"cost.w_align"}


@pytest.mark.parametrize(
    ("assignment", "value"),
    [
        ("robot.optimizer.samples=512", 512),
        ("cost.push_ring = 0.2, 0.5", (0.2, 0.5)),
        ("reference=time", "time"),
        ("episode.tight=true", True),
        ("episode.tight=0", False),
        ("robot.tool_noise=1,2,3,4,5,6", (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)),
        ("cost.w_arm_clearance=1e3", 1000.0),
    ],
)
def test_values_are_read_by_the_type_of_their_field(assignment: str, value: object):
    config = set_option(best(), assignment)
    read = options(config)[assignment.partition("=")[0].strip()]
    assert read == value
    assert type(read) is type(value)


@pytest.mark.parametrize("preset", PRESETS)
def test_a_method_that_does_not_exist_has_no_settings(preset: str):
    with pytest.raises(ConfigError, match="did you mean cloi"):
        PRESETS[preset]("clio")


@pytest.mark.parametrize(
    ("assignment", "suggestion"),
    [
        ("cost.w_aligm=1", "cost.w_align"),
        ("w_align=1", "cost.w_align"),
        ("robot.samples=64", "robot.optimizer.samples"),
        ("control_perod=0.1", "control_period"),
    ],
)
def test_an_unknown_name_suggests_the_nearest(assignment: str, suggestion: str):
    with pytest.raises(ConfigError, match=f"did you mean .*{suggestion}"):
        set_option(best(), assignment)


@pytest.mark.parametrize(
    ("assignment", "allowed"),
    [
        ("robot.optimizer.samples=0", "2 to"),
        ("robot.optimizer.horizon=0", "1 to"),
        ("object.optimizer.samples=-5", "2 to"),
        ("object.optimizer.horizon=0", "1 to"),
        ("robot.optimizer.samples=12.5", "integer, 2 to 1000000"),
        ("cost.w_align=much", "the value is invalid\n  allowed: number, >= 0"),
        ("cost.w_align=nan", "finite"),
        ("cost.w_align=inf", "finite"),
        ("cost.w_align=-1", "number, >= 0"),
        ("cost.push_ring=0.2", r"2 comma-separated numbers, each >= 0 \[m\]"),
        ("reference=clock", "time or progress"),
        ("episode.tight=perhaps", "true or false"),
        ("control_period=0", "0.001 to 1"),
        ("cost.w_align", "NAME=VALUE"),
    ],
)
def test_a_value_that_cannot_be_used_is_refused_with_what_is_allowed(assignment: str, allowed: str):
    with pytest.raises(ConfigError, match=allowed):
        set_option(best(), assignment)


def test_the_name_of_the_preset_is_no_setting():
    with pytest.raises(ConfigError, match="the setting does not exist"):
        set_option(best(), "preset=paper")


def test_settings_that_contradict_each_other_are_refused():
    few_steps = set_option(set_option(best(), "robot.optimizer.horizon=4"), "robot.optimizer.knots=6")
    with pytest.raises(ConfigError, match=r"robot\.optimizer\.knots = 6"):
        validate(few_steps)
    validate(set_option(few_steps, "robot.optimizer.knots=0"))
    with pytest.raises(ConfigError, match="lower bound is above"):
        validate(set_option(best(), "cost.push_ring=0.6,0.2"))


def test_a_config_made_by_hand_is_checked_too():
    config: Config = best()
    broken = replace(config, robot=replace(config.robot, optimizer=replace(config.robot.optimizer, samples=0)))
    with pytest.raises(ConfigError, match=r"robot\.optimizer\.samples = 0"):
        validate(broken)
