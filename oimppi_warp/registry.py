"""Registries, in which methods, optimisers, engines, plants, cost terms and shapes are added by name.

Everything that offers a choice (the command line, suites, the viewer, tables, ``oimppi doctor``) reads a registry, so a
new entry appears in all of them. Shipped entries are imported on first use. Other entries are registered in Python
(:meth:`Registry.register`) or, to be available on the command line and in worker processes too, declared by an
installed package as an entry point of the registry's group. `docs/extending.md` has an example of each.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from functools import cached_property
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Generic, Literal, TypeVar

from oimppi_warp.errors import ConfigError

T = TypeVar("T")


class Registry(Mapping[str, T], Generic[T]):
    """Named implementations of one kind, in the order in which they were added.

    Args:
        kind: Noun for an entry, in the singular, for messages: ``"method"``.
        group: Entry point group for entries of installed packages: ``"oimppi_warp.methods"``.
        shipped: Location of each shipped entry: ``"module:attribute"``.
    """

    def __init__(self, kind: str, group: str, shipped: Mapping[str, str]) -> None:
        self.kind = kind
        self.group = group
        self._targets: dict[str, str] = dict(shipped)
        self._loaded: dict[str, T] = {}

    def register(self, name: str, value: Any = None) -> Any:
        """Adds an entry; without ``value``, returns a decorator that adds one.

        Raises:
            ConfigError: The name is taken by another entry.
        """
        if value is None:
            return lambda decorated: self.register(name, decorated)
        if name in self and self._loaded.get(name) is not value:
            raise ConfigError(f"{self.kind} {name!r} is registered already\n  to do:   choose another name")
        self._loaded[name] = value
        return value

    def unregister(self, name: str) -> None:
        """Removes an entry that :meth:`register` added; shipped and installed entries stay."""
        if name not in self._targets:
            self._loaded.pop(name, None)

    def get_checked(self, name: str) -> T:
        """Returns the entry of a name.

        Raises:
            ConfigError: The entry does not exist; the message lists those that do.
        """
        self.check(name)
        return self[name]

    def check(self, name: str, *others: str) -> None:
        """Checks that an entry exists, without importing it.

        Args:
            name: The name.
            *others: Other names that are allowed, such as ``"auto"``.

        Raises:
            ConfigError: The entry does not exist; the message lists those that do.
        """
        known = [*others, *self]
        if name not in known:
            near = difflib.get_close_matches(str(name), known, n=1)
            hint = f"\n  to do:   did you mean {near[0]}?" if near else ""
            raise ConfigError(f"{self.kind} {name!r} does not exist\n  allowed: {', '.join(known)}{hint}")

    def is_local(self, name: str) -> bool:
        """Returns whether an entry was added by :meth:`register`, and so is unknown to other processes."""
        return name in self._loaded and name not in self._targets and name not in self._installed

    def choice(self, *others: str) -> Any:
        """Returns the names as a ``Literal`` type, for command lines; ``others`` come first."""
        return Literal.__getitem__((*others, *self))  # pyright: ignore[reportAttributeAccessIssue]

    def package_of(self, name: str) -> str:
        """Returns the installed package that declares an entry; empty for a shipped or registered one."""
        point = self._installed.get(name)
        return point.dist.name if point is not None and point.dist is not None else ""

    def loadable(self) -> Iterator[tuple[str, T]]:
        """Yields names and entries, except those of installed packages that cannot be loaded."""
        for name in self:
            try:
                yield name, self[name]
            except ConfigError:
                continue

    def __getitem__(self, name: str) -> T:
        if name not in self._loaded:
            if name in self._targets:
                module, _, attribute = self._targets[name].partition(":")
                self._loaded[name] = getattr(import_module(module), attribute)
            elif name in self._installed:
                try:
                    self._loaded[name] = self._installed[name].load()
                except Exception as error:
                    raise ConfigError(
                        f"{self.kind} {name!r} of the package {self.package_of(name)} cannot be loaded: {error}\n"
                        "  to do:   fix or remove the package; `oimppi doctor` lists its entries"
                    ) from error
            else:
                raise KeyError(name)
        return self._loaded[name]

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys((*self._targets, *self._installed, *self._loaded)))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __contains__(self, name: object) -> bool:
        return name in self._targets or name in self._loaded or name in self._installed

    @cached_property
    def _installed(self) -> dict[str, EntryPoint]:
        """Returns the entry points that installed packages declare; shipped names cannot be replaced."""
        return {point.name: point for point in entry_points(group=self.group) if point.name not in self._targets}
