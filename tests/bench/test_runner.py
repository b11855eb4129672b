"""Running a suite: in parallel, resumed, killed, with trials that raise, and each trial again on its own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.synthetic_episode import make_log

from oimppi_warp.bench import worker
from oimppi_warp.bench.films import write_films
from oimppi_warp.bench.results import load_results
from oimppi_warp.bench.runner import BenchError, SuiteRun, cluster_backend
from oimppi_warp.bench.suite import Suite, load_suite
from oimppi_warp.bench.trial import Trial
from oimppi_warp.cli.main import main
from oimppi_warp.errors import ConfigError
from oimppi_warp.record.log import EpisodeLog

ROOT = Path(__file__).resolve().parents[2]

FEW = """
tasks = ["task01"]
methods = ["mppi", "soi"]
trials = 3
"""

TINY = """
tasks = ["task02"]
methods = ["cloi", "soi"]
trials = 2
max_sim_seconds = 0.4
set = ["robot.optimizer.samples=64", "object.optimizer.samples=64", "object.plan_steps=20"]
"""


def suite_of(folder: Path, text: str) -> Suite:
    (folder / "mine.toml").write_text(text)
    return load_suite(folder / "mine.toml")


class Episodes:
    """Stands for the episodes of all trials; what is in ``acts`` happens in the trial of that name."""

    def __init__(self) -> None:
        self.ran: list[tuple[str, str, int]] = []
        self.acts: dict[tuple[str, int], Any] = {}

    def make(self, trial: Trial) -> Any:
        self.ran.append((trial.task, trial.run.method, trial.number))

        def run() -> EpisodeLog:
            act = self.acts.get((trial.run.method, trial.number))
            if isinstance(act, Exception):
                raise act
            log = make_log(steps=80, method=trial.run.method, arrive=0.5 if act == "fail" else 1.0)
            if act == "interrupt":
                log.header["ended"] = "interrupted"
            return log

        return SimpleNamespace(run=run)


@pytest.fixture
def episodes(monkeypatch: pytest.MonkeyPatch) -> Episodes:
    episodes = Episodes()
    monkeypatch.setattr(worker, "make_episode", episodes.make)
    return episodes


def test_a_second_run_runs_nothing(episodes: Episodes, tmp_path: Path):
    suite = suite_of(tmp_path, FEW)
    first = SuiteRun(suite, tmp_path / "out").execute(jobs=1)
    assert len(episodes.ran) == len(first.results) == 6
    again = SuiteRun(suite, tmp_path / "out")
    assert again.pending == []
    assert again.execute(jobs=1) == first
    assert len(episodes.ran) == 6
    assert load_results(tmp_path / "out").results == first.results


def test_ctrl_c_keeps_what_is_finished_and_the_next_run_does_the_rest(episodes: Episodes, tmp_path: Path):
    suite = suite_of(tmp_path, FEW)
    episodes.acts["soi", 1] = "interrupt"
    with pytest.raises(KeyboardInterrupt):
        SuiteRun(suite, tmp_path / "out").execute(jobs=1)
    kept = load_results(tmp_path / "out")
    assert (len(kept.results), kept.planned) == (len(episodes.ran) - 1, 6)
    before = list(episodes.ran)
    episodes.acts.clear()
    assert len(SuiteRun(suite, tmp_path / "out").execute(jobs=1).results) == 6
    assert sorted(before[:-1] + episodes.ran[len(before) :]) == sorted({*before, *episodes.ran})


def test_a_trial_that_raises_is_recorded_and_does_not_end_the_suite(episodes: Episodes, tmp_path: Path):
    suite = suite_of(tmp_path, FEW)
    episodes.acts["mppi", 1] = RuntimeError(f"something in {ROOT} broke\n  to do:   mend it")
    results = SuiteRun(suite, tmp_path / "out").execute(jobs=1)
    (failed,) = [result for result in results.results if result.error]
    assert (failed.run.method, failed.number, failed.success) == ("mppi", 1, False)
    assert failed.error.startswith("Traceback")
    assert str(ROOT) not in failed.error
    assert failed.evidence == "RuntimeError: something in . broke"
    assert len(results.results) == 6

    episodes.acts.clear()
    assert SuiteRun(suite, tmp_path / "out").pending == []  # it is finished, too
    retried = SuiteRun(suite, tmp_path / "out", retry=True)
    assert [(trial.run.method, trial.number) for trial in retried.pending] == [("mppi", 1)]
    assert all(result.success for result in retried.execute(jobs=1).results)


def test_a_changed_setting_is_a_new_trial_and_nothing_is_mixed(episodes: Episodes, tmp_path: Path):
    SuiteRun(suite_of(tmp_path, FEW), tmp_path / "out").execute(jobs=1)
    changed = SuiteRun(suite_of(tmp_path, FEW + 'set = ["cost.w_d=3"]\n'), tmp_path / "out")
    assert len(changed.pending) == 6
    results = changed.execute(jobs=1)
    assert len(results.results) == 6
    assert all("cost.w_d=3" in result.command for result in results.results)
    more = SuiteRun(suite_of(tmp_path, FEW.replace("3", "4")), tmp_path / "out")
    assert [trial.number for trial in more.pending] == [3, 3]


def test_a_trial_whose_file_is_broken_runs_again(episodes: Episodes, tmp_path: Path):
    suite = suite_of(tmp_path, FEW)
    SuiteRun(suite, tmp_path / "out").execute(jobs=1)
    broken, gone, *_ = sorted((tmp_path / "out" / "trials").iterdir())
    (broken / "trial.json").write_text('{"trial": ')
    (gone / "trial.json").unlink()
    assert len(SuiteRun(suite, tmp_path / "out").pending) == 2


def test_every_trial_has_its_record_and_no_half_written_file(episodes: Episodes, tmp_path: Path):
    episodes.acts["soi", 0] = "fail"
    run = SuiteRun(suite_of(tmp_path, FEW), tmp_path / "out")
    results = run.execute(jobs=1)
    for trial, result in zip(run.trials, results.results, strict=True):
        folder = tmp_path / "out" / "trials" / trial.name
        assert {path.name for path in folder.iterdir()} == {"episode.npz", "episode.json", "trial.json"}
        assert len(EpisodeLog.load(folder)) == 80
        facts = json.loads((folder / "trial.json").read_text())
        assert facts["result"]["command"] == trial.command
        assert bool(result.cause) is (not result.success)
    assert [result.number for result in results.results if not result.success] == [0]


def test_the_fastest_success_and_every_failure_are_filmed(episodes: Episodes, tmp_path: Path):
    episodes.acts = {("mppi", 1): "fail", ("soi", 0): "fail", ("soi", 2): RuntimeError("no")}
    run = SuiteRun(suite_of(tmp_path, FEW), tmp_path / "out")
    run.execute(jobs=1)
    files = write_films(run)
    names = sorted("-".join(file.name.split("-")[:4]) for file in files)
    assert names == [
        "failed-task01-mppi-001",
        "failed-task01-soi-000",
        "fastest-task01-mppi-000",
        "fastest-task01-soi-001",
    ]
    assert all(file.read_bytes()[:6] == b"GIF89a" for file in files)
    files[0].write_bytes(b"kept")
    assert write_films(run) == files and files[0].read_bytes() == b"kept"


def test_trials_in_real_time_come_last_and_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    text = FEW + '[[entry]]\nmode = "realtime"\nlabel = "clock"\n[[entry]]\n'
    run = SuiteRun(suite_of(tmp_path, text), tmp_path / "out")
    assert [trial.real_time for trial in run.pending] == [False] * 6 + [True] * 6
    asked = []

    def outcomes(trials: list[Trial], *, jobs: int, backend: str) -> list[Any]:
        asked.append(({trial.real_time for trial in trials}, jobs))
        return []

    monkeypatch.setattr("oimppi_warp.bench.runner._outcomes", outcomes)
    run.execute()
    run.execute(jobs=3)
    assert asked == [({False}, -1), ({True}, 1), ({False}, 3), ({True}, 3)]


def test_trials_in_parallel_can_each_be_run_again_with_the_same_result_to_the_bit(tmp_path: Path):
    run = SuiteRun(suite_of(tmp_path, TINY.replace("trials = 2", "trials = 1")), tmp_path / "out")
    results = run.execute(jobs=2)
    assert [result.error for result in results.results] == ["", ""]
    for trial in run.trials:
        assert main([*trial.arguments, "--record", str(tmp_path / trial.name)]) == 1  # half a second is not enough
        first, second = (
            EpisodeLog.load(tmp_path / "out" / "trials" / trial.name),
            EpisodeLog.load(tmp_path / trial.name),
        )
        assert len(first) == len(second) == 8
        for name in ("command", "object_pose", "joint_position", "min_cost", "contact_robot_obstacle"):
            np.testing.assert_array_equal(first[name], second[name])
        assert first.header["config"] == second.header["config"]


def test_a_killed_run_loses_no_finished_trial(tmp_path: Path):
    suite = suite_of(tmp_path, TINY.replace("trials = 2", "trials = 3"))
    out = tmp_path / "out"
    command = [sys.executable, "-m", "oimppi_warp", "bench", str(suite.file), "--out", str(out), "--jobs", "1"]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    while not (finished := list(out.glob("trials/*/trial.json"))) and process.poll() is None:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.kill()
    assert process.wait() == -signal.SIGKILL
    finished = list(out.glob("trials/*/trial.json"))
    assert 1 <= len(finished) < 6
    content = {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in finished}
    for path in finished:
        EpisodeLog.load(path.parent)

    run = SuiteRun(suite, out)
    assert len(run.pending) == 6 - len(finished)
    assert len(run.execute(jobs=1).results) == 6
    assert {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in finished} == content


def test_a_worker_that_dies_again_and_again_ends_the_suite_with_a_word(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("oimppi_warp.bench.runner.run_trial", die)
    with pytest.raises(BenchError, match="died twice"):
        SuiteRun(suite_of(tmp_path, FEW), tmp_path / "out").execute(jobs=2)


def die(trial: Trial, leader: int) -> None:
    assert os.getpid() != leader
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_local_cluster_of_dask_runs_trials(tmp_path: Path):
    pytest.importorskip("distributed")
    suite = suite_of(tmp_path, TINY.replace("trials = 2", "trials = 1")).only(methods=("cloi",))
    (there,) = SuiteRun(suite, tmp_path / "dask").execute(jobs=1, backend="dask").results
    (here,) = SuiteRun(suite, tmp_path / "here").execute(jobs=1).results
    assert there.error == ""
    assert len(there.pose) == 8
    assert there.pose == here.pose


def test_a_backend_that_is_not_installed_says_what_to_install(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(ConfigError, match=r"pip install 'oimppi-warp\[cluster\]'"),
        cluster_backend("dask", "", 1),
    ):
        pass


def test_the_command_writes_results_and_a_report(
    episodes: Episodes, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("oimppi_warp.bench.runner.prepare", lambda trials: None)
    suite = suite_of(tmp_path, FEW)
    episodes.acts["mppi", 0] = "fail"
    folder = tmp_path / "out"
    command = ["bench", str(suite.file), "--out", str(folder), "--jobs", "1", "--trials", "2", "--methods", "mppi"]
    assert main(command) == 0
    printed = capsys.readouterr().out
    assert "1/2" in printed
    assert "9 to 91 %" in printed
    assert "time [s]" in printed
    assert {path.name for path in folder.iterdir()} == {
        "trials",
        "results.json",
        "report.html",
        "report.md",
        "pictures",
    }

    assert main(["report", str(folder / "results.json"), "--out", str(tmp_path / "again")]) == 0
    assert (tmp_path / "again" / "report.html").read_bytes() == (folder / "report.html").read_bytes()

    episodes.acts.clear()
    other = [*command, "--set", "cost.w_d=3"]
    other[3] = str(tmp_path / "other")
    assert main(other) == 0
    capsys.readouterr()
    assert main(["compare", str(folder), str(tmp_path / "other"), "--out", str(tmp_path / "c.md")]) == 0
    printed = capsys.readouterr().out
    assert "only A" in printed and "oimppi run task01 --method mppi" in printed
    assert "Pairs that differ" in (tmp_path / "c.md").read_text()


def test_a_trial_that_raised_is_status_1(episodes: Episodes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("oimppi_warp.bench.runner.prepare", lambda trials: None)
    suite = suite_of(tmp_path, FEW)
    episodes.acts["mppi", 0] = RuntimeError("broken")
    command = ["bench", str(suite.file), "--out", str(tmp_path / "o"), "--jobs", "1", "--no-report"]
    assert main(command) == 1
    episodes.acts["soi", 2] = "interrupt"
    assert main([*command, "--set", "cost.w_d=3"]) == 130


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["bench", "smok"], "did you mean smoke?"),
        (["bench", "smoke", "--jobs", "0"], "1 or more"),
        (["bench", "smoke", "--trials", "0"], "an integer from 1"),
        (["bench", "smoke", "--seed", "4294967296"], "an integer from 0 to 4294967295"),
        (["bench", "smoke", "--first", "999999", "--trials", "2"], "first + trials up to 1000000"),
        (["run", "task01", "--seed", "4294967296"], "allowed: 0 to 4294967295"),
        (["bench", "smoke", "--tasks", "task05"], "allowed: task01, task02"),
        (["bench", "smoke", "--set", "cost.w_aling=2"], "did you mean cost.w_align"),
        (["bench", "smoke", "--methods", "mppi,soi"], "put spaces between names, not commas"),
        (["bench", "smoke", "--tolerance", "5,1"], "above 0, up to 0.5 and 3.14"),
        (["bench", "smoke", "--cluster", "somewhere:1"], "--backend dask"),
        (["report", "nowhere"], "there is no such file or folder\n  allowed: a folder written by oimppi bench"),
        (["compare", "nowhere", "nowhere"], "results.json"),
    ],
)
def test_bad_options_are_status_2_and_nothing_is_written(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert said in captured.err
    assert "Traceback" not in captured.err
    assert list(tmp_path.iterdir()) == []


def test_a_plant_whose_package_is_missing_is_reported_before_any_trial(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setitem(sys.modules, "gym_pusht", None)  # importing it raises ModuleNotFoundError
    assert main(["bench", "pusht", "--trials", "1", "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "gym_pusht is not installed" in said and "pip install 'oimppi-warp[pusht]'" in said
    assert not (tmp_path / "out").exists()


def test_without_a_suite_the_shipped_ones_are_listed(capsys: pytest.CaptureFixture[str]):
    assert main(["bench"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in ("best-sim", "lab", "paper-sim", "smoke"))
