"""A damaged scene or robot is read, or refused with a reason: no other exception, no crash, no hang."""

from __future__ import annotations

import pytest
from support import robot_fuzzing
from support.fuzzing import MOST, damaged, outcomes


@pytest.mark.parametrize(
    ("seed", "count"), [(1, 60), pytest.param(7, 2500, marks=[pytest.mark.slow, pytest.mark.timeout(1800)])]
)
def test_damaged_scenes_are_read_or_refused_with_a_reason(tmp_path, seed, count):
    found = outcomes(seed, count, tmp_path)
    assert [outcome for outcome in found if not outcome.is_sound] == []
    assert len(found) == count
    read = sum(outcome.words == "scene" for outcome in found)
    assert 0.1 * count < read < 0.9 * count  # else the damage is too harsh, or none


@pytest.mark.parametrize(
    ("seed", "count"), [(1, 7), pytest.param(7, 600, marks=[pytest.mark.slow, pytest.mark.timeout(3600)])]
)
def test_damaged_robots_are_converted_or_refused_with_a_reason(tmp_path, seed, count):
    found = outcomes(seed, count, tmp_path, module=robot_fuzzing.__name__)
    assert [outcome for outcome in found if not outcome.is_sound] == []
    assert len(found) == count
    converted = sum(outcome.words == "scene" for outcome in found)
    assert 0.1 * count < converted < 0.9 * count  # else the damage is too harsh, or none


def test_the_same_numbers_do_the_same_damage():
    assert damaged(1, 5) == damaged(1, 5)
    assert damaged(1, 5) != damaged(1, 6)
    assert robot_fuzzing.damaged(1, 5) == robot_fuzzing.damaged(1, 5)
    assert robot_fuzzing.damaged(1, 5) != robot_fuzzing.damaged(1, 6)


def test_a_process_that_dies_is_noticed(tmp_path):
    found = outcomes(1, 1000, tmp_path / "nowhere")
    assert len(found) == MOST
    assert not any(outcome.is_sound for outcome in found)
    assert "FileNotFoundError" in found[0].words
