"""The errors a person can cause, each with what was wrong, where, what is allowed and what to do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


class OimppiError(Exception):
    """Base of every error that bad input raises; the command line turns it into one message and exit status 2."""


@dataclass(frozen=True)
class Problem:
    """Something in a scene that a person should know of; tools get its fields as they are.

    Attributes:
        file: The USD file it stands in.
        severity: An error stops a run, a warning may spoil it.
        prim: Path of the prim it stands at; empty where it stands at none.
        what: What was found, with the value that was found.
        allowed: What would be allowed there.
        fix: What to do about it.
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
        what: What was found to be wrong, with the value that was found.
        file: The USD file it stands in.
        prim: Path of the prim it stands at, if it stands at one.
        allowed: What would be allowed there.
        fix: What to do about it.
        others: How many more mistakes there are in the scene.
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
        """The same as data."""
        return Problem(self.file, "error", self.prim, self.what, self.allowed, self.fix)

    def among(self, others: int) -> SceneError:
        """The same, with word of so many other mistakes in the scene."""
        return SceneError(self.what, file=self.file, prim=self.prim, allowed=self.allowed, fix=self.fix, others=others)


class ConfigError(OimppiError):
    """A setting that does not exist or has a value that cannot be used."""


class DeviceError(OimppiError):
    """A compute device that is not there."""


class ObservationError(OimppiError):
    """An observation that cannot be used: an array of the wrong length, or, at the start, impossible numbers."""
