"""Scenes that other programs wrote: converted into the same task and the same physics, or refused with a reason."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from elsewhere import differences, flat, measured_in, with_y_up, written
from pxr import Usd

from oimppi_warp.kinematics import tip_frame, tip_jacobian
from oimppi_warp.observation import planar_transform
from oimppi_warp.plant import SimulatedPlant
from oimppi_warp.reach import joints_for
from oimppi_warp.scene import Scene
from oimppi_warp.usd import load_scene
from oimppi_warp.usd.editing import save_scene
from oimppi_warp.world import World

SAME = 1e-3
"""Contact makes more of the rounding of single precision: how far two pushes may be apart after 1.5 s [m]."""

NAMES = ("task02", "task05", "lab02", "point01", "arm7_01")


def converted(folder: Path, name: str, *, metres: float = 1.0, kilograms: float = 1.0, y_up: bool = False) -> Scene:
    """A shipped scene after it was written in other units."""
    stage = flat(name)
    measured_in(stage, metres, kilograms)
    if y_up:
        with_y_up(stage)
    return load_scene(written(stage, folder / f"{name}.usda"))


def pushed(scene: Scene, seconds: float = 1.5) -> tuple[np.ndarray, np.ndarray]:
    """Joint positions and object transforms while the first joint pushes the object, shapes [step, dof], [step, 7]."""
    plant, robot = SimulatedPlant(World(scene)), scene.robot
    tip = np.array([*tip_frame(robot, robot.start)[1][:2], 0.012])
    joints = joints_for(robot, robot.start, tip)
    joints = robot.start if joints is None else joints  # a robot that cannot lower its tool has it low already
    velocity = -0.5 * np.eye(robot.dof)[0]
    away = (tip_jacobian(robot, joints)[:2] @ velocity) / np.linalg.norm(tip_jacobian(robot, joints)[:2] @ velocity)
    at = tip[:2] + 0.14 * away
    plant.place(joints, planar_transform((float(at[0]), float(at[1]), 0.3), scene.object.rest_height))
    seen = []
    for _ in range(int(seconds / plant.control_period)):
        plant.apply(velocity)
        seen.append(plant.observe())
    return np.array([each.joint_position for each in seen]), np.array([each.object_transform for each in seen])


def test_two_tasks_that_differ_are_told_apart():
    found = differences(load_scene("task02"), load_scene("task04"), tolerance=1e-6)
    assert any(".obstacles" in each for each in found)
    assert differences(load_scene("task02").robot, load_scene("arm7_01").robot, tolerance=1e-6)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    ("metres", "kilograms", "y_up"),
    [(0.01, 1.0, False), (0.001, 0.001, False), (1.0, 1.0, True), (0.0254, 0.4536, True)],
)
def test_a_scene_in_other_units_is_the_same_task(tmp_path, name, metres, kilograms, y_up):
    scene = converted(tmp_path, name, metres=metres, kilograms=kilograms, y_up=y_up)
    assert differences(load_scene(name), scene, tolerance=1e-6) == []


@pytest.mark.parametrize("name", ["task01", "task05", "point01"])
def test_a_scene_in_other_units_moves_the_same(tmp_path, name):
    joints, poses = pushed(load_scene(name))
    other_joints, other_poses = pushed(converted(tmp_path, name, metres=0.01, kilograms=0.001, y_up=True))
    assert np.linalg.norm(poses[-1, :2] - poses[0, :2]) > 0.01
    np.testing.assert_allclose(other_joints, joints, atol=1e-5)
    np.testing.assert_allclose(other_poses, poses, atol=SAME)


def test_a_file_in_other_units_is_left_as_it_is(tmp_path):
    scene = converted(tmp_path, "task02", metres=0.01, y_up=True)
    before = scene.file.read_text()
    saved = save_scene(scene.with_goal((0.4, 0.3, 0.0)), tmp_path / "saved.usda")
    assert scene.file.read_text() == before
    assert "metersPerUnit = 1\n" in saved.read_text()
    assert differences(scene.with_goal((0.4, 0.3, 0.0)), load_scene(saved), tolerance=1e-6) == []
    assert Usd.Stage.Open(str(scene.file)).GetMetadata("upAxis") == "Y"
