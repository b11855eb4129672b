"""The command: options, exit status, what it prints and what it writes. The episode is one of our own making."""

from __future__ import annotations

import json
import os
import pty
import signal
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from support.synthetic_episode import make_log, make_scene

from oimppi_warp.cli.main import main
from oimppi_warp.compute.device import CompileNotice, pick_device
from oimppi_warp.config.run_spec import RunSpec
from oimppi_warp.errors import DeviceError, SceneError
from oimppi_warp.record.log import EpisodeLog


class Stage:
    """Stands for everything that the command calls: the scene's loader, its checks and the episode."""

    def __init__(self) -> None:
        self.log = make_log()
        self.asked: dict[str, Any] = {}
        self.problem: BaseException | None = None
        self.planner = SimpleNamespace(engine="quasistatic", engine_reason="a plan takes 9 ms of 50 ms")

    def load_scene(self, name: str) -> Any:
        if self.problem is not None:
            raise self.problem
        return make_scene()

    def sample_start(self, scene: Any, seed: int) -> tuple[float, float, float]:
        return (0.3, -0.4, 0.01 * seed)

    def check_task(self, scene: Any) -> None:
        if scene.start[0] > 1.0:
            raise SceneError("the start is off the table", file="synthetic.usda")

    def setup(self, scene: Any, config: Any, spec: RunSpec) -> Any:
        self.asked = {"scene": scene, "config": config, **asdict(spec)}
        self.config, self.plant = config, None
        return SimpleNamespace(scene=scene, config=config, spec=spec, episode=lambda **_: self)

    def run(self, on_step: Any = None) -> EpisodeLog:
        if on_step is not None:
            on_step(self.log)
        return self.log


@pytest.fixture
def stage(monkeypatch: pytest.MonkeyPatch) -> Stage:
    stage = Stage()
    modules = {
        "usd": {"load_scene": stage.load_scene},
        "geometry.feasibility": {"check_task": stage.check_task, "sample_start": stage.sample_start},
        "runtime.setup": {"Setup": stage.setup},
    }
    for name, content in modules.items():
        monkeypatch.setitem(sys.modules, f"oimppi_warp.{name}", SimpleNamespace(**content))
    return stage


def status(*arguments: object) -> int | str | None:
    try:
        return main([str(argument) for argument in arguments])
    except SystemExit as stop:  # how the parser of the options ends
        return stop.code


def test_success_is_status_0_and_a_summary(stage: Stage, capsys: pytest.CaptureFixture[str]):
    assert status("run", "synthetic", "--device", "cpu") == 0
    out = capsys.readouterr().out
    assert "goal reached" in out
    assert "goal not reached" not in out
    assert "goal reached within 200 mm and 0.5 rad" in out
    assert "median 13.0 ms" in out


def test_the_summary_tells_how_a_success_ended_and_only_stricter_tolerances(
    stage: Stage, capsys: pytest.CaptureFixture[str]
):
    stage.log.header |= {"ended": "object fell", "tight_tolerance": {"position": 0.199, "yaw": 0.499}}
    assert status("run", "synthetic", "--device", "cpu") == 0
    said = capsys.readouterr().out
    assert "goal reached within 200 mm and 0.5 rad, also within 199 mm and 0.499 rad (object fell)" in said
    stage.log.header["tight_tolerance"] = stage.log.header["tolerance"]
    status("run", "synthetic", "--device", "cpu")
    assert "goal reached within 200 mm and 0.5 rad (object fell)" in capsys.readouterr().out


def test_a_goal_that_was_not_reached_is_status_1(stage: Stage, capsys: pytest.CaptureFixture[str]):
    stage.log = make_log(arrive=0.5)
    assert status("run", "synthetic") == 1
    out = capsys.readouterr().out
    assert "goal not reached" in out and "to the goal" not in out


def test_an_interrupted_episode_is_status_130_and_leaves_its_record(stage: Stage, tmp_path: Path):
    stage.log = make_log(steps=7, arrive=0.1)
    stage.log.header["ended"] = "interrupted"
    assert status("run", "synthetic", "--record", tmp_path / "r", "--json", tmp_path / "m.json") == 130
    assert len(EpisodeLog.load(tmp_path / "r")) == 7
    assert json.loads((tmp_path / "m.json").read_text())["ended"] == "interrupted"


def test_ctrl_c_before_the_episode_is_status_130_without_a_traceback(stage: Stage, capsys: pytest.CaptureFixture[str]):
    stage.problem = KeyboardInterrupt()
    assert status("run", "synthetic") == 130
    assert "Traceback" not in capsys.readouterr().err


def test_ctrl_c_that_an_extension_makes_a_system_error_of_is_status_130(
    stage: Stage, capsys: pytest.CaptureFixture[str]
):
    """USD raises one if Ctrl-C comes while one of its functions examines a Python object."""
    made = SystemError("returned a result with an exception set")
    made.__cause__ = KeyboardInterrupt()
    refused = SceneError("the file cannot be read")  # by a reader that catches every exception
    refused.__context__ = made
    for stage.problem in (made, refused):
        assert status("run", "synthetic") == 130
        assert capsys.readouterr().err == "oimppi: interrupted\n"
    stage.problem = SceneError("the record cannot be written")
    stage.problem.__context__ = KeyboardInterrupt()
    assert status("run", "synthetic") == 2, "what fails after Ctrl-C is told"
    assert "cannot be written" in capsys.readouterr().err


def test_record_and_json_hold_log_plots_and_metrics(stage: Stage, tmp_path: Path):
    assert status("run", "synthetic", "--record", tmp_path / "r", "--json", tmp_path / "m.json") == 0
    names = {path.name for path in (tmp_path / "r").iterdir()}
    assert names == {"episode.npz", "episode.json", "way.png", "errors.png", "plan_times.png"}
    assert json.loads((tmp_path / "m.json").read_text())["success"] is True


@pytest.mark.parametrize(("options", "preset"), [((), "best"), (("--plant", "lab"), "lab"),
                                                 (("--plant", "lab", "--preset", "best"), "best"),
                                                 (("--mode", "realtime"), "best")])  # fmt: skip
def test_the_lab_has_a_preset_of_its_own(stage: Stage, options: tuple[str, ...], preset: str):
    status("run", "synthetic", *options)
    assert stage.asked["config"].preset == preset
    given = dict(zip(options[::2], options[1::2], strict=True))
    assert stage.asked["plant"] == given.get("--plant", "ideal")
    assert stage.asked["mode"] == given.get("--mode", "lockstep")


def test_options_reach_the_episode(stage: Stage, capsys: pytest.CaptureFixture[str]):
    status(
        *("run", "synthetic", "--method", "soi", "--seed", "4", "--device", "cpu", "--preset", "paper"),
        *("--engine", "newton", "--threads", "3", "--randomize"),
        *("--set", "cost.w_align=3", "robot.optimizer.samples=64", "--set", "reference=progress"),
        *("--goal", "-0.1,0.2,-3", "--max-sim-seconds", "12", "--tolerance", "0.01,0.05"),
    )
    config = stage.asked["config"]
    assert (stage.asked["method"], stage.asked["seed"], stage.asked["device"]) == ("soi", 4, "cpu")
    assert (stage.asked["engine"], stage.asked["threads"]) == ("newton", 3)
    assert "engine quasistatic: a plan takes 9 ms of 50 ms" in capsys.readouterr().err
    assert config.robot.uncertainty.draws == 4
    assert (config.preset, config.object.optimizer.horizon) == ("paper", 90)
    assert (config.cost.w_align, config.robot.optimizer.samples, config.reference) == (3.0, 64, "progress")
    assert (config.episode.max_sim_seconds, config.episode.tolerance) == (12.0, (0.01, 0.05))
    assert stage.asked["scene"].goal == (-0.1, 0.2, -3.0)


@pytest.mark.parametrize(
    ("options", "start"),
    [
        (["--seed", "7"], (0.3, -0.4, 0.07)),
        (["--start", "1", "--seed", "7"], (0.32, -0.43, 0.1)),
        (["--start", "-0.1,0.2,3"], (-0.1, 0.2, 3.0)),
    ],
)
def test_the_start_is_drawn_by_the_seed_unless_one_is_given(
    stage: Stage, options: list[str], start: tuple[float, float, float]
):
    status("run", "synthetic", *options)
    assert stage.asked["scene"].start == pytest.approx(start)


OPTIONS = ("method", "engine", "device", "threads", "seed", "start", "goal", "preset", "set", "plant", "mode",
           "randomize", "max-sim-seconds", "record", "json")  # fmt: skip

BAD_INPUT = {
    "no command": ([], "run"),
    "unknown command": (["runn", "task02"], "oimppi has no command 'runn'"),
    "unknown command of a group": (["scene", "nwe"], "did you mean new?"),
    "no scene": (["run"], "SCENE"),
    "unknown option": (["run", "t", "--metod", "soi"], "--method"),
    "unknown method": (["run", "t", "--method", "sio"], "did you mean soi?"),
    "unknown plant": (["run", "t", "--plant", "idael"], "did you mean ideal?"),
    "plant of a file that is missing": (["run", "t", "--plant", "nowhere.py:Arm"], "there is no file nowhere.py"),
    "unknown preset": (["run", "t", "--preset", "bset"], "paper"),
    "seed that is no number": (["run", "t", "--seed", "x"], "--seed"),
    "negative seed": (["run", "t", "--seed", "-1"], "0 to 4294967295"),
    "threads that are no number": (["run", "t", "--threads", "two"], "--threads: two is not a whole number"),
    "friction that is no number": (["run", "t", "--friction", "low"], "--friction: low is not a number"),
    "knock with a word": (["run", "t", "--knock", "1", "2", "x"], "--knock: x is not a number"),
    "knock with two numbers": (["run", "t", "--knock", "1", "2"], "Expected 3 values"),
    "no threads": (["run", "t", "--threads", "0"], "1 or more"),
    "unknown engine": (["run", "t", "--engine", "bullet"], "newton"),
    "unknown setting": (["run", "t", "--set", "cost.w_aling=2"], "cost.w_align"),
    "no samples": (["run", "t", "--set", "robot.optimizer.samples=0"], "robot.optimizer.samples = 0"),
    "no horizon": (["run", "t", "--set", "object.optimizer.horizon=0"], "object.optimizer.horizon = 0"),
    "no time": (["run", "t", "--max-sim-seconds", "0"], "max_sim_seconds"),
    "goal that is no pose": (["run", "t", "--goal", "1,2"], "x,y,yaw"),
    "goal that is not finite": (["run", "t", "--goal", "nan,0,0"], "x,y,yaw"),
    "start that is no pose": (
        ["run", "t", "--start", "here"],
        "of a start listed in the scene, or x,y,yaw",
    ),
    "start that the scene has not": (["run", "t", "--start", "10"], "0 to 1"),
    "start off the table": (["run", "t", "--start", "2,0,0"], "off the table"),
    "start for a plant that has its own": (
        ["run", "t", "--plant", "pusht", "--start", "0"],
        "choose a start with --seed",
    ),
    "plant option that is none": (["run", "t", "--plant-options", "fast"], "NAME=VALUE"),
    "no tolerance": (["run", "t", "--tolerance", "5mm,0.02"], "--tolerance 5mm,0.02: not a tolerance"),
    "tolerance in mm": (["run", "t", "--tolerance", "5,1"], "above 0, up to 0.5 and 3.14"),
    "tolerance of nothing": (["run", "t", "--tolerance", "0,0.02"], "e.g. 0.005,0.02"),
    "device that is not there": (["run", "t", "--device", "cuda:99"], "auto, cpu"),
    "folder that cannot be made": (["run", "t", "--json", "/dev/null/m.json"], "/dev/null is not a writable folder"),
    "record into a file": (["run", "t", "--record", __file__], "not a writable folder"),
}


def test_a_misspelt_option_is_searched_among_those_of_the_command(capsys: pytest.CaptureFixture[str]):
    assert status("run", "t", "--metod", "soi") == 2
    said = capsys.readouterr().err
    assert "--method" in said and "demos" not in said and "oimppi run --help" in said


@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("words", ["run --help", "scenes", "scene check task01", "compare {0} {0}"])
def test_output_that_nobody_reads_to_the_end_ends_in_silence(words: str, unbuffered: str):
    results = Path(__file__).resolve().parents[2] / "docs" / "results" / "newton.json"
    command = f"{sys.executable} -m oimppi_warp {words.format(results)}; echo status $? >&2"
    environment = os.environ | {"PYTHONUNBUFFERED": unbuffered}
    pipe = ["sh", "-c", f"({command}) | true"]
    said = subprocess.run(pipe, env=environment, capture_output=True, text=True, check=False).stderr
    assert "status 141" in said and "Broken" not in said and "Exception" not in said


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_a_run_like_ctrl_c_with_a_complete_record(number: signal.Signals, tmp_path: Path):
    leader, follower = pty.openpty()
    command = [sys.executable, "-m", "oimppi_warp", "run", "task01", "--seed", "1", "--engine", "quasistatic"]
    command += ["--device", "cpu", "--threads", "1", "--tolerance", "0.0001,0.0001", "--max-sim-seconds", "500"]
    ended = subprocess.Popen(
        [*command, "--record", str(tmp_path / "r")],
        stdin=follower,
        stdout=follower,
        stderr=follower,
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),  # the tests may run under `nohup`
    )
    os.close(follower)
    shown = b""
    while b"ms per plan" not in shown:  # the progress of the episode
        shown += os.read(leader, 4096)
    if number == signal.SIGHUP:
        os.close(leader)  # the terminal is gone
    ended.send_signal(number)
    gone = number == signal.SIGHUP  # writing to the terminal may fail before the signal comes
    assert ended.wait(timeout=60) in ((130, 141) if gone else (130,))
    assert EpisodeLog.load(tmp_path / "r").header["ended"] == "interrupted"
    if number != signal.SIGHUP:
        os.close(leader)


@pytest.mark.parametrize("case", BAD_INPUT)
def test_bad_input_is_status_2_with_one_message_and_nothing_written(
    stage: Stage, case: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    arguments, said = BAD_INPUT[case]
    outputs = [] if {"--record", "--json"} & set(arguments) or len(arguments) < 2 else ["--record", "r", "--json", "m"]
    assert status(*arguments, *outputs) == 2
    captured = capsys.readouterr()
    assert said in captured.err
    assert "Traceback" not in captured.err
    assert captured.out == ""
    assert list(tmp_path.iterdir()) == []
    assert stage.asked == {}


def test_a_scene_that_cannot_be_run_is_status_2_with_its_own_words(stage: Stage, capsys: pytest.CaptureFixture[str]):
    stage.problem = SceneError("no robot", file="a.usda", prim="/World", fix="reference one")
    assert status("run", "a.usda") == 2
    assert capsys.readouterr().err == "oimppi: a.usda </World>: no robot\n  to do:   reference one\n"


def test_scenes_lists_every_shipped_scene_with_a_line(capsys: pytest.CaptureFixture[str]):
    assert status("scenes") == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.strip()]
    names = [line.split()[0] for line in lines]
    assert {"task01", "task02", "task03", "task03_wide", "task04", "task05", "lab01", "lab02"} <= set(names)
    assert all(len(line.split()) > 3 for line in lines)


def test_auto_picks_a_device_that_is_there():
    assert pick_device("auto") in ("cpu", "cuda:0")
    assert pick_device("cpu") == "cpu"
    with pytest.raises(DeviceError, match="allowed: auto, cpu"):
        pick_device("gpu")


def test_a_compiled_module_is_told_in_one_line():
    said: list[str] = []
    notice = CompileNotice(said.append)
    notice.info("Warp 1.19.0 initialized:")
    notice.info("Module oimppi_warp.kernels.costs.stage_costs 1a2b3c4 load on device 'cpu' took 3.10 ms  (cached)")
    notice.info("Module oimppi_warp.kernels.costs.stage_costs 1a2b3c4 load on device 'cpu' took 2345.60 ms  (compiled)")
    assert said == ["compiled oimppi_warp.kernels.costs.stage_costs for cpu in 2.3 s"]


def test_help_explains_every_option(capsys: pytest.CaptureFixture[str]):
    assert status("run", "--help") == 0
    out = capsys.readouterr().out
    for option in OPTIONS:
        assert f"--{option} " in out
