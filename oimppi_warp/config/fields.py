"""Fields of the settings dataclasses, with help, unit and bounds as metadata."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, field
from typing import Any

_KEY = "oimppi_warp"


@dataclass(frozen=True)
class About:
    """Help, unit and bounds of a field of a settings dataclass, kept in the field's metadata.

    Attributes:
        text: Description, shown in help, tooltips and `docs/settings.md`.
        unit: Unit, empty if dimensionless; for a tuple whose entries have different units, one per entry.
        low: Smallest number allowed, in this unit; for a tuple, the smallest for every entry.
        high: Largest number allowed, in this unit; with infinity, every finite number above ``low`` is allowed.
        option: Whether the field can be set by name; labels, such as the preset's name, cannot.
    """

    text: str
    unit: str = ""
    low: float = 0.0
    high: float = math.inf
    option: bool = True


def setting(default: Any, text: str, *, unit: str = "", low: float = 0.0, high: float = math.inf) -> Any:
    """Makes a dataclass field that is one setting.

    Args:
        default: Default value; the annotation gives the type: bool, int, float, a tuple of them, or a ``Literal``.
        text: Description, shown in help, tooltips and `docs/settings.md`.
        unit: SI unit (angles in rad), empty if dimensionless; for a tuple whose entries have different units, one per
            entry.
        low: Smallest number allowed, in this unit; for a tuple, the smallest for every entry.
        high: Largest number allowed, in this unit; with infinity, every finite number above ``low`` is allowed.
    """
    return field(default=default, metadata={_KEY: About(text, unit, low, high)})


def group(default: Any, text: str) -> Any:
    """Makes a dataclass field that is a group of settings.

    Args:
        default: A frozen dataclass whose fields are made by :func:`setting`, or a mapping from names to weights.
        text: Description of the group.
    """
    return field(default=default, metadata={_KEY: About(text)})


def label(default: Any, text: str) -> Any:
    """Makes a dataclass field that accompanies the settings and cannot be set by name.

    Args:
        default: Default value, a string.
        text: Description of the field.
    """
    return field(default=default, metadata={_KEY: About(text, option=False)})


def about(item: Field[Any]) -> About:
    """Returns help, unit and bounds of a field.

    Raises:
        TypeError: The field was not made with :func:`setting`, :func:`group` or :func:`label`, or it has no default.
    """
    found = item.metadata.get(_KEY)
    if found is None or item.default is MISSING:
        raise TypeError(
            f"{item.name}: the field has no help or no default value\n"
            "  to do:   make it with oimppi_warp.config.fields.setting(default, text, ...)"
        )
    return found


class ExtraWeights(Mapping[str, float]):
    """Weights of cost terms from outside the package, by name; immutable, so that settings compare and hash by value.

    Args:
        weights: The weight of each term; default: no terms.
    """

    __slots__ = ("_weights",)

    def __init__(self, weights: Mapping[str, float] | None = None) -> None:
        self._weights = dict(sorted((weights or {}).items()))

    def __getitem__(self, name: str) -> float:
        return self._weights[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._weights)

    def __len__(self) -> int:
        return len(self._weights)

    def __hash__(self) -> int:
        return hash(tuple(self._weights.items()))

    def __repr__(self) -> str:
        return f"ExtraWeights({self._weights})"
