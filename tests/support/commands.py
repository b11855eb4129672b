"""The commands that documents show: found in them, parsed as the command line parses them, and followed in a folder."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import tyro

from oimppi_warp.cli.main import Command, main
from oimppi_warp.geometry.feasibility import check_task
from oimppi_warp.usd import load_scene
from oimppi_warp.view.replay import Replay

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])
SMALL = ["--set", "robot.optimizer.samples=64", "object.optimizer.samples=64", "--device", "cpu"]
SHORT = ["--max-sim-seconds", "0.5", *SMALL]
"""Options after which a run takes a second, and does not reach its goal."""
_BLOCK = re.compile(r"^ *```sh\n(.*?)^ *```$", flags=re.MULTILINE | re.DOTALL)
_INDENTED = re.compile(r"^ {4}(?:\$ )?(oimppi (?:.*\\\n)*.*)$", flags=re.MULTILINE)
_MENTION = re.compile(r"^oimppi run --|\b[A-Z]+\b|\.\.\.|\.x\b|\||--help| --[\w-]+$")
"""What a command has in a sentence that speaks of it, but does not tell the reader to type it."""


def shell_lines(text: str) -> list[str]:
    """Lines of the shell blocks of a document; a line that goes on after a backslash is one line."""
    blocks = [*_BLOCK.findall(text), *_INDENTED.findall(_BLOCK.sub("", text))]
    lines = "\n".join(blocks).replace("\\\n", " ").splitlines()
    return [line.strip() for line in lines if line.strip() and not line.strip().startswith("#")]


def spans(text: str) -> Iterator[str]:
    """Commands in sentences that can be typed as they are: with an argument, and no word that stands for another."""
    for span in re.findall(r"`(oimppi [^`]+)`", _BLOCK.sub("", text)):
        line = " ".join(span.split())
        names = 3 if line.startswith(("oimppi scene ", "oimppi ros2 ", "oimppi perceive ")) else 2
        if len(line.split()) > names and not re.search(
            r"^oimppi run --|\b[A-Z]{1,}\b|\.\.\.|\.x\b|\||--help| --[\w-]+$", line
        ):
            yield line


def words_of(line: str) -> list[str]:
    """Words of a command without its comment."""
    return shlex.split(line, comments=True)


def parsed(line: str) -> object:
    """The command of a line that begins with ``oimppi``, as the command line parses it."""
    return tyro.cli(Command, prog="oimppi", args=words_of(line)[1:])


def follow(line: str, *, short: bool = True) -> None:
    """Runs a command here; what would serve a page for ever only loads what it would show.

    Args:
        line: The command, which begins with ``oimppi``.
        short: Whether a run is cut off after half a second.
    """
    parsed(line)
    command, *arguments = words_of(line)[1:]
    if command == "view":
        if "--replay" in arguments:
            assert len(Replay(arguments[arguments.index("--replay") + 1]))
        else:
            check_task(load_scene(arguments[0]))
    elif command == "run" and "--plant" not in arguments:
        assert main([command, *arguments, *(SHORT if short else [])]) == (1 if short else 0)
    elif command == "doctor":
        assert main([command, *arguments]) in (0, 1)
    elif command == "demo" and short:
        assert main(["run", "task02", "--start", "1", "--record", "oimppi-demo", *SHORT]) == 1
    elif command in ("demo", "export", "scenes") or (command == "scene" and arguments[0] != "robot"):
        assert main([command, *arguments]) == 0
    # Others take minutes, or ask for an arm: that they can be parsed must do here.
