"""The simulated lab: what it reports, how late, how often, how exactly, and how its arm follows commands."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from support import small_tasks

from oimppi_warp.config.lab import LabConfig
from oimppi_warp.errors import ConfigError
from oimppi_warp.physics.world import World
from oimppi_warp.plants.lab import TICK, LabPlant

STILL = np.zeros(6)
FAR = LabConfig(outlier_probability=0.0)


@pytest.fixture(scope="module")
def world() -> World:
    return World(small_tasks.shipped("lab01"))


def sightings(plant: LabPlant, steps: int) -> list[tuple[float, float, np.ndarray]]:
    """When each detection arrived, when it was made, and its pose, over some control steps at rest."""
    found, last = [], math.nan
    for _ in range(steps):
        seen = plant.observe()
        assert seen.object_time is not None
        if not math.isnan(seen.object_time) and seen.object_time != last:
            found.append((seen.time, seen.object_time, seen.object_pose))
            last = seen.object_time
        plant.apply(STILL)
    return found


def test_detections_come_at_their_rate_and_late_by_their_delay(world: World):
    plant = LabPlant(world, replace(FAR, rate=2.0, delay=0.15))
    found = sightings(plant, 60)
    np.testing.assert_allclose([made for _, made, _ in found], np.arange(0.0, 2.6, 0.5), atol=1e-9)
    np.testing.assert_allclose([arrived - made for arrived, made, _ in found], 0.15, atol=1e-9)


def test_nothing_is_known_of_the_object_before_the_first_detection_arrives(world: World):
    plant = LabPlant(world, replace(FAR, delay=0.3))
    for _ in range(6):
        seen = plant.observe()
        assert seen.object_time is not None and math.isnan(seen.object_time)
        assert np.isnan(seen.object_pose).all()
        plant.apply(STILL)
    assert np.isfinite(plant.observe().object_pose).all()


def test_detections_scatter_by_what_was_asked_for(world: World):
    plant = LabPlant(world, replace(FAR, rate=20.0, position_noise=0.01, yaw_noise=0.1), seed=4)
    poses = np.array([pose for _, _, pose in sightings(plant, 400)])
    off = poses - plant.truth().object_pose
    np.testing.assert_allclose(off.std(axis=0), (0.01, 0.01, 0.1), rtol=0.15)
    np.testing.assert_allclose(off.mean(axis=0), 0.0, atol=0.02)


def test_wrong_detections_come_as_often_as_asked_for_and_are_far_off(world: World):
    config = replace(FAR, rate=20.0, outlier_probability=0.3, outlier_size=0.2, position_noise=0.001)
    plant = LabPlant(world, config, seed=1)
    poses = np.array([pose for _, _, pose in sightings(plant, 400)])
    away = np.linalg.norm(poses[:, :2] - plant.truth().object_pose[:2], axis=1)
    wrong = away > 0.05
    assert wrong.mean() == pytest.approx(0.3, abs=0.07)
    assert plant.wrong_detections == wrong.sum()
    assert away[wrong].min() > 0.09 and away[wrong].max() < 0.31
    assert away[~wrong].max() < 0.01


def test_joints_are_reported_a_hundred_times_a_second_with_noise(world: World):
    plant = LabPlant(world, replace(FAR, joint_noise=0.002), seed=3)
    reports = []
    for _ in range(100):
        plant.apply(STILL)
        trail = plant.observe().trail
        assert len(trail) == 6  # the last of the observation before, and five new ones
        np.testing.assert_allclose(np.diff(trail[:, 0]), TICK, atol=1e-9)
        reports.append(trail[1:, 1:])
    off = np.concatenate(reports) - world.scene.robot.start
    np.testing.assert_allclose(off.std(axis=0), 0.002, rtol=0.15)


def test_the_object_is_not_seen_while_the_arm_stands_before_it(world: World):
    plant = LabPlant(world, replace(FAR, rate=20.0), start=(0.40, 0.0, 0.0))
    before = small_tasks.joints_at(world.scene.robot, (0.46, 0.0, 0.015))
    inner = plant._plant
    inner.data.qpos[world.mujoco.joint_qpos] = before
    seen = len(sightings(plant, 40))
    assert not plant.camera.sees(before, plant.truth().object_pose)
    assert seen <= 1  # the picture taken before the arm was put there


def test_speeds_change_no_faster_than_the_acceleration_limit(world: World):
    limit = 5.0
    plant = LabPlant(world, replace(FAR, acceleration_limit=limit, command_latency=0.0))
    random, before = np.random.default_rng(0), plant.driven
    for _ in range(20):
        plant.apply(random.uniform(-0.5, 0.5, 6))
        assert np.abs(plant.driven - before).max() <= limit * plant.control_period + 1e-9
        before = plant.driven
    # A step of 0.5 rad/s takes a tenth of a second.
    still = LabPlant(world, replace(FAR, acceleration_limit=limit, command_latency=0.0))
    command = np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    still.apply(command)
    assert still.driven[0] == pytest.approx(0.25)
    still.apply(command)
    assert still.driven[0] == pytest.approx(0.5)


@pytest.mark.parametrize("ticks", [0, 2, 4])
def test_a_command_takes_effect_after_the_latency(world: World, ticks: int):
    plant = LabPlant(world, replace(FAR, command_latency=ticks * TICK, acceleration_limit=1e6, joint_noise=0.0))
    plant.observe()
    command = np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    plant.apply(command)
    turned = plant.observe().joint_position[0] - world.scene.robot.start[0]
    assert turned == pytest.approx(0.5 * (5 - ticks) * TICK, rel=0.25)


def test_the_same_seed_and_commands_give_the_same_observations(world: World):
    def run(seed: int) -> np.ndarray:
        plant = LabPlant(world, LabConfig(rate=10.0), seed=seed)
        rows = []
        for step in range(20):
            plant.apply(np.full(6, 0.01 * step))
            seen = plant.observe()
            rows.append(np.concatenate([seen.joint_position, seen.object_pose]))
        return np.array(rows)

    np.testing.assert_array_equal(run(3), run(3))
    assert not np.array_equal(run(3), run(4))


def test_a_control_period_that_the_reports_do_not_divide_is_refused(world: World):
    with pytest.raises(ConfigError, match="multiple"):
        LabPlant(world, FAR, control_period=0.025)


def test_a_command_that_is_not_finite_is_refused(world: World):
    with pytest.raises(ValueError, match="finite"):
        LabPlant(world, FAR).apply(np.full(6, np.nan))
