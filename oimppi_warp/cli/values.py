"""Parsing of numbers and of optional values on the command line.

tyro treats ``T | None`` as a choice between two types, and its error messages name both. With these rules, such an
option is parsed as a T, and numbers have messages of their own.
"""

from __future__ import annotations

import types
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Union, get_args, get_origin

from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

VALUES = ConstructorRegistry()
"""Rules for tyro, besides its own."""

_NUMBERS = {int: "a whole number", float: "a number"}


@VALUES.primitive_rule
def number(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """Returns the parser of an ``int``, a ``float`` or a tuple of these; ``None`` for other types."""
    kinds = get_args(info.type) if get_origin(info.type) is tuple else (info.type,)
    if not kinds or any(kind not in _NUMBERS for kind in kinds):
        return None
    several = get_origin(info.type) is tuple

    def read(texts: list[str]) -> Any:
        values = tuple(_number(text, kind) for text, kind in zip(texts, kinds, strict=True))
        return values if several else values[0]

    return PrimitiveConstructorSpec(
        nargs=len(kinds),
        metavar=" ".join(kind.__name__.upper() for kind in kinds),
        instance_from_str=read,
        is_instance=lambda value: isinstance(value, tuple if several else (int, float)),
        str_from_instance=lambda value: [str(each) for each in (value if several else (value,))],
    )


@VALUES.primitive_rule
def optional(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """Returns the parser of a ``T | None``: that of T; ``None`` for other types."""
    if get_origin(info.type) not in (Union, types.UnionType):
        return None
    kinds = [kind for kind in get_args(info.type) if kind is not type(None)]
    if len(kinds) != 1 or len(get_args(info.type)) != 2:
        return None
    spec = ConstructorRegistry.get_primitive_spec(PrimitiveTypeInfo.make(kinds[0], info.markers))
    if not isinstance(spec, PrimitiveConstructorSpec):
        return None
    is_given: Callable[[Any], Any] = spec.is_instance
    written: Callable[[Any], list[str]] = spec.str_from_instance
    return replace(
        spec,
        is_instance=lambda value: value is None or is_given(value),
        str_from_instance=lambda value: ["None"] if value is None else written(value),
    )


def _number(text: str, kind: type) -> Any:
    try:
        return kind(text)
    except ValueError:
        raise ValueError(f"{text} is not {_NUMBERS[kind]}") from None
