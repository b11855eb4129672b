"""A plant of one's own needs three things: its period, what it reports, and to be moved. What it reports is checked."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.small_tasks import shipped

from oimppi_warp.config.overrides import set_option
from oimppi_warp.config.presets import best
from oimppi_warp.config.run_spec import RunSpec
from oimppi_warp.config.settings import Config
from oimppi_warp.errors import ConfigError, ObservationError, OimppiError
from oimppi_warp.geometry.kinematics import tip_frame
from oimppi_warp.observation import Observation, planar_transform
from oimppi_warp.planning.factory import make_planner
from oimppi_warp.planning.planner import Planner
from oimppi_warp.plants.drive import Drive
from oimppi_warp.plants.plant import (
    ContactPlant,
    JudgingPlant,
    MovablePlant,
    RealPlant,
    SimulatedPlant,
    StopRules,
    TruthfulPlant,
    Verdict,
    ideal_plant,
)
from oimppi_warp.record.metrics import summarize
from oimppi_warp.registries import PLANTS
from oimppi_warp.runtime.control import lock_step
from oimppi_warp.runtime.episode import Episode, check_plant
from oimppi_warp.runtime.estimator import Estimator
from oimppi_warp.scene import Scene


class Kinematic:
    """An arm that does exactly what it is told, beside an object that nothing moves."""

    control_period = 0.1

    def __init__(self, scene: Scene) -> None:
        self.time, self.joints, self.pose = 0.0, scene.robot.start.copy(), np.array(scene.start)
        self.transform = planar_transform(scene.start, scene.object.rest_height)

    def observe(self) -> Observation:
        return Observation(self.time, self.joints, np.zeros_like(self.joints), self.pose, self.transform)

    def apply(self, joint_velocity: np.ndarray) -> None:
        self.joints = self.joints + self.control_period * joint_velocity
        self.time += self.control_period


def small(method: str = "mppi", *changes: str) -> Config:
    config = best(method)
    for change in ("robot.optimizer.samples=128", "object.optimizer.samples=64", "episode.max_sim_seconds=2", *changes):
        config = set_option(config, change)
    return config


def test_a_plant_with_a_period_a_report_and_a_command_is_enough(device: str):
    scene = shipped("task01")
    plant = Kinematic(scene)
    assert not isinstance(plant, TruthfulPlant | ContactPlant | MovablePlant)
    episode = Episode(scene, small(), plant=plant, method="mppi", engine="quasistatic", device=device)
    log = episode.run()
    assert log.header["plant"] == "Kinematic"
    # It is planned in the plant's steps, and the record says so.
    assert len(log) == 20
    assert log.header["control_period"] == log.header["config"]["control_period"] == plant.control_period
    np.testing.assert_allclose(log["time"], 0.1 * np.arange(1, 21))
    # What it does not know is not made up; what it reports is the record.
    assert np.isnan(log["contact_tool_object"]).all() and np.isnan(log["contact_robot_obstacle"]).all()
    np.testing.assert_array_equal(log["object_pose"], np.tile(scene.start, (20, 1)))
    metrics = summarize(log)
    assert metrics.ended == "time limit" and np.isnan(metrics.max_contact_tool_object_n)
    # The tool sets out towards the object.
    away = np.linalg.norm(log["tool_position"][:, :2] - np.array(scene.start[:2]), axis=1)
    begin = np.linalg.norm(tip_frame(scene.robot, scene.robot.start)[1][:2] - np.array(scene.start[:2]))
    assert away[-1] < begin - 0.05


class Judging(Kinematic):
    """Places its object itself, and says after how many control periods the task is done or the episode over."""

    own_world = True

    def __init__(self, scene: Scene, *, done: int = 99, over: int = 99) -> None:
        super().__init__(scene.with_start((0.35, -0.4, 0.2)))
        self.done, self.over = done, over

    @property
    def verdict(self) -> Verdict:
        steps = round(self.time / self.control_period)
        return Verdict(steps >= self.done, steps >= self.over, {"steps": float(steps), "half": 0.5 * steps})


@pytest.mark.parametrize(
    ("limits", "ended", "steps"),
    [({"done": 5}, "success", 5), ({"over": 7}, "time limit", 7), ({"done": 4, "over": 4}, "success", 4)],
)
def test_a_plant_may_judge_the_task_itself(device: str, limits: dict, ended: str, steps: int):
    scene = shipped("task01")
    plant = Judging(scene, **limits)
    assert isinstance(plant, JudgingPlant) and not isinstance(Kinematic(scene), JudgingPlant)
    log = Episode(scene, small(), plant=plant, method="mppi", engine="quasistatic", device=device).run()
    metrics = summarize(log)
    assert (metrics.ended, metrics.success, len(log)) == (ended, ended == "success", steps)
    assert metrics.best_scores == {"steps": steps, "half": 0.5 * steps}
    assert np.isnan(metrics.success_time_s) or metrics.success_time_s == pytest.approx(0.1 * steps)
    np.testing.assert_allclose(log["scores"], np.outer(np.arange(1, steps + 1), [1.0, 0.5]))
    # It starts where the plant put it, and the record says so; others have no scores.
    np.testing.assert_allclose(metrics.start, (0.35, -0.4, 0.2))
    np.testing.assert_allclose(log["object_pose"], np.tile((0.35, -0.4, 0.2), (steps, 1)))


def test_a_plant_that_does_not_judge_has_no_scores(device: str):
    log = Episode(shipped("task01"), small(), plant=Kinematic(shipped("task01")), method="mppi", device=device).run()
    assert log.header["scores"] == [] and summarize(log).best_scores == {}
    assert np.isnan(log["done"]).all()


def test_a_plant_is_registered_by_name_and_removed_again(device: str):
    def kinematic(scene: Scene, config: Config, *, seed: int) -> Kinematic:
        made.append(seed)
        return Kinematic(scene)

    made: list[int] = []
    scene, config = shipped("point01"), small("cloi", "episode.max_sim_seconds=0.2")
    with pytest.raises(ConfigError, match=r"plant 'kinematic' does not exist\n  allowed: ideal, lab, pusht"):
        Episode(scene, config, plant="kinematic")
    PLANTS.register("kinematic", kinematic)
    try:
        log = Episode(scene, config, plant="kinematic", engine="quasistatic", device=device, seed=7).run()
        assert log.header["plant"] == "kinematic" and made == [7] and len(log) == 2
        with pytest.raises(ConfigError, match="already registered"):
            PLANTS.register("kinematic", Kinematic)
        with pytest.raises(ConfigError, match="already registered"):
            PLANTS.register("lab", kinematic)
    finally:
        PLANTS.unregister("kinematic")
    assert list(PLANTS) == ["ideal", "lab", "pusht", "xarm", "ros2"]


def test_the_simulated_plant_takes_part_in_every_protocol():
    plant = ideal_plant(shipped("task01"), Config())
    assert isinstance(plant, SimulatedPlant)
    assert isinstance(plant, TruthfulPlant) and isinstance(plant, ContactPlant) and isinstance(plant, MovablePlant)


@pytest.fixture(scope="module")
def planner(device: str) -> Planner:
    made = make_planner(shipped("task01"), small("cloi"), method="cloi", engine="quasistatic", device=device)
    made.start(Kinematic(shipped("task01")).observe())
    return made


WRONG_LENGTHS = {
    "joint_position": (np.zeros(5), r"joint_position has shape \(5,\)\n  allowed: \(6,\)"),
    "joint_velocity": (np.zeros(7), "joint_velocity"),
    "object_pose": (np.zeros(2), "object_pose"),
    "object_transform": (np.zeros(6), "object_transform"),
    "trail": (np.zeros((3, 6)), "trail"),
}


@pytest.mark.parametrize("name", WRONG_LENGTHS)
def test_an_array_of_another_length_is_an_error_that_names_it(planner: Planner, name: str):
    value, said = WRONG_LENGTHS[name]
    wrong = replace(Kinematic(shipped("task01")).observe(), **{name: value})
    estimator = Estimator(shipped("task01"), Config())
    for use in (planner.plan, planner.start, estimator.update):
        with pytest.raises(ObservationError, match=said) as raised:
            use(wrong)
        assert isinstance(raised.value, OimppiError)


NONSENSE = {
    "joint_position": (np.array([0.0, np.nan, 0, 0, 0, 0]), "non-finite values in the joint positions"),
    "joint_velocity": (np.full(6, np.inf), "non-finite values in the joint velocities"),
    "object_pose": (np.array([1e6, 0.0, 0.0]), "1e.06 m from the origin"),
    "object_transform": (np.array([0, 0, 0, 0, 0, 0, np.nan]), "non-finite values in the object.s transform"),
}


@pytest.mark.parametrize("name", NONSENSE)
def test_what_cannot_be_true_stops_the_arm_and_says_why(planner: Planner, name: str):
    good = Kinematic(shipped("task01")).observe()
    value, said = NONSENSE[name]
    wrong = replace(good, **{name: value})
    plan = planner.plan(wrong)
    np.testing.assert_array_equal(plan.command, np.zeros(6))
    assert re.search(said, plan.problem), plan.problem
    with pytest.raises(ObservationError, match="an episode cannot start from this observation"):
        planner.start(wrong)
    # The next true observation is planned from as if nothing had happened.
    again = planner.plan(good)
    assert not again.problem and np.isfinite(again.command).all() and np.abs(again.command).max() > 0.0


def test_joints_far_beyond_their_limits_are_an_error_of_the_sensor(planner: Planner):
    good = Kinematic(shipped("task01")).observe()
    joints = good.joint_position.copy()
    joints[1] = shipped("task01").robot.joints[1].upper + 1.0
    assert "joint 2 is reported 1 rad beyond its limits" in planner.plan(replace(good, joint_position=joints)).problem
    joints[1] = shipped("task01").robot.joints[1].upper + 0.01
    assert not planner.plan(replace(good, joint_position=joints)).problem


def test_an_episode_goes_on_after_a_report_that_cannot_be_true_and_its_record_says_where(device: str):
    scene = shipped("task01")

    class Flickering(Kinematic):
        def observe(self) -> Observation:
            seen = super().observe()
            return replace(seen, object_pose=np.full(3, np.nan)) if 0.25 < self.time < 0.45 else seen

    log = Episode(scene, small(), plant=Flickering(scene), method="mppi", engine="quasistatic", device=device).run()
    assert len(log) == 20
    ((step, reason),) = log.header["problems"]
    assert step == 3 and "non-finite values in the object's pose" in reason
    np.testing.assert_array_equal(log["stopped"], [0, 0, 0, 1, 1] + [0] * 15)
    np.testing.assert_array_equal(log["command"][3:5], np.zeros((2, 6)))
    assert np.abs(log["command"][5:]).max() > 0.0


def test_joints_that_are_not_known_stop_an_arm_whose_object_is_estimated(device: str):
    scene = shipped("task01")

    class Dated(Kinematic):
        def observe(self) -> Observation:
            joints = np.full(6, np.nan) if 0.25 < self.time < 0.45 else self.joints
            return replace(super().observe(), joint_position=joints, object_time=self.time)

    made = make_planner(scene, small(), method="mppi", engine="quasistatic", device=device)
    loop = lock_step(Drive(Dated(scene), 6), made, Estimator(scene, Config()), dof=6)
    beats = [next(loop) for _ in range(8)]
    assert [beat.plan is not None for beat in beats] == [False, True, True, False, False, True, True, True]
    np.testing.assert_array_equal(beats[3].command, np.zeros(6))
    assert np.isnan(beats[3].estimate).all() or np.isnan(beats[2].estimate).all()


def test_an_option_that_a_run_does_not_have_is_an_error():
    with pytest.raises(ConfigError, match="sead: a run has no such option\n  allowed: method, engine"):
        make_planner(shipped("task01"), small(), sead=3)
    with pytest.raises(ConfigError, match="did you mean cloi"):
        make_planner(shipped("task01"), small(), method="clio")


@pytest.mark.parametrize("period", [None, 50, True, "0.05"])
def test_a_plant_whose_control_period_is_missing_or_in_milliseconds_is_an_error(period: Any):
    plant = Kinematic(shipped("task01"))
    plant.control_period = period
    said = r"Kinematic has .*control_period[\s\S]*in seconds, 0\.001 to 1, such as 0\.05"
    with pytest.raises(ConfigError, match=said):
        Episode(shipped("task01"), small(), plant=plant, engine="quasistatic", device="cpu")


def test_a_real_arm_in_lock_step_is_an_error():
    rules = StopRules()
    members = {name: lambda *_: None for name in vars(RealPlant) if not name.startswith("_")} | {"rules": rules}
    made = type("Arm", (Kinematic,), members)(shipped("task01"))
    with pytest.raises(ConfigError, match="the plant Arm is a real arm, which runs in real time only"):
        check_plant(made, RunSpec(), passed=False)
    check_plant(made, RunSpec(mode="realtime"), passed=False)


@pytest.mark.parametrize("name", ["observe", "apply"])
def test_a_plant_without_one_of_its_methods_is_an_error(name: str):
    class Mute(Kinematic):
        pass

    setattr(Mute, name, None)
    with pytest.raises(ConfigError, match=rf"the plant Mute has no method {name}\n  to do:   add {name}\("):
        Episode(shipped("task01"), small(), plant=Mute(shipped("task01")), engine="quasistatic", device="cpu")


@pytest.mark.parametrize(("share", "fits"), [(0.0, False), (0.05, False), (0.9, True), (1.1, True), (2.0, False)])
def test_a_plant_in_lock_step_whose_time_does_not_pass_with_its_periods_is_an_error(
    share: float, fits: bool, device: str
):
    class Slow(Kinematic):
        def apply(self, joint_velocity: np.ndarray) -> None:
            super().apply(joint_velocity)
            self.time += (share - 1.0) * self.control_period

    plant = Slow(shipped("task01"))
    episode = Episode(shipped("task01"), small(), plant=plant, method="mppi", engine="quasistatic", device=device)
    if fits:
        assert len(episode.run()) == 20
        return
    said = rf"the plant Slow: its time advanced by {share:.3g} s in 10 control periods of 0.1 s\n  allowed: about 1 s"
    with pytest.raises(ObservationError, match=said):
        episode.run()


class Watched(Kinematic):
    """Keeps what it was told, and reports too few joints from some time on."""

    def __init__(self, scene: Scene, fails: float) -> None:
        super().__init__(scene)
        self.told: list[np.ndarray] = []
        self.fails = fails

    def observe(self) -> Observation:
        seen = super().observe()
        return seen if self.time < self.fails else replace(seen, joint_position=seen.joint_position[:5])

    def apply(self, joint_velocity: np.ndarray) -> None:
        self.told.append(joint_velocity)
        super().apply(joint_velocity)


def test_however_an_episode_ends_the_arm_is_told_to_stop(device: str):
    scene = shipped("task01")
    for fails, steps in ((0.35, None), (np.inf, 3), (np.inf, None)):
        plant = Watched(scene, fails)
        episode = Episode(scene, small(), plant=plant, method="mppi", engine="quasistatic", device=device)
        if fails < np.inf:
            with pytest.raises(ObservationError, match="joint_position"):
                episode.run()
        elif steps is not None:  # as when a viewer is closed
            loop = episode.steps()
            for _ in range(steps):
                next(loop)
            loop.close()
        else:
            episode.run()
        assert np.abs(plant.told[-2]).max() > 0.0
        np.testing.assert_array_equal(plant.told[-1], np.zeros(6))


def test_settings_are_checked_before_a_plant_is_made_of_them_and_a_plants_own_values_after(device: str):
    scene = shipped("task01")
    with pytest.raises(ConfigError, match="control_period = 0 cannot be used"):
        Episode(scene, replace(small(), control_period=0.0), method="mppi", device=device)
    plant = Kinematic(scene)
    plant.control_period = 7.0
    with pytest.raises(ConfigError, match=r"has a control_period of 7\.0"):
        Episode(scene, small(), plant=plant, method="mppi", device=device)
    late = Kinematic(scene)
    late.latency = 3.0  # type: ignore[attr-defined]
    with pytest.raises(ConfigError, match=r"latency of 3 s\n  allowed: 0 to 1 s"):
        Episode(scene, small(), plant=late, method="mppi", engine="quasistatic", device=device)


def test_joints_that_cannot_be_true_do_not_move_what_is_believed():
    scene = shipped("task01")
    estimator, seen = Estimator(scene, Config()), Kinematic(scene).observe()
    believed = estimator.update(seen)
    assert believed is not None
    wild = replace(seen, time=0.1, joint_position=seen.joint_position + 1e3, object_time=0.0)
    assert estimator.update(wild) is None
    after = estimator.update(replace(seen, time=0.2, object_time=0.0))
    assert after is not None
    np.testing.assert_allclose(after.object_pose, believed.object_pose, atol=1e-5)
