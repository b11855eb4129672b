"""Every command that a document shows is one; those of the tutorial and of the FAQ are run, in an empty folder."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from support.commands import PAGES, ROOT, follow, parsed, shell_lines, spans, words_of

import oimppi_warp as ow

TUTORIAL = (ROOT / "docs" / "tutorial.md").read_text()
EXTRAS = re.findall(r"^([a-z0-9]+) = \[\"", (ROOT / "pyproject.toml").read_text(), flags=re.MULTILINE)
WHEEL = f"oimppi_warp-{ow.__version__}-py3-none-any.whl"
named = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)


@named
def test_every_command_can_be_parsed(page: Path):
    text = page.read_text()
    if page.name == "CHANGELOG.md":
        return  # it tells of commands that were
    for line in [*shell_lines(text), *spans(text)]:
        program, *arguments = words_of(line)
        match program:
            case "oimppi":
                assert parsed(line)
            case "pipx" | "uvx":
                assert arguments[-2:] == ["oimppi", "demo"] and WHEEL in arguments
            case "make":
                assert re.search(rf"^{arguments[0]}:", (ROOT / "Makefile").read_text(), flags=re.MULTILINE), line
            case "python" | "python3" if arguments[0].startswith("tools/"):
                assert (ROOT / arguments[0]).is_file(), line
            case "pip" | "pushing/bin/pip":
                extra = re.findall(r"\[(.*?)\]", line)
                assert arguments[0] == "install" and (set(extra) <= set(EXTRAS) if extra else WHEEL in arguments), line
            case _:
                known = ("python3 -m venv pushing", ". pushing/bin/activate")
                assert line in known or page.stem not in ("index", "tutorial", "gallery", "methods", "faq"), line


def small(method: str) -> ow.Config:
    config = ow.set_option(ow.paper(method), "robot.optimizer.samples=64")
    return replace(config, episode=replace(config.episode, max_sim_seconds=0.5))


@pytest.mark.parametrize("short", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_the_tutorial_works_from_its_first_line_to_its_last(short, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    if short:
        monkeypatch.setattr(ow, "best", small)
    blocks = re.findall(r"^```(sh|python)\n(.*?)^```$", TUTORIAL, flags=re.MULTILINE | re.DOTALL)
    for kind, text in blocks:
        if kind == "python":
            exec(compile(text, "docs/tutorial.md", "exec"), {"__name__": "tutorial"})
        for line in shell_lines(f"```sh\n{text}```\n") if kind == "sh" else []:
            if words_of(line)[0] == "oimppi":
                follow(line, short=short)
    for span in spans(TUTORIAL):
        follow(span, short=short)
    written = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")}
    assert {"oimppi-demo/way.png", "oimppi-demo/episode.html", "my_task.usda", "runs/lossy/episode.npz"} <= written
    printed = capsys.readouterr().out
    assert short or ("oimppi-demo/way.png shows the path" in printed and printed.count("True") == 2)


@pytest.mark.parametrize("page", ["methods", "faq", "gallery"])
def test_the_commands_of_a_page_work(page: str, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for line in shell_lines((ROOT / "docs" / f"{page}.md").read_text()):
        follow(line)


def test_every_message_that_the_questions_quote_is_one():
    sources = "".join(path.read_text() for path in (ROOT / "oimppi_warp").rglob("*.py"))
    quoted = re.findall(r'^### "(.*)"$', (ROOT / "docs" / "faq.md").read_text(), flags=re.MULTILINE)
    assert len(quoted) >= 3
    assert [message for message in quoted if message not in sources] == []
