"""Controls for all settings, with help and unit as tooltip, generated from the fields of the config dataclasses."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any, get_args, get_origin

from oimppi_warp.config.overrides import Setting, changed, options, set_option, settings_of, validate
from oimppi_warp.config.settings import Config
from oimppi_warp.errors import ConfigError

_SLIDER_TOP = 4.0
"""Upper end of a slider, as a multiple of the default."""


class SettingsPanel:
    """Shows controls for all settings in folders, and lists the changed ones, each with a button that resets it.

    An optimizer's kind is a dropdown; selecting another kind replaces the controls in the folder. Folders are added one
    by one, by :meth:`add_folder`, since a browser may need a second to create all controls.

    Args:
        server: A viser server.
        config: Initial settings, which are also the defaults that the buttons restore.
        on_change: Callback that receives the new settings.
    """

    def __init__(self, server: Any, config: Config, on_change: Callable[[Config], None]) -> None:
        self._gui = server.gui
        self._default = self.config = config
        self._on_change = on_change
        self._controls: dict[str, Any] = {}
        self._buttons: dict[str, Any] = {}
        self._changed = self._gui.add_folder("Changed settings", order=6.0, visible=False)
        with self._changed:
            self._command = self._gui.add_markdown("")
        self._root = self._gui.add_folder("Settings", order=8.0, expand_by_default=False)
        self._folders: dict[str, Any] = {}
        self._orders: dict[str, float] = {}
        self._missing = list(_in_folders(config))
        self._lock = threading.RLock()  # the browser's events come in threads of their own

    def add_folder(self) -> bool:
        """Adds the next folder; returns whether there are more."""
        with self._lock:
            if self._missing:
                self._build(self._missing.pop(0))
            return bool(self._missing)

    def set(self, name: str, value: Any) -> None:
        """Changes a setting by its dotted name.

        Raises:
            ConfigError: The value is not allowed for this setting.
        """
        text = ",".join(map(str, value)) if isinstance(value, tuple) else str(value)
        with self._lock:
            config = validate(set_option(self.config, f"{name}={text}"))
            if options(config)[name] == options(self.config)[name]:
                return
            self._apply(config)
            self._on_change(config)

    def replace(self, config: Config) -> None:
        """Replaces all settings and their defaults, for example by a preset."""
        with self._lock:
            self._default = config
            self._apply(config)

    def _apply(self, config: Config) -> None:
        """Displays these settings, with the controls that their optimizers need."""
        while self.add_folder():
            pass
        before, self.config = _in_folders(self.config), config
        now = _in_folders(config)
        for folder in {**before, **now}:
            if before.get(folder, {}).keys() != now.get(folder, {}).keys():
                self._build(folder)
        for name, value in options(config).items():
            if self._controls[name].value != _control_value(value):
                self._controls[name].value = _control_value(value)
        self._show_changed()

    def _build(self, folder: str) -> None:
        """Recreates a folder's controls, keeping the folder's position."""
        order = self._orders.setdefault(folder, float(len(self._orders)))
        if folder in self._folders:
            self._folders.pop(folder).remove()
            self._controls = {name: c for name, c in self._controls.items() if name.rpartition(".")[0] != folder}
        settings = _in_folders(self.config).get(folder)
        if not settings:
            return
        with self._root:
            self._folders[folder] = self._gui.add_folder(folder or "general", order=order, expand_by_default=False)
        with self._folders[folder]:
            for setting in settings.values():
                self._add(setting)

    def _add(self, setting: Setting) -> None:
        name, value, kind = setting.name, setting.value, setting.kind
        about = setting.help.replace("`", "")  # a tooltip is plain text
        shown = name.rpartition(".")[2]
        low, high = setting.about.low, setting.about.high
        if get_args(kind) and isinstance(value, str):
            control = self._gui.add_dropdown(shown, get_args(kind), initial_value=value, hint=about)
        elif isinstance(value, bool):
            control = self._gui.add_checkbox(shown, initial_value=value, hint=about)
        elif isinstance(value, int | float):
            top = min(high, max(_SLIDER_TOP * value, low + 1.0)) if value else min(high, 10.0)
            if isinstance(value, int):
                low, top, step = int(low), math.ceil(top), 1
            else:
                step = 10.0 ** (math.floor(math.log10(top - low)) - 3)
                top = math.ceil(top / step) * step
            control = self._gui.add_slider(shown, min=low, max=top, step=step, initial_value=value, hint=about)
        elif get_origin(kind) is tuple:
            control = self._gui.add_text(shown, initial_value=_control_value(value), hint=about)
        else:
            raise TypeError(f"{name}: no control for settings of type {kind}")
        self._controls[name] = control

        @control.on_update
        def _changed(event: Any) -> None:
            if event.client_id is None:
                return  # changed by this program, not in a browser
            try:
                self.set(name, event.target.value)
            except ConfigError as error:
                event.target.value = _control_value(options(self.config)[name])
                event.client.add_notification("Invalid value", str(error), color="red")

    def _show_changed(self) -> None:
        now, differing = options(self.config), changed(self.config, self._default)
        for name in set(self._buttons) - differing.keys():
            self._buttons.pop(name).remove()
        for name in sorted(differing.keys() - self._buttons.keys()):
            with self._changed:
                button = self._gui.add_button(f"Reset {name} to {_control_value(differing[name])}")
            button.on_click(lambda _event, name=name: self._revert(name))
            self._buttons[name] = button
        self._changed.visible = bool(differing)
        assignments = " ".join(f"{name}={_control_value(now[name])}" for name in sorted(differing))
        self._command.content = f"`--set {assignments}`" if differing else ""

    def _revert(self, name: str) -> None:
        self.set(name, changed(self.config, self._default)[name])


def _in_folders(config: Config) -> dict[str, dict[str, Setting]]:
    """Groups the settings by folder."""
    folders: dict[str, dict[str, Setting]] = {}
    for name, setting in settings_of(config).items():
        folders.setdefault(name.rpartition(".")[0], {})[name] = setting
    return folders


def _control_value(value: Any) -> Any:
    """Converts a value to the form that a control holds."""
    return (
        ",".join(f"{part:g}" if isinstance(part, float) else str(part) for part in value)
        if isinstance(value, tuple)
        else value
    )
