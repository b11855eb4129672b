"""The manual's list of what is said about scenes: made from the scenes of the tests, so that it is never out of date.

    PYTHONPATH=tests python -m support.messages

writes `docs/scene-check.md` anew below its heading "All messages".
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from pathlib import Path

from support.bad_scenes import IMPOSSIBLE, MISTAKES, walls
from support.lint_cases import LINT_CASES
from support.variants import variant

from oimppi_warp.authoring.checks.check import check_scene

MANUAL = Path(__file__).resolve().parents[2] / "docs" / "scene-check.md"

HEADING = "## All messages\n"


def manual() -> str:
    """The page as it should be."""
    above = MANUAL.read_text().partition(HEADING)[0]
    return "\n".join([above + HEADING, *_tables(), ""])


def _tables() -> Iterator[str]:
    yield "<!-- Made by tests/support/messages.py; do not edit by hand. -->\n"
    yield "Each message is shown for one faulty scene; numbers and prims are examples."
    errors = {name: change for name, (change, *_) in {**MISTAKES, **IMPOSSIBLE}.items()} | {"no room": walls}
    warnings = {name: change for name, (change, _) in LINT_CASES.items()}
    for title, changes in (("Errors", errors), ("Warnings", warnings)):
        yield f"\n### {title}\n"
        yield "| found | at | allowed | to do |\n|---|---|---|---|"
        rows = [_row(change) for change in changes.values()]
        yield from dict.fromkeys(rows)


def _row(change) -> str:
    with tempfile.TemporaryDirectory() as folder:
        problem = check_scene(variant(Path(folder), change))[0]
        cells = [problem.what, f"`{problem.prim}`" if problem.prim else "", problem.allowed, problem.fix]
        return "| " + " | ".join(_plain(cell, folder) for cell in cells) + " |"


def _plain(text: str, folder: str) -> str:
    """Without what differs from one machine to the next, and safe in a table."""
    for place in (str(Path(folder).resolve()), folder, str(Path(__file__).parent)):
        text = text.replace(place, "...")
    text = re.sub(r"0x[0-9a-f]+", "...", text)
    return text.replace("|", "\\|").replace("<", "\\<").replace("_", "\\_") if "`" not in text else text


if __name__ == "__main__":
    MANUAL.write_text(manual())
