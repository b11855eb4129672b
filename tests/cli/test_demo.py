"""The command ``oimppi demo``: which run it is, and that it overwrites nothing."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

from oimppi_warp.cli import main as command


def run_of(monkeypatch, *arguments: str, status: int = 0) -> command.Run:
    """The run that the demo makes; it is not carried out, but leaves a record."""
    made: list[command.Run] = []

    def execute(run: command.Run) -> int:
        made.append(run)
        run.record.mkdir(exist_ok=True)
        (run.record / "episode.json").write_text("{}")
        return status

    monkeypatch.setattr(command.Run, "execute", execute)
    assert command.main(["demo", *arguments]) == status
    return made[0]


def test_the_demo_is_a_run_of_task02_whose_record_is_told(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    run = run_of(monkeypatch)
    assert (run.scene, run.start, run.record, run.run.method) == ("task02", "1", Path("oimppi-demo"), "cloi")
    assert " view --replay oimppi-demo " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("found", "started", "told"),
    [
        ("/usr/bin/oimppi", "/usr/bin/oimppi", "  oimppi view"),
        (None, ".venv/bin/oimppi", "  .venv/bin/oimppi view"),
        (None, "/package/oimppi_warp/__main__.py", "  python -m oimppi_warp view"),
    ],
)
def test_the_commands_that_it_names_can_be_copied(monkeypatch, tmp_path, capsys, found, started, told):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(shutil, "which", lambda name: found)
    monkeypatch.setattr(sys, "argv", [started, "demo"])
    run_of(monkeypatch)
    assert told in capsys.readouterr().out


def test_a_second_demo_has_a_folder_of_its_own_unless_the_first_may_be_overwritten(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    run_of(monkeypatch)
    assert run_of(monkeypatch).record == Path("oimppi-demo-2")
    assert " export oimppi-demo-2 --to html" in capsys.readouterr().out
    forced = run_of(monkeypatch, "--force")
    assert forced.record == Path("oimppi-demo") and forced.force


def test_nothing_is_told_of_a_demo_that_could_not_begin(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    run_of(monkeypatch, status=2)
    assert "What to try next" not in capsys.readouterr().out
