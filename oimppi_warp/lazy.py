"""Public names of a package that are imported on first use, so that the package itself is imported at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def names_on_first_use(
    package: str, modules: Mapping[str, str], namespace: dict[str, Any]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """A package's ``__getattr__`` and ``__dir__`` (PEP 562).

    Args:
        package: Its name.
        modules: The module below it that each public name is in.
        namespace: Its globals, where a name stays once it was asked for.
    """

    def look_up(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}; it has {', '.join(sorted(modules))}")
        namespace[name] = value = getattr(import_module(f"{package}.{modules[name]}"), name)
        return value

    return look_up, lambda: [*namespace, *modules]
