"""Where the object is believed to be: predicted pushes, delay, wrong detections, the way back from a wrong belief."""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from support import small_tasks

from oimppi_warp.config.settings import Config
from oimppi_warp.observation import Observation
from oimppi_warp.physics.world import World
from oimppi_warp.plants.plant import SimulatedPlant
from oimppi_warp.runtime.estimator import Estimator
from oimppi_warp.scene import Scene

SPEED = 0.08
"""Speed of the tool while it pushes [m/s]."""
STEPS = 30
"""Length of a push in control steps."""


@pytest.fixture(scope="module")
def can() -> Scene:
    return small_tasks.shipped("lab01")


class Push:
    """A straight push of the object in the plant, and what an estimator is told of it.

    Args:
        scene: The task.
        start: Of the object.
        aside: Of the tool from the object's middle [m].
    """

    def __init__(self, scene: Scene, *, start: tuple[float, float, float] = (0.45, 0.05, 0.0), aside: float = 0.0):
        self.scene = scene
        world = World(scene)
        self.plant = SimulatedPlant(world, start=start)
        joints = small_tasks.joints_at(scene.robot, (start[0] + aside, start[1] + 0.06, 0.02))
        self.plant.data.qpos[world.mujoco.joint_qpos] = joints
        mujoco.mj_forward(self.plant.model, self.plant.data)
        self._controls = iter(small_tasks.straight(scene.robot, joints, (0.0, -SPEED, 0.0), STEPS))

    def told(self, seen: tuple[float, np.ndarray] | None) -> Observation:
        """The plant's joints, and a detection (when, what) or none so far."""
        time, pose = (math.nan, np.full(3, np.nan)) if seen is None else seen
        return replace(self.plant.observe(), object_pose=pose, object_time=time)

    def truth(self) -> np.ndarray:
        return self.plant.observe().object_pose

    def step(self) -> None:
        self.plant.apply(next(self._controls))


def believing(scene: Scene, push: Push, *, off: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Estimator:
    """An estimator that two detections have convinced, of the truth or of something ``off``."""
    estimator, pose = Estimator(scene, Config()), push.truth() + off
    assert estimator.update(push.told((0.0, pose))) is None
    assert estimator.event == "first"
    assert estimator.update(push.told((1e-6, pose))) is not None
    return estimator


def distance(believed: Observation | None, truth: np.ndarray) -> float:
    assert believed is not None
    return float(np.linalg.norm(believed.object_pose[:2] - truth[:2]))


def test_nothing_is_believed_until_two_detections_agree(can: Scene):
    push, estimator = Push(can), Estimator(can, Config())
    assert estimator.update(push.told(None)) is None
    assert estimator.update(push.told((0.0, push.truth() + (0.2, 0.0, 0.0)))) is None
    assert estimator.update(push.told((0.01, push.truth()))) is None
    believed = estimator.update(push.told((0.02, push.truth())))
    assert estimator.event == "accepted"
    assert distance(believed, push.truth()) < 1e-3


@pytest.mark.parametrize(("name", "start", "aside"), [("lab01", (0.45, 0.05, 0.0), 0.0),
                                                      ("lab01", (0.45, 0.05, 0.0), 0.008),
                                                      ("task01", (0.45, 0.03, 0.0), 0.03)])  # fmt: skip
def test_a_push_that_nobody_sees_is_predicted(name: str, start: tuple[float, float, float], aside: float):
    scene = small_tasks.shipped(name)
    push = Push(scene, start=start, aside=aside)
    estimator, began = believing(scene, push), push.truth()
    seen = (1e-6, began)
    for _ in range(STEPS):
        push.step()
        believed = estimator.update(push.told(seen))
    way = float(np.linalg.norm(push.truth()[:2] - began[:2]))
    assert way > 0.05
    assert distance(believed, push.truth()) < 0.15 * way
    assert 0.0 < estimator.spread[0] < way


def test_a_detection_of_the_past_is_brought_to_the_present(can: Scene):
    """Half a second late while the can is pushed: taken as it is, it would be off by the way since."""
    push = Push(can)
    estimator, seen, believed = believing(can, push, off=(0.01, 0.01, 0.0)), None, None
    past: list[tuple[float, np.ndarray]] = []
    for step in range(STEPS):
        push.step()
        now = push.plant.observe()
        past.append((now.time, now.object_pose))
        if step == 25:
            seen = past[15]
        believed = estimator.update(push.told(seen if seen is not None else (1e-6, push.truth())))
    assert seen is not None
    late = float(np.linalg.norm(seen[1][:2] - push.truth()[:2]))
    assert late > 0.04
    assert distance(believed, push.truth()) < 0.35 * late


def test_a_wrong_detection_is_rejected_and_changes_nothing(can: Scene):
    push = Push(can)
    estimator = believing(can, push)
    believed = estimator.update(push.told((2e-6, push.truth() + (0.15, 0.05, 1.0))))
    assert estimator.event == "rejected"
    assert distance(believed, push.truth()) < 1e-3
    assert distance(estimator.update(push.told((3e-6, push.truth()))), push.truth()) < 1e-3
    assert estimator.event == "accepted"


def test_two_wrong_detections_that_do_not_agree_are_both_rejected(can: Scene):
    push = Push(can)
    estimator = believing(can, push)
    for step, off in enumerate([(0.15, 0.05, 1.0), (-0.15, 0.1, 0.0)]):
        believed = estimator.update(push.told((1e-5 * (step + 1), push.truth() + off)))
        assert estimator.event == "rejected"
    assert distance(believed, push.truth()) < 1e-3


def test_two_detections_that_agree_overrule_a_wrong_belief(can: Scene):
    push = Push(can)
    estimator = believing(can, push, off=(-0.12, 0.2, 0.0))
    for _ in range(8):
        push.step()
        estimator.update(push.told((1e-6, push.truth())))
    seen = (push.plant.observe().time, push.truth())
    believed = estimator.update(push.told(seen))
    assert estimator.event == "rejected"
    assert distance(believed, push.truth()) > 0.1
    for _ in range(8):  # the first of them follows the pushes too, so that the second is compared with it as it is now
        push.step()
        estimator.update(push.told(seen))
    believed = estimator.update(push.told((push.plant.observe().time, push.truth())))
    assert estimator.event == "recovered"
    assert distance(believed, push.truth()) < 0.01


def test_what_is_believed_is_the_less_certain_the_further_it_was_pushed_unseen(can: Scene):
    push = Push(can)
    estimator = believing(can, push)
    spreads = [estimator.spread[0]]
    for _ in range(STEPS):
        push.step()
        estimator.update(push.told((1e-6, push.truth())))
        spreads.append(estimator.spread[0])
    assert (np.diff(spreads) >= -1e-12).all()
    assert spreads[-1] > 2.0 * spreads[0]
    estimator.update(push.told((push.plant.observe().time, push.truth())))
    assert estimator.spread[0] < 0.005 + 1e-9  # no worse than the detection


def test_what_is_decided_is_foreseen(can: Scene):
    push = Push(can)
    for _ in range(10):
        push.step()
    estimator = believing(can, push)
    believed = estimator.update(push.told((2e-6, push.truth())))
    assert believed is not None
    joints = push.plant.observe().joint_position
    velocity = small_tasks.straight(can.robot, joints, (0.0, -SPEED, 0.0), 1)[0]
    ahead = estimator.predict(believed, [(0.02, velocity), (0.08, velocity)])
    before = push.truth()
    for _ in range(2):
        push.plant.apply(velocity)
    assert ahead.time == pytest.approx(believed.time + 0.1)
    np.testing.assert_allclose(ahead.joint_position, push.plant.observe().joint_position, atol=2e-3)
    moved = float(np.linalg.norm(push.truth()[:2] - before[:2]))
    assert moved > 0.005
    assert distance(ahead, push.truth()) < 0.3 * moved + 5e-4
    assert estimator.predict(believed, [(0.0, velocity)]) is believed


def test_it_runs_longer_than_its_memory(can: Scene):
    config = Config()
    estimator, pose = Estimator(can, config), np.array([0.45, 0.05, 0.0])
    joints = can.robot.start
    for step in range(3000):
        time = 0.01 * step
        seen = math.floor(time)
        told = replace(small_tasks.observe(can, joints=joints, pose=pose), time=time, object_time=float(seen))
        believed = estimator.update(told)
    assert distance(believed, pose) < 1e-3
    assert estimator.spread[0] < config.estimator.position_noise


def test_a_plant_that_knows_where_the_object_is_is_believed_at_once(can: Scene):
    push, estimator = Push(can), Estimator(can, Config())
    assert distance(estimator.update(push.plant.observe()), push.truth()) < 1e-6
    for _ in range(STEPS):
        push.step()
        believed = estimator.update(push.plant.observe())
        assert distance(believed, push.truth()) < 1e-6
