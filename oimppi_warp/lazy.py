"""Lazy import of a package's public names, so that importing the package itself is fast."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def names_on_first_use(
    package: str, modules: Mapping[str, str], namespace: dict[str, Any]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Returns the functions ``__getattr__`` and ``__dir__`` for a package (PEP 562).

    ``__getattr__`` imports a public name; for other names it raises AttributeError, with a list of the public names.

    Args:
        package: Name of the package, such as ``"oimppi_warp"``.
        modules: Public names, each with its module relative to the package, such as ``"config.settings"``.
        namespace: Globals of the package, to which a name is added when it is first used.
    """

    def look_up(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}; it has {', '.join(sorted(modules))}")
        namespace[name] = value = getattr(import_module(f"{package}.{modules[name]}"), name)
        return value

    return look_up, lambda: [*namespace, *modules]
