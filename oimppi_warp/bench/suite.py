"""Benchmark suites: the tasks, methods, starts and settings to run, in a TOML file that users can copy and edit.

Keys can be given at the top of the file, and again in each ``[[entry]]``, where they apply to that entry only. A file
without entries is one entry. The keys are the fields of :class:`Entry`, those of its run options and those of its
settings; `docs/bench.md` lists them.
"""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from oimppi_warp.config.presets import PRESETS
from oimppi_warp.config.run_spec import LARGEST_SEED, MODES, RunSpec
from oimppi_warp.errors import ConfigError
from oimppi_warp.plants.factory import starts_itself
from oimppi_warp.record.log import flatten, to_json
from oimppi_warp.registries import ENGINES, METHODS, PLANTS
from oimppi_warp.runtime.request import TOLERANCE_LIMITS, SettingsRequest, is_tolerance
from oimppi_warp.suggestions import did_you_mean, did_you_mean_file

SUITES = Path(__file__).parent / "suites"
"""Folder of the shipped suites."""

MOST_TRIALS = 10_000
"""Maximum number of trials per task and method in one suite."""

NUMBERS = 1_000_000
"""Trial numbers range from 0 to one less than this."""

RUN = RunSpec(engine="quasistatic", device="cpu", threads=1)
"""Default options of a run; the same on every machine."""

SETTINGS = SettingsRequest()
"""Default settings."""


@dataclass(frozen=True)
class Entry:
    """Several tasks with several methods, all with the same options and settings.

    Attributes:
        tasks: Names of shipped scenes, or USD files (paths are relative to the suite's file).
        methods: Names of methods; by default all registered ones.
        trials: Number of trials per task and method.
        first: Number of the first trial. The lowest numbers use the scene's own starts; all other starts are drawn.
        beside: If given, all starts are drawn at this distance from an obstacle or the robot's base, from and to [m].
        run: Options of all runs. Its seed is the one from which the trials' seeds are derived, its method is replaced
            by each of ``methods``; its engine is never ``"auto"``, which depends on the load of the machine.
        settings: Settings of all runs.
        label: Suffix to the task's name that distinguishes entries with the same tasks and methods.
    """

    tasks: tuple[str, ...] = ()
    methods: tuple[str, ...] = field(default_factory=lambda: tuple(METHODS))
    trials: int = 10
    first: int = 0
    beside: tuple[float, float] | None = None
    run: RunSpec = RUN
    settings: SettingsRequest = SETTINGS
    label: str = ""

    @property
    def numbers(self) -> range:
        """Returns the trial numbers of each task and method."""
        return range(self.first, self.first + self.trials)

    def changed(self, values: Mapping[str, Any]) -> Entry:
        """Returns the entry with other values for some keys (those of a suite's file)."""
        values = {_FIELDS.get(key, key): value for key, value in values.items()}

        def part(of: Any) -> dict[str, Any]:
            return {item.name: values[item.name] for item in fields(of) if item.name in values}

        run, settings = replace(self.run, **part(self.run)), replace(self.settings, **part(self.settings))
        return replace(self, **part(self), run=run, settings=settings)

    def row(self) -> dict[str, Any]:
        """Returns the entry as it would appear in a file, in JSON types."""
        names = {name: key for key, name in _FIELDS.items()}
        found = {names.get(name, name): value for name, value in flatten(self).items()}
        del found["method"]
        return to_json(found)


_FIELDS = {"set": "assignments"}
"""Keys of a suite's file whose field has a different name."""


@dataclass(frozen=True)
class Published:
    """A result that others published for the same tasks; the report shows it below ours.

    Attributes:
        name: Name of the method.
        source: Publication, and the conditions that differ.
        success: Success rate, from 0 to 1; NaN if it is not given.
        scores: Means over the episodes of their largest scores, by the names that the plant gives them.
    """

    name: str
    source: str
    success: float = math.nan
    scores: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Suite:
    """A suite of trials.

    Attributes:
        name: The file's stem.
        title: One-line description.
        file: File that it was read from.
        entries: Entries of the suite.
        note: Remark for the report.
        published: Results that others published.
    """

    name: str
    title: str
    file: Path
    entries: tuple[Entry, ...]
    note: str = ""
    published: tuple[Published, ...] = ()

    def changed(self, **changes: Any) -> Suite:
        """Returns the suite with other values for some keys in all entries; values of ``None`` are ignored.

        Raises:
            ConfigError: The suite cannot be run with these values.
        """
        wanted = {name: value for name, value in changes.items() if value is not None}
        return self._checked(entry.changed(wanted) for entry in self.entries)

    def assigned(self, assignments: tuple[str, ...]) -> Suite:
        """Returns the suite with settings (``NAME=VALUE``) changed in all entries, overriding their own.

        Raises:
            ConfigError: There is no such setting, or the value is not allowed for it.
        """
        return self._checked(
            entry.changed({"set": (*entry.settings.assignments, *assignments)}) for entry in self.entries
        )

    def only(self, *, tasks: tuple[str, ...] = (), methods: tuple[str, ...] = ()) -> Suite:
        """Returns the part of the suite with the given tasks and methods; an empty tuple selects all.

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
                    spaces = "\n  to do:   put spaces between names, not commas" if "," in name else ""
                    raise ConfigError(
                        f"{option} {name}: not part of the suite {self.name}\n  allowed: {allowed}{spaces}"
                    )
        kept = [
            replace(
                entry,
                tasks=tuple(task for task in entry.tasks if not tasks or task in tasks),
                methods=tuple(method for method in entry.methods if not methods or method in methods),
            )
            for entry in self.entries
        ]
        return replace(self, entries=tuple(entry for entry in kept if entry.tasks and entry.methods))

    def _checked(self, entries: Iterable[Entry]) -> Suite:
        suite = replace(self, entries=tuple(entries))
        _check(suite)
        return suite


def shipped_suites() -> list[Suite]:
    """Returns the suites shipped with the package, ordered by name."""
    return [load_suite(path) for path in sorted(SUITES.glob("*.toml"))]


def load_suite(suite: str | Path) -> Suite:
    """Reads and checks a suite.

    Args:
        suite: Name of a shipped suite, or a TOML file.

    Raises:
        ConfigError: There is no such suite, or it cannot be run.
    """
    file = _find(suite)
    try:
        found = tomllib.loads(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{file}: not a TOML file ({error})") from None
    except OSError as error:
        raise ConfigError(f"{file}: cannot be read ({error.strerror})") from None
    title, note = found.pop("title", file.stem), found.pop("note", "")
    for key, text in (("title", title), ("note", note)):
        if not isinstance(text, str):
            raise ConfigError(f"{file}: {key} = {text!r}\n  allowed: text")
    published = _published(file, found.pop("published", []))
    tables = found.pop("entry", [{}])
    if not isinstance(tables, list) or not tables or not all(isinstance(table, dict) for table in tables):
        raise ConfigError(f"{file}: entry is not a list of tables\n  allowed: [[entry]], followed by its keys")
    for table in (found, *tables):
        if place := PLANTS.place(table.get("plant")):
            table["plant"] = f"{os.path.relpath(file.parent / place[0])}:{place[1]}"
            try:
                PLANTS.check(table["plant"])
            except ConfigError as error:
                raise ConfigError(f"{file}: {error}") from None
    common = _values(found, f"{file}: ", beside=("title", "note", "entry", "published"))
    entries = []
    for number, table in enumerate(tables):
        where = f"{file}: " if len(tables) == 1 else f"{file}, entry {number + 1}: "
        entry = Entry().changed(common | _values(table, where))
        if not entry.tasks:
            fix = 'tasks = ["task01", "task02"]'
            raise ConfigError(f"{where}no tasks\n  to do:   add some at the top of the file or in the entry: {fix}")
        entries.append(entry)
    made = Suite(file.stem, title, file, tuple(entries), note, published)
    _check(made)
    return made


def _published(file: Path, tables: Any) -> tuple[Published, ...]:
    """Reads the results that others published; raises ConfigError if one of them is not as :class:`Published` says."""
    found = []
    for table in tables if isinstance(tables, list) else [tables]:
        try:
            row = Published(**table)
        except TypeError:
            row = None
        if row is None or not (
            isinstance(row.name, str)
            and isinstance(row.source, str)
            and isinstance(row.scores, dict)
            and all(map(_number, [row.success, *row.scores.values()]))
        ):
            raise ConfigError(
                f"{file}: [[published]] = {table!r} cannot be used\n"
                "  allowed: name and source (text), success (0 to 1), scores (a table of numbers)"
            )
        found.append(row)
    return tuple(found)


def _check(suite: Suite) -> None:
    """Raises ConfigError for a combination of valid values from which no trials can be made."""
    for entry in suite.entries:
        where = f"{suite.file}, {', '.join(entry.tasks)}"
        if entry.numbers.stop > NUMBERS:
            raise ConfigError(
                f"{where}: the last trial would be number {entry.numbers.stop - 1}\n"
                f"  allowed: first + trials up to {NUMBERS}"
            )
        if entry.beside is not None and starts_itself(entry.run.plant):
            raise ConfigError(
                f"{where}: beside cannot be used with the plant {entry.run.plant}, which chooses the starts itself\n"
                "  to do:   remove one of the two"
            )
        for method in entry.methods:
            try:
                entry.settings.config(method)
            except ConfigError as error:
                raise ConfigError(f"{suite.file}, {method} on {', '.join(entry.tasks)}: {error}") from None


def _find(suite: str | Path) -> Path:
    names = [path.stem for path in sorted(SUITES.glob("*.toml"))]
    if str(suite) in names:
        return SUITES / f"{suite}.toml"
    file = Path(os.path.expanduser(suite))
    if file.is_file():
        return file.resolve()
    hint = did_you_mean_file(suite, names, [".toml"])
    hint = hint or "run `oimppi bench` to list the suites; see docs/bench.md for the keys"
    raise ConfigError(
        f"{suite}: no such suite\n  allowed: a TOML file, or one of {', '.join(names)}\n  to do:   {hint}"
    )


def _strings(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(item, str) for item in value)


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _integer(low: int, high: int) -> tuple[Callable[[Any], bool], str]:
    def fits(value: Any) -> bool:
        return isinstance(value, int) and not isinstance(value, bool) and low <= value <= high

    return fits, f"an integer from {low} to {high}"


def _one_of(names: Any, others: str = "") -> tuple[Callable[[Any], bool], str]:
    return lambda value: isinstance(value, str) and value in names, " or ".join(f'"{name}"' for name in names) + others


_JOINTS = str.maketrans("", "", "_-")


def _keys() -> dict[str, tuple[Callable[[Any], bool], str]]:
    """Returns, for each key, a test for valid values and a description of them."""
    return {
        "tasks": (lambda value: _strings(value) and bool(value), 'a list of scenes, like ["task01", "my_task.usda"]'),
        "methods": (
            lambda value: _strings(value) and bool(value) and all(name in METHODS for name in value),
            f"a list of names from {', '.join(METHODS)}",
        ),
        "trials": _integer(1, MOST_TRIALS),
        "first": _integer(0, NUMBERS - 1),
        "beside": (
            lambda value: (
                isinstance(value, list)
                and len(value) == 2
                and _number(value[0])
                and _number(value[1])
                and 0 <= value[0] < value[1] < 10
            ),
            "two distances below 10 m, the second larger, like [0.0005, 0.002]",
        ),
        "preset": _one_of(PRESETS),
        "engine": _one_of(ENGINES),
        "device": (lambda value: isinstance(value, str), '"cpu", "cuda:0", ... or "auto"'),
        "threads": _integer(1, 1024),
        "seed": _integer(0, LARGEST_SEED),
        "set": (_strings, 'a list of settings, like ["robot.optimizer.samples=512"]'),
        "max_sim_seconds": (lambda value: _number(value) and value > 0, "a time above zero, in seconds"),
        "tolerance": (
            lambda value: (
                isinstance(value, list) and len(value) == 2 and all(map(_number, value)) and is_tolerance(*value)
            ),
            f"position [m] and yaw [rad], {TOLERANCE_LIMITS}, like [0.005, 0.02]",
        ),
        "mode": _one_of(MODES),
        "plant": _one_of(PLANTS, " or FILE.py:NAME"),
        "plant_options": (
            lambda value: _strings(value) and all("=" in item for item in value),
            'a list of options of the plant, like ["damping=0.1"]',
        ),
        "friction": (lambda value: _number(value) and 0 < value <= 10, "a friction coefficient above 0, up to 10"),
        "knock": (
            lambda value: isinstance(value, list) and len(value) == 3 and all(_number(x) and x >= 0 for x in value),
            "time [s], force [N] and duration [s], like [5, 3, 0.3]",
        ),
        "label": (
            lambda value: isinstance(value, str) and value.translate(_JOINTS).isalnum(),
            "letters, digits, _ and -",
        ),
    }


def check_value(key: str, value: Any, where: str) -> None:
    """Checks the value of a key of a suite's file.

    Args:
        key: The key.
        value: Its value.
        where: Beginning of the error message.

    Raises:
        ConfigError: The value is not allowed for this key.
    """
    fits, allowed = _keys()[key]
    if not fits(value):
        raise ConfigError(f"{where}{key} = {value!r} cannot be used\n  allowed: {allowed}")


def _values(table: dict[str, Any], where: str, *, beside: tuple[str, ...] = ()) -> dict[str, Any]:
    """Checks the keys of a table, which may have others ``beside`` these, and converts its lists to tuples."""
    known = _keys()
    for key, value in table.items():
        if key not in known:
            allowed = [*beside, *known]
            near = did_you_mean(key, allowed)
            hint = f"\n  to do:   {near}" if near else ""
            raise ConfigError(f"{where}{key}: unknown key\n  allowed: {', '.join(allowed)}{hint}")
        check_value(key, value, where)
    return {key: tuple(value) if isinstance(value, list) else value for key, value in table.items()}
