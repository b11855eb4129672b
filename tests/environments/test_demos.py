"""Demonstrations: successful episodes of the environment, in a data set that Minari reads, and a policy learns from."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import minari
import numpy as np
import pytest

from oimppi_warp.cli.main import main
from oimppi_warp.config.overrides import set_option
from oimppi_warp.config.presets import best
from oimppi_warp.environments.demos import EPISODES, Demonstrator, demonstrate, record
from oimppi_warp.environments.push import PushEnvironment

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "environments.md").read_text(encoding="utf-8")
TOLERANCE = (0.05, 0.2)
COUNT = 12
"""Demonstrations in the data set of these tests."""
OPTIONS = (
    "point01",
    "--method",
    "mppi",
    "--tolerance",
    "0.05,0.2",
    "--jobs",
    "1",
    "--set",
    "robot.optimizer.samples=128",
)


def who(actions: str = "joint") -> Demonstrator:
    config = set_option(best("mppi"), "robot.optimizer.samples=128")
    return Demonstrator("point01", "mppi", config, actions, TOLERANCE, 800)


@pytest.mark.parametrize("actions", ["joint", "tool"])
def test_the_recorded_actions_lead_to_the_recorded_observations(actions):
    found = demonstrate(who(actions), 3)
    assert found.success and found.actions.dtype == found.observations.dtype == np.float32
    again = PushEnvironment("point01", actions=actions, tolerance=TOLERANCE)  # pyright: ignore[reportArgumentType]
    seen, _ = again.reset(seed=3)
    np.testing.assert_array_equal(seen, found.observations[0])
    for step, action in enumerate(found.actions):
        seen, reward, ended, _, info = again.step(action)
        np.testing.assert_array_equal(seen, found.observations[step + 1])
        assert reward == found.rewards[step]
    assert ended and info["is_success"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("demos")
    assert main(["demos", *OPTIONS, "--episodes", str(COUNT), "--actions", "tool", "--out", str(folder)]) == 0
    return folder


def test_minari_reads_what_was_recorded(folder: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder))
    assert list(minari.list_local_datasets()) == ["oimppi/point01/mppi-tool-v0"]
    data = minari.load_dataset("oimppi/point01/mppi-tool-v0")
    assert data.total_episodes == COUNT
    for seed, episode in enumerate(data.iterate_episodes()):
        assert episode.observations.shape == (len(episode.actions) + 1, 2 * 2 + 11)
        assert episode.terminations[-1] and not episode.terminations[:-1].any() and not episode.truncations.any()
        assert episode.rewards.sum() > 1.0
        expected = demonstrate(who("tool"), seed) if seed == 2 else None
        if expected is not None:
            np.testing.assert_array_equal(episode.actions, expected.actions)
    environment = data.recover_environment()
    assert environment.unwrapped.scene.tolerance.position == TOLERANCE[0]
    np.testing.assert_array_equal(environment.reset(seed=0)[0], data[0].observations[0])


def test_a_recording_goes_on_where_it_stopped(tmp_path: Path):
    counted: list[tuple[int, int]] = []
    found = record(who(), tmp_path, episodes=2, jobs=1, on_episode=lambda *so_far: counted.append(so_far))
    assert counted == [(1, 0), (2, 0)] and [each.seed for each in found] == [0, 1]
    counted.clear()
    more = record(who(), tmp_path, episodes=3, jobs=1, on_episode=lambda *so_far: counted.append(so_far))
    assert counted == [(3, 0)] and [each.seed for each in more] == [0, 1, 2]
    np.testing.assert_array_equal(more[0].actions, found[0].actions)
    # Others, who demonstrate something else, do not take these for theirs.
    record(replace(who(), tolerance=(0.04, 0.2)), tmp_path, episodes=1, jobs=1)
    assert len(list((tmp_path / EPISODES).iterdir())) == 2


def test_failures_are_left_out_and_other_seeds_take_their_place(tmp_path: Path):
    impatient = replace(who(), steps=len(demonstrate(who(), 4).actions))  # seed 4 succeeds just in time
    found = record(impatient, tmp_path, episodes=2, first=0, jobs=1)
    assert len(found) == 2 and all(each.success and len(each.actions) <= impatient.steps for each in found)
    stored = [file.stem for file in (tmp_path / EPISODES / impatient.key).iterdir()]
    assert {f"{each.seed:05d}" for each in found} <= set(stored)


def test_a_policy_learns_from_the_demonstrations(folder: Path, tmp_path: Path):
    """The page's script, as printed, on a few demonstrations of a point robot."""
    (code,) = re.findall(r"```python\n# clone\.py\n(.*?)```", PAGE, flags=re.DOTALL)
    (tmp_path / "clone.py").write_text(code)
    run = subprocess.run(
        [sys.executable, "clone.py", "oimppi/point01/mppi-tool-v0"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT), "MINARI_DATASETS_PATH": str(folder), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=280,
    )
    assert run.returncode == 0, run.stderr
    explained, nearest = run.stdout.splitlines()[-2:]
    assert int(re.findall(r"explains (\d+) %", explained)[0]) > 70
    assert int(re.findall(r"nearest: (\d+) %", nearest)[0]) < 60  # of the way, after few demonstrations


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--episodes", "0"], "--episodes 0 cannot be used"),
        (["--first", "-1"], "--first -1 cannot be used"),
        (["--jobs", "0"], "--jobs 0 cannot be used"),
        (["--tolerance", "5mm"], "not a tolerance"),
        (["--set", "cost.w_aling=1"], "cost.w_align"),
    ],
)
def test_bad_input_is_status_2(options, said, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["demos", "point01", "--out", str(tmp_path / "out"), *options]) == 2
    assert said in capsys.readouterr().err and not (tmp_path / "out").exists()
