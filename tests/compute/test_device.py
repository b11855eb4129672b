"""What Warp says: nothing in a script that did not ask, each kernel that is compiled on the command line."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

EPISODE = """
import oimppi_warp as ow
from oimppi_warp.config.overrides import set_option

scene, config = ow.load_scene("task01"), set_option(ow.best("cloi"), "episode.max_sim_seconds=0.1")
assert len(ow.Episode(scene, config, method="cloi", engine="quasistatic", device="cpu").run()) == 2
ow.make_planner(scene, config, method="mppi", engine="quasistatic", device="cpu").warm_up()
"""

KERNEL = """
import warp as wp
from oimppi_warp.compute.device import start_warp, tell_compilation

@wp.kernel
def double(numbers: wp.array[float]):
    numbers[wp.tid()] *= 2.0

{before}
numbers = wp.ones(3, dtype=float, device="cpu")
wp.launch(double, dim=3, inputs=[numbers], device="cpu")
"""


def said(script: str, folder: Path, *, cache: Path | None = None) -> tuple[str, str]:
    """Returns what a script prints on stdout and on stderr."""
    (folder / "script.py").write_text(script)
    caches = {} if cache is None else {"WARP_CACHE_PATH": str(cache / "warp"), "OIMPPI_CACHE": str(cache / "fields")}
    command = [sys.executable, str(folder / "script.py")]
    done = subprocess.run(command, env=os.environ | caches, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout, done.stderr


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache in which the kernel is soon compiled."""
    return tmp_path_factory.mktemp("cache")


NATIVE = """
import os, sys
from oimppi_warp.compute import device

sys.stderr.write("before, ")
with device._without_line(b"dropped"):
    os.write(2, b"kept, this is dropped\\nkept 1\\n")
    sys.stderr.write("kept 2\\n")
    sys.stderr.flush()
sys.stderr.write("after\\n")
"""


def test_only_the_line_about_the_driver_is_dropped(tmp_path):
    assert said(NATIVE, tmp_path)[1] == "before, kept 1\nkept 2\nafter\n"


def test_warp_starts_where_there_is_no_error_output(tmp_path):
    assert said("import os; os.close(2)\n" + EPISODE, tmp_path) == ("", "")


def test_a_script_that_runs_an_episode_prints_nothing(tmp_path):
    assert said(EPISODE, tmp_path) == ("", "")


@pytest.mark.slow
def test_a_script_that_runs_an_episode_prints_nothing_while_kernels_are_compiled(tmp_path):
    assert said(EPISODE, tmp_path, cache=tmp_path) == ("", "")
    assert any((tmp_path / "warp").rglob("*upright_rollout*"))


@pytest.mark.parametrize(
    ("before", "told"),
    [
        ("start_warp()", []),
        ("wp.config.log_level = wp.LOG_DEBUG; start_warp()", ["initialized:", "Module __main__"]),
        ("start_warp(); wp.config.log_level = wp.LOG_INFO; start_warp()", ["Module __main__"]),
    ],
)
def test_modules_are_told_to_those_who_ask_for_them(tmp_path, compiled, before, told):
    out, errors = said(KERNEL.format(before=before), tmp_path, cache=compiled)
    assert errors == ""
    assert bool(out) == bool(told)
    for words in told:
        assert words in out


def test_the_command_line_tells_each_kernel_that_is_compiled(tmp_path):
    out, errors = said(KERNEL.format(before="start_warp(); tell_compilation(print)"), tmp_path, cache=tmp_path)
    assert errors == ""
    assert re.fullmatch(r"compiled __main__ for cpu in \d+\.\d s\n", out)


def test_a_logger_of_ones_own_gets_all_that_warp_says(tmp_path, compiled):
    before = """
class Mine:
    def debug(self, message): print(message)
    info = error = debug
    def warning(self, message, category=None, stacklevel=1): print(message)

wp.set_logger(Mine())
start_warp()
"""
    out, errors = said(KERNEL.format(before=before), tmp_path, cache=compiled)
    assert errors == ""
    assert "initialized:" in out
    assert "Module __main__" in out


def test_warnings_of_warp_are_still_told(tmp_path, compiled):
    after = 'start_warp()\nfrom warp._src.logger import log_warning\nlog_warning("look out")'
    out, errors = said(KERNEL.format(before=after), tmp_path, cache=compiled)
    assert out == ""
    assert "look out" in errors
