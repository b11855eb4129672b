"""The command ``oimppi scene check``."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated

from tyro.conf import FlagCreatePairsOff, Positional, arg

from oimppi_warp.errors import ConfigError, SceneError

if TYPE_CHECKING:
    from rich.console import Console

    from oimppi_warp.errors import Problem


@dataclass(frozen=True)
class Check:
    """Check scenes for problems that would prevent or spoil a run, and suggest fixes.

    Exit status: 0 no errors, 1 errors (with --strict, also warnings), 2 bad input, such as a missing file.
    """

    files: Annotated[Positional[tuple[str, ...]], arg(metavar="FILE ...", help_behavior_hint="")]
    """USD files, or names of shipped scenes."""

    strict: FlagCreatePairsOff[bool] = False
    """Treat warnings as errors."""

    json: FlagCreatePairsOff[bool] = False
    """Print the problems as JSON: objects with file, severity (error or warning), prim, what, allowed and fix."""

    def execute(self) -> int:
        """Prints the problems found and returns the exit status."""
        if not self.files:
            raise ConfigError("there is no file to check\n  to do:   name one or more USD files or shipped scenes")
        from rich.console import Console

        from oimppi_warp.authoring.checks.check import check_scene
        from oimppi_warp.compute.device import tell_compilation

        tell_compilation(lambda line: print(line, file=sys.stderr))
        console = Console(highlight=False, emoji=False, markup=False)
        problems: list[Problem] = []
        missing = False
        for file in self.files:
            try:
                found = check_scene(file)
            except SceneError as error:
                print(f"oimppi: {error}", file=sys.stderr)
                missing = True
                continue
            problems += found
            if not self.json:
                _show(console, file, found)
        if self.json:
            print(json.dumps([asdict(problem) for problem in problems], indent=2))
        counted = [problem for problem in problems if self.strict or problem.severity == "error"]
        return 2 if missing else int(bool(counted))


def _show(console: Console, file: str, problems: Sequence[Problem]) -> None:
    """Prints the problems of one scene, after a line with their number."""
    from rich.text import Text

    errors = sum(problem.severity == "error" for problem in problems)
    counts = [_count(errors, "error"), _count(len(problems) - errors, "warning")]
    verdict = ", ".join(count for count in counts if count) or "no problems found"
    color = "red" if errors else "yellow" if problems else "green"
    console.print(Text.assemble((file, "bold"), ": ", (verdict, color)), soft_wrap=True)
    for problem in problems:
        mark = Text(problem.severity, style="bold red" if problem.severity == "error" else "bold yellow")
        console.print(Text.assemble("  ", mark, f"  <{problem.prim}>" if problem.prim else ""), soft_wrap=True)
        for name, text in (("found", problem.what), ("allowed", problem.allowed), ("to do", problem.fix)):
            if text:
                console.print(Text.assemble("    ", (f"{name:9}", "dim"), text), soft_wrap=True)


def _count(number: int, noun: str) -> str:
    """Returns a number with its noun, ``"2 errors"``; empty if the number is zero."""
    return f"{number} {noun}{'s' * (number != 1)}" if number else ""
