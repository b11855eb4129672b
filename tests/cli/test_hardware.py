"""A push through the vendor's SDK: planner and emulated lab in two processes, as on a table with a real arm."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from support.emulated_lab import COMMAND_PORT, POSE_PORT, address
from support.pushing import forces

from oimppi_warp.cli.main import main
from oimppi_warp.record.log import EpisodeLog

FORCE = 20.0
"""Largest force between tool and object of a gentle push [N]."""


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "oimppi_warp", *arguments]


@contextmanager
def emulator(host: str, *arguments: str, log: Path) -> Iterator[None]:
    """The command `oimppi lab-emulator` in a process of its own; what it says ends up in ``log``."""
    ports = ("--host", host, "--port", str(COMMAND_PORT), "--pose-port", str(POSE_PORT))
    with log.open("w") as said:
        process = subprocess.Popen(command("lab-emulator", *arguments, *ports), stdout=said, stderr=subprocess.STDOUT)
        try:
            until = time.monotonic() + 120.0
            while "listens" not in log.read_text():
                assert process.poll() is None, log.read_text()
                assert time.monotonic() < until
                time.sleep(0.1)
            yield
        finally:
            process.terminate()
            process.wait(timeout=30.0)


def push(host: str, folder: Path, *options: str, seed: int = 0) -> dict:
    """Runs the command `oimppi run` on the emulator; the metrics, and the record in ``folder``."""
    addresses = ("--robot-address", f"{host}:{COMMAND_PORT}", "--pose-address", f"{host}:{POSE_PORT}")
    results = ("--record", str(folder), "--json", str(folder / "metrics.json"), "--seed", str(seed))
    run = command("run", "lab01", "--plant", "xarm", "--device", "cpu", *addresses, *results, *options)
    done = subprocess.run(run, capture_output=True, text=True, timeout=250, check=False)
    assert (folder / "metrics.json").exists(), done.stderr
    return json.loads((folder / "metrics.json").read_text()) | {"said": done.stdout + done.stderr}


@pytest.mark.timeout(600)
def test_the_can_of_lab01_is_pushed_to_its_goal_over_tcp(tmp_path, capsys):
    host = address()
    with emulator(host, "lab01", "--start", "0", "--seed", "1", log=tmp_path / "emulator.txt"):
        assert (
            main(["doctor", "--robot-address", f"{host}:{COMMAND_PORT}", "--pose-address", f"{host}:{POSE_PORT}"]) == 0
        )
        assert "firmware 2.5.0" in capsys.readouterr().out
        found = push(host, tmp_path / "run", "--yes", "--resume")
    assert found["success"], found["said"]
    assert found["mode"] == "realtime"
    assert found["detections"] >= 0.5 * found["sim_time_s"], "the camera sees the object about once a second"
    assert found["command_jitter_ms"] < 50.0
    tool, obstacles, arm = forces(tmp_path / "emulator.txt")
    assert 0.1 < tool < FORCE
    assert obstacles == arm == 0.0
    log = EpisodeLog.load(tmp_path / "run")
    assert len(log) == found["steps"]
    assert main(["export", str(tmp_path / "run"), "--to", "usd"]) == 0, "the record replays"


@pytest.mark.timeout(600)
def test_a_signal_to_end_stops_the_arm_and_leaves_the_record(tmp_path):
    host = address()
    with emulator(host, "lab01", "--start", "0", log=tmp_path / "emulator.txt"):
        addresses = ("--robot-address", f"{host}:{COMMAND_PORT}", "--pose-address", f"{host}:{POSE_PORT}")
        run = command("run", "lab01", "--plant", "xarm", "--device", "cpu", "--yes", *addresses)
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
    rows = []
    for seed in range(20):
        host, log = address(), tmp_path / f"emulator{seed}.txt"
        with emulator(host, "lab01", "--seed", str(seed), log=log):
            found = push(host, tmp_path / f"run{seed}", "--yes", "--resume", seed=seed)
        rows.append((found["success"], found["stops"], found["command_jitter_ms"], *forces(log)))
        print(seed, *rows[-1], flush=True)
    assert sum(row[0] for row in rows) >= 19
    assert max(row[3] for row in rows) < FORCE
    assert max(max(row[4:]) for row in rows) == 0.0


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
