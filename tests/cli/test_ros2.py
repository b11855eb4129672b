"""A push through ROS 2: planner and simulated lab in two processes."""

from __future__ import annotations

import json
from contextlib import AbstractContextManager
from pathlib import Path

import pytest
from support.ros2_lab import HERE, new_domain
from support.two_processes import assert_19_of_20, assert_gentle_success, push, serving

from oimppi_warp.cli.main import main
from oimppi_warp.record.log import EpisodeLog

pytestmark = pytest.mark.realtime


def lab(domain: int, *options: str, log: Path) -> AbstractContextManager[None]:
    """The command `oimppi ros2 plant` with lab01."""
    topics = ("--domain", str(domain), "--peers", HERE)
    return serving("ros2", "plant", "lab01", *topics, *options, sign="Ctrl-C ends it", log=log)


def pushed(domain: int, folder: Path, *, seed: int = 0) -> dict:
    return push(folder, "--plant", "ros2", "--plant-options", f"domain={domain}", f"peers={HERE}", seed=seed)


@pytest.mark.timeout(600)
def test_the_can_of_lab01_is_pushed_to_its_goal_over_ros(tmp_path, capsys):
    domain, log = new_domain(), tmp_path / "lab.txt"
    with lab(domain, "--start", "0", "--seed", "1", log=log):
        assert main(["ros2", "check", "--plant-options", f"domain={domain}", f"peers={HERE}"]) == 0
        said = capsys.readouterr().out
        assert "object at" in said
        assert "/joint_states" in said
        found = pushed(domain, tmp_path / "run")
    assert_gentle_success(found, log)
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

    def one(seed: int, log: Path):
        domain = new_domain()
        return lab(domain, "--seed", str(seed), log=log), lambda: pushed(domain, tmp_path / f"run{seed}", seed=seed)

    assert_19_of_20(one, tmp_path)
