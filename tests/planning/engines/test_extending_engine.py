"""A rollout engine from outside the package, written in NumPy: planned with by its name, and taken out again."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import warp as wp
from support import small_tasks
from support.device import assert_same

from oimppi_warp.compute.step import Launch
from oimppi_warp.config.overrides import set_option
from oimppi_warp.config.presets import best
from oimppi_warp.errors import ConfigError
from oimppi_warp.geometry.kinematics import tip_frame, tip_jacobian
from oimppi_warp.planning.engines.dynamics import RobotDynamics
from oimppi_warp.planning.engines.quasistatic import QuasistaticDynamics
from oimppi_warp.planning.factory import make_planner
from oimppi_warp.registries import ENGINES

TARGET = np.array([0.35, 0.15, 0.2])
"""Where the tip is sent [m]."""


class Reaching(RobotDynamics):
    """The tip moves as the Jacobian of its first position says; what costs is where it is from ``TARGET``."""

    def rollout(self, controls: wp.array, costs: wp.array) -> Launch:
        """Prepares the squared distances of the tip, summed over the horizon."""

        def roll() -> None:
            joints = self.observation.joint_position
            velocities = controls.numpy() @ tip_jacobian(self.task.scene.robot, joints)[:3].T
            tips = tip_frame(self.task.scene.robot, joints)[1] + self.task.dt * np.cumsum(velocities, axis=1)
            costs.assign(1e3 * np.sum((tips - TARGET) ** 2, axis=(1, 2)).astype(np.float32))

        return roll


@pytest.fixture
def reaching() -> Iterator[None]:
    ENGINES.register("reaching", Reaching)
    yield
    ENGINES.unregister("reaching")


def test_an_engine_in_numpy_is_planned_with(reaching, device):
    scene = small_tasks.shipped("task01")
    config = set_option(best("mppi"), "robot.controls=joint")
    planner = make_planner(scene, config, method="mppi", engine="reaching", device=device, threads=1)
    joints = scene.robot.start
    planner.start(small_tasks.observe(scene))
    off = [np.linalg.norm(tip_frame(scene.robot, joints)[1] - TARGET)]
    for _ in range(40):
        plan = planner.plan(small_tasks.observe(scene, joints=joints))
        joints = joints + small_tasks.DT * plan.command
        off.append(np.linalg.norm(tip_frame(scene.robot, joints)[1] - TARGET))
    assert off[0] > 0.15 and off[-1] < 0.03, off


def test_what_an_engine_leaves_out_has_a_default(reaching, device):
    scene = small_tasks.shipped("task01")
    planner = make_planner(scene, best("cloi"), method="cloi", engine="reaching", device=device, threads=1)
    seen = small_tasks.observe(scene)
    planner.start(seen)
    plan = planner.plan(seen)
    horizon = planner.config.robot.optimizer.horizon
    assert planner.dynamics.terms == ("cost",)
    np.testing.assert_allclose(plan.terms, [plan.update.min_cost], rtol=1e-6)
    np.testing.assert_allclose(plan.tips, np.tile(tip_frame(scene.robot, seen.joint_position)[1], (horizon + 1, 1)))
    np.testing.assert_allclose(plan.object_poses, np.tile(seen.object_pose, (horizon + 1, 1)), atol=1e-9)
    samples = planner.samples(6)
    assert samples.tips.shape == (6, horizon + 1, 3)
    assert samples.terms["cost"] == pytest.approx(plan.update.min_cost, rel=1e-6)


def test_any_callable_that_makes_an_engine_is_one(device: str):
    made = []

    def engine(task):
        made.append(task)
        return QuasistaticDynamics(task)

    ENGINES.register("mine", engine)
    try:
        scene = small_tasks.shipped("task01")
        commands = []
        for name in ("mine", "quasistatic"):
            planner = make_planner(scene, best("mppi"), method="mppi", engine=name, device=device, seed=4)
            planner.start(small_tasks.observe(scene))
            commands.append(planner.plan(small_tasks.observe(scene)).command)
        assert [task.scene.name for task in made] == ["task01"]
        assert_same(commands[0], commands[1], cuda=1e-4)
    finally:
        ENGINES.unregister("mine")


def test_an_engine_that_was_taken_out_is_unknown(reaching, device):
    ENGINES.unregister("reaching")
    scene = small_tasks.shipped("task01")
    with pytest.raises(ConfigError, match=r"engine 'reaching' does not exist\n.*quasistatic, newton"):
        make_planner(scene, best("mppi"), method="mppi", engine="reaching", device=device)
