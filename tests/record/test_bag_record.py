"""A log as a bag and back, without a scene: every column, the messages beside them, and bags that are not complete."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.synthetic_episode import make_log

from oimppi_warp.record.bag import BagReader, BagWriter
from oimppi_warp.record.bag_record import COLUMN, RECORD, TRUE_OBJECT_POSE, load_record, read_log, stamps_of, write_log
from oimppi_warp.record.log import COLUMNS, EpisodeLog, LogError, to_json
from oimppi_warp.record.metrics import summarize

pytest.importorskip("rosbags.highlevel")

JOINTS = [f"joint{i}" for i in range(1, 7)]


def written(log: EpisodeLog, folder: Path) -> Path:
    with BagWriter(folder) as bag:
        write_log(bag, log, JOINTS, 0.025)
    return folder


def messages_of(path: Path, topic: str) -> list[Any]:
    with BagReader(path) as bag:
        return list(bag.messages([topic]))


@pytest.mark.parametrize("method", ["cloi", "soi"])
def test_a_log_comes_back_from_a_bag(method: str, tmp_path: Path):
    log = make_log(steps=57, method=method)
    log.header["note"] = "ü, \n, \u2028"
    again = read_log(written(log, tmp_path / "bag"))
    assert again.header == to_json(log.header)
    assert again.columns == log.columns
    for name in COLUMNS:
        np.testing.assert_array_equal(again[name], log[name])
    assert [step for step, _ in again.references] == list(range(0, 57, 10))
    for (_, path), (_, other) in zip(log.references, again.references, strict=True):
        np.testing.assert_allclose(other, path, atol=1e-14)
    assert summarize(again).json() == summarize(log).json()


@settings(deadline=None, max_examples=10)
@given(st.lists(st.floats(width=64), min_size=1, max_size=8), st.floats(-6.28, 6.28))
def test_every_number_and_every_yaw_of_a_plan_comes_back(tmp_path_factory, numbers: list[float], yaw: float):
    log = EpisodeLog(make_log(steps=0).header)
    for step, number in enumerate(numbers):
        log.append(time=0.05 * step, min_cost=number, scores=np.array([number, 0.0]), object_pose=np.full(3, number))
    log.add_reference(np.array([[0.1, 0.2, yaw]]), step=0)
    again = read_log(written(log, tmp_path_factory.mktemp("bags") / "bag"))
    for name in log.columns:
        np.testing.assert_array_equal(again[name], log[name])
    np.testing.assert_allclose(again.references[0][1], [[0.1, 0.2, yaw]], atol=1e-14)


def test_times_never_decrease_and_begin_at_the_epoch_or_when_the_bag_did():
    log = EpisodeLog({})
    for time in (0.05, np.nan, 0.1, 0.09, 0.15):
        log.append(time=time)
    began, stamps = stamps_of(log)
    assert began == 0
    assert stamps.tolist() == [50_000_000, 50_000_000, 100_000_000, 100_000_000, 150_000_000]
    log.header["began_ns"] = 1_790_000_000_123_456_789
    began, stamps = stamps_of(log)
    assert began == 1_790_000_000_123_456_789 and stamps[-1] == began + 150_000_000


def test_the_estimate_is_on_the_usual_topic_and_the_truth_on_its_own_if_it_differs(tmp_path: Path):
    log = make_log(steps=4)
    truth = log["object_pose"]
    assert not messages_of(written(log, tmp_path / "alike"), TRUE_OBJECT_POSE)
    columns = {name: log[name] for name in log.columns}
    estimate = truth + np.array([0.01, 0.0, 0.0])
    estimate[0] = np.nan  # nothing was seen yet
    path = written(EpisodeLog.of_columns(log.header, columns | {"estimated_pose": estimate}), tmp_path / "apart")
    seen = [message.content.pose.position.x for message in messages_of(path, "/object_pose")]
    np.testing.assert_allclose(seen, estimate[1:, 0])
    known = [message.content.pose.position.x for message in messages_of(path, TRUE_OBJECT_POSE)]
    np.testing.assert_allclose(known, truth[:, 0])


def test_a_record_beside_its_bag_is_read_from_the_record(tmp_path: Path):
    make_log(steps=3).save(tmp_path)
    written(make_log(steps=5), tmp_path / "bag")
    (tmp_path / "bag" / "bag.mcap").rename(tmp_path / "episode.mcap")
    assert len(load_record(tmp_path)) == 3
    assert len(load_record(tmp_path / "episode.mcap")) == 5
    with pytest.raises(LogError, match="there is no such folder"):
        load_record(tmp_path / "nothing")


def rewritten(source: Path, target: Path, change: Any) -> Path:
    """Copies a bag, with each message changed or, if the change is ``None``, left out."""
    with BagReader(source) as bag:
        messages = list(bag.messages(list(bag.topics)))
    with BagWriter(target) as bag:
        for message in messages:
            content = change(message)
            if content is not None:
                bag.write(message.topic, message.time, content)
    return target


def test_a_bag_with_missing_messages_is_no_complete_record(tmp_path: Path):
    source = written(make_log(steps=12), tmp_path / "bag")
    cut = rewritten(source, tmp_path / "cut", lambda m: m.content if m.time < 400_000_000 else None)
    with pytest.raises(LogError, match=r"no complete record \(.* of 12 of time.*\n  to do:   export it again"):
        read_log(cut)
    plans = rewritten(source, tmp_path / "plans", lambda m: None if m.topic == "/oimppi/plan" else m.content)
    with pytest.raises(LogError, match="0 of 2 of plan"):
        read_log(plans)


@pytest.mark.parametrize("text", ["", "{", "[1]", "{}", json.dumps({"steps": "many", "header": {}, "plans": []})])
def test_a_bag_whose_header_is_damaged_is_refused(text: str, tmp_path: Path):
    def damaged(message: Any) -> Any:
        if message.topic == RECORD:
            message.content.data = text
        return message.content

    source = written(make_log(steps=2), tmp_path / "bag")
    with pytest.raises(LogError, match=f"{RECORD} is not the header of a record"):
        read_log(rewritten(source, tmp_path / "damaged", damaged))


def test_columns_that_somebody_left_out_are_not_a_number(tmp_path: Path):
    source = written(make_log(steps=4), tmp_path / "bag")
    left = rewritten(source, tmp_path / "left", lambda m: None if m.topic == COLUMN + "clearance" else m.content)
    log = read_log(left)
    assert np.isnan(log["clearance"]).all() and np.isfinite(log["command"]).all()
