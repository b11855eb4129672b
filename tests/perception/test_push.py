"""Pushes of the lab's can whose poses come from nothing but rendered images of the tag on it."""

from __future__ import annotations

import numpy as np
import pytest
from support.camera_lab import camera_lab

from oimppi_warp.config.presets import lab
from oimppi_warp.geometry.feasibility import sample_start
from oimppi_warp.record.metrics import summarize
from oimppi_warp.runtime.episode import Episode
from oimppi_warp.usd import load_scene


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 8))])
def test_the_can_is_pushed_to_its_goal_by_what_the_camera_sees(seed: int):
    scene, config = load_scene("lab01"), lab()
    scene = scene.with_start(sample_start(scene, seed))
    plant, detector = camera_lab(scene, config.lab, control_period=config.control_period)
    log = Episode(scene, config, method="cloi", device="cpu", engine="quasistatic", plant=plant, seed=seed).run()
    metrics = summarize(log)
    print(
        f"{metrics.sim_time_s:.1f} s, {metrics.position_error_m:.4f} m at the end; {len(detector.errors)} detections, "
        f"median {1e3 * np.median(detector.errors):.2f} mm, at most {1e3 * max(detector.errors):.2f} mm off, "
        f"{detector.hidden} images without"
    )
    assert metrics.success, metrics.position_error_m
    assert metrics.position_error_m <= scene.tolerance.position
    assert len(detector.errors) >= 5
    assert np.median(detector.errors) <= 0.003
