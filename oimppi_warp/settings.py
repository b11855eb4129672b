"""Settings by their names: listing them, changing one from text, and what is allowed."""

from __future__ import annotations

import difflib
import inspect
import math
import re
from dataclasses import fields, is_dataclass, replace
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from oimppi_warp.config import Config
from oimppi_warp.errors import ConfigError

T = TypeVar("T")


def options(config: Any) -> dict[str, Any]:
    """Every setting by its dotted name, e.g. ``{"control_period": 0.05, "robot.optimizer.samples": 1200, ...}``."""
    found: dict[str, Any] = {}
    for item in fields(config):
        value = getattr(config, item.name)
        if is_dataclass(value):
            found |= {f"{item.name}.{name}": inner for name, inner in options(value).items()}
        elif item.name != "preset":
            found[item.name] = value
    return found


def descriptions(config: Any) -> dict[str, str]:
    """What each setting of :func:`options` is, from the docstrings of the dataclasses."""
    found: dict[str, str] = {}
    about = _attributes(inspect.getdoc(type(config)) or "")
    for item in fields(config):
        value = getattr(config, item.name)
        if is_dataclass(value):
            found |= {f"{item.name}.{name}": text for name, text in descriptions(value).items()}
        elif item.name != "preset":
            found[item.name] = about.get(item.name, "")
    return found


def kinds(config: Any) -> dict[str, Any]:
    """The type of each setting of :func:`options`."""
    found: dict[str, Any] = {}
    types = get_type_hints(type(config))
    for item in fields(config):
        value = getattr(config, item.name)
        if is_dataclass(value):
            found |= {f"{item.name}.{name}": kind for name, kind in kinds(value).items()}
        elif item.name != "preset":
            found[item.name] = types[item.name]
    return found


def _attributes(text: str) -> dict[str, str]:
    """The entries below ``Attributes:`` in a docstring."""
    found: dict[str, str] = {}
    _, _, entries = text.partition("Attributes:\n")
    for entry in re.split(r"\n(?=    \w)", "\n" + entries):
        names, colon, about = entry.strip().partition(":")
        if colon:
            found |= {name.strip(): " ".join(about.split()) for name in names.split(",")}
    return found


def bounds_of(name: str) -> tuple[float, float]:
    """Smallest and largest value of a setting by its dotted name."""
    return _BOUNDS.get(name.rpartition(".")[2], (0, math.inf))


def set_option(config: T, assignment: str) -> T:
    """A copy of ``config`` with one setting changed, e.g. ``"cost.w_align=2"`` or ``"robot.optimizer.samples=512"``.

    Tuples are written with commas, ``"cost.reach=0.2,0.6"``. The value is checked on its own; :func:`validate` checks
    the settings against each other, once all are set.

    Raises:
        ConfigError: The name is unknown (the message suggests the nearest) or the value has another type or is out of
            bounds.
    """
    name, equals, text = (part.strip() for part in assignment.partition("="))
    if not equals:
        raise ConfigError(f"--set {assignment!r}: no value\n  allowed: NAME=VALUE, e.g. cost.w_align=2")
    known = options(config)
    if name not in known:
        raise ConfigError(_unknown(name, list(known)))
    return _replaced(config, name.split("."), text, name)


def validate(config: Config) -> Config:
    """``config`` itself, if a planner can be made from it.

    Raises:
        ConfigError: A value is out of bounds, or two of them contradict each other.
    """
    known = options(config)
    for name, value in known.items():
        _check_bounds(name, value)
    for level in ("robot", "object"):
        knots, horizon = known[f"{level}.optimizer.knots"], known[f"{level}.optimizer.horizon"]
        if knots == 1 or knots > horizon:
            raise ConfigError(
                f"{level}.optimizer.knots = {knots}: no such spline over a horizon of {horizon} steps\n"
                f"  allowed: 0 (noise drawn for every step) or 2 to {horizon}"
            )
    for name in ("robot.optimizer.effective_samples", "object.optimizer.effective_samples", "cost.reach", "object_cost.reach"):
        low, high = known[name]
        if low > high:
            raise ConfigError(f"{name} = {low:g},{high:g}: the lower bound is above the upper one")
    return config


_BOUNDS: dict[str, tuple[float, float]] = {
    "samples": (2, 1_000_000),
    "horizon": (1, 10_000),
    "iterations": (1, 1_000),
    "contact_steps": (1, 1_000),
    "substeps": (1, 1_000),
    "draws": (0, 1_000),
    "tail": (0, 1),
    "plan_steps": (1, 100_000),
    "temperature": (1e-6, math.inf),
    "effective_samples": (0, 1),
    "control_period": (0.001, 1.0),
    "joint_velocity_limit": (1e-3, math.inf),
    "speed_limit": (1e-3, math.inf),
    "max_sim_seconds": (0.001, math.inf),
    "gamma_0": (-1, 1),
    "rate": (0.01, 100.0),
    "outlier_probability": (0, 1),
    "camera": (-100.0, 100.0),
    "acceleration_limit": (0.1, math.inf),
    "gate": (0.1, math.inf),
    "memory": (0.05, 5.0),
    "topple_near": (1e-3, math.inf),
}
"""Smallest and largest value by the name of the field; everything else is finite and not negative."""


def _check_bounds(name: str, value: Any) -> None:
    """Raise ConfigError for a number outside its bounds; text passes."""
    low, high = bounds_of(name)
    numbers = value if isinstance(value, tuple) else (value,)
    for number in numbers:
        if isinstance(number, float | int) and not (low <= number <= high and math.isfinite(number)):
            to = f"to {high:g}" if math.isfinite(high) else "or more (finite)"
            raise ConfigError(f"{name} = {number:g} cannot be used\n  allowed: {low:g} {to}")


def _unknown(name: str, known: list[str]) -> str:
    """What to say about a setting that does not exist: the nearest names, by the whole and by the last part."""
    leaf = name.rpartition(".")[2]
    same_leaf = [other for other in known if other.rpartition(".")[2] == leaf]
    near_leaf = difflib.get_close_matches(leaf, {other.rpartition(".")[2] for other in known}, n=1)
    near = same_leaf or difflib.get_close_matches(name, known, n=3, cutoff=0.75)
    near = near or [other for other in known if other.rpartition(".")[2] in near_leaf]
    hint = f"did you mean {' or '.join(near)}?" if near else f"one of {', '.join(known)}"
    return f"--set {name}: no such setting\n  to do:   {hint}"


def _replaced(config: Any, path: list[str], text: str, name: str) -> Any:
    """``config`` with the field at ``path`` parsed from ``text``."""
    head, *rest = path
    if rest:
        value = _replaced(getattr(config, head), rest, text, name)
    else:
        kind = get_type_hints(type(config))[head]
        try:
            value = _parsed(kind, text)
        except ValueError:
            raise ConfigError(f"--set {name}={text}: not a value for it\n  allowed: {_described(kind)}") from None
        _check_bounds(name, value)
    return replace(config, **{head: value})


def _parsed(kind: Any, text: str) -> Any:
    """``text`` as a value of the type ``kind``; ValueError if it is none."""
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


_TRUTH = {"true": True, "1": True, "false": False, "0": False}


def _described(kind: Any) -> str:
    """The type ``kind`` in words."""
    if get_origin(kind) is Literal:
        return " or ".join(get_args(kind))
    if get_origin(kind) is tuple:
        return f"{len(get_args(kind))} numbers with commas between them"
    return {bool: "true or false", int: "a whole number", float: "a number"}[kind]
