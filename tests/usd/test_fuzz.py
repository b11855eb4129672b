"""A damaged scene is read, or refused with a reason: no other exception, no crash, no hang."""

from __future__ import annotations

import pytest
from support.fuzzing import MOST, damaged, outcomes


@pytest.mark.parametrize(
    ("seed", "count"), [(1, 150), pytest.param(7, 2500, marks=[pytest.mark.slow, pytest.mark.timeout(1800)])]
)
def test_damaged_scenes_are_read_or_refused_with_a_reason(tmp_path, seed, count):
    found = outcomes(seed, count, tmp_path)
    assert [outcome for outcome in found if not outcome.is_sound] == []
    assert len(found) == count
    read = sum(outcome.words == "scene" for outcome in found)
    assert 0.1 * count < read < 0.9 * count  # else the damage is too harsh, or none


def test_the_same_numbers_do_the_same_damage():
    assert damaged(1, 5) == damaged(1, 5)
    assert damaged(1, 5) != damaged(1, 6)


def test_a_process_that_dies_is_noticed(tmp_path):
    found = outcomes(1, 1000, tmp_path / "nowhere")
    assert len(found) == MOST
    assert not any(outcome.is_sound for outcome in found)
    assert "FileNotFoundError" in found[0].words
