"""Errors caused by bad input. A message states the mistake and, where they are known, its place, the allowed
values and a fix.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


class OimppiError(Exception):
    """Base class of the errors caused by bad input; the command line prints the message and exits with status 2."""


@dataclass(frozen=True)
class Problem:
    """A problem in a scene, as data for tools.

    Attributes:
        file: The USD file with the problem.
        severity: ``"error"`` if the problem prevents a run, ``"warning"`` if it may spoil one.
        prim: Path of the prim with the problem; empty if the problem concerns the whole file.
        what: Description of the problem, with the value found.
        allowed: Description of the allowed values; empty if there is nothing to choose from.
        fix: Instruction that fixes the problem; empty if ``allowed`` suffices.
    """

    file: str
    severity: Literal["error", "warning"]
    prim: str
    what: str
    allowed: str = ""
    fix: str = ""


class SceneError(OimppiError):
    """A scene that cannot be run, or a file of a robot or an object that cannot be used.

    Args:
        what: Description of the mistake, with the value found.
        file: The file with the mistake, or its path; empty if there is none.
        prim: The USD prim with the mistake, or its path; empty if there is none.
        allowed: Description of the allowed values; empty if there is nothing to choose from.
        fix: Instruction that fixes the mistake; empty if ``allowed`` suffices.
        others: Number of further mistakes in the scene, which ``oimppi scene check`` lists.
    """

    def __init__(
        self,
        what: str,
        *,
        file: object = "",
        prim: object = "",
        allowed: str = "",
        fix: str = "",
        others: int = 0,
    ) -> None:
        self.what, self.file, self.prim, self.allowed, self.fix = what, str(file), str(prim), allowed, fix
        place = " ".join(part for part in (self.file, f"<{self.prim}>" if self.prim else "") if part)
        lines = [f"{place}: {what}" if place else what]
        if allowed:
            lines.append(f"  allowed: {allowed}")
        if fix:
            lines.append(f"  to do:   {fix}")
        if others:
            lines.append(f"  and {others} more: `oimppi scene check {self.file}` lists them all")
        super().__init__("\n".join(lines))

    @property
    def problem(self) -> Problem:
        """Returns the error as a problem with the severity ``"error"``."""
        return Problem(self.file, "error", self.prim, self.what, self.allowed, self.fix)

    def among(self, others: int) -> SceneError:
        """Returns a copy of the error whose message adds that the scene has ``others`` further mistakes."""
        return SceneError(self.what, file=self.file, prim=self.prim, allowed=self.allowed, fix=self.fix, others=others)


class ConfigError(OimppiError):
    """A setting, an option or an argument that does not exist or has a value that cannot be used."""


def missing_package(what: str, package: str, extra: str) -> ConfigError:
    """Returns the error of an optional package that is not installed.

    Args:
        what: What was asked for, such as ``the plant pusht``.
        package: The package that it needs.
        extra: The extra of this package that installs it.
    """
    return ConfigError(f"{what}: {package} is not installed\n  to do:   pip install 'oimppi-warp[{extra}]'")


class DeviceError(OimppiError):
    """A compute device that does not exist, or has too little free memory."""


class ObservationError(OimppiError):
    """An observation that cannot be used: an array has the wrong shape or, at the start, implausible values."""


class HardwareError(OimppiError):
    """A robot, its controller or a sensor that cannot be reached or used; the message states what to do."""
