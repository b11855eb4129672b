"""Scenes with random damage, and a process that reads them one after the other: USD may take the process down.

    PYTHONPATH=tests python -m support.fuzzing SEED FIRST COUNT FOLDER

It prints a line before and after each stage. A stage that takes longer than :data:`LIMIT` ends the process.
"""

from __future__ import annotations

import faulthandler
import os
import random
import re
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

LIMIT = 60.0
"""Time that reading a stage may take, on a machine that does something else too [s]."""

MARK = "stage"
"""Before each outcome, since Warp prints too."""

MOST = 5
"""Failures after which enough is known."""

BASES = ("task02", "task05", "lab02", "point01", "task05 in centimetres", "point01 in centimetres")

WHOLE = 10
"""Every so many stages, all of the check is run."""

NUMBERS = ("0", "-1", "1e-30", "1e30", "1e400", "nan", "inf", "-inf", "3", "0.1", "1000000007", "-0.0")

KINDS = (
    r"<.*>",
    r"\".*\"",
    r"def|over|class",
    r"Cube|Sphere|Cylinder|Capsule|Mesh|Xform|Scope|Material|Physics\w+Joint|PhysicsScene|PhysicsCollisionGroup",
    r"bool|int|float|double|float3|double3|double2|point3f|vector3f|quatf|token|string",
    r"(physics|oimppi|newton|xformOp|drive):[\w:]+",
)
"""Words that may stand in each other's places."""

TOKEN = re.compile(r"[A-Za-z_][\w:]*|-?\d[\d.eE+-]*|<[^<>\s]*>|@[^@\s]*@|\"[^\"\n]*\"|\s+|.", re.DOTALL)


@dataclass(frozen=True)
class Outcome:
    """What came of one stage: "scene", "refused", or else what went wrong."""

    number: int
    words: str

    @property
    def is_sound(self) -> bool:
        """Whether it was read, or refused with a reason."""
        return self.words in ("scene", "refused")


@cache
def base(name: str) -> str:
    """The text of a shipped scene with its robot and its objects, but without what only shows."""
    from support.foreign_scenes import flat, measured_in, with_y_up

    stage = flat(name.partition(" ")[0])
    shown = [prim.GetPath() for prim in stage.Traverse() if prim.GetName() in ("skin", "Goal", "Camera", "Sky", "Sun")]
    for path in shown:
        stage.RemovePrim(path)
    if " " in name:
        measured_in(stage, 0.01, 0.001)
        with_y_up(stage)
    return stage.ExportToString()


def damaged(seed: int, number: int) -> bytes:
    """A scene's text with one to three pieces of damage, always the same for the same numbers.

    Most of it is still USD: other numbers, words of the same kind, properties taken out or put elsewhere.
    """
    chance = random.Random(f"{seed} {number}")
    text = base(chance.choice(BASES))
    for _ in range(chance.randint(1, 3)):
        (damage,) = chance.choices((_number, _word, _properties, _tokens, _lines), (8, 8, 6, 1, 1))
        text = damage(text, chance)
    raw = text.encode()
    return bytes_damaged(raw, chance) if chance.random() < 0.05 else raw


def _number(text: str, chance: random.Random) -> str:
    """Another number in the place of one."""
    tokens = TOKEN.findall(text)
    places = [i for i, token in enumerate(tokens) if re.fullmatch(r"-?\d[\d.eE+-]*|inf|nan", token)]
    tokens[chance.choice(places)] = chance.choice((*NUMBERS, tokens[chance.choice(places)]))
    return "".join(tokens)


def _word(text: str, chance: random.Random) -> str:
    """A word, path or string of the scene in the place of one of its kind."""
    tokens = TOKEN.findall(text)
    kind = chance.choice(KINDS)
    places = [i for i, token in enumerate(tokens) if re.fullmatch(kind, token)]
    if places:
        tokens[chance.choice(places)] = tokens[chance.choice(places)]
    return "".join(tokens)


def _properties(text: str, chance: random.Random) -> str:
    """A property taken out, put somewhere else, or given the value of another."""
    lines = text.splitlines(keepends=True)
    places = [i for i, line in enumerate(lines) if re.match(r" +[\w ]+(\[\])? [\w:]+ = [^(\n]*(\([^()]*\))?\n", line)]
    here, there = chance.sample(places, 2)
    match chance.randrange(3):
        case 0:
            del lines[here]
        case 1:
            lines.insert(there, lines[here])
        case _:
            lines[here] = lines[here].partition(" = ")[0] + " = " + lines[there].partition(" = ")[2]
    return "".join(lines)


def _tokens(text: str, chance: random.Random) -> str:
    tokens = TOKEN.findall(text)
    first, second = sorted(chance.sample(range(len(tokens)), 2))
    match chance.randrange(3):
        case 0:
            del tokens[first : min(second, first + chance.randint(1, 3))]
        case 1:
            tokens.insert(second, tokens[first])
        case _:
            tokens[first], tokens[second] = tokens[second], tokens[first]
    return "".join(tokens)


def _lines(text: str, chance: random.Random) -> str:
    lines = text.splitlines(keepends=True)
    first = chance.randrange(len(lines))
    piece = lines[first : first + chance.randint(1, 12)]
    match chance.randrange(3):
        case 0:
            del lines[first : first + len(piece)]
        case 1:
            lines[first:first] = piece
        case _:
            at = chance.randrange(len(lines))
            lines[at:at] = piece
    return "".join(lines)


def bytes_damaged(raw: bytes, chance: random.Random) -> bytes:
    """A file cut short, or with a few other bytes."""
    at = chance.randrange(len(raw))
    match chance.randrange(3):
        case 0:
            return raw[:at]
        case 1:
            return raw[:at] + bytes(chance.randrange(256) for _ in range(4)) + raw[at:]
        case _:
            return raw[:at] + bytes([raw[at] ^ (1 << chance.randrange(8))]) + raw[at + 1 :]


def outcomes(seed: int, count: int, folder: Path, *, module: str = __name__) -> list[Outcome]:
    """Read damaged files in a process of its own, which is started again after each that it does not survive.

    Args:
        seed: Seed of the damage.
        count: Number of files.
        folder: Folder for them.
        module: The module whose ``main`` reads them.
    """
    found: list[Outcome] = []
    while len(found) < count and sum(not outcome.is_sound for outcome in found) < MOST:
        command = [sys.executable, "-m", module, *map(str, (seed, len(found), count - len(found), folder))]
        ended = subprocess.run(
            command, cwd=Path(__file__).parents[1], capture_output=True, text=True, errors="replace", check=False
        )
        lines = [line.split(" ", 2) for line in ended.stdout.splitlines() if line.startswith(f"{MARK} ")]
        found += [Outcome(int(number), words) for _, number, words in lines]
        if len(found) < count:
            found.append(Outcome(len(found), f"exit status {ended.returncode}: {ended.stderr[-2000:]}"))
    return found


def read(file: Path, *, whole: bool) -> str:
    """What comes of a file, in a word.

    Args:
        file: The stage.
        whole: Whether to look for ways to the goal too, which takes most of a second.
    """
    from oimppi_warp.authoring.checks.check import check_scene
    from oimppi_warp.geometry.feasibility import task_mistakes
    from oimppi_warp.usd import inspect_scene
    from oimppi_warp.usd.lint import lint_stage

    if whole:
        problems = check_scene(file)
        return "refused" if any(problem.severity == "error" for problem in problems) else "scene"
    found = inspect_scene(file)
    if found.stage is not None:
        list(lint_stage(found.stage))
    if found.scene is None:
        assert found.mistakes
        return "refused"
    return "refused" if list(task_mistakes(found.scene)) else "scene"


def main() -> None:
    """Read stages and say what came of each."""
    import shutil
    import traceback

    seed, first, count = map(int, sys.argv[1:4])
    cache = Path(sys.argv[4]) / "cache"
    os.environ["OIMPPI_CACHE"] = str(cache)  # fields of damaged scenes are of no use to anyone
    for number in range(first, first + count):
        file = Path(sys.argv[4]) / f"damaged{number}.usda"
        file.write_bytes(damaged(seed, number))
        faulthandler.dump_traceback_later(LIMIT, exit=True)
        try:
            words = read(file, whole=number % WHOLE == 0)
        except Exception as error:
            ours = [frame for frame in traceback.extract_tb(error.__traceback__) if "oimppi_warp" in frame.filename]
            words = f"{type(error).__name__} at {ours[-1].filename}:{ours[-1].lineno}"
        faulthandler.cancel_dump_traceback_later()
        file.unlink()
        shutil.rmtree(cache, ignore_errors=True)
        print(f"\n{MARK}", number, words, flush=True)


if __name__ == "__main__":
    main()
