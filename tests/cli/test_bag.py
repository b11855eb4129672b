"""The commands that take bags: ``oimppi import-bag``, and replay and export of what it writes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.lab_bags import EPOCH, make_bag

from oimppi_warp.cli.main import main
from oimppi_warp.record.bag_record import load_record
from oimppi_warp.record.log import EpisodeLog
from oimppi_warp.view.replay import Replay

highlevel = pytest.importorskip("rosbags.highlevel")


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    return make_bag(seconds=2.0).write(tmp_path_factory.mktemp("bags") / "lab")


def test_a_bag_becomes_a_record_that_is_replayed_exported_and_imported_again(bag: Path, tmp_path: Path, capsys):
    record = tmp_path / "record"
    assert main(["import-bag", str(bag), "--scene", "task02", "--goal=0.4,0.1,0", "--output", str(record)]) == 0
    printed = capsys.readouterr().out
    for words in (
        "/joint_states: 201 messages",
        "the frame fp_object_pose: 2 messages",
        "goal not reached",
        "30 control",
    ):
        assert words in printed
    assert {path.name for path in record.iterdir()} == {"episode.npz", "episode.json", "way.png", "errors.png"}
    replay = Replay(record)
    assert replay.scene.goal == (0.4, 0.1, 0.0)
    assert replay.picture(3).status == "recorded" and len(replay) == 30

    assert main(["export", str(record), "--to", "mcap"]) == 0
    file = record / "episode.mcap"
    with highlevel.AnyReader([file]) as reader:
        times = [time for connection, time, _ in reader.messages() if connection.topic == "/joint_states"]
    assert times[0] == EPOCH + 550_000_000, "the time of the laboratory: 0.05 s after the object was seen"
    log, again = EpisodeLog.load(record), load_record(file)
    for name in log.columns:
        np.testing.assert_array_equal(again[name], log[name])

    second = tmp_path / "second"
    assert main(["import-bag", str(file), "--scene", "task02", "--output", str(second)]) == 0
    once, twice = log, EpisodeLog.load(second)
    for name in ("joint_position", "joint_velocity", "object_pose", "command", "planned_command"):
        np.testing.assert_allclose(twice[name], once[name][1:], atol=1e-9, err_msg=name)


def test_without_an_output_the_record_is_beside_the_bag(bag: Path):
    assert main(["import-bag", str(bag), "--scene", "task02"]) == 0
    assert len(EpisodeLog.load(bag.parent / "lab-record")) == 30


def test_bad_input_ends_with_a_message_and_status_2(bag: Path, tmp_path: Path, capsys):
    record = tmp_path / "record"
    for options, words in (
        (["--object", "cup"], "neither a topic nor a frame cup"),
        (["--control-period", "0"], "--control-period 0 cannot be used"),
        (["--goal", "here"], "--goal here: not a pose"),
        (["--output", str(bag / "metadata.yaml")], "is not a writable folder"),
        (["--scene", "task99"], "task99"),
    ):
        given = ["import-bag", str(bag), "--scene", "task02", "--output", str(record), *options]
        assert main(given) == 2
        found = capsys.readouterr()
        assert found.err.startswith("oimppi: ") and words in found.err and not found.out
    assert not record.exists()


def test_a_bag_that_is_no_record_is_not_replayed_but_the_import_is_named(bag: Path, capsys):
    assert main(["view", "--replay", str(bag)]) == 2
    message = capsys.readouterr().err
    assert "contains no record" in message and "/joint_states (sensor_msgs/JointState)" in message
    assert "  to do:   `oimppi import-bag" in message
