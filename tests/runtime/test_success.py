"""How often the object reaches its goal: the figures of the README, seed by seed. Minutes, hence slow."""

from __future__ import annotations

import pytest
from support.episodes import episode

from oimppi_warp.config.presets import best, lab
from oimppi_warp.geometry.feasibility import sample_start
from oimppi_warp.record.metrics import summarize
from oimppi_warp.runtime.episode import Episode
from oimppi_warp.usd import load_scene

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1200)]

SEEDS = range(10)


@pytest.mark.parametrize("method", ["cloi", "soi"])
@pytest.mark.parametrize("name", ["task01", "task02", "task03", "task04", "task05"])
def test_the_object_reaches_its_goal_from_drawn_starts(name: str, method: str):
    found = [summarize(episode(name, method, seed=seed).run()) for seed in SEEDS]
    assert sum(metrics.success for metrics in found) >= 9, [m.run.seed for m in found if not m.success]
    assert sum(metrics.success_tight for metrics in found) >= 8, [m.run.seed for m in found if not m.success_tight]


WEDGED = [(0.378, -0.176, 1.567), (0.404, -0.175, 1.571), (0.477, 0.031, 1.083)]
"""Poses of the T of task03 in which it leans on a box, or touches both."""


def test_a_wedged_object_is_freed():
    found = []
    for start in WEDGED:
        scene = load_scene("task03").with_start(start)
        for seed in range(3):
            found.append(summarize(Episode(scene, best("soi"), method="soi", device="cpu", seed=seed).run()))
    assert sum(metrics.success for metrics in found) >= 8


@pytest.mark.parametrize(("name", "method"), [("lab01", "cloi"), ("lab02", "cloi"), ("lab01", "soi"), ("lab02", "soi")])
def test_the_can_reaches_its_goal_in_the_lab(name: str, method: str, device: str):
    found = []
    for seed in SEEDS:
        scene = load_scene(name)
        scene = scene.with_start(sample_start(scene, seed))
        found.append(summarize(Episode(scene, lab(method), method=method, device=device, seed=seed, plant="lab").run()))
    assert sum(metrics.success for metrics in found) >= 9, [m.run.seed for m in found if not m.success]
