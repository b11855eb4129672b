"""Suites: what stands in them, which trials they make, and what is said about bad ones."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import shapely
from support.sample_results import changed, make_trial

from oimppi_warp.bench.suite import SUITES, Entry, Suite, _keys, load_suite, shipped_suites
from oimppi_warp.bench.trial import make_trials, trial_seed
from oimppi_warp.config.run_spec import LARGEST_SEED
from oimppi_warp.errors import ConfigError
from oimppi_warp.geometry.feasibility import fixed_outlines, object_outline
from oimppi_warp.usd import load_scene

SMALL = """
tasks = ["task01", "task02"]
methods = ["soi", "mppi"]
trials = 3
"""


def suite_of(folder: Path, text: str) -> Suite:
    file = folder / "mine.toml"
    file.write_text(text)
    return load_suite(file)


def test_the_shipped_suites_have_the_trials_that_they_promise():
    found = {suite.name: suite for suite in shipped_suites()}
    assert set(found) == {
        "ablation",
        "best-sim",
        "cornered",
        "disturbed",
        "exact",
        "lab",
        "paper-sim",
        "pusht",
        "smoke",
        "tippy",
    }
    for name, preset in (("paper-sim", "paper"), ("best-sim", "best")):
        trials, scenes = make_trials(found[name])
        assert len(trials) == 6 * 3 * 10
        assert set(scenes) == {"task01", "task02", "task03", "task03_wide", "task04", "task05"}
        assert {(t.settings.preset, t.run.engine, t.run.mode) for t in trials} == {(preset, "quasistatic", "lockstep")}
    exact, _ = make_trials(found["exact"])
    assert len(exact) == 5 * 3 * 20 and {trial.number for trial in exact} == set(range(1000, 1020))
    assert all(trial.config.episode.exact for trial in exact)
    cornered, scenes = make_trials(found["cornered"])
    assert len(cornered) == 4 * 2 * 10
    for trial in cornered:
        scene = scenes[trial.task]
        away = [shapely.distance(object_outline(scene, trial.start), at) for _, _, at in fixed_outlines(scene)]
        assert 0.0005 <= min(away) <= 0.002
    lab, _ = make_trials(found["lab"])
    assert all(trial.real_time and trial.run.plant == "lab" for trial in lab)
    assert lab[0].config.preset == "lab"
    tippy, scenes = make_trials(found["tippy"])
    assert len(tippy) == 7 * 2 * 10 and len(scenes) == 7
    pusht, _ = make_trials(found["pusht"])
    assert len(pusht) == 3 * 200 and [trial.run.seed for trial in pusht[:3]] == [1000] * 3  # as in env.reset(seed=1000)
    assert all("--start" not in trial.arguments and trial.config.episode.max_sim_seconds == 30 for trial in pusht)
    assert found["pusht"].published[0].scores == {"coverage": 0.959} and "learns nothing" in found["pusht"].note


def test_the_first_trials_use_the_scenes_own_starts_and_all_methods_share_them(tmp_path: Path):
    trials, scenes = make_trials(suite_of(tmp_path, SMALL + "seed = 7\n").changed(trials=13))
    assert len(trials) == 2 * 2 * 13
    for task, scene in scenes.items():
        for number in range(13):
            found = [trial for trial in trials if (trial.task, trial.number) == (task, number)]
            assert len({trial.start for trial in found}) == len({trial.run.seed for trial in found}) == 1
            assert {trial.run.method for trial in found} == {"soi", "mppi"}
            if number < 10:
                assert found[0].start == tuple(map(float, scene.starts[number]))
    assert len({trial.run.seed for trial in trials}) == 13
    starts = {trial.start for trial in trials if trial.task == "task01" and trial.number >= 10}
    assert len(starts) == 3
    again, _ = make_trials(suite_of(tmp_path, SMALL + "seed = 7\n").changed(trials=13))
    assert [trial.key for trial in again] == [trial.key for trial in trials]
    other, _ = make_trials(suite_of(tmp_path, SMALL).changed(trials=13))
    assert starts.isdisjoint(trial.start for trial in other)


def test_trials_can_be_numbered_from_ten_on_so_that_none_has_a_listed_start(tmp_path: Path):
    suite = suite_of(tmp_path, SMALL + "first = 10\n").changed(trials=5)
    trials, scenes = make_trials(suite)
    assert [trial.number for trial in trials if trial.task == "task01"] == [10, 10, 11, 11, 12, 12, 13, 13, 14, 14]
    assert {trial.run.seed for trial in trials} == {10, 11, 12, 13, 14}
    for trial in trials:
        listed = [tuple(map(float, start)) for start in scenes[trial.task].starts]
        assert len(listed) == 10
        assert trial.start not in listed
    from_zero, _ = make_trials(suite.changed(first=0, trials=15))
    assert [trial for trial in from_zero if trial.number >= 10 and trial.task == "task01"] == trials[:10]
    assert "task01-soi-010-" in trials[0].name


def test_trials_of_two_seeds_share_no_start_from_number_ten_on(tmp_path: Path):
    suite = suite_of(tmp_path, 'tasks = ["task01"]\nmethods = ["mppi"]\ntrials = 20\nfirst = 10\n')
    starts = [
        {trial.start for trial in make_trials(suite.changed(seed=seed))[0]} for seed in (0, 1, 20261126, LARGEST_SEED)
    ]
    assert [len(found) for found in starts] == [20] * 4
    assert len(set.union(*starts)) == 80


def test_a_trial_of_an_earlier_version_keeps_its_seed_and_its_start(tmp_path: Path):
    for seed, number in ((0, 0), (7, 12), (100_000, 9_999)):
        assert trial_seed(seed, number) == 10_000 * seed + number
    suite = suite_of(tmp_path, 'tasks = ["task01"]\nmethods = ["mppi"]\ntrials = 2\nfirst = 10\nseed = 7\n')
    trials, _ = make_trials(suite)
    assert [trial.run.seed for trial in trials] == [70010, 70011]
    assert [trial.start for trial in trials] == [(0.341, -0.3887, -0.0601), (0.2501, -0.4264, 0.3227)]


def test_every_other_trial_has_a_32_bit_seed_of_its_own_above_those():
    seeds = (100_001, 20261126, LARGEST_SEED)
    found = [trial_seed(seed, number) for seed in seeds for number in range(1000)]
    found += [trial_seed(3, number) for number in range(10_000, 11_000)]
    assert len(set(found)) == 4000
    assert min(found) > 10_000 * 100_000 + 9_999
    assert max(found) <= LARGEST_SEED
    assert max(found) - min(found) > 0.99 * (LARGEST_SEED - 10_000 * 100_001)
    assert trial_seed(20261126, 10) == 1_479_739_914


def test_the_last_number_of_a_trial_has_a_bound(tmp_path: Path):
    suite = suite_of(tmp_path, SMALL)
    assert suite.changed(first=999_990, trials=10).entries[0].numbers[-1] == 999_999
    with pytest.raises(ConfigError, match=r"number 1000000\n  allowed: first \+ trials up to 1000000"):
        suite.changed(first=999_990, trials=11)


def test_the_keys_of_a_suite_are_the_fields_of_an_entry():
    assert set(Entry().row()) == set(_keys())


def test_a_trial_is_written_with_its_options_beside_its_other_fields():
    row = make_trial(assignments=("cost.w_d=3",)).row()
    assert set(row) == {
        *("task", "scene", "content", "number", "start", "method", "engine", "device", "threads", "seed", "plant"),
        *("plant_options", "mode", "friction", "knock", "preset", "assignments", "max_sim_seconds", "tolerance"),
    }
    assert (row["method"], row["assignments"]) == ("cloi", ["cost.w_d=3"])


def test_an_entry_has_what_stands_at_the_top_unless_it_says_otherwise(tmp_path: Path):
    suite = suite_of(
        tmp_path, SMALL + '[[entry]]\n[[entry]]\nmethods = ["cloi"]\nmode = "realtime"\nset = ["cost.w_d=3"]\n'
    )
    first, second = suite.entries
    assert (first.methods, first.run.mode, first.settings.assignments) == (("soi", "mppi"), "lockstep", ())
    assert (second.methods, second.run.mode) == (("cloi",), "realtime")
    assert second.settings.assignments == ("cost.w_d=3",)
    assert second.tasks == first.tasks


def test_the_same_task_and_method_twice_need_labels(tmp_path: Path):
    twice = SMALL + '[[entry]]\n[[entry]]\nmethods = ["soi"]\nset = ["cost.w_d=3"]\n'
    with pytest.raises(ConfigError, match="soi on task01 is listed twice"):
        make_trials(suite_of(tmp_path, twice))
    trials, scenes = make_trials(suite_of(tmp_path, twice + 'label = "far"\n'))
    assert set(scenes) == {"task01", "task02", "task01-far", "task02-far"}
    assert len({trial.key for trial in trials}) == len(trials) == 18


def test_a_scene_beside_the_suite_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    scene = load_scene("task01").file
    for part in ("robots", "objects", "schema"):
        shutil.copytree(scene.parent / part, tmp_path / part)
    shutil.copy(scene, tmp_path / "mine.usda")
    suite = suite_of(tmp_path, 'tasks = ["mine.usda"]\nmethods = ["mppi"]\ntrials = 1\n')
    (trial,), _ = make_trials(suite)
    assert trial.task == "mine"
    monkeypatch.chdir(tmp_path)
    (here,), _ = make_trials(suite)
    assert here.scene == "mine.usda"
    assert here.key == trial.key

    used = tmp_path / "objects" / "t_block.usda"
    used.write_text(used.read_text() + "\n# a file that the scene refers to\n")
    (other,), _ = make_trials(suite)
    assert other.key != trial.key


@pytest.mark.parametrize(
    "change",
    [
        {"content": "c1"},
        {"method": "soi"},
        {"seed": 1},
        {"start": (0.3, -0.45, 0.01)},
        {"engine": "newton"},
        {"device": "cuda:0"},
        {"preset": "paper"},
        {"assignments": ("cost.w_d=3",)},
        {"max_sim_seconds": 3.0},
        {"tolerance": (0.005, 0.02)},
        {"plant": "lab"},
        {"plant_options": ("gain=2",)},
        {"mode": "realtime"},
    ],
)
def test_what_decides_the_result_changes_the_key(change: dict):
    assert make_trial(**change).key != make_trial().key


def test_what_does_not_decide_the_result_leaves_the_key():
    trial = make_trial()
    assert changed(trial, threads=8).key == trial.key
    assert changed(trial, scene="elsewhere/task01.usda").key == trial.key
    same = f"robot.optimizer.samples={trial.config.robot.optimizer.samples}"
    assert changed(trial, assignments=(same,)).key == trial.key
    clock = changed(trial, mode="realtime")
    assert changed(clock, threads=8).key != clock.key


def test_the_command_says_everything_and_mode_and_plant_only_when_they_are_special():
    command = make_trial(assignments=("cost.w_d=3", "reference=time"), max_sim_seconds=2.5).command
    assert command == (
        "oimppi run task01 --method cloi --preset best --engine quasistatic --device cpu --threads 1 --seed 0 "
        "--start 0.3,-0.45,0.0 --max-sim-seconds 2.5 --set cost.w_d=3 reference=time"
    )
    assert "--mode realtime --plant lab" in make_trial(mode="realtime", plant="lab").command
    assert make_trial(plant_options=("gain=2", "name=a b")).command.endswith("--plant-options gain=2 'name=a b'")
    itself = make_trial(plant="pusht", plant_options=("damping=0.1",)).command
    assert itself.endswith("--seed 0 --plant pusht --plant-options damping=0.1") and "--start" not in itself
    disturbed = make_trial(friction=0.25, knock=(5.0, 3.0, 0.3))
    assert disturbed.command.endswith("--friction 0.25 --knock 5.0 3.0 0.3")
    assert disturbed.key != make_trial().key


def test_a_suite_with_disturbances_says_them_and_keeps_them_in_its_results(tmp_path):
    file = tmp_path / "shaken.toml"
    file.write_text(SMALL + "friction = 0.25\nknock = [5, 3, 0.3]\n")
    (entry,) = load_suite(file).entries
    assert entry.run.friction == 0.25 and entry.run.knock == (5, 3, 0.3)
    assert entry.row()["knock"] == [5, 3, 0.3]
    for line in ("friction = 0", "knock = [5, 3]", "beside = [0.002, 0.001]", "beside = 0.002"):
        file.write_text(SMALL + line)
        with pytest.raises(ConfigError, match="cannot be used"):
            load_suite(file)


BAD = {
    "no TOML": ("tasks = [", "not a TOML file"),
    "no tasks": ("trials = 2", "no tasks"),
    "empty tasks": ("tasks = []", "a list of scenes"),
    "a word for a list": ('tasks = "task01"', "a list of scenes"),
    "unknown key": (SMALL + "sead = 1", "did you mean seed?"),
    "unknown method": ('tasks = ["task01"]\nmethods = ["rrt"]', "a list of names from mppi, soi, cloi"),
    "no trials": (SMALL.replace("3", "0"), "an integer from 1"),
    "trials that are none": (SMALL.replace("3", "true"), "an integer from 1"),
    "seed of 33 bits": (SMALL + "seed = 4294967296", "an integer from 0 to 4294967295"),
    "trials beyond the last": (SMALL + "first = 999999", "first + trials up to 1000000"),
    "first before zero": (SMALL + "first = -1", "an integer from 0 to 999999"),
    "unknown plant": (SMALL + 'plant = "real"', '"ideal" or "lab"'),
    "plant options that are none": (SMALL + 'plant_options = ["damping"]', 'like ["damping=0.1"]'),
    "starts that the plant chooses": (
        SMALL + 'beside = [0.0005, 0.002]\nplant = "pusht"',
        "beside cannot be used with the plant pusht",
    ),
    "a note that is none": (SMALL + "note = 3", "note = 3"),
    "a published figure without source": (SMALL + '[[published]]\nname = "a"', "name and source (text)"),
    "a published figure that is none": (
        SMALL + '[[published]]\nname = "a"\nsource = "b"\nscores = { reward = "high" }',
        "scores (a table of numbers)",
    ),
    "timed engine": (SMALL + 'engine = "auto"', '"quasistatic" or "newton"'),
    "unknown mode": (SMALL + 'mode = "fast"', '"lockstep" or "realtime"'),
    "unknown preset": (SMALL + 'preset = "bset"', '"best" or "paper"'),
    "unknown setting": (SMALL + 'set = ["cost.w_aling=2"]', "did you mean cost.w_align"),
    "bad setting of one method": (SMALL + 'set = ["robot.optimizer.horizon=3"]', "not possible for a horizon"),
    "tolerance of one number": (SMALL + "tolerance = [0.005]", "position [m] and yaw [rad]"),
    "tolerance of nothing": (SMALL + "tolerance = [0.005, 0]", "position [m] and yaw [rad]"),
    "tolerance in mm": (SMALL + "tolerance = [5, 0.1]", "above 0, up to 0.5 and 3.14"),
    "time that is none": (SMALL + "max_sim_seconds = 0", "above zero"),
    "entry that is a table": (SMALL + "[entry]\nseed = 1", "[[entry]]"),
    "bad key in an entry": (SMALL + "[[entry]]\n[[entry]]\nseed = -1", "entry 2: seed = -1"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_suite_is_refused_with_what_is_allowed(case: str, tmp_path: Path):
    text, said = BAD[case]
    with pytest.raises(ConfigError) as error:
        suite_of(tmp_path, text)
    assert said in str(error.value)
    assert "mine.toml" in str(error.value)


def test_a_name_that_is_no_suite_is_answered_with_those_there_are():
    with pytest.raises(ConfigError, match=r"paper-sim[\s\S]*did you mean best-sim\?"):
        load_suite("best-sin")


def test_a_file_that_is_misspelt_or_lacks_its_ending_is_found_beside_it(tmp_path: Path):
    (tmp_path / "mine.toml").write_text(SMALL)
    for name in ("mine", "mien.toml"):
        with pytest.raises(ConfigError, match=rf"did you mean {tmp_path}/mine\.toml\?"):
            load_suite(tmp_path / name)


def test_a_scene_that_does_not_exist_is_searched_beside_the_suite(tmp_path: Path):
    (tmp_path / "push_ell.usda").write_text("#usda 1.0")
    with pytest.raises(ConfigError, match=r"mine\.toml: .*push_el\.usda: there is no such file") as error:
        make_trials(suite_of(tmp_path, 'tasks = ["push_el.usda"]'))
    assert "push_ell.usda?" in str(error.value) and "pusht" not in str(error.value).partition("to do")[2]


def test_a_part_of_a_suite_can_be_run():
    suite = load_suite("paper-sim").only(tasks=("task02",), methods=("soi",))
    assert [(entry.tasks, entry.methods) for entry in suite.entries] == [(("task02",), ("soi",))]
    with pytest.raises(ConfigError, match="allowed: task01"):
        suite_all = load_suite("paper-sim")
        suite_all.only(tasks=("task09",))


def test_suites_are_package_data():
    assert sorted(path.suffix for path in SUITES.iterdir() if path.is_file()) == [".toml"] * 10
    import tomllib

    project = tomllib.loads((Path(__file__).resolve().parents[2] / "pyproject.toml").read_text())
    assert "*.toml" in project["tool"]["setuptools"]["package-data"]["*"]


def test_starts_are_given_to_the_last_digit(tmp_path: Path):
    trials, _ = make_trials(suite_of(tmp_path, SMALL))
    for trial in trials:
        text = trial.arguments[trial.arguments.index("--start") + 1]
        np.testing.assert_array_equal([float(part) for part in text.split(",")], trial.start)
