"""Old names of settings are accepted wherever a setting is named."""

from __future__ import annotations

from dataclasses import asdict

import pytest

from oimppi_warp.config.overrides import changed, from_record, options, set_option
from oimppi_warp.config.presets import PRESETS, best
from oimppi_warp.config.renamed import SETTINGS, present_name
from oimppi_warp.config.settings import Config
from oimppi_warp.errors import ConfigError
from oimppi_warp.record.log import to_json
from oimppi_warp.runtime.request import SettingsRequest


def old_names() -> list[tuple[str, str]]:
    """Every old name of a setting, with the present one."""
    found = []
    for old, present in SETTINGS.items():
        for name in options(Config()):
            if name == present or name.startswith(f"{present}."):
                found.append((old + name.removeprefix(present), name))
    return found


def text_of(value: object) -> str:
    """A value as ``--set`` takes it."""
    return ",".join(map(str, value)) if isinstance(value, tuple) else str(value)


def test_every_entry_of_the_table_leads_to_settings_that_exist():
    for old, present in SETTINGS.items():
        assert [name for name in options(Config()) if f"{name}.".startswith(f"{present}.")], f"{old} leads nowhere"
        assert present_name(present) == present, f"{old} leads to another old name"


@pytest.mark.parametrize(("old", "present"), old_names())
def test_every_old_name_sets_what_its_present_name_sets(old: str, present: str):
    value = text_of(options(PRESETS["paper"]("cloi"))[present])
    assert set_option(best(), f"{old}={value}") == set_option(best(), f"{present}={value}")


def test_a_command_with_old_names_makes_the_same_settings():
    old = SettingsRequest(
        "best",
        (
            "robot.mppi.samples=512",
            "object.mppi.knots=0",
        ),
    ).config("cloi")
    new = SettingsRequest(
        "best",
        (
            "robot.optimizer.samples=512",
            "object.optimizer.knots=0",
        ),
    ).config("cloi")
    assert old == new
    assert (new.robot.optimizer.samples, new.object.optimizer.knots) == (512, 0)


def test_an_old_name_that_is_wrong_is_answered_with_present_names():
    with pytest.raises(ConfigError, match=r"did you mean robot\.optimizer\.samples"):
        set_option(best(), "robot.mppi.sampels=512")


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("optimizer", ["mppi", "cem"])
def test_a_record_gives_back_the_settings_that_it_holds(preset: str, optimizer: str):
    config = set_option(set_option(PRESETS[preset]("soi"), f"object.optimizer={optimizer}"), "cost.w_tilt=7")
    record = to_json(asdict(config))
    assert record["object"]["optimizer"]["kind"] == optimizer
    assert from_record(record) == config


def test_a_record_of_an_earlier_version_gives_its_settings():
    config = set_option(best("soi"), "robot.optimizer.effective_samples=0.1,0.2")
    record = to_json(asdict(config))
    for level in ("robot", "object"):
        record[level]["mppi"] = record[level].pop("optimizer")
        del record[level]["mppi"]["kind"]
    record["regrasp"] = record.pop("reposition")
    record["regrasp"]["w_guide"] = record["regrasp"].pop("w_waypoint")
    record["cost"]["w_clearance"], record["cost"]["clearance"] = 2.0, 0.5
    del record["cost"]["w_arm_clearance"], record["cost"]["arm_clearance"]
    for costs in ("cost", "object_cost"):
        record[costs]["reach"] = record[costs].pop("push_ring")
    del record["cost"]["extra"], record["resolved_for"]
    config = set_option(set_option(config, "cost.w_arm_clearance=2"), "cost.arm_clearance=0.5")
    assert from_record(record) == config


def test_a_record_with_a_setting_that_does_not_exist_or_a_wrong_value_is_refused():
    record = to_json(asdict(best()))
    with pytest.raises(ConfigError, match=r"record: cost\.w_aligm"):
        from_record({"cost": {"w_aligm": 1.0}})
    with pytest.raises(ConfigError, match=r"record: cost\.push_ring = 3"):
        from_record(record | {"cost": {"reach": 3}})
    with pytest.raises(ConfigError, match="the value is invalid\n  allowed: integer, 2 to 1000000"):
        from_record({"robot": {"mppi": {"samples": 1.5}}})


def test_what_was_changed_is_told_with_the_defaults_values():
    config = set_option(set_option(best(), "robot.optimizer=cem"), "robot.optimizer.elites=0.2")
    config = set_option(config, "cost.w_tilt=7")
    assert changed(config, best()) == {"robot.optimizer": "mppi", "robot.optimizer.elites": 0.05, "cost.w_tilt": 3.0}
    assert changed(best(), best()) == {}


def test_a_record_without_a_setting_is_read_with_what_its_version_did():
    record = to_json(asdict(best("cloi")))
    del record["robot"]["controls"], record["robot"]["optimizer"]["least_noise"], record["cost"]["w_stance"]
    found = from_record(record)
    assert (found.robot.controls, found.robot.optimizer.least_noise, found.cost.w_stance) == ("joint", 1.0, 0.0)
    assert found.cost.w_track == best("cloi").cost.w_track, "as the record has it"
    del record["object"]["plans"], record["object"]["optimizer"]["least_noise"], record["reposition"]["least_pace"]
    found = from_record(record)
    assert (found.object.plans, found.object.optimizer.least_noise, found.reposition.least_pace) == (1, 1.0, 1.0)
