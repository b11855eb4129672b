"""The check of a GPU: it ends in time whatever hangs, and a second run takes only what the first one missed."""

from __future__ import annotations

import json
import random
import re
import sys
import time
from argparse import Namespace
from pathlib import Path

import pytest

TOOLS = Path(__file__).parents[2] / "tools"

STEPS = """
import json, pathlib, sys, time
step, out = sys.argv[1], pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
count = pathlib.Path(__file__).with_name("runs.txt")
with count.open("a") as stream:
    stream.write(step + "\\n")
out.write_text(json.dumps({"problems": [], "first": 1.0}))
if step == "hangs" and not pathlib.Path(__file__).with_name("mended").exists():
    import subprocess
    subprocess.run([sys.executable, "-c", "import time; time.sleep(600)"])
if step == "wrong":
    out.write_text(json.dumps({"problems": ["off by 2"]}))
sys.exit(3 if step == "fails" else 0)
"""


@pytest.fixture
def tools(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(TOOLS))
    import gpu_check
    import gpu_pack
    import gpu_steps

    return Namespace(check=gpu_check, pack=gpu_pack, steps=gpu_steps)


@pytest.fixture
def place(tools, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in the project's place, with steps that behave as their names say."""
    (tmp_path / "tools").mkdir()
    (tmp_path / "tools" / "gpu_steps.py").write_text(STEPS)
    monkeypatch.setattr(tools.check, "ROOT", tmp_path)
    monkeypatch.setattr(tools.check, "STEPS", {"well": 60, "hangs": 3, "fails": 60, "wrong": 60})
    return tmp_path


def options(place: Path, **changes) -> Namespace:
    usual = {"out": place / "out", "parts": None, "work": place / "work", "budget": 60.0, "device": "cuda:0"}
    (place / "work").mkdir(exist_ok=True)
    return Namespace(**usual | {"resume": None, "small": False, "steps": None} | changes)


def test_a_step_that_hangs_is_ended_with_its_children_and_the_others_run(tools, place):
    began = time.monotonic()
    record = tools.check.check(options(place))
    assert time.monotonic() - began < 30.0
    ended = {name: step["ended"] for name, step in record["steps"].items()}
    assert ended == {"well": "done", "hangs": "ended after 3 s", "fails": "exit status 3", "wrong": "done"}
    assert record["steps"]["hangs"]["found"] == {"problems": [], "first": 1.0}, "what it had found by then"
    assert json.loads((place / "out" / "gpu.json").read_text())["steps"] == record["steps"]


def test_a_second_run_takes_only_what_is_missing(tools, place):
    tools.check.check(options(place))
    (place / "tools" / "mended").touch()
    runs = place / "tools" / "runs.txt"
    runs.unlink()
    record = tools.check.check(options(place, out=place / "again"))
    assert runs.read_text().split() == ["hangs", "fails"]
    assert record["steps"]["hangs"]["ended"] == "done" and record["steps"]["well"]["ended"] == "done"
    runs.unlink()
    (place / "work" / "gpu.json").unlink()  # another machine, as bare as the first
    tools.check.check(options(place, resume=place / "again" / "gpu.json"))
    assert runs.read_text().split() == ["fails"]


def test_no_step_begins_without_time(tools, place):
    record = tools.check.check(options(place, budget=5.0))
    assert {step["ended"] for step in record["steps"].values()} == {"no time was left"}
    assert not (place / "tools" / "runs.txt").exists()


@pytest.mark.parametrize(("steps", "status"), [({"well": 60}, 0), ({"well": 60, "wrong": 60}, 1), ({"fails": 60}, 1)])
def test_the_table_ends_with_the_problems(tools, place, monkeypatch, capsys, steps, status):
    monkeypatch.setattr(tools.check, "STEPS", steps)
    monkeypatch.setattr(sys, "argv", ["gpu_check.py", "--out", str(place / "out"), "--work", str(place / "work")])
    (place / "work").mkdir()
    assert tools.check.main() == status
    out = capsys.readouterr().out
    assert ("no problems" in out) == (status == 0)
    assert ("wrong: off by 2" in out) == ("wrong" in steps)
    assert ("fails: exit status 3" in out) == ("fails" in steps)


def test_every_step_exists_and_every_package_is_pinned(tools):
    assert all(callable(getattr(tools.steps, name)) for name in tools.check.STEPS)
    lock = TOOLS.parent / "requirements.lock"
    entries = tools.pack.pinned(lock, tools.pack.PACKAGES)
    assert all(f"\n{name}==" in f"\n{entries}" for name in tools.pack.PACKAGES)
    assert entries.count("--hash=sha256:") >= len(tools.pack.PACKAGES)
    with pytest.raises(ValueError, match="no entry for torch"):
        tools.pack.pinned(lock, ("torch",))


def test_a_profile_is_read_from_the_profilers_table(tools):
    table = '==PROF== Connected\n"ID","Kernel Name","gpu__time_duration.sum"\n"","","us"\n"0","rollout","41.5"\n'
    assert tools.steps._profiled(table) == {"0 rollout": {"gpu__time_duration.sum": "41.5 us"}}
    assert tools.steps._profiled("no permission") == "no permission"


def test_parts_are_put_together_again(tools, tmp_path, monkeypatch):
    monkeypatch.setattr(tools.pack, "PART", 2000)
    root, out = tmp_path / "root", tmp_path / "out"
    (root / "site").mkdir(parents=True)
    out.mkdir()
    data = random.Random(1).randbytes(5000)
    (root / "site" / "library.so").write_bytes(data)
    parts = tools.pack.compress(root, out, level=1)
    assert [part.name for part in parts] == ["part-aa", "part-ab", "part-ac"]
    tools.check.unpack(out, tmp_path / "work")
    assert (tmp_path / "work" / "site" / "library.so").read_bytes() == data
    with pytest.raises(FileNotFoundError, match="gpu_pack"):
        tools.check.unpack(tmp_path / "nothing", tmp_path / "other")


def test_every_package_of_the_lock_is_packed_or_expected_there_or_left_out_on_purpose(tools):
    import gpu_rehearsal

    lock = (TOOLS.parent / "requirements.lock").read_text()
    names = {re.split(r"[=\[ ]", line, maxsplit=1)[0] for line in lock.splitlines() if re.match(r"\w", line)}
    places = [set(tools.pack.PACKAGES), set(gpu_rehearsal.EXPECTED), set(tools.pack.LEFT_OUT)]
    assert set.union(*places) == names
    assert sum(map(len, places)) == len(names)


def test_launches_of_a_kernel_are_added_up_the_longest_first(tools):
    found = {
        "0 short": {"gpu__time_duration.sum": "1,500 ns"},
        "1 long": {"gpu__time_duration.sum": "4,000 ns"},
        "2 short": {"gpu__time_duration.sum": "1,000 ns"},
    }
    sums = tools.steps._per_kernel(found)
    assert list(sums.items()) == [("long", {"launches": 1, "us": 4.0}), ("short", {"launches": 2, "us": 2.5})]
    assert tools.steps._per_kernel("no table") == "no table"
