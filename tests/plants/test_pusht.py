"""Push-T as a plant: gym-pusht's own starts, motion, coverage and end, in this package's units and directions."""

from __future__ import annotations

import builtins
import math
from dataclasses import replace

import gym_pusht  # noqa: F401  # registers the environment
import gymnasium
import numpy as np
import pytest
from support.small_tasks import shipped

from oimppi_warp.config.overrides import set_option
from oimppi_warp.config.presets import best
from oimppi_warp.errors import ConfigError
from oimppi_warp.plants.plant import ContactPlant, JudgingPlant, MovablePlant, StreamingPlant, TruthfulPlant
from oimppi_warp.plants.pusht import PushT
from oimppi_warp.record.metrics import summarize
from oimppi_warp.runtime.episode import Episode


def plant(seed: int = 0, **options) -> PushT:
    return PushT(shipped("pusht"), best(), seed=seed, **options)


def own(seed: int):
    made = gymnasium.make("gym_pusht/PushT-v0", obs_type="state", disable_env_checker=True)
    return made, made.reset(seed=seed)[1]


@pytest.mark.parametrize("seed", [0, 1000])
def test_a_start_is_that_of_the_environment_with_the_same_seed(seed):
    _, info = own(seed)
    seen = plant(seed).observe()
    np.testing.assert_allclose(seen.joint_position, [info["pos_agent"][0] / 1e3, 0.512 - info["pos_agent"][1] / 1e3])
    x, y, angle = info["block_pose"]
    np.testing.assert_allclose(seen.object_pose, [x / 1e3, 0.512 - y / 1e3, -angle])
    np.testing.assert_allclose(seen.joint_velocity, 0.0)


def test_it_is_a_plant_that_knows_the_truth_and_judges():
    made = plant()
    assert isinstance(made, JudgingPlant) and isinstance(made, TruthfulPlant)
    assert not isinstance(made, MovablePlant | StreamingPlant | ContactPlant)
    assert made.verdict.scores.keys() == {"coverage", "reward"}
    np.testing.assert_array_equal(made.truth().object_pose, made.observe().object_pose)


@pytest.mark.parametrize("velocity", [(0.1, 0.0), (-0.05, 0.12)])
def test_the_agent_is_where_the_velocity_leads_it(velocity):
    """From rest, and on: also while it still has the velocity that the controller left it with."""
    made = plant(3)
    made._inner._set_state(np.array([256, 256, 60, 60, 0.0]))  # in the middle, with the T out of the way
    made._read(made._inner._get_info())
    for step in range(1, 6):
        before = made.observe()
        made.apply(np.array(velocity))
        after = made.observe()
        np.testing.assert_allclose(after.joint_position - before.joint_position, 0.1 * np.array(velocity), atol=1e-6)
        np.testing.assert_allclose(after.joint_velocity, velocity, atol=1e-5)
        assert after.time == pytest.approx(0.1 * step)
    made.apply(np.zeros(2))
    np.testing.assert_allclose(made.observe().joint_position, after.joint_position, atol=1e-6)


def test_targets_stay_in_the_window():
    made = plant(3)
    for _ in range(60):
        made.apply(np.array([2.0, 2.0]))
    assert (made.observe().joint_position <= 0.512 + 1e-6).all()
    with pytest.raises(ValueError, match="finite"):
        made.apply(np.array([math.nan, 0.0]))


def test_the_verdict_is_that_of_the_environment():
    made = plant(0)
    made._inner._set_state(np.array([450, 60, 256, 256, math.pi / 4]))
    # The frame moves when the T is turned about its centre of gravity, so put it where the goal is.
    made._inner.block.position = (256, 256)
    made.apply(np.zeros(2))
    verdict = made.verdict
    assert verdict.success and verdict.over
    assert verdict.scores["coverage"] == pytest.approx(1.0, abs=1e-6) and verdict.scores["reward"] == 1.0
    np.testing.assert_allclose(made.observe().object_pose, shipped("pusht").goal, atol=1e-9)
    # From then on nothing moves, but time goes on, so that a control loop can stop as it always does.
    before = made.observe()
    made.apply(np.array([0.3, 0.3]))
    np.testing.assert_array_equal(made.observe().joint_position, before.joint_position)
    assert made.observe().time == pytest.approx(before.time + 0.1)


def test_another_goal_is_judged_by_itself():
    scene = shipped("pusht").with_goal((0.2, 0.3, 0.4))
    made = PushT(scene, best(), seed=0)
    made._inner.block.angle = -0.4
    made._inner.block.position = (200, 212)
    made.apply(np.zeros(2))
    assert made.verdict.scores["coverage"] > 0.99
    np.testing.assert_allclose(made.observe().object_pose, scene.goal, atol=1e-3)


def test_the_environment_ends_after_300_steps():
    made = plant(0)
    for _ in range(299):
        made.apply(np.zeros(2))
    assert not made.verdict.over
    made.apply(np.zeros(2))
    assert made.verdict.over and not made.verdict.success


def test_the_centre_of_mass_of_the_scene_is_that_of_the_t():
    scene = shipped("pusht")
    moved = replace(scene, object=replace(scene.object, center_of_mass=np.array([0.0, -0.055, 0.0])))
    assert tuple(PushT(moved, best(), seed=0)._inner.block.center_of_gravity) == pytest.approx((0.0, 55.0))
    assert tuple(plant(0)._inner.block.center_of_gravity) == pytest.approx((0.0, 45.0))


def test_damping_lets_the_t_slide_on():
    def slid(**options) -> float:
        made = plant(0, **options)
        made._inner.block.velocity = (100.0, 0.0)
        before = made.observe().object_pose
        made.apply(np.zeros(2))
        return float(np.linalg.norm((made.observe().object_pose - before)[:2]))

    assert slid(damping=0.5) > 5.0 * slid()  # which moves for one step of the physics
    with pytest.raises(ConfigError, match="damping=2"):
        plant(0, damping=2.0)


@pytest.mark.parametrize("name", ["task01", "point01"])
def test_another_task_is_refused(name):
    with pytest.raises(ConfigError, match=f"cannot run {name}"):
        PushT(shipped(name), best(), seed=0)


def test_without_the_extra_the_message_names_it(monkeypatch):
    found = builtins.__import__

    def missing(name, *rest, **named):
        if name == "gym_pusht":
            raise ModuleNotFoundError("No module named 'gym_pusht'", name="gym_pusht")
        return found(name, *rest, **named)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(ConfigError, match=r"the plant pusht: gym_pusht is not.*\n.*pip install 'oimppi-warp\[pusht\]'"):
        plant()


@pytest.mark.parametrize("method", ["mppi", "soi", "cloi"])
def test_the_t_is_pushed_onto_its_place(method, device: str):
    """With the default settings and two starts; the record has the plant's own start, period, scores and verdict."""
    for seed in (0, 4):
        log = Episode(
            shipped("pusht"), best(method), plant="pusht", method=method, seed=seed, engine="quasistatic", device=device
        ).run()
        metrics = summarize(log)
        assert metrics.ended == "success" and metrics.success
        assert metrics.best_scores["coverage"] > 0.95 and metrics.best_scores["reward"] == 1.0
        assert metrics.steps < 200 and log.header["control_period"] == 0.1
        assert metrics.success_time_s == pytest.approx(log["time"][-1])
        np.testing.assert_allclose(metrics.start, plant(seed).observe().object_pose)
        assert log["done"].sum() == log["done"][-1] == 1.0
        assert "control_period" in log.header["requested"]


def test_the_time_limit_of_the_environment_ends_an_episode(device: str):
    config = set_option(best("mppi"), "robot.tip_speed_limit=0.001")
    config = set_option(config, "robot.optimizer.samples=8")
    log = Episode(shipped("pusht"), config, plant="pusht", method="mppi", engine="quasistatic", device=device).run()
    assert len(log) == 300 and summarize(log).ended == "time limit" and not summarize(log).success
