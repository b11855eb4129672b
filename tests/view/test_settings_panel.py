"""The viewer's panel of settings: every setting has a control, and another optimizer brings its own."""

from __future__ import annotations

import io
from contextlib import redirect_stdout
from types import SimpleNamespace

import pytest
import viser

from oimppi_warp.config.overrides import options, set_option, settings_of
from oimppi_warp.config.presets import best, lab
from oimppi_warp.config.settings import Config
from oimppi_warp.errors import ConfigError
from oimppi_warp.view.settings_panel import SettingsPanel


@pytest.fixture(scope="module")
def server():
    with redirect_stdout(io.StringIO()):
        made = viser.ViserServer(host="127.0.0.1", port=8490, verbose=False)
    yield made
    made.stop()


@pytest.fixture
def told() -> list[Config]:
    """The settings that the panel tells of."""
    return []


@pytest.fixture
def panel(server, told) -> SettingsPanel:
    made = SettingsPanel(server, best("cloi"), told.append)
    while made.add_folder():
        pass
    return made


def buttons(panel: SettingsPanel) -> set[str]:
    return {button.label for button in panel._buttons.values()}


def test_every_setting_has_a_control_with_its_help_and_unit(panel):
    assert panel._controls.keys() == options(best("cloi")).keys()
    for name, setting in settings_of(best("cloi")).items():
        assert panel._controls[name].hint == setting.help.replace("`", "")
    assert panel._controls["robot.joint_velocity_limit"].hint.endswith("[rad/s]")
    assert panel._controls["robot.optimizer"].options == ("mppi", "cem")


def test_folders_come_one_by_one_and_all_at_once_when_settings_change(server, told):
    panel = SettingsPanel(server, best("cloi"), told.append)
    assert not panel._controls, "the browser would be busy before the arm moves"
    assert panel.add_folder()
    assert {name.rpartition(".")[0] for name in panel._controls} == {""}
    panel.set("robot.optimizer", "cem")
    assert panel._controls.keys() == options(told[-1]).keys()
    assert not panel.add_folder()


def test_another_optimizer_brings_its_settings_into_its_folder(panel, told):
    panel.set("robot.optimizer", "cem")
    assert told[-1] == set_option(best("cloi"), "robot.optimizer=cem")
    assert panel._controls.keys() == options(told[-1]).keys()
    panel.set("robot.optimizer.elites", 0.2)
    assert told[-1].robot.optimizer.elites == 0.2
    assert buttons(panel) == {"Reset robot.optimizer to mppi", "Reset robot.optimizer.elites to 0.05"}
    assert panel._command.content == "`--set robot.optimizer=cem robot.optimizer.elites=0.2`"
    panel._revert("robot.optimizer")
    assert told[-1] == best("cloi")
    assert panel._controls.keys() == options(best("cloi")).keys()
    assert not panel._buttons and not panel._changed.visible


def test_a_control_changes_its_setting_and_a_value_that_cannot_be_used_is_put_back(panel, told):
    control = panel._controls["object.optimizer.knots"]
    warnings = []
    client = SimpleNamespace(add_notification=lambda *words, **more: warnings.append(words))

    def choose(value):
        control.value = value
        event = SimpleNamespace(client_id=1, client=client, target=control)
        for callback in control._impl.update_cb:
            callback(event)

    choose(0)
    assert told[-1].object.optimizer.knots == 0
    choose(1)
    assert control.value == 0 and "not possible for a horizon" in warnings[0][1]
    assert len(told) == 1


def test_a_preset_becomes_the_new_default(panel, told):
    panel.set("cost.w_align", 7)
    panel.replace(lab("cloi"))
    assert panel.config == lab("cloi") and not panel._buttons
    assert panel._controls["robot.optimizer.samples"].value == 512
    assert panel._controls["cost.w_align"].value == lab("cloi").cost.w_align
    with pytest.raises(ConfigError, match="number, >= 0"):
        panel.set("cost.w_align", -1)
