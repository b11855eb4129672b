"""A damaged mesh, MJCF file or USD object is imported, or refused with a reason: nothing else comes of it."""

from __future__ import annotations

import pytest
from support.object_fuzzing import ENDINGS, damaged, outcomes


@pytest.mark.parametrize(
    ("seed", "count"), [(1, 7), pytest.param(7, 500, marks=[pytest.mark.slow, pytest.mark.timeout(1800)])]
)
def test_damaged_objects_are_imported_or_refused_with_a_reason(tmp_path, seed, count):
    found = outcomes(seed, count, tmp_path)
    assert [outcome for outcome in found if not outcome.is_sound] == []
    assert len(found) == count
    imported = sum(outcome.words == "scene" for outcome in found)
    assert 0.1 * count < imported < 0.9 * count  # else the damage is too harsh, or none


def test_the_same_numbers_do_the_same_damage_to_files_of_every_kind():
    assert damaged(1, 5) == damaged(1, 5)
    assert {damaged(1, number)[0] for number in range(len(ENDINGS))} == set(ENDINGS)
