"""A suite: which tasks, methods and starts to try, with which settings, as a TOML file that a person can copy.

The keys of :class:`Entry` may stand at the top of the file, and again in each ``[[entry]]``, where they count for that
entry only. A file without entries is one entry.
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from oimppi_warp.errors import ConfigError
from oimppi_warp.presets import PRESETS
from oimppi_warp.registries import METHODS
from oimppi_warp.task import make_config

SUITES = Path(__file__).parent / "suites"
"""Where the shipped suites are."""

ENGINES = ("quasistatic", "newton")
"""Engines that a suite may name: ``auto`` is left out, because it depends on how busy the machine is."""

MODES = ("lockstep", "realtime")
"""Whether the plant waits for the planner, or not."""

PLANTS = ("ideal", "lab")
"""The plant as it is, or with the lab's imperfections."""

MOST = 10_000
"""Trials of a task and method at the most; the seeds of trials are this far apart from suite seed to suite seed."""


@dataclass(frozen=True)
class Entry:
    """Some tasks with some methods, all with the same settings.

    Attributes:
        tasks: Names of shipped scenes, or USD files (a relative path counts from the suite's file).
        methods: Who plans.
        trials: Starts of each task: the scene's own first, then drawn ones.
        preset: Settings to begin with.
        engine: What rolls samples out.
        device: Where the planner computes; another device gives other results.
        threads: Of a planner on the CPU; they change no result, only how long plans take.
        seed: From which the seeds of all trials come.
        set: Changes of settings, ``NAME=VALUE``.
        max_sim_seconds: Time limit of an episode [simulated s], if another than the preset's.
        mode: ``lockstep``, or ``realtime``: trials that run against the clock run one at a time.
        plant: ``ideal`` or ``lab``.
        label: Tells entries with the same tasks and methods apart: it is put behind the task's name.
    """

    tasks: tuple[str, ...] = ()
    methods: tuple[str, ...] = tuple(METHODS)
    trials: int = 10
    preset: str = "best"
    engine: str = "quasistatic"
    device: str = "cpu"
    threads: int = 1
    seed: int = 0
    set: tuple[str, ...] = ()
    max_sim_seconds: float | None = None
    mode: str = "lockstep"
    plant: str = "ideal"
    label: str = ""


@dataclass(frozen=True)
class Suite:
    """A suite of trials.

    Attributes:
        name: The file's stem.
        title: One line about it.
        file: Where it was read from.
        entries: What is tried.
    """

    name: str
    title: str
    file: Path
    entries: tuple[Entry, ...]

    def changed(self, **changes: Any) -> Suite:
        """The suite with the same changes in all entries; those that are ``None`` are left out."""
        wanted = {name: value for name, value in changes.items() if value is not None}
        suite = replace(self, entries=tuple(replace(entry, **wanted) for entry in self.entries))
        _check_settings(suite)
        return suite

    def assigned(self, assignments: tuple[str, ...]) -> Suite:
        """The suite with settings (``NAME=VALUE``) changed in all entries, after their own."""
        suite = replace(self, entries=tuple(replace(each, set=(*each.set, *assignments)) for each in self.entries))
        _check_settings(suite)
        return suite

    def only(self, *, tasks: tuple[str, ...] = (), methods: tuple[str, ...] = ()) -> Suite:
        """The part of the suite with these tasks and methods; an empty tuple means all.

        Raises:
            ConfigError: The suite has no such task or method.
        """
        for option, wanted, present in (
            ("--tasks", tasks, [task for entry in self.entries for task in entry.tasks]),
            ("--methods", methods, [method for entry in self.entries for method in entry.methods]),
        ):
            for name in wanted:
                if name not in present:
                    allowed = ", ".join(dict.fromkeys(present))
                    raise ConfigError(f"{option} {name}: not in the suite {self.name}\n  allowed: {allowed}")
        kept = [
            replace(
                entry,
                tasks=tuple(task for task in entry.tasks if not tasks or task in tasks),
                methods=tuple(method for method in entry.methods if not methods or method in methods),
            )
            for entry in self.entries
        ]
        return replace(self, entries=tuple(entry for entry in kept if entry.tasks and entry.methods))


def shipped_suites() -> list[Suite]:
    """The suites that come with the package, in the order of their names."""
    return [load_suite(path) for path in sorted(SUITES.glob("*.toml"))]


def load_suite(suite: str | Path) -> Suite:
    """Read and check a suite.

    Args:
        suite: Name of a shipped suite, or a TOML file.

    Raises:
        ConfigError: There is none, or it cannot be run; the message says what is wrong and what is allowed.
    """
    file = _find(suite)
    try:
        found = tomllib.loads(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{file}: not a TOML file ({error})") from None
    except OSError as error:
        raise ConfigError(f"{file}: cannot be read ({error.strerror})") from None
    title = found.pop("title", file.stem)
    if not isinstance(title, str):
        raise ConfigError(f"{file}: title = {title!r}\n  allowed: text")
    tables = found.pop("entry", [{}])
    if not isinstance(tables, list) or not tables or not all(isinstance(table, dict) for table in tables):
        raise ConfigError(f"{file}: entry is no list of tables\n  allowed: [[entry]], with its keys below it")
    common = _values(found, f"{file}: ")
    entries = []
    for number, table in enumerate(tables):
        where = f"{file}: " if len(tables) == 1 else f"{file}, entry {number + 1}: "
        entry = Entry(**(common | _values(table, where)))
        if not entry.tasks:
            fix = 'tasks = ["task01", "task02"]'
            raise ConfigError(f"{where}no tasks\n  to do:   name some at the top or in the entry: {fix}")
        entries.append(entry)
    made = Suite(file.stem, title, file, tuple(entries))
    _check_settings(made)
    return made


def _check_settings(suite: Suite) -> None:
    """Raise ConfigError for settings that no planner can be made from."""
    for entry in suite.entries:
        for method in entry.methods:
            try:
                make_config(entry.preset, method, assignments=entry.set, max_sim_seconds=entry.max_sim_seconds)
            except ConfigError as error:
                raise ConfigError(f"{suite.file}, {method} on {', '.join(entry.tasks)}: {error}") from None


def _find(suite: str | Path) -> Path:
    names = [path.stem for path in sorted(SUITES.glob("*.toml"))]
    if str(suite) in names:
        return SUITES / f"{suite}.toml"
    file = Path(suite).expanduser()
    if file.is_file():
        return file.resolve()
    near = difflib.get_close_matches(file.stem, names, n=1, cutoff=0.5)
    hint = (
        f"did you mean {near[0]}?" if near else "`oimppi bench` without a name lists them; docs/bench.md has the keys"
    )
    raise ConfigError(
        f"{suite}: no such suite\n  allowed: a TOML file, or one of {', '.join(names)}\n  to do:   {hint}"
    )


def _texts(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(item, str) for item in value)


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _whole(low: int, high: int) -> tuple[Callable[[Any], bool], str]:
    def fits(value: Any) -> bool:
        return isinstance(value, int) and not isinstance(value, bool) and low <= value <= high

    return fits, f"a whole number from {low} to {high}"


def _one_of(names: Any) -> tuple[Callable[[Any], bool], str]:
    return lambda value: isinstance(value, str) and value in names, " or ".join(f'"{name}"' for name in names)


_JOINTS = str.maketrans("", "", "_-")

_METHODS = tuple(METHODS)
_KEYS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "tasks": (lambda value: _texts(value) and bool(value), 'a list of scenes, like ["task01", "my_task.usda"]'),
    "methods": (
        lambda value: _texts(value) and bool(value) and set(value) <= set(_METHODS),
        f"a list out of {', '.join(_METHODS)}",
    ),
    "trials": _whole(1, MOST),
    "preset": _one_of(PRESETS),
    "engine": _one_of(ENGINES),
    "device": (lambda value: isinstance(value, str), '"cpu", "cuda:0", ... or "auto"'),
    "threads": _whole(1, 1024),
    "seed": _whole(0, 100_000),
    "set": (_texts, 'a list of settings, like ["robot.optimizer.samples=512"]'),
    "max_sim_seconds": (lambda value: _number(value) and value > 0, "a number of seconds above zero"),
    "mode": _one_of(MODES),
    "plant": _one_of(PLANTS),
    "label": (lambda value: isinstance(value, str) and value.translate(_JOINTS).isalnum(), "letters, digits, _ and -"),
}
"""For each key: whether a value may stand there, and what is allowed."""

assert _KEYS.keys() == {field.name for field in fields(Entry)}


def check_value(key: str, value: Any, where: str) -> None:
    """Raise ConfigError where a value cannot stand at a key; ``where`` comes first in the message."""
    fits, allowed = _KEYS[key]
    if not fits(value):
        raise ConfigError(f"{where}{key} = {value!r}: cannot be used\n  allowed: {allowed}")


def _values(table: dict[str, Any], where: str) -> dict[str, Any]:
    """The keys of a table as values of an entry."""
    for key, value in table.items():
        if key not in _KEYS:
            near = difflib.get_close_matches(key, [*_KEYS, "title", "entry"], n=1)
            hint = f"\n  to do:   did you mean {near[0]}?" if near else ""
            raise ConfigError(f"{where}{key}: no such key\n  allowed: title, entry, {', '.join(_KEYS)}{hint}")
        check_value(key, value, where)
    return {key: tuple(value) if isinstance(value, list) else value for key, value in table.items()}
