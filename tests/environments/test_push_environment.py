"""The tasks as Gymnasium environments: what Gymnasium checks, and what the docstring promises."""

from __future__ import annotations

import subprocess
import sys
import warnings
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import oimppi_warp.environments  # noqa: F401  # registers them
from oimppi_warp.config.overrides import set_option
from oimppi_warp.config.presets import best
from oimppi_warp.environments.push import PushEnvironment, vector_of
from oimppi_warp.errors import ConfigError, SceneError
from oimppi_warp.geometry.feasibility import sample_start
from oimppi_warp.geometry.footprint import limit_surface
from oimppi_warp.geometry.kinematics import tip_frame
from oimppi_warp.planning.factory import make_planner
from oimppi_warp.record.metrics import pose_error
from oimppi_warp.usd import load_scene, shipped_scenes

ADVICE = ("-infinity", "infinity. This", "symmetric and normalized")


def made(name: str = "task01", **options) -> PushEnvironment:
    environment = gymnasium.make(f"oimppi/{name}-v0", **options).unwrapped
    assert isinstance(environment, PushEnvironment)
    return environment


def test_every_shipped_scene_is_registered_and_any_file_can_be_made():
    ids = {spec.id for spec in gymnasium.registry.values() if spec.namespace == "oimppi"}
    assert ids == {f"oimppi/{scene.name}-v0" for scene in shipped_scenes()} | {"oimppi/scene-v0"}
    file = next(scene.path for scene in shipped_scenes() if scene.name == "task03")
    assert made("scene", scene=file).scene.name == "task03"
    limited = gymnasium.make("oimppi/task01-v0")
    assert limited.spec is not None and limited.spec.max_episode_steps == 800


def test_registering_imports_nothing_heavy():
    heavy = "('pxr', 'warp', 'mujoco', 'newton', 'matplotlib')"
    code = f"import sys, oimppi_warp.environments; print([name for name in {heavy} if name in sys.modules])"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert said.strip() == "[]"


def test_without_gymnasium_the_import_says_what_to_install():
    code = "import sys; sys.modules['gymnasium'] = None; import oimppi_warp.environments"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert run.returncode == 1
    assert "the environments: gymnasium is not installed\n  to do:   pip install 'oimppi-warp[gym]'" in run.stderr


@pytest.mark.parametrize(("name", "actions"), [("task02", "joint"), ("pusht", "tool"), ("lab01", "tool")])
def test_gymnasium_finds_nothing_wrong(name, actions):
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        check_env(made(name, actions=actions, render_mode="rgb_array"))
    said = [str(each.message) for each in found if "gymnasium" in each.filename]
    assert not [text for text in said if not any(part in text for part in ADVICE)]


def test_a_seed_starts_where_a_run_with_that_seed_does():
    environment, scene = made("task02"), load_scene("task02")
    for seed in (3, 4):
        environment.reset(seed=seed)
        assert environment.scene.start == sample_start(scene, seed)
        np.testing.assert_allclose(environment.state.object_pose, environment.scene.start, atol=1e-12)
    # Further episodes start elsewhere, the same ones after the same seed.
    starts = [environment.reset()[0] for _ in range(3)]
    environment.reset(seed=4)
    np.testing.assert_array_equal([environment.reset()[0] for _ in range(3)], starts)
    assert len({tuple(start) for start in starts}) == 3


def test_start_and_goal_may_be_given():
    environment = made("task01")
    start, goal = (0.35, -0.4, 0.3), (0.45, 0.2, 1.0)
    seen, info = environment.reset(options={"start": start, "goal": goal})
    assert environment.scene.start == start and environment.scene.goal == goal
    np.testing.assert_allclose(
        seen[-8:], [0.35, -0.4, np.cos(0.3), np.sin(0.3), 0.45, 0.2, np.cos(1.0), np.sin(1.0)], rtol=1e-6
    )
    assert (info["position_error"], info["yaw_error"]) == pytest.approx(pose_error(start, goal))
    with pytest.raises(SceneError, match="not wholly on the table"):
        environment.reset(options={"start": (3.0, 0.0, 0.0)})
    with pytest.raises(ConfigError, match="not a pose"):
        environment.reset(options={"goal": (0.1, 0.2)})


def test_the_observation_is_what_the_docstring_says():
    environment = made("task01")
    seen, _ = environment.reset(seed=0)
    for _ in range(20):
        seen, *_ = environment.step(np.array([0.2, 0.0, 0.0, 0.0, 0.0, -0.1]))
    state = environment.state
    assert seen.dtype == np.float32 and seen.shape == (2 * 6 + 11,)
    tip = tip_frame(environment.scene.robot, state.joint_position)[1]
    np.testing.assert_array_equal(seen, vector_of(state, tip, environment.scene.goal))
    np.testing.assert_allclose(seen[:6], state.joint_position, rtol=1e-6)
    np.testing.assert_allclose(seen[6:12], [0.2, 0.0, 0.0, 0.0, 0.0, -0.1], atol=0.01)
    np.testing.assert_allclose(seen[12:15], tip, rtol=1e-6)


def test_actions_are_limited_like_the_commands_of_a_planner():
    environment = made("task01")
    environment.reset(seed=0)
    environment.step(np.full(6, 100.0))
    assert environment._drive.peak_acceleration <= 19.98 and environment._drive.peak_jerk <= 499.98 + 1e-6
    for _ in range(200):  # down, into the table
        environment.step(np.array([0.0, 1.2, 0.0, 0.0, 0.0, 0.0]))
        assert environment._plant.contacts.robot_obstacle == 0.0
    with pytest.raises(ValueError, match="finite"):
        environment.step(np.full(6, np.nan))


def test_tool_actions_move_the_tip_upright_and_at_the_height_for_pushing():
    environment = made("task01", actions="tool")
    environment.reset(seed=0)
    assert environment.action_space.shape == (2,)
    for _ in range(40):
        environment.step(np.zeros(2))
    before = environment._tip()
    for _ in range(20):
        environment.step(np.array([0.0, 0.1]))
    rotation, tip = tip_frame(environment.scene.robot, environment.state.joint_position)
    np.testing.assert_allclose(tip - before, [0.0, 0.1, 0.0], atol=0.01)
    assert tip[2] == pytest.approx(environment.config.cost.height, abs=0.003)
    assert rotation[2, 2] < -0.999


def planned(environment: PushEnvironment, *, seed: int, steps: int = 800) -> list[tuple]:
    """Steps of the environment with a planner of this package in the loop."""
    config = set_option(best("mppi"), "robot.optimizer.samples=512")
    environment.reset(seed=seed)
    planner = make_planner(environment.scene, config, method="mppi", device="cpu", engine="quasistatic", seed=seed)
    planner.start(environment.state)
    taken = []
    for _ in range(steps):
        taken.append(environment.step(planner.plan(environment.state).command))
        if taken[-1][2]:
            break
    return taken


def test_a_planner_in_the_loop_succeeds_and_the_rewards_add_up():
    environment = made("task01", tolerance=(0.01, 0.05))
    taken = planned(environment, seed=5)
    first, goal = environment.scene.start, environment.scene.goal
    *_, (_, _, terminated, truncated, info) = taken
    assert terminated and not truncated and info["is_success"] and info["position_error"] < 0.01
    assert not any(step[4]["is_success"] for step in taken[:-1])

    def distance(pose) -> float:
        away, turn = pose_error(pose, goal)
        return np.hypot(away, limit_surface(environment.scene.object).radius * turn)

    total = sum(step[1] for step in taken)
    assert total == pytest.approx(distance(first) - distance(environment.state.object_pose) + 1.0, abs=1e-9)


def test_an_object_that_falls_ends_the_episode_without_success():
    environment = made("task01")
    environment.reset(seed=0)
    pose = environment.state.object_transform.copy()
    pose[:2] = 3.0
    environment._plant.place(environment.state.joint_position, pose)
    for _ in range(20):
        _, _, terminated, _, info = environment.step(np.zeros(6))
    assert terminated and not info["is_success"]


def test_a_vector_of_environments_runs_in_processes_of_its_own():
    vector = gymnasium.make_vec("oimppi/task01-v0", num_envs=2, vectorization_mode="async", actions="tool")
    try:
        seen, _ = vector.reset(seed=[1, 2])
        again = [made(actions="tool").reset(seed=seed)[0] for seed in (1, 2)]
        np.testing.assert_array_equal(seen, again)
        seen, rewards, *_ = vector.step(np.array([[0.1, 0.0], [0.0, 0.1]], np.float32))
        assert seen.shape == (2, 23) and rewards.shape == (2,)
    finally:
        vector.close()


def test_a_picture_shows_what_moves():
    environment = made("pusht", actions="tool", render_mode="rgb_array")
    environment.reset(seed=0)
    before = environment.render()
    for _ in range(10):
        environment.step(np.array([0.3, 0.3]))
    after = environment.render()
    assert before is not None and after is not None
    assert before.dtype == np.uint8 and before.shape == after.shape and before.shape[2] == 3
    assert np.abs(before.astype(int) - after).max() > 50
    assert made("pusht").render() is None


@pytest.mark.parametrize("options", [{"actions": "torque"}, {"render_mode": "human"}])
def test_an_option_that_cannot_be_used_is_said(options):
    with pytest.raises(ConfigError, match="allowed: "):
        PushEnvironment("task01", **options)


def test_a_file_that_is_no_scene_is_said(tmp_path: Path):
    with pytest.raises(SceneError):
        PushEnvironment(tmp_path / "none.usda")
