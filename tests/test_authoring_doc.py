"""docs/authoring.md: what it tells a reader to do is done here, line by line, in an empty folder."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from oimppi_warp.cli.main import main
from oimppi_warp.geometry.feasibility import check_task
from oimppi_warp.usd import load_scene

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "authoring.md").read_text()
BLOCKS = re.findall(r"^```(\w+) ?([\w.]*)\n(.*?)^```$", PAGE, flags=re.MULTILINE | re.DOTALL)
SHORT = [
    "--max-sim-seconds",
    "0.5",
    "--set",
    "robot.optimizer.samples=64",
    "object.optimizer.samples=64",
    "--device",
    "cpu",
]


def follow(line: str) -> None:
    """Run a command of the page; what would serve a browser for ever is only loaded, what would plan is cut short."""
    program, command, *arguments = shlex.split(line)
    assert program == "oimppi"
    if command == "view":
        check_task(load_scene(arguments[0]))
    elif command == "run":
        assert main([command, *arguments, *SHORT]) in (0, 1)
    else:
        assert main([command, *arguments]) == 0


def test_every_command_and_every_line_of_code_works(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for kind, name, text in BLOCKS:
        if kind == "sh":
            for line in text.splitlines():
                follow(line)
        elif kind == "python":
            exec(compile(text, "docs/authoring.md", "exec"), {})
        elif kind == "usda":
            Path(name).write_text(text)
            check_task(load_scene(name))
    made = {"first.usda", "by_hand.usda", "bracket.stl", "push_bracket.usda", "sign.usda", "horseshoe.usda"}
    assert made <= {path.name for path in tmp_path.iterdir()}
    assert "convex pieces: volume" in capsys.readouterr().out


def test_what_is_shown_of_the_file_is_in_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first = next(line for _, _, text in BLOCKS for line in text.splitlines() if line.startswith("oimppi scene new"))
    follow(first)
    written = (tmp_path / "first.usda").read_text()
    (shown,) = [text for kind, _, text in BLOCKS if kind == "text"]
    for line in shown.splitlines():
        assert line.strip() in written


def test_pictures_and_links_of_the_page_are_there():
    targets = re.findall(r"\]\(([^)#]+)(?:#[\w-]*)?\)", PAGE)
    assert len(targets) > 8
    for target in targets:
        assert (ROOT / "docs" / target).is_file(), target


def test_every_option_that_the_page_names_is_one(capsys):
    known: set[str] = set()
    for command in (["scene", "new"], ["scene", "import"], ["run"]):
        with pytest.raises(SystemExit):
            main([*command, "--help"])
        known |= options_in(capsys.readouterr().out)
    named = options_in(PAGE)
    assert {"--object", "--mass", "--height", "--font", "--scale", "--lay", "--robot", "--force", "--seed"} <= named
    assert named <= known


def options_in(text: str) -> set[str]:
    return set(re.findall(r"(?<![\w-])--[a-z][\w-]*", text))
