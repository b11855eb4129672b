"""Every setting as a control, made from the config dataclasses: the docstring is the tooltip."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, get_args, get_origin

from oimppi_warp.config import Config
from oimppi_warp.errors import ConfigError
from oimppi_warp.settings import bounds_of, descriptions, kinds, options, set_option, validate

_SLIDER_TOP = 4.0
"""A slider goes up to so many times the default."""


class SettingsPanel:
    """Controls for all settings in folders, and the changed ones with a button each that takes the change back.

    Args:
        server: viser's.
        config: The settings to begin with, which are the defaults that buttons lead back to.
        on_change: Called with the new settings.
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
        about, types = descriptions(config), kinds(config)
        folders: dict[str, list[str]] = {}
        for name in options(config):
            folders.setdefault(name.rpartition(".")[0], []).append(name)
        with self._gui.add_folder("Settings", order=8.0, expand_by_default=False):
            for folder, names in folders.items():
                with self._gui.add_folder(folder or "general", expand_by_default=False):
                    for name in names:
                        self._add(name, types[name], about[name])

    def set(self, name: str, value: Any) -> None:
        """Changes a setting by its dotted name.

        Raises:
            ConfigError: It cannot have that value.
        """
        text = ",".join(map(str, value)) if isinstance(value, tuple) else str(value)
        config = validate(set_option(self.config, f"{name}={text}"))
        if options(config)[name] == options(self.config)[name]:
            return
        self.config = config
        self._show_changed()
        self._on_change(config)

    def replace(self, config: Config) -> None:
        """Other settings, which are the new defaults: a preset, say."""
        self._default = self.config = config
        for name, value in options(config).items():
            self._controls[name].value = _shown(value)
        self._show_changed()

    def _add(self, name: str, kind: Any, about: str) -> None:
        value, label = options(self.config)[name], name.rpartition(".")[2]
        low, high = bounds_of(name)
        if get_args(kind) and isinstance(value, str):
            control = self._gui.add_dropdown(label, get_args(kind), initial_value=value, hint=about)
        elif isinstance(value, bool):
            control = self._gui.add_checkbox(label, initial_value=value, hint=about)
        elif isinstance(value, int | float):
            top = min(high, max(_SLIDER_TOP * value, low + 1.0)) if value else min(high, 10.0)
            if isinstance(value, int):
                low, top, step = int(low), math.ceil(top), 1
            else:
                step = 10.0 ** (math.floor(math.log10(top - low)) - 3)
                top = math.ceil(top / step) * step
            control = self._gui.add_slider(label, min=low, max=top, step=step, initial_value=value, hint=about)
        else:
            assert get_origin(kind) is tuple, name
            control = self._gui.add_text(label, initial_value=_shown(value), hint=about)
        self._controls[name] = control

        @control.on_update
        def _changed(event: Any) -> None:
            if event.client_id is None:
                return  # it was set from here
            try:
                self.set(name, event.target.value)
            except ConfigError as error:
                event.target.value = _shown(options(self.config)[name])
                event.client.add_notification("This value cannot be used", str(error), color="red")

    def _show_changed(self) -> None:
        now, default = options(self.config), options(self._default)
        changed = {name for name in now if now[name] != default[name]}
        for name in set(self._buttons) - changed:
            self._buttons.pop(name).remove()
        for name in sorted(changed - set(self._buttons)):
            with self._changed:
                button = self._gui.add_button(f"{name}: back to {_shown(default[name])}")
            button.on_click(lambda _event, name=name: self._take_back(name))
            self._buttons[name] = button
        self._changed.visible = bool(changed)
        assignments = " ".join(f"{name}={_shown(now[name])}" for name in sorted(changed))
        self._command.content = f"`--set {assignments}`" if changed else ""

    def _take_back(self, name: str) -> None:
        value = options(self._default)[name]
        self._controls[name].value = _shown(value)
        self.set(name, value)


def _shown(value: Any) -> Any:
    """A value as a control holds it."""
    return (
        ",".join(f"{part:g}" if isinstance(part, float) else str(part) for part in value)
        if isinstance(value, tuple)
        else value
    )
