"""Write `docs/settings.md`, the table of all settings, from the fields of the config dataclasses.

python tools/settings_page.py
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import Any

from oimppi_warp.config.fields import about
from oimppi_warp.config.overrides import Setting, set_option, settings_of
from oimppi_warp.config.renamed import SETTINGS
from oimppi_warp.config.settings import Config
from oimppi_warp.registries import OPTIMIZERS

PAGE = Path(__file__).resolve().parents[1] / "docs" / "settings.md"
HEAD = ("name", "default", "unit", "allowed", "what it is")
INTRO = """\
# Settings

Every setting of a run, by the name that `--set NAME=VALUE`, a suite's `set` and the viewer's panel know it by. Tuples
are written with commas: `--set cost.push_ring=0.3,0.55`. Defaults are those of the preset `best` for CLOI; `paper`,
`lab` and `best` for other methods begin with other values for some (`oimppi_warp/config/presets.py`). What takes effect
on a task can differ from what was asked for: `oimppi_warp/planning/resolve.py` says where, and a record holds what took
effect.

This page is written by `python tools/settings_page.py`.
"""


def page() -> str:
    """Return the content of the page."""
    config = Config()
    groups: dict[str, list[Setting]] = {}
    for name, setting in settings_of(config).items():
        groups.setdefault(name.rpartition(".")[0], []).append(setting)
    parts = [INTRO, _table(groups.pop(""))]
    for group, settings in groups.items():
        parts += [f"## `{group}`\n\n{_group_help(group)}", _table(settings)]
    parts += _other_optimizers(config)
    old = [(f"`{name}`", f"`{now}`") for name, now in SETTINGS.items()]
    parts += [
        "## Old names\n\nStill accepted, in commands, suites and records, with everything below them.",
        _rows(("old", "present"), old),
    ]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def _group_help(group: str) -> str:
    """Returns the help of a nested group, by its dotted name."""
    owner: Any = Config()
    *outer, last = group.split(".")
    for name in outer:
        owner = getattr(owner, name)
    return next(about(item).text for item in fields(owner) if item.name == last)


def _other_optimizers(config: Config) -> list[str]:
    """Returns a table of the settings that each optimizer other than the default one adds."""
    parts = []
    for kind in OPTIMIZERS:
        found = settings_of(set_option(config, f"robot.optimizer={kind}"))
        own = [setting for name, setting in found.items() if name not in settings_of(config)]
        if own:
            title = f"## With `robot.optimizer={kind}`, and the same with `object.optimizer={kind}`"
            doc = "These come in place of those of `mppi` that it does not have; what both have is kept."
            parts += [f"{title}\n\n{doc}", _table(own)]
    return parts


def _table(settings: Iterable[Setting]) -> str:
    return _rows(
        HEAD,
        [(f"`{s.name}`", f"`{_value(s.value)}`", s.about.unit or "-", s.allowed, s.about.text) for s in settings],
    )


def _value(value: object) -> str:
    """Formats a value as `--set` accepts it."""
    if isinstance(value, tuple):
        return ",".join(map(_value, value))
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)


def _rows(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    return "\n".join("| " + " | ".join(row) + " |" for row in (head, ("---",) * len(head), *rows))


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
