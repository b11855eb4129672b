"""Registries, in which methods, optimizers, engines, plants, cost terms and shapes are added by name.

The command line, suites, the viewer, tables and ``oimppi doctor`` offer the entries of the registries, so a new entry
appears in all of them. Shipped entries are imported on first use. Other entries are registered in Python with
:meth:`Registry.register`. To be available on the command line and in worker processes too, an entry must be declared by
an installed package as an entry point of the registry's group. `docs/extending.md` has an example of each. A registry
may also take entries straight from a Python file, as ``FILE.py:NAME``.
"""

from __future__ import annotations

import hashlib
import os
import shlex
import sys
from collections.abc import Iterator, Mapping
from functools import cached_property
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, Literal, TypeVar

from oimppi_warp.errors import ConfigError
from oimppi_warp.suggestions import did_you_mean, did_you_mean_file

T = TypeVar("T")


class Registry(Mapping[str, T], Generic[T]):
    """Named implementations of one kind: the shipped ones, then those of installed packages, then registered ones.

    Looking up a name (``registry[name]``) imports the entry. It raises KeyError if the name is unknown, and ConfigError
    if an installed package's entry cannot be loaded.

    Args:
        kind: Noun for an entry, in the singular, for messages, such as ``"method"``.
        group: Entry point group for entries of installed packages, such as ``"oimppi_warp.methods"``.
        shipped: Shipped entries by name, each as ``"module:attribute"``.
        from_files: Whether ``FILE.py:NAME``, an attribute of a Python file, names an entry too. Such entries are not
            listed.
    """

    def __init__(self, kind: str, group: str, shipped: Mapping[str, str], *, from_files: bool = False) -> None:
        self.kind = kind
        self.group = group
        self.from_files = from_files
        self._targets: dict[str, str] = dict(shipped)
        self._loaded: dict[str, T] = {}

    def register(self, name: str, value: Any = None) -> Any:
        """Adds an entry and returns it; without ``value``, returns a decorator that adds the decorated object.

        Args:
            name: Name of the entry.
            value: The entry, of the type that the registry documents.

        Raises:
            ConfigError: Another entry has this name.
        """
        if value is None:
            return lambda decorated: self.register(name, decorated)
        if name in self and self._loaded.get(name) is not value:
            raise ConfigError(f"{self.kind} {name!r} is already registered\n  to do:   choose another name")
        self._loaded[name] = value
        return value

    def unregister(self, name: str) -> None:
        """Removes an entry that :meth:`register` added; shipped entries and those of installed packages are kept."""
        if name not in self._targets:
            self._loaded.pop(name, None)

    def get_checked(self, name: str) -> T:
        """Returns the entry with a name, after importing it if needed.

        Raises:
            ConfigError: No entry has this name (the message lists all names), or the entry cannot be loaded.
        """
        self.check(name)
        return self[name]

    def check(self, name: str, *others: str) -> None:
        """Checks that an entry exists, without importing it.

        Args:
            name: Name of the entry.
            *others: Other names that are allowed, such as ``"auto"``.

        Raises:
            ConfigError: No entry has this name; the message lists all names.
        """
        known = [*others, *self]
        if name in known:
            return
        if place := self.place(name):
            if not place[0].is_file():
                near = did_you_mean_file(place[0], (), (".py",)).removesuffix("?")
                fix = f"{near}:{place[1]}?" if near else "give the path of a Python file, as FILE.py:NAME"
                raise ConfigError(f"{self.kind} {name!r}: there is no file {place[0]}\n  to do:   {fix}")
            return
        near = did_you_mean(str(name), known)
        hint = f"\n  to do:   {near}" if near else ""
        files = ", or FILE.py:NAME" if self.from_files else ""
        raise ConfigError(f"{self.kind} {name!r} does not exist\n  allowed: {', '.join(known)}{files}{hint}")

    def place(self, name: object) -> tuple[Path, str] | None:
        """Returns file and attribute of an entry ``FILE.py:NAME``; ``None`` for other names."""
        if not (self.from_files and isinstance(name, str)):
            return None
        file, _, attribute = name.rpartition(":")
        return (Path(os.path.expanduser(file)), attribute) if file.endswith(".py") and attribute else None

    def is_local(self, name: str) -> bool:
        """Returns whether an entry was added by :meth:`register`, which makes it unknown to other processes."""
        return name in self._loaded and name not in self._targets and name not in self._installed

    def choice(self, *others: str) -> Any:
        """Returns the names of all entries as a ``Literal`` type, for the command line, with ``others`` before them."""
        return Literal.__getitem__((*others, *self))  # pyright: ignore[reportAttributeAccessIssue]

    def package_of(self, name: str) -> str:
        """Returns the name of the installed package that declares an entry; empty for other entries."""
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
        if name not in self._loaded and (place := self.place(name)) and place[0].is_file():
            return self._from_file(*place)
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
                        "  to do:   fix or uninstall the package; `oimppi doctor` lists the entries that it adds"
                    ) from error
            else:
                raise KeyError(name)
        return self._loaded[name]

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys((*self._targets, *self._installed, *self._loaded)))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __contains__(self, name: object) -> bool:
        if name in self._targets or name in self._loaded or name in self._installed:
            return True
        place = self.place(name)
        return place is not None and place[0].is_file()

    def _from_file(self, file: Path, attribute: str) -> T:
        """Returns an attribute of a Python file."""
        try:
            module = _run_file(file.resolve())
        except (Exception, SystemExit) as error:
            raise ConfigError(
                f"{self.kind} {f'{file}:{attribute}'!r}: the file cannot be loaded: {type(error).__name__}: {error}\n"
                f"  to do:   run `{shlex.join([sys.executable, str(file)])}` to see where"
            ) from error
        if not hasattr(module, attribute):
            own = {name for name, value in vars(module).items() if getattr(value, "__module__", "") == module.__name__}
            found = sorted(name for name in own if not name.startswith("_"))
            near = did_you_mean(attribute, found)
            raise ConfigError(
                f"{self.kind} {f'{file}:{attribute}'!r}: the file defines no {attribute}\n"
                f"  allowed: {', '.join(found) or 'nothing'}" + (f"\n  to do:   {near}" if near else "")
            )
        return getattr(module, attribute)

    @cached_property
    def _installed(self) -> dict[str, EntryPoint]:
        """Returns the entry points of installed packages by name, except those with the name of a shipped entry."""
        return {point.name: point for point in entry_points(group=self.group) if point.name not in self._targets}


def _run_file(file: Path) -> ModuleType:
    """Imports a Python file, once per process; it can import the files beside it, as with ``python FILE``."""
    name = f"{file.stem}_{hashlib.sha256(str(file).encode()).hexdigest()[:12]}"  # the same in every process
    if name not in sys.modules:
        if str(file.parent) not in sys.path:
            sys.path.insert(0, str(file.parent))
        spec = spec_from_file_location(name, file)
        if spec is None or spec.loader is None:
            raise ImportError("not a Python file")
        module = sys.modules[name] = module_from_spec(spec)  # dataclasses look their module up
        try:
            spec.loader.exec_module(module)
        except BaseException:
            del sys.modules[name]
            raise
    return sys.modules[name]
