"""The errors a person can cause, each with what was wrong, where, what is allowed and what to do."""

from __future__ import annotations


class OimppiError(Exception):
    """Base of every error that bad input raises; the command line turns it into one message and exit status 2."""


class SceneError(OimppiError):
    """A scene that cannot be run.

    Args:
        what: What was found to be wrong, with the value that was found.
        file: The USD file it stands in.
        prim: Path of the prim it stands at, if it stands at one.
        allowed: What would be allowed there.
        fix: What to do about it.
    """

    def __init__(self, what: str, *, file: object = "", prim: object = "", allowed: str = "", fix: str = "") -> None:
        self.what, self.file, self.prim, self.allowed, self.fix = what, str(file), str(prim), allowed, fix
        place = " ".join(part for part in (self.file, f"<{self.prim}>" if self.prim else "") if part)
        lines = [f"{place}: {what}" if place else what]
        if allowed:
            lines.append(f"  allowed: {allowed}")
        if fix:
            lines.append(f"  to do:   {fix}")
        super().__init__("\n".join(lines))


class ConfigError(OimppiError):
    """A setting that does not exist or has a value that cannot be used."""


class DeviceError(OimppiError):
    """A compute device that is not there."""
