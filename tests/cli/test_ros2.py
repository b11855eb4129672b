"""A push through ROS 2: planner and simulated lab in two processes."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from support.pushing import forces
from support.ros2_lab import HERE, new_domain

from oimppi_warp.cli.main import main
from oimppi_warp.record.log import EpisodeLog

FORCE = 20.0
"""Largest force between tool and object of a gentle push [N]."""


@contextmanager
def lab(domain: int, *arguments: str, log: Path) -> Iterator[None]:
    """The command `oimppi ros2 plant` in a process of its own; what it says ends up in ``log``."""
    command = [sys.executable, "-m", "oimppi_warp", "ros2", "plant", *arguments]
    with log.open("w") as said:
        options = ("--domain", str(domain), "--peers", HERE)
        process = subprocess.Popen([*command, *options], stdout=said, stderr=subprocess.STDOUT)
        try:
            until = time.monotonic() + 120.0
            while "Ctrl-C ends it" not in log.read_text():
                assert process.poll() is None, log.read_text()
                assert time.monotonic() < until
                time.sleep(0.1)
            yield
        finally:
            process.terminate()
            process.wait(timeout=30.0)


def push(domain: int, folder: Path, *options: str, seed: int = 0) -> dict:
    """Runs the command `oimppi run` on the topics; the metrics, and the record in ``folder``."""
    run = [sys.executable, "-m", "oimppi_warp", "run", "lab01", "--plant", "ros2", "--device", "cpu"]
    results = ("--record", str(folder), "--json", str(folder / "metrics.json"), "--seed", str(seed))
    topics = ("--plant-options", f"domain={domain}", f"peers={HERE}", *options)
    done = subprocess.run(
        [*run, "--yes", "--resume", *results, *topics], capture_output=True, text=True, timeout=250, check=False
    )
    assert (folder / "metrics.json").exists(), done.stderr
    return json.loads((folder / "metrics.json").read_text()) | {"said": done.stdout + done.stderr}


@pytest.mark.timeout(600)
def test_the_can_of_lab01_is_pushed_to_its_goal_over_ros(tmp_path, capsys):
    domain = new_domain()
    with lab(domain, "lab01", "--start", "0", "--seed", "1", log=tmp_path / "lab.txt"):
        topics = (f"domain={domain}", f"peers={HERE}")
        assert main(["ros2", "check", "--plant-options", *topics]) == 0
        said = capsys.readouterr().out
        assert "object at" in said
        assert "/joint_states" in said
        found = push(domain, tmp_path / "run")
    assert found["success"], found["said"]
    assert found["mode"] == "realtime"
    assert found["detections"] >= 0.5 * found["sim_time_s"], "the camera sees the object about once a second"
    assert found["command_jitter_ms"] < 50.0
    tool, obstacles, arm = forces(tmp_path / "lab.txt")
    assert 0.1 < tool < FORCE
    assert obstacles == arm == 0.0
    assert len(EpisodeLog.load(tmp_path / "run")) == found["steps"]


def test_nobody_is_there(capsys):
    topics = [f"domain={new_domain()}", f"peers={HERE}"]
    assert main(["doctor", "--ros2", "--json", "--plant-options", *topics]) == 1
    (check,) = json.loads(capsys.readouterr().out)
    assert "nothing publishes /joint_states" in check["what"]
    assert check["remedy"]
    assert main(["run", "lab01", "--plant", "ros2", "--yes", "--plant-options", *topics]) == 2
    assert "nothing publishes /joint_states" in capsys.readouterr().err


def test_options_of_other_plants(capsys):
    assert main(["run", "lab01", "--plant", "ros2", "--robot-address", "192.168.1.7"]) == 2
    assert "has no address" in capsys.readouterr().err
    assert main(["run", "lab01", "--plant", "ros2", "--plant-options", "topic=/x"]) == 2
    assert "has no such option" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_lab01_over_ros_succeeds_in_19_of_20_trials(tmp_path):
    """Perception at 1 Hz with the lab's errors; starts and errors by the seeds 0 to 19."""
    rows = []
    for seed in range(20):
        domain, log = new_domain(), tmp_path / f"lab{seed}.txt"
        with lab(domain, "lab01", "--seed", str(seed), log=log):
            found = push(domain, tmp_path / f"run{seed}", seed=seed)
        rows.append((found["success"], found["stops"], found["command_jitter_ms"], *forces(log)))
        print(seed, *rows[-1], flush=True)
    assert sum(row[0] for row in rows) >= 19
    assert max(row[3] for row in rows) < FORCE
    assert max(max(row[4:]) for row in rows) == 0.0
