"""A push through the vendor's SDK: planner and emulated lab in two processes, as on a table with a real arm."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import AbstractContextManager
from pathlib import Path

import pytest
from support.emulated_lab import COMMAND_PORT, POSE_PORT, address
from support.two_processes import assert_19_of_20, assert_gentle_success, command, push, serving

from oimppi_warp.cli.main import main
from oimppi_warp.record.log import EpisodeLog

pytestmark = pytest.mark.realtime


def lab(host: str, *options: str, log: Path) -> AbstractContextManager[None]:
    """The command `oimppi lab-emulator` with lab01."""
    ports = ("--host", host, "--port", str(COMMAND_PORT), "--pose-port", str(POSE_PORT))
    return serving("lab-emulator", "lab01", *ports, *options, sign="listens", log=log)


def addresses(host: str) -> tuple[str, ...]:
    return ("--robot-address", f"{host}:{COMMAND_PORT}", "--pose-address", f"{host}:{POSE_PORT}")


def pushed(host: str, folder: Path, *, seed: int = 0) -> dict:
    return push(folder, "--plant", "xarm", *addresses(host), seed=seed)


@pytest.mark.timeout(600)
def test_the_can_of_lab01_is_pushed_to_its_goal_over_tcp(tmp_path, capsys):
    host, log = address(), tmp_path / "emulator.txt"
    with lab(host, "--start", "0", "--seed", "1", log=log):
        assert main(["doctor", *addresses(host)]) == 0
        assert "firmware 2.5.0" in capsys.readouterr().out
        found = pushed(host, tmp_path / "run")
    assert_gentle_success(found, log)
    assert len(EpisodeLog.load(tmp_path / "run")) == found["steps"]
    assert main(["export", str(tmp_path / "run"), "--to", "usd"]) == 0, "the record replays"


@pytest.mark.timeout(600)
def test_a_signal_to_end_stops_the_arm_and_leaves_the_record(tmp_path):
    host = address()
    with lab(host, "--start", "0", log=tmp_path / "emulator.txt"):
        run = command("run", "lab01", "--plant", "xarm", "--device", "cpu", "--yes", *addresses(host))
        process = subprocess.Popen(
            [*run, "--record", str(tmp_path / "run")], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        from support.emulated_lab import OtherClient

        from oimppi_warp.plants.xarm.protocol import Register

        client, until = OtherClient(host), time.monotonic() + 120.0
        while client.command(Register.GET_STATE)[1] != 1:  # it moves
            assert process.poll() is None
            assert time.monotonic() < until
            time.sleep(0.1)
        time.sleep(8.0)  # it is at its start posture by now, and pushes
        process.send_signal(signal.SIGTERM)
        said, _ = process.communicate(timeout=60.0)
        assert client.command(Register.GET_STATE)[1] == 4
        client.close()
    assert process.returncode == 130, said
    log = EpisodeLog.load(tmp_path / "run")
    assert log.header["ended"] == "interrupted"
    assert len(log) > 10


def test_options_of_an_arm_without_an_arm(capsys):
    assert main(["run", "lab01", "--robot-address", "192.168.1.7"]) == 2
    assert "--plant xarm" in capsys.readouterr().err
    assert main(["run", "lab01", "--plant", "xarm"]) == 2
    assert "--robot-address" in capsys.readouterr().err
    assert main(["run", "lab01", "--plant", "xarm", "--robot-address", "127.0.0.1:1", "--speed", "2"]) == 2
    assert "--speed 2 cannot be used" in capsys.readouterr().err
    assert main(["run", "lab01", "--plant", "xarm", "--robot-address", "127.0.0.1:0"]) == 2
    assert "is no address" in capsys.readouterr().err
    assert main(["lab-emulator", "lab01", "--port", "0"]) == 2


def test_doctor_without_an_arm(capsys):
    assert main(["doctor", "--robot-address", "127.0.0.1:9", "--json"]) == 1
    checks = json.loads(capsys.readouterr().out)
    assert not any(check["good"] for check in checks if "priority" not in check["what"])
    assert all(check["remedy"] for check in checks)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_lab01_over_tcp_succeeds_in_19_of_20_trials(tmp_path):
    """Perception at 1 Hz with the lab's errors; starts and errors by the seeds 0 to 19."""

    def one(seed: int, log: Path):
        host = address()
        made = lab(host, "--seed", str(seed), log=log)
        return made, lambda: pushed(host, tmp_path / f"run{seed}", seed=seed)

    assert_19_of_20(one, tmp_path)


@pytest.mark.slow
@pytest.mark.timeout(6000)
def test_an_hour_of_pushing(tmp_path):
    """Again and again to the goal and back: memory, rows and the controller's watchdog."""
    minutes = float(os.environ.get("OIMPPI_HOUR_MINUTES", "60"))
    code = "import sys; from support.hour import hour; hour(sys.argv[1], float(sys.argv[2]))"
    path = os.pathsep.join(["tests", os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", code, address(), str(60.0 * minutes)],
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    print(done.stdout)
    assert done.returncode == 0, done.stderr[-3000:]
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["grown_mb"] < 50.0
    assert found["rows_missing"] == 0
    assert found["refused"] == 0
    assert found["expired"] == 0
