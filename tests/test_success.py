"""How often the object reaches its goal: the figures of the README, seed by seed. Minutes, hence slow."""

from __future__ import annotations

import pytest
from test_episode import episode

from oimppi_warp.config import Method
from oimppi_warp.metrics import summarize

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1200)]

SEEDS = range(10)


@pytest.mark.parametrize(
    ("name", "method", "least", "least_tight"),
    [("task01", "cloi", 10, 7), ("task02", "cloi", 10, 7), ("task01", "soi", 9, 0), ("task02", "soi", 8, 0)],
)
def test_the_object_reaches_its_goal_from_drawn_starts(name: str, method: Method, least: int, least_tight: int):
    found = [summarize(episode(name, method, seed=seed).run()) for seed in SEEDS]
    assert sum(metrics.success for metrics in found) >= least, [m.seed for m in found if not m.success]
    assert sum(metrics.success_tight for metrics in found) >= least_tight, [
        m.seed for m in found if not m.success_tight
    ]
