"""The manual's list of messages about scenes, made from the scenes of the tests so that it is never out of date.

    PYTHONPATH=tests python -m support.messages

rewrites `docs/scene-check.md` below its heading "Messages".
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from pathlib import Path

from pxr import Gf, Usd
from support.bad_scenes import IMPOSSIBLE, MISTAKES, barrier, put, vast, walls
from support.lint_cases import LINT_CASES, several
from support.variants import variant

from oimppi_warp.authoring.checks.check import check_scene

MANUAL = Path(__file__).resolve().parents[2] / "docs" / "scene-check.md"

HEADING = "## Messages\n"

_ABOUT = """\
The tables show most messages, each for one faulty scene; the warnings about listed starts, which are worded like the
errors about the start, are left out. Numbers and prims are examples. Lengths and masses are in metres and kilograms,
whatever the units of the stage."""


def lying(stage: Usd.Stage) -> None:
    """The can on its round side."""
    stage.GetPrimAtPath("/World/Object/shape/piece0").GetAttribute("axis").Set("X")
    place = stage.GetPrimAtPath("/World/Object").GetAttribute("xformOp:translate")
    place.Set(Gf.Vec3d(*place.Get()[:2], 0.033))


_FURTHER_ERRORS = [(vast, "point01", "the arm reaches")]

_FURTHER_WARNINGS = [
    (lambda stage: None, "lab01", "a push may tip the object over"),
    (lying, "lab01", "the object lies on its round side"),
    (several(put("/World", "oimppi:spread", Gf.Vec2d(0.0)), put("/World", "oimppi:starts", [])), "task02", "every run"),
    (barrier(0.12), "task01", "no free path"),
    (barrier(0.162), "task01", "the path to the goal is narrow"),
]
"""Changes, the scenes that they are made to, and the beginnings of the messages."""


def manual() -> str:
    """The page as it should be."""
    above = MANUAL.read_text().partition(HEADING)[0]
    return "\n".join([above + HEADING, *_tables(), ""])


def _tables() -> Iterator[str]:
    yield "<!-- Made by tests/support/messages.py; do not edit by hand. -->\n"
    yield _ABOUT
    errors = {name: change for name, (change, *_) in {**MISTAKES, **IMPOSSIBLE}.items()} | {"no room": walls}
    warnings = {name: change for name, (change, _) in LINT_CASES.items()}
    for title, changes, further in (("Errors", errors, _FURTHER_ERRORS), ("Warnings", warnings, _FURTHER_WARNINGS)):
        yield f"\n### {title}\n"
        yield "| found | at | allowed | to do |\n|---|---|---|---|"
        rows = [*(_row(change) for change in changes.values()), *(_row(*each) for each in further)]
        yield from dict.fromkeys(rows)


def _row(change, scene: str = "task02", begins: str = "") -> str:
    with tempfile.TemporaryDirectory() as folder:
        problems = check_scene(variant(Path(folder), change, scene))
        problem = next(problem for problem in problems if problem.what.startswith(begins))
        cells = [problem.what, f"`{problem.prim}`" if problem.prim else "", problem.allowed, problem.fix]
        return "| " + " | ".join(plain(cell, folder) for cell in cells) + " |"


def plain(text: str, folder: str = "") -> str:
    """A text as the manual has it: without what differs from one machine to the next, and safe in a table."""
    places = (str(Path(folder).resolve()), folder) if folder else ()
    for place in (*places, str(Path(__file__).parent)):
        text = text.replace(place, "...")
    text = re.sub(r"0x[0-9a-f]+", "...", text)
    return text.replace("|", "\\|").replace("<", "\\<").replace("_", "\\_") if "`" not in text else text


if __name__ == "__main__":
    MANUAL.write_text(manual())
