"""The disk cache of computed arrays: what is stored is not computed again, and it does not grow without bounds."""

from __future__ import annotations

import os

import numpy as np
import pytest
from support.small_tasks import shipped

from oimppi_warp.compute import cache
from oimppi_warp.physics.mujoco_model import translate_scene


@pytest.fixture(autouse=True)
def own_folder(monkeypatch: pytest.MonkeyPatch, tmp_path):
    monkeypatch.setenv("OIMPPI_CACHE", str(tmp_path))


def test_an_array_is_computed_once():
    made = []

    def compute() -> np.ndarray:
        made.append(1)
        return np.arange(5.0)

    first, second = (cache.cached("field", "abc", compute) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert len(made) == 1


def test_a_truncated_array_is_computed_again(tmp_path):
    cache.cached("field", "abc", lambda: np.arange(5.0))
    (tmp_path / "field-abc.npy").write_bytes(b"nothing")
    np.testing.assert_array_equal(cache.cached("field", "abc", lambda: np.arange(5.0)), np.arange(5.0))


def test_what_was_not_used_for_longest_makes_room(monkeypatch: pytest.MonkeyPatch, tmp_path):
    monkeypatch.setattr(cache, "_LARGEST", 3500)
    (tmp_path / "mine.npy").write_bytes(bytes(10_000))  # somebody else's, in the same folder
    os.utime(tmp_path / "mine.npy", (0, 0))
    for number, name in enumerate("abc"):
        cache.cached("field", 24 * name, lambda: np.zeros(120))  # about a kilobyte each
        os.utime(tmp_path / f"field-{24 * name}.npy", (number, number))
    cache.cached("field", 24 * "a", lambda: np.ones(120))  # it is in use again
    cache.cached("field", 24 * "d", lambda: np.zeros(120))
    left = {file.name for file in tmp_path.iterdir()}
    assert left == {"mine.npy", *(f"field-{24 * name}.npy" for name in "acd")}


def test_a_model_is_among_what_makes_room(monkeypatch: pytest.MonkeyPatch, tmp_path):
    translate_scene(shipped("task01"), sensing=False)
    (stored,) = tmp_path.glob("mujoco-*.npz")
    monkeypatch.setattr(cache, "_LARGEST", 0)
    cache.make_room(tmp_path)
    assert not stored.exists()
