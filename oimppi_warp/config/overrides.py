"""Functions that list settings by name, change one from text, read them from a record, and validate them."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import lru_cache
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from oimppi_warp.config.fields import About, ExtraWeights, about
from oimppi_warp.config.renamed import ADDED, present_name
from oimppi_warp.config.settings import Config, RobotCost, Sampling, check_order
from oimppi_warp.errors import ConfigError
from oimppi_warp.registries import COST_TERMS, OPTIMIZERS

T = TypeVar("T")


@dataclass(frozen=True)
class Setting:
    """A setting and its current value.

    Attributes:
        name: Dotted name, such as ``"robot.optimizer.samples"``.
        value: Current value; for an optimizer, the name of its kind.
        kind: Type: bool, int, float, a tuple of them, or a ``Literal`` of strings.
        about: Help, unit and bounds of the setting.
    """

    name: str
    value: Any
    kind: Any
    about: About

    @property
    def help(self) -> str:
        """Returns the description, followed by the unit in square brackets unless the setting is dimensionless."""
        return f"{self.about.text} [{self.about.unit}]" if self.about.unit else self.about.text

    @property
    def allowed_with_unit(self) -> str:
        """Returns :attr:`allowed`, followed by the unit in square brackets unless the setting is dimensionless."""
        return f"{self.allowed} [{self.about.unit}]" if self.about.unit else self.allowed

    @property
    def allowed(self) -> str:
        """Returns a description of the allowed values: their type and, for numbers, their bounds."""
        if get_origin(self.kind) is Literal or self.kind is bool:
            return _described(self.kind)
        each = "each " if get_origin(self.kind) is tuple else ""
        return f"{_described(self.kind)}, {each}{_range(self.about.low, self.about.high)}"


def settings_of(config: Any) -> dict[str, Setting]:
    """Returns every setting of a config by dotted name.

    An optimizer is listed as a setting of its own, whose value is the name of its kind, and with the settings of this
    kind.

    Args:
        config: A ``Config``, or one of the dataclasses nested in it.

    Raises:
        TypeError: A field was not made with :func:`oimppi_warp.config.fields.setting`.
    """
    return {setting.name: setting for setting in _walk(config, "")}


def options(config: Any) -> dict[str, Any]:
    """Returns the values of :func:`settings_of`, e.g. ``{"control_period": 0.05, "robot.optimizer": "mppi", ...}``."""
    return {name: setting.value for name, setting in settings_of(config).items()}


def extra_weights(cost: RobotCost) -> ExtraWeights:
    """Returns the weight of every cost term from outside the package: that in ``cost.extra``, or the term's default."""
    return ExtraWeights({name: float(term.weight) for name, term in COST_TERMS.loadable()} | dict(cost.extra))


def effective_weights(cost: RobotCost) -> ExtraWeights:
    """Returns :func:`extra_weights` without zero weights.

    A zero weight remains if it turns off a term whose default weight is not zero.
    """
    of_itself = {name for name, term in COST_TERMS.loadable() if term.weight != 0.0}
    return ExtraWeights({name: w for name, w in extra_weights(cost).items() if w != 0.0 or name in of_itself})


def set_option(config: T, assignment: str) -> T:
    """Returns a config with one setting changed, e.g. ``"cost.w_align=2"`` or ``"robot.optimizer.samples=512"``.

    Tuples are written with commas, ``"cost.push_ring=0.2,0.6"``. ``"robot.optimizer=cem"`` selects another optimizer,
    which keeps the settings that all optimizers have, such as samples and horizon. Names
    of earlier versions are accepted (:mod:`oimppi_warp.config.renamed`). Only the type and the bounds of the value are
    checked here; once all settings have their values, :func:`validate` checks that they are consistent.

    Args:
        config: The config, which remains unchanged.
        assignment: ``NAME=VALUE`` with the dotted name of the setting.

    Raises:
        ConfigError: The name is unknown (the message suggests the nearest), or the value has the wrong type or is out
            of bounds.
    """
    given, equals, text = (part.strip() for part in assignment.partition("="))
    if not equals:
        raise ConfigError(f"--set {assignment}: the value is missing\n  allowed: NAME=VALUE, e.g. cost.w_align=2")
    name = present_name(given)
    known = settings_of(config)
    if name not in known:
        raise ConfigError(_unknown("--set", given, config, list(known)))

    def read(kind: Any) -> Any:
        try:
            return _parsed(kind, text)
        except ValueError:
            raise ConfigError(
                f"--set {given}={text}: the value is invalid\n  allowed: {known[name].allowed_with_unit}"
            ) from None

    return _changed(config, name.split("."), known[name], read)


def from_record(record: Mapping[str, Any]) -> Config:
    """Reads settings from a record's JSON, the inverse of :func:`oimppi_warp.record.log.to_json` of a ``Config``.

    Names of earlier versions are converted. Settings that the record does not have get the value with the effect of an
    earlier version (:data:`oimppi_warp.config.renamed.ADDED`), or else the default of ``Config``.

    Args:
        record: The settings as nested dictionaries.

    Raises:
        ConfigError: The record has a setting that does not exist, or a value of the wrong type or out of bounds.
    """
    labels = {item.name for item in fields(Config) if not about(item).option}
    config = replace(Config(), **{name: record[name] for name in labels if name in record})
    recorded = {present_name(name): value for name, value in _flat(record, "") if name not in labels}
    values = {**ADDED, **recorded}
    values = {name.removesuffix(".kind"): value for name, value in values.items()}
    # The kind determines which settings an optimizer has, so it comes first.
    for name in sorted(values, key=lambda name: name.count(".")):
        known = settings_of(config)
        if name.startswith("cost.extra.") and name not in known:
            cost = replace(config.cost, extra={**config.cost.extra, name.removeprefix("cost.extra."): values[name]})
            config = replace(config, cost=cost)
            continue
        if name not in known:
            raise ConfigError(_unknown("record:", name, config, list(known)))

        def read(kind: Any, setting: Setting = known[name]) -> Any:
            try:
                return _cast(kind, values[setting.name])
            except (TypeError, ValueError):
                raise ConfigError(
                    f"record: {setting.name} = {values[setting.name]!r}: the value is invalid\n"
                    f"  allowed: {setting.allowed_with_unit}"
                ) from None

        config = _changed(config, name.split("."), known[name], read)
    return config


def changed(config: Config, default: Config) -> dict[str, Any]:
    """Returns the settings of ``config`` that differ from ``default``, by dotted name, with the values of ``default``.

    If an optimizer is of another kind than in ``default``, its settings are compared with those that ``default`` has
    after a change to the same kind.
    """
    wanted = default
    for name, setting in settings_of(config).items():
        if name in _OPTIMIZERS and setting.value != options(wanted)[name]:
            wanted = set_option(wanted, f"{name}={setting.value}")
    now, usual = options(config), options(wanted) | {name: options(default)[name] for name in _OPTIMIZERS}
    return {name: usual[name] for name in now if now[name] != usual[name]}


_OPTIMIZERS = ("robot.optimizer", "object.optimizer")


def validate(config: Config) -> Config:
    """Validates a config and returns it unchanged.

    Raises:
        ConfigError: A value is out of bounds, two values contradict each other, or an optimizer or a cost term with a
            nonzero weight is not registered.
    """
    for name in _OPTIMIZERS:
        settings = getattr(config, name.partition(".")[0]).optimizer
        OPTIMIZERS.check(settings.kind)
        settings.check(name)
    for name, weight in config.cost.extra.items():
        if weight != 0.0:
            COST_TERMS.check(name)
    for setting in _walk(config, ""):
        _check(setting, setting.value)
    check_order("cost.push_ring", config.cost.push_ring)
    check_order("object_cost.push_ring", config.object_cost.push_ring)
    return config


def _walk(config: Any, prefix: str) -> Iterator[Setting]:
    """Yields the settings in a dataclass and in those nested in it, with ``prefix`` before their names."""
    types = _types(type(config))
    for item in fields(config):
        value, said, name = getattr(config, item.name), about(item), f"{prefix}{item.name}"
        if not said.option:
            continue
        if isinstance(value, Sampling):
            yield Setting(name, value.kind, OPTIMIZERS.choice(), said)
        if isinstance(value, Mapping):
            yield from (_extra(term, weight, f"{name}.{term}") for term, weight in extra_weights(config).items())
        elif is_dataclass(value):
            yield from _walk(value, f"{name}.")
        else:
            yield Setting(name, value, types[item.name], said)


def _extra(term: str, weight: float, name: str) -> Setting:
    """Returns the setting for the weight of a cost term from outside the package."""
    text = COST_TERMS[term].about if term in COST_TERMS else "Weight of a cost term that is not registered."
    return Setting(name, weight, float, About(text))


@lru_cache
def _types(kind: type) -> dict[str, Any]:
    """Returns the types of a dataclass's fields."""
    return get_type_hints(kind)


def _changed(config: Any, path: list[str], setting: Setting, read: Callable[[Any], Any]) -> Any:
    """Returns ``config`` with the setting at ``path`` replaced by the checked result of ``read`` for its type."""
    head, *rest = path
    value = getattr(config, head)
    if isinstance(value, Mapping):
        found = read(setting.kind)
        _check(setting, found)
        value = ExtraWeights({**value, ".".join(rest): found})
    elif rest:
        value = _changed(value, rest, setting, read)
    elif isinstance(value, Sampling):
        value = _of_kind(read(str), value, setting.name)
    else:
        value = read(setting.kind)
        _check(setting, value)
    return replace(config, **{head: value})


def _of_kind(kind: str, before: Sampling, name: str) -> Sampling:
    """Returns the settings of another kind of optimizer, keeping those that all kinds have."""
    if kind == before.kind:
        return before
    try:
        settings = OPTIMIZERS.get_checked(kind).Settings
    except ConfigError as error:
        raise ConfigError(f"{name}={kind}: {error}") from None
    if not issubclass(settings, Sampling):
        raise ConfigError(
            f"{name}={kind}: the Settings class of this optimizer, {settings.__name__}, is not derived from Sampling\n"
            "  to do:   derive the class from oimppi_warp.config.settings.Sampling"
        )
    common: dict[str, Any] = {item.name: getattr(before, item.name) for item in fields(Sampling)}
    return settings(**{**common, "kind": kind})


def _check(setting: Setting, value: Any) -> None:
    """Raises ConfigError for a number outside its bounds, or a string that is not allowed."""
    if get_origin(setting.kind) is Literal and value not in get_args(setting.kind):
        raise ConfigError(f"{setting.name} = {value} cannot be used\n  allowed: {setting.allowed}")
    low, high = setting.about.low, setting.about.high
    numbers = value if isinstance(value, tuple) else (value,)
    for number in numbers:
        if isinstance(number, float | int) and not (low <= number <= high and math.isfinite(number)):
            finite = "" if math.isfinite(number) or math.isfinite(high) else ", finite"
            raise ConfigError(
                f"{setting.name} = {number:g} cannot be used\n  allowed: {setting.allowed_with_unit}{finite}"
            )


def _range(low: float, high: float) -> str:
    """Describes bounds: ``0 to 1``, or ``>= 0`` if the upper bound is infinite."""
    bounds = [f"{bound:.0f}" if 1e6 <= bound < math.inf else f"{bound:g}" for bound in (low, high)]
    return " to ".join(bounds) if math.isfinite(high) else f">= {bounds[0]}"


def _flat(record: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    """Yields the entries of nested dictionaries by dotted names."""
    for name, value in record.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _unknown(where: str, name: str, config: Any, known: list[str]) -> str:
    """Returns the message for an unknown setting, with the closest names by the whole name and by its last part.

    Args:
        where: Beginning of the message, before the name: ``"--set"`` or ``"record:"``.
        name: The unknown name.
        config: The config in which it was looked up.
        known: The names of all its settings.
    """
    present = present_name(name)
    for group in _OPTIMIZERS:
        if present.startswith(f"{group}.") and group in known:
            present_kind = options(config)[group]
            own = ", ".join(other for other in known if other.startswith(f"{group}."))
            near = difflib.get_close_matches(present, known, n=1, cutoff=0.75)
            hint = f"did you mean {near[0]}? Otherwise, " if near else ""
            return (
                f"{where} {name}: the optimizer {present_kind} has no such setting\n  allowed: {own}\n"
                f"  to do:   {hint}select the optimizer that has this setting first, with {group}=NAME"
            )
    leaf = name.rpartition(".")[2]
    same_leaf = [other for other in known if other.rpartition(".")[2] == leaf]
    near_leaf = difflib.get_close_matches(leaf, {other.rpartition(".")[2] for other in known}, n=1)
    near = same_leaf or difflib.get_close_matches(name, known, n=3, cutoff=0.75)
    near = near or [other for other in known if other.rpartition(".")[2] in near_leaf]
    hint = f"did you mean {' or '.join(near)}?" if near else "choose a setting from the list in docs/settings.md"
    return f"{where} {name}: the setting does not exist\n  to do:   {hint}"


def _parsed(kind: Any, text: str) -> Any:
    """Parses ``text`` as a value of the type ``kind``; raises ValueError if the text is no such value."""
    if get_origin(kind) is Literal:
        if text not in get_args(kind):
            raise ValueError(text)
        return text
    if get_origin(kind) is tuple:
        parts = text.strip("()[] ").split(",")
        return tuple(_parsed(part_kind, part.strip()) for part_kind, part in zip(get_args(kind), parts, strict=True))
    if kind is bool:
        if text.lower() not in _TRUTH:
            raise ValueError(text)
        return _TRUTH[text.lower()]
    return kind(text)


def _cast(kind: Any, value: Any) -> Any:
    """Converts a value from JSON to the type ``kind``; raises TypeError or ValueError if that is not possible."""
    if get_origin(kind) is tuple:
        return tuple(_cast(part_kind, part) for part_kind, part in zip(get_args(kind), value, strict=True))
    if get_origin(kind) is Literal or kind is str:
        return _parsed(kind, value) if isinstance(value, str) else _parsed(int, value)
    if isinstance(value, bool) != (kind is bool) or not isinstance(value, int | float) or kind(value) != value:
        raise ValueError(value)
    return kind(value)


_TRUTH = {"true": True, "1": True, "false": False, "0": False}


def _described(kind: Any) -> str:
    """Describes the type ``kind``."""
    if get_origin(kind) is Literal:
        *others, last = get_args(kind)
        return f"{', '.join(others)} or {last}" if others else last
    if get_origin(kind) is tuple:
        return f"{len(get_args(kind))} comma-separated numbers"
    return {bool: "true or false", int: "integer", float: "number"}[kind]
