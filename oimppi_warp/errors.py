"""Errors caused by bad input; each message states the mistake and its place, the allowed values and a fix."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


class OimppiError(Exception):
    """Base class of all errors from bad input; the command line shows one message and exits with status 2."""


@dataclass(frozen=True)
class Problem:
    """A problem in a scene, as data for tools.

    Attributes:
        file: The USD file with the problem.
        severity: An error prevents a run; a warning may spoil it.
        prim: Path of the prim with the problem; empty if there is none.
        what: Description of the problem, with the value found.
        allowed: The values that would be allowed.
        fix: How to fix it.
    """

    file: str
    severity: Literal["error", "warning"]
    prim: str
    what: str
    allowed: str = ""
    fix: str = ""


class SceneError(OimppiError):
    """A scene that cannot be run.

    Args:
        what: Description of the mistake, with the value found.
        file: The USD file with the mistake.
        prim: Path of the prim with the mistake, if there is one.
        allowed: The values that would be allowed.
        fix: How to fix it.
        others: Number of other mistakes in the scene.
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
        """Returns the error as data."""
        return Problem(self.file, "error", self.prim, self.what, self.allowed, self.fix)

    def among(self, others: int) -> SceneError:
        """Returns the same error with a note that the scene has ``others`` more mistakes."""
        return SceneError(self.what, file=self.file, prim=self.prim, allowed=self.allowed, fix=self.fix, others=others)


class ConfigError(OimppiError):
    """A setting that does not exist or has a value that cannot be used."""


class DeviceError(OimppiError):
    """A compute device that does not exist."""


class ObservationError(OimppiError):
    """An observation that cannot be used: an array of the wrong length or, at the start, impossible values."""
