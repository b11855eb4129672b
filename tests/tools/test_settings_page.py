"""The page of all settings, and what the fields say of themselves."""

from __future__ import annotations

import runpy
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from oimppi_warp.config.fields import setting
from oimppi_warp.config.overrides import options, set_option, settings_of
from oimppi_warp.config.presets import PRESETS
from oimppi_warp.config.settings import Sampling

ROOT = Path(__file__).resolve().parents[2]


def test_the_page_of_settings_is_what_the_fields_say():
    written = runpy.run_path(str(ROOT / "tools" / "settings_page.py"))["page"]()
    assert (ROOT / "docs" / "settings.md").read_text() == written, "run python tools/settings_page.py"


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("method", ["mppi", "soi", "cloi"])
@pytest.mark.parametrize("optimizer", ["mppi", "cem"])
def test_every_setting_has_help_that_is_a_sentence_a_type_and_bounds(preset: str, method: str, optimizer: str):
    config = set_option(PRESETS[preset](method), f"robot.optimizer={optimizer}")
    found = settings_of(config)
    assert found.keys() == options(config).keys()
    for name, one in found.items():
        assert one.about.text[0].isupper() and one.about.text.endswith("."), name
        assert len(one.about.text) > 20, name
        assert one.about.low < one.about.high, name
        assert one.help == (f"{one.about.text} [{one.about.unit}]" if one.about.unit else one.about.text)


def test_bounds_and_units_are_those_of_the_field():
    found = settings_of(PRESETS["best"]())
    samples, limit = found["robot.optimizer.samples"], found["robot.joint_velocity_limit"]
    assert (samples.about.low, samples.about.high) == (2, 1_000_000)
    assert limit.about.unit == "rad/s" and limit.help.endswith("[rad/s]")
    assert limit.allowed_with_unit == "number, >= 0.001 [rad/s]"
    assert samples.allowed_with_unit == samples.allowed == "integer, 2 to 1000000"


def test_a_field_without_help_is_refused_where_it_is_listed():
    @dataclass(frozen=True)
    class Bare(Sampling):
        mystery: float = 1.0

    with pytest.raises(TypeError, match="mystery"):
        settings_of(Bare())

    @dataclass(frozen=True)
    class Told(Sampling):
        mystery: float = setting(1.0, "Number that the test needs.", unit="m", high=2.0)

    assert settings_of(Told())["mystery"].help == "Number that the test needs. [m]"


def test_settings_keep_their_help_and_bounds_without_docstrings():
    script = """
import oimppi_warp.config.settings
from oimppi_warp.errors import ConfigError
from oimppi_warp.config.presets import PRESETS
from oimppi_warp.config.overrides import set_option, settings_of, validate
if oimppi_warp.config.settings.__doc__ is not None:
    raise SystemExit("docstrings were kept")
for name, make in PRESETS.items():
    found = settings_of(validate(make("cloi")))
    if not all(setting.help for setting in found.values()) or len(found) < 80:
        raise SystemExit(f"{name}: a setting without help")
print(settings_of(make("cloi"))["cost.w_tilt"].help)
if set_option(make("cloi"), "cost.w_tilt=7").cost.w_tilt != 7.0:
    raise SystemExit("not set")
try:
    set_option(make("cloi"), "cost.w_tilt=-7")
except ConfigError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-OO", "-c", script], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        "Weight of the tool's tilt from vertical (equation 19). [1/rad]",
        "cost.w_tilt = -7 cannot be used",
        "  allowed: number, >= 0 [1/rad]",
    ]
