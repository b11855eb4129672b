"""The record of an episode, the numbers computed from it and the pictures drawn from it."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from support.synthetic_episode import GOAL, START, make_log, make_scene

from oimppi_warp.config.run_spec import RunSpec
from oimppi_warp.plots.episode import draw
from oimppi_warp.record.log import COLUMNS, EpisodeLog, LogError, to_json, unused_folder
from oimppi_warp.record.metrics import first_hold, hold_steps, pose_error, summarize

REQUIRED = """scene method engine device preset seed start goal success success_tight position_error_m yaw_error_rad
    mean_position_error_m min_clearance_m steps sim_time_s preplan_time_s plan_ms_median plan_ms_p95 control_hz
    versions"""


def test_a_saved_log_is_read_back_to_the_bit(tmp_path: Path):
    log = make_log(steps=300)
    again = EpisodeLog.load(log.save(tmp_path / "new" / "folder"))
    assert again.header == to_json(log.header)
    assert len(again) == 300
    for name in COLUMNS:
        np.testing.assert_array_equal(again[name], log[name])
    assert [step for step, _ in again.references] == list(range(0, 300, 10))
    for (_, path), (_, other) in zip(log.references, again.references, strict=True):
        np.testing.assert_array_equal(path, other)


def test_a_record_of_an_earlier_version_is_read_with_what_it_knows_of_its_run(tmp_path: Path):
    made = make_log(steps=3)
    assert not made.header.keys() & {"threads", "requested", "plant", "mode"}
    log = EpisodeLog.load(made.save(tmp_path))
    assert log.run == RunSpec("cloi", "quasistatic", "cpu", None, 3, "ideal", mode="lockstep")
    assert summarize(log).run == log.run


def test_the_options_of_a_run_stand_beside_the_other_numbers_in_json():
    made = make_log(steps=3)
    made.header |= {"threads": 2, "plant": "lab", "mode": "realtime", "requested": {"cost.w_theta": [0.3, "any yaw"]}}
    found = json.loads(summarize(made).json())
    assert "run" not in found
    names = ("method", "engine", "device", "threads", "seed", "plant", "mode")
    assert [found[name] for name in names] == ["cloi", "quasistatic", "cpu", 2, 3, "lab", "realtime"]


def test_a_log_without_steps_can_be_saved_and_read(tmp_path: Path):
    log = EpisodeLog.load(make_log(steps=0).save(tmp_path))
    assert len(log) == 0
    assert log.references == []
    assert log["object_pose"].shape == (0, 3)


def test_saving_leaves_two_files_and_no_others(tmp_path: Path):
    make_log(steps=3).save(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["episode.json", "episode.npz"]


def test_a_save_that_fails_leaves_no_record_that_looks_complete(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    make_log(steps=3).save(tmp_path)
    replace = Path.replace

    def full_disk(self: Path, target: Path) -> Path:
        if target.name == "episode.json":
            raise OSError(28, "No space left on device")
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", full_disk)
    with pytest.raises(LogError, match="No space left"):
        make_log(steps=5).save(tmp_path)
    with pytest.raises(LogError, match="no complete record"):
        EpisodeLog.load(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["episode.npz"]


def test_a_folder_without_a_record_is_an_error_that_says_what_is_needed(tmp_path: Path):
    with pytest.raises(LogError, match=r"episode\.npz and episode\.json"):
        EpisodeLog.load(tmp_path)
    inside = make_log(steps=5).save(tmp_path / "trials" / "first")
    with pytest.raises(LogError, match=f"to do:   give one of the records in it, such as {inside}"):
        EpisodeLog.load(tmp_path)


@pytest.mark.parametrize("size", [0, 10, 2000])
def test_a_truncated_record_is_an_error(tmp_path: Path, size: int):
    file = make_log(steps=300).save(tmp_path) / "episode.npz"
    file.write_bytes(file.read_bytes()[:size])
    with pytest.raises(LogError, match="no complete record"):
        EpisodeLog.load(tmp_path)


def test_columns_left_out_are_nan_in_that_row_only():
    log = EpisodeLog({})
    log.append(time=0.0, object_pose=np.zeros(3))
    log.append(time=1.0, object_plan_ms=4.0)
    np.testing.assert_array_equal(log["object_plan_ms"], [np.nan, 4.0])
    assert np.isnan(log["object_pose"][1]).all()


def test_a_log_grows_past_its_first_buffer():
    log = EpisodeLog({})
    for step in range(1000):
        log.append(time=float(step), command=np.full(6, step))
    np.testing.assert_array_equal(log["time"], np.arange(1000))
    np.testing.assert_array_equal(log["command"][:, 5], np.arange(1000))


def test_a_column_that_is_not_in_the_table_is_refused():
    with pytest.raises(KeyError, match="no such column: speed"):
        EpisodeLog({}).append(speed=1.0)


def test_a_row_of_another_shape_is_refused_and_not_counted():
    log = EpisodeLog({})
    log.append(command=np.zeros(6))
    with pytest.raises(ValueError, match="command"):
        log.append(command=np.zeros(7))
    assert len(log) == 1


def test_json_holds_no_number_that_json_does_not_know():
    assert to_json({"a": math.inf, "b": np.float32(2), "c": (np.nan, 1)}) == {"a": None, "b": 2.0, "c": [None, 1]}


def test_metrics_have_every_required_field_and_are_strict_json():
    text = summarize(make_log()).json()
    fields = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert set(REQUIRED.split()) <= fields.keys()
    assert fields["start"] == list(START)


def test_the_object_that_stays_at_its_goal_succeeds():
    log = make_log(arrive=1.0)
    metrics = summarize(log)
    assert metrics.success
    assert metrics.position_error_m == pytest.approx(0.0, abs=1e-9)
    row = round(metrics.success_time_s / 0.05) - 1
    assert log["yaw_error"][row] <= 0.5 < log["yaw_error"][row - 1]


def test_the_object_that_stops_short_fails():
    metrics = summarize(make_log(arrive=0.6))
    assert not metrics.success
    assert not metrics.success_tight
    assert math.isnan(metrics.success_time_s)
    assert json.loads(metrics.json())["success_time_s"] is None


@pytest.mark.parametrize(("error", "yaw", "exact"), [(0.004, 0.01, True), (0.006, 0.01, False), (0.004, 0.03, False)])
def test_within_5_mm_and_a_fiftieth_of_a_radian_is_exact(error: float, yaw: float, exact: bool):
    log = make_log(steps=40, arrive=0.2)
    log["position_error"][20:30], log["yaw_error"][20:30] = error, yaw
    assert "exact_tolerance" not in log.header, "as in records of earlier versions"
    assert (summarize(log).success_tight, summarize(log).success_exact) == (True, exact)
    log.header["exact_tolerance"] = {"position": 0.005, "yaw": None}
    assert summarize(log).success_exact is (error < 0.005)


@pytest.mark.parametrize(("rows", "success"), [(9, False), (10, True)])
def test_half_a_second_within_tolerance_is_ten_steps(rows: int, success: bool):
    log = make_log(steps=40, arrive=0.2)
    log["position_error"][20 : 20 + rows] = 0.1
    log["yaw_error"][20 : 20 + rows] = 0.1
    assert summarize(log).success is success


def test_two_short_stays_do_not_add_up():
    inside = np.array([1] * 6 + [0] + [1] * 6, dtype=bool)
    assert first_hold(inside, 7) is None
    assert first_hold(inside, 6) == 0
    assert first_hold(inside[:4], 6) is None
    assert hold_steps(0.5, 0.05) == 10
    assert hold_steps(0.0, 0.05) == 1


def test_yaw_does_not_count_where_its_tolerance_is_none():
    log = make_log(arrive=1.0)
    log["yaw_error"][:] = 3.0
    assert not summarize(log).success
    log.header["tolerance"] = {"position": 0.1, "yaw": None}
    assert summarize(log).success


def test_yaw_error_takes_the_short_way_round():
    assert pose_error((0, 0, math.pi - 0.1), (0, 0, -math.pi + 0.1)) == pytest.approx((0.0, 0.2))
    assert pose_error((3, 4, 5 * math.pi), (0, 0, 0)) == pytest.approx((5.0, math.pi))


def test_total_time_holds_preplanning_and_plans_slower_than_the_control_period():
    fast, slow = make_log(method="soi", plan_ms=10), make_log(method="soi", plan_ms=400)
    assert summarize(fast).total_time_s == pytest.approx(2.0 + summarize(fast).success_time_s)
    until = round(summarize(slow).success_time_s / 0.05)
    assert summarize(slow).total_time_s == pytest.approx(2.0 + slow["plan_ms"][:until].sum() / 1000)


def test_control_frequency_is_the_inverse_of_the_mean_plan_time():
    log = make_log()
    assert summarize(log).control_hz == pytest.approx(1000 / log["plan_ms"].mean())


def test_cost_terms_are_averaged_by_name():
    log = make_log()
    assert summarize(log).mean_cost_terms["goal"] == pytest.approx(5.0)
    assert list(summarize(log).mean_cost_terms) == log.header["cost_terms"]


def test_an_episode_that_was_stopped_before_its_first_step_has_metrics():
    metrics = summarize(make_log(steps=0))
    assert not metrics.success
    assert metrics.steps == 0
    assert metrics.position_error_m == pytest.approx(math.dist(START[:2], GOAL[:2]))
    json.loads(metrics.json())


@pytest.mark.parametrize(("steps", "method"), [(120, "soi"), (1, "cloi"), (0, "cloi"), (30, "mppi")])
def test_every_log_can_be_drawn(tmp_path: Path, steps: int, method: str):
    files = draw(make_log(steps=steps, method=method), make_scene(), tmp_path)
    assert {file.name for file in files} == {"way.png", "errors.png", "plan_times.png"}
    for file in files:
        assert file.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
        assert file.stat().st_size > 5000


def test_a_record_is_never_written_over_by_accident(tmp_path):
    folder = tmp_path / "demo"
    assert unused_folder(folder) == folder
    folder.mkdir()
    assert unused_folder(folder) == folder, "an empty folder holds no record"
    (folder / "episode.json").write_text("{}")
    assert unused_folder(folder) == tmp_path / "demo-2"
    (tmp_path / "demo-2").mkdir()
    (tmp_path / "demo-2" / "episode.npz").write_bytes(b"")
    assert unused_folder(folder) == tmp_path / "demo-3"
