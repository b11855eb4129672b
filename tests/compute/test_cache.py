"""The disk cache of computed arrays: what is stored is not computed again, and it does not grow without bounds."""

from __future__ import annotations

import os

import numpy as np
import pytest

from oimppi_warp.compute import cache


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
    for number, name in enumerate("abc"):
        cache.cached("field", name, lambda: np.zeros(120))  # about a kilobyte each
        os.utime(tmp_path / f"field-{name}.npy", (number, number))
    cache.cached("field", "a", lambda: np.ones(120))  # it is in use again
    cache.cached("field", "d", lambda: np.zeros(120))
    assert sorted(file.name for file in tmp_path.iterdir()) == ["field-a.npy", "field-c.npy", "field-d.npy"]
