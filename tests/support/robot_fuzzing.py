"""URDF and MJCF files of arms with random damage, and a process that makes robots of them.

    PYTHONPATH=tests python -m support.robot_fuzzing SEED FIRST COUNT FOLDER

It prints a line after each file. A file that takes longer than :data:`LIMIT` ends the process.
"""

from __future__ import annotations

import copy
import faulthandler
import random
import re
import shutil
import sys
import traceback
import xml.etree.ElementTree as ET
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from functools import cache
from io import StringIO
from pathlib import Path

from support.fuzzing import MARK, NUMBERS, bytes_damaged
from support.sample_arms import ARMS, FORMATS

LIMIT = 60.0
"""Time that a file may take [s]."""

ODD = (*NUMBERS, "", "1 2", "3.14", "1.5707", "0 0 0", "a", "nowhere.stl", "package://a/b.stl", "0.0001")
"""Values of attributes, of which many are out of place."""

TAGS = (
    "link",
    "joint",
    "body",
    "geom",
    "sphere",
    "mesh",
    "fixed",
    "free",
    "mimic",
    "limit",
    "site",
    "include",
    "frame",
)


@cache
def base(name: str, form: str) -> str:
    """The text of an arm in a format."""
    return FORMATS[form](ARMS[name]())


def damaged(seed: int, number: int) -> tuple[bytes, str, list[str]]:
    """A file with one to three pieces of damage, its format, and the options that the arm needs."""
    chance = random.Random(f"robot {seed} {number}")
    name, form = chance.choice(sorted(ARMS)), chance.choice(sorted(FORMATS))
    root = ET.fromstring(base(name, form))
    kinds: tuple[Callable[[ET.Element, random.Random], None], ...] = (_value, _attribute, _element, _tag)
    for _ in range(chance.randint(1, 3)):
        (damage,) = chance.choices(kinds, (8, 3, 4, 1))
        damage(root, chance)
    raw = ET.tostring(root)
    return (bytes_damaged(raw, chance) if chance.random() < 0.05 else raw), form, list(ARMS[name]().options)


def _with_attributes(root: ET.Element) -> list[ET.Element]:
    return [element for element in root.iter() if element.attrib]


def _value(root: ET.Element, chance: random.Random) -> None:
    """Another value in the place of one, or another number in a value."""
    element = chance.choice(_with_attributes(root) or [root])
    if not element.attrib:
        return
    key = chance.choice(sorted(element.attrib))
    numbers = re.split(r"(\s+)", element.attrib[key])
    match chance.randrange(3):
        case 0:
            element.set(key, chance.choice(ODD))
        case 1:
            numbers[chance.randrange(len(numbers))] = chance.choice(NUMBERS)
            element.set(key, "".join(numbers))
        case _:
            others = [other.attrib[key] for other in root.iter() if key in other.attrib]
            element.set(key, chance.choice(others))


def _attribute(root: ET.Element, chance: random.Random) -> None:
    """An attribute taken out, or added from another element."""
    element, other = (chance.choice(_with_attributes(root) or [root]) for _ in range(2))
    if chance.random() < 0.5 and element.attrib:
        del element.attrib[chance.choice(sorted(element.attrib))]
    elif other.attrib:
        key = chance.choice(sorted(other.attrib))
        element.set(key, other.attrib[key])


def _element(root: ET.Element, chance: random.Random) -> None:
    """An element taken out, repeated, or put elsewhere."""
    parents = [(parent, child) for parent in root.iter() for child in parent]
    if not parents:
        return
    parent, child = chance.choice(parents)
    match chance.randrange(3):
        case 0:
            parent.remove(child)
        case 1:
            parent.append(copy.deepcopy(child))
        case _:
            chance.choice(list(root.iter())).append(copy.deepcopy(child))


def _tag(root: ET.Element, chance: random.Random) -> None:
    """An element of another name."""
    element = chance.choice(list(root.iter()))
    element.tag = chance.choice((*TAGS, chance.choice(list(root.iter())).tag))


def convert(file: Path, options: list[str], folder: Path) -> str:
    """What comes of a file, in a word: "scene", "refused", or what is wrong with the answer."""
    from oimppi_warp.cli.main import main as command

    out, told = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(told):
        status = command(["scene", "robot", str(file), "--name", "arm", "--out", str(folder), "--force", *options])
    words = told.getvalue()
    if status == 0:
        return "scene" if (folder / "robots" / "arm.usda").is_file() else "nothing was written"
    if status != 2 or len(re.findall("^oimppi: ", words, re.MULTILINE)) != 1 or "Traceback" in words:
        return f"status {status}: {words[-2000:]}"
    if "Error:" in words or folder.exists():  # a kind of exception that nobody put into words
        return f"unclear: {words[-2000:]}" if "Error:" in words else "a file was left"
    return "refused"


def main() -> None:
    """Make robots and say what came of each file."""
    seed, first, count = map(int, sys.argv[1:4])
    folder = Path(sys.argv[4])
    for number in range(first, first + count):
        raw, form, options = damaged(seed, number)
        file = folder / f"damaged{number}.{form}"
        file.write_bytes(raw)
        faulthandler.dump_traceback_later(LIMIT, exit=True)
        try:
            words = convert(file, options, folder / "out")
        except Exception as error:
            ours = [frame for frame in traceback.extract_tb(error.__traceback__) if "oimppi_warp" in frame.filename]
            words = f"{type(error).__name__} at {ours[-1].filename}:{ours[-1].lineno}: {error}"
        faulthandler.cancel_dump_traceback_later()
        shutil.rmtree(folder / "out", ignore_errors=True)
        file.unlink()
        print(f"\n{MARK}", number, words.replace("\n", " | "), flush=True)


if __name__ == "__main__":
    main()
