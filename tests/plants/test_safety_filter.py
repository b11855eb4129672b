"""The filter in front of every plant: whatever is commanded, the arm touches nothing and no joint reaches its limit."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import mujoco
import numpy as np
import pytest
from support.small_tasks import shipped

from oimppi_warp.config.presets import best, paper
from oimppi_warp.config.settings import Safety
from oimppi_warp.geometry.kinematics import tip_frame, tip_jacobian
from oimppi_warp.observation import Observation
from oimppi_warp.physics.newton_model import ROLES
from oimppi_warp.physics.world import World
from oimppi_warp.planning.optimizers.optimizer import Update
from oimppi_warp.planning.plan import Plan, PlanDetails
from oimppi_warp.plants.drive import Drive
from oimppi_warp.plants.plant import SimulatedPlant
from oimppi_warp.plants.safety_filter import SafetyFilter
from oimppi_warp.record.metrics import summarize
from oimppi_warp.runtime.control import lock_step, real_time
from oimppi_warp.runtime.episode import Episode
from oimppi_warp.runtime.estimator import Estimator
from oimppi_warp.scene import Scene

PERIOD = 0.05


class Commanding:
    """A planner from outside: joint velocities that change every 0.6 s, at random."""

    def __init__(self, dof: int, seed: int, speed: float = 1.5) -> None:
        self.rng, self.dof, self.speed, self.plans = np.random.default_rng(seed), dof, speed, 0
        self.command = np.zeros(dof)

    def start(self, observation: Observation) -> float:
        return 0.0

    def plan(self, observation: Observation) -> Plan:
        if self.plans % 12 == 0:
            self.command = self.rng.uniform(-self.speed, self.speed, self.dof)
        self.plans += 1
        nothing = Update(min_cost=0.0, temperature=1.0, effective_samples=1.0, lost=0)
        none = np.zeros((0, 3))
        return Plan(self.command, 0.0, lambda: PlanDetails(nothing, None, np.zeros(0), none, none, none))


class Watch:
    """Distances of the arm, computed from a model of its own."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.world = scene, World(scene).mujoco
        self.model, self.data = self.world.model, mujoco.MjData(self.world.model)
        roles = np.array([ROLES[role] for role in self.world.roles])
        self.moving = np.flatnonzero(np.isin(roles, ["arm", "tool"]))
        self.still = np.flatnonzero(np.isin(roles, ["table", "obstacle"]))
        self.body = self.model.geom_bodyid

    def place(self, joints: np.ndarray) -> None:
        self.data.qpos[self.world.joint_qpos] = joints
        mujoco.mj_kinematics(self.model, self.data)

    def distance(self, a: int, b: int) -> float:
        return mujoco.mj_geomDistance(self.model, self.data, int(a), int(b), 1.0, None)

    def around(self, joints: np.ndarray) -> float:
        self.place(joints)
        return min(self.distance(a, b) for a in self.moving for b in self.still)

    def itself(self, joints: np.ndarray) -> float:
        """Distance of links that are neither the same nor neighbours; the bodies of the shipped arm are a chain."""
        self.place(joints)
        apart = [(a, b) for a in self.moving for b in self.moving if self.body[a] - self.body[b] >= 3]
        return min(self.distance(a, b) for a, b in apart)

    def to_limits(self, joints: np.ndarray) -> float:
        ends = np.array([(joint.lower, joint.upper) for joint in self.scene.robot.joints])
        return float(np.minimum(joints - ends[:, 0], ends[:, 1] - joints).min())


def wild(scene: Scene, seed: int, *, filtered: bool, steps: int = 300) -> tuple[list, SimulatedPlant, float]:
    """Steps of an arm that is commanded at random, its plant, and the largest force on table and obstacles [N]."""
    plant = SimulatedPlant(World(scene), start=scene.start)
    drive = Drive(plant, scene.robot.dof, Safety())
    guard = SafetyFilter(scene, Safety(), PERIOD) if filtered else None
    done, force = [], 0.0
    for step in islice(
        lock_step(drive, Commanding(scene.robot.dof, seed), None, dof=scene.robot.dof, guard=guard), steps
    ):
        done.append(step)
        force = max(force, plant.contacts.robot_obstacle)
    return done, plant, force


def scaled(before: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """The part of a change that the limits of acceleration and jerk allow, as the drive scales it."""
    most = Safety().most_change(PERIOD)
    return before + min(1.0, most / max(float(np.abs(wanted - before).max()), 1e-9)) * (wanted - before)


@pytest.mark.parametrize("name", ["task02", "task04", "arm7_01"])
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_whatever_is_commanded_the_arm_touches_nothing(name: str, seed: int):
    scene, safety = shipped(name), Safety()
    watch = Watch(scene)
    steps, _, force = wild(scene, seed, filtered=True)
    at = [step.observed.joint_position for step in steps]
    assert force == 0.0
    assert min(map(watch.around, at)) > 0.0
    assert name == "arm7_01" or min(map(watch.itself, at)) > 0.0
    assert min(map(watch.to_limits, at)) > -1e-3, "the plant's own lag of its drives included"
    assert sum(bool(step.filtered.reason) for step in steps) > 30, "the commands would have led somewhere"
    assert max(step.peak_acceleration for step in steps) <= safety.acceleration_limit + 1e-6
    assert max(step.peak_jerk for step in steps) <= safety.jerk_limit + 1e-6


def test_without_the_filter_it_does():
    scene = shipped("task02")
    steps, _, force = wild(scene, 1, filtered=False)
    assert force > 100.0
    assert not any(step.filtered.reason for step in steps)


def test_the_arm_does_not_touch_itself():
    """Folded by joints 2, 3 and 5 until links that are not neighbours would meet."""
    scene = shipped("task01")
    watch, guard = Watch(scene), SafetyFilter(scene, Safety(), PERIOD)
    folded = np.array([0.0, -1.0, 0.2, 0.0, 2.2, 0.0])

    def follow(filtered: bool) -> tuple[float, set[str]]:
        joints, before, reasons, least = scene.robot.start.copy(), np.zeros(6), set(), np.inf
        for _ in range(200):
            wanted = scaled(before, np.clip(folded - joints, -1.0, 1.0))
            if filtered:
                done = guard.project(joints, wanted, before)
                wanted, reasons = done.joint_velocity, reasons | ({done.reason} if done.reason else set())
            joints, before = joints + PERIOD * wanted, wanted
            least = min(least, watch.itself(joints))
        return least, reasons

    assert follow(False)[0] < -0.01
    least, reasons = follow(True)
    assert least > 0.0
    assert any("link" in reason for reason in reasons)


def test_a_command_within_the_bounds_passes_unchanged():
    scene = shipped("task02")
    guard = SafetyFilter(scene, Safety(), PERIOD)
    for wanted in 0.3 * np.eye(6):
        done = guard.project(scene.robot.start, wanted, np.zeros(6))
        assert done.joint_velocity is wanted and not done.reason and not done.stopped


def test_a_tool_that_is_led_into_the_table_goes_on_across_it():
    scene = shipped("task01")
    guard, watch = SafetyFilter(scene, Safety(), PERIOD), Watch(scene)
    joints, before, least = scene.robot.start.copy(), np.zeros(6), np.inf
    start = tip_frame(scene.robot, joints)[1]
    for _ in range(40):
        wanted = np.linalg.pinv(tip_jacobian(scene.robot, joints)) @ np.array([0.0, 0.1, -0.2, 0.0, 0.0, 0.0])
        done = guard.project(joints, scaled(before, wanted), before)
        assert not done.stopped
        joints, before = joints + PERIOD * done.joint_velocity, done.joint_velocity
        least = min(least, watch.around(joints))
    assert 0.75 * Safety().margin < least < 1.5 * Safety().margin
    assert "tool and the table" in done.reason
    assert tip_frame(scene.robot, joints)[1][1] - start[1] > 0.7 * 0.1 * 40 * PERIOD


def test_a_joint_brakes_in_time_for_its_limit():
    scene = shipped("task01")
    guard, most = SafetyFilter(scene, Safety(), PERIOD), Safety().most_change(PERIOD)
    joints, before, reasons, upper = scene.robot.start.copy(), np.zeros(6), set(), scene.robot.joints[4].upper
    while joints[4] < upper - 1e-3:
        done = guard.project(joints, scaled(before, np.array([0.0, 0.0, 0.0, 0.0, 1.5, 0.0])), before)
        assert not done.stopped and np.abs(done.joint_velocity - before).max() <= most + 1e-9
        joints, before, reasons = joints + PERIOD * done.joint_velocity, done.joint_velocity, reasons | {done.reason}
    assert joints[4] <= upper and before[4] < 0.02
    assert "the limit of joint 5" in reasons


def test_where_nothing_keeps_all_bounds_the_arm_is_brought_to_rest():
    """At full speed, a hand's breadth above the table: too late to brake within the limits."""
    scene = shipped("task01")
    guard, most = SafetyFilter(scene, Safety(), PERIOD), Safety().most_change(PERIOD)
    joints = scene.robot.start
    down = np.linalg.pinv(tip_jacobian(scene.robot, joints)) @ np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])
    down *= 3.0 / np.abs(down).max()
    done = guard.project(joints, down, down)
    assert done.stopped and "tool and the table" in done.reason
    assert np.abs(done.joint_velocity - down).max() <= most + 1e-9
    sinks = tip_jacobian(scene.robot, joints)[2]
    assert sinks @ done.joint_velocity > sinks @ (down - most * np.sign(down)) - 1e-9, "as fast as it can brake"
    unknown = guard.project(np.full(6, np.nan), down, np.full(6, 0.1))
    assert unknown.stopped and unknown.problem == "the joint positions cannot be true"
    np.testing.assert_array_equal(unknown.joint_velocity, np.zeros(6))
    far = joints.copy()
    far[0] = 100.0
    np.testing.assert_array_equal(guard.project(far, np.zeros(6), np.zeros(6)).joint_velocity, np.zeros(6))


def test_an_arm_at_rest_stays_at_rest_where_nothing_helps():
    """A wrong scene, or a wrong reading: links deep in the table, from where distances lead anywhere."""
    scene = shipped("task01")
    guard = SafetyFilter(scene, Safety(), PERIOD)
    for shoulder in np.linspace(0.6, 2.0, 15):
        joints, before = scene.robot.start.copy(), np.zeros(6)
        joints[1] = shoulder
        for _ in range(20):
            done = guard.project(joints, np.zeros(6), before)
            joints, before = joints + PERIOD * done.joint_velocity, done.joint_velocity
            assert np.abs(before).max() < 0.2


def test_joints_without_limits_are_filtered_as_others():
    scene = shipped("task01")
    robot = scene.robot
    free = replace(robot.joints[0], lower=-np.inf, upper=np.inf)
    endless = replace(scene, robot=replace(robot, joints=(free, *robot.joints[1:])))
    inverse = np.linalg.pinv(tip_jacobian(robot, robot.start))
    joints = robot.start + inverse @ np.array([0.0, 0.0, -0.035, 0.0, 0.0, 0.0])
    down = inverse @ np.array([0.0, 0.1, -0.2, 0.0, 0.0, 0.0])
    results = [SafetyFilter(each, Safety(), PERIOD).project(joints, down, 0.3 * down) for each in (scene, endless)]
    assert results[0].reason and not results[0].stopped
    np.testing.assert_allclose(results[1].joint_velocity, results[0].joint_velocity, atol=1e-9)


def test_what_the_arm_cannot_change_does_not_stop_it():
    scene = shipped("point01")  # its tool slides 12 mm above the table
    guard = SafetyFilter(scene, replace(Safety(), margin=0.013), PERIOD)
    done = guard.project(scene.robot.start, np.array([0.1, 0.05]), np.zeros(2))
    np.testing.assert_array_equal(done.joint_velocity, [0.1, 0.05])


def test_an_arm_that_is_too_close_is_taken_back_slowly():
    scene = shipped("task01")
    guard, watch = SafetyFilter(scene, Safety(), PERIOD), Watch(scene)
    joints = scene.robot.start.copy()
    while watch.around(joints) > 0.0005:
        down = np.array([0.0, 0.0, -0.0002, 0.0, 0.0, 0.0])
        joints = joints + np.linalg.pinv(tip_jacobian(scene.robot, joints)) @ down
    before = np.zeros(6)
    for _ in range(60):
        done = guard.project(joints, np.zeros(6), before)
        joints, before = joints + PERIOD * done.joint_velocity, done.joint_velocity
        assert np.abs(tip_jacobian(scene.robot, joints)[:3] @ before).max() < 0.011
    assert watch.around(joints) > 0.9 * Safety().margin


def test_in_real_time_too():
    scene = shipped("task02")
    plant = SimulatedPlant(World(scene), start=scene.start)
    guard, config = SafetyFilter(scene, Safety(), PERIOD), best("mppi")
    loop = real_time(
        Drive(plant, 6, Safety()),
        Commanding(6, 2),
        Estimator(scene, config),
        dof=6,
        expires=1.0,
        guard=guard,
        sleep=lambda seconds: None,
    )
    reasons = set()
    for step in islice(loop, 300):
        assert step.filtered is not None
        reasons.add(step.filtered.reason)
        assert plant.contacts.robot_obstacle == 0.0
    loop.close()
    assert len(reasons) > 2


def test_an_episode_records_what_was_filtered(device: str, monkeypatch: pytest.MonkeyPatch):
    scene, config = shipped("task02"), best("mppi")
    config = replace(config, episode=replace(config.episode, max_sim_seconds=3.0))
    episode = Episode(scene, config, method="mppi", engine="quasistatic", device=device, threads=1)
    down = np.linalg.pinv(tip_jacobian(scene.robot, scene.robot.start)) @ np.array([0.0, 0.0, -0.3, 0.0, 0.0, 0.0])
    plan = episode.planner.plan
    monkeypatch.setattr(episode.planner, "plan", lambda seen: replace(plan(seen), command=down))
    log = episode.run()
    count = int(log["filtered"].sum())
    assert count > 20
    assert sum(log.header["filtered"].values()) == count
    assert any("tool and the table" in reason for reason in log.header["filtered"])
    assert summarize(log).filtered_commands == count
    assert np.nanmax(log["contact_robot_obstacle"]) == 0.0


def test_the_preset_of_the_paper_has_no_filter():
    assert best("cloi").safety.filter and not paper().safety.filter
