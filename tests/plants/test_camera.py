"""The lab's camera and what hides the object from it, against geometry worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from support import small_tasks

from oimppi_warp.physics.world import World
from oimppi_warp.plants.camera import Camera
from oimppi_warp.scene import Collider, Link


def with_one_ball(center: tuple[float, float, float], radius: float):
    """The world of lab 01 with the whole arm one ball on its fixed base [m]."""
    scene = small_tasks.shipped("lab01")
    ball = Collider("/ball", "sphere", np.array([*center, 0.0, 0.0, 0.0, 1.0]), (radius,))
    links = tuple(replace(link, colliders=()) for link in scene.robot.links)
    return World(replace(scene, robot=replace(scene.robot, base=Link("/base", 1.0, (ball,)), links=links)))


def test_a_ball_in_the_line_of_sight_hides_the_object_and_beside_it_does_not():
    eye, pose = (1.2, 0.0, 0.9), np.array([0.4, 0.0, 0.0])
    middle = ((eye[0] + pose[0]) / 2, 0.0, (eye[2] + 0.101) / 2)
    assert not Camera(with_one_ball(middle, 0.05), eye).sees(np.zeros(6), pose)
    # Half way, the can's top is half as wide: a ball is out of all lines from 0.05 + 0.033 / 2 on.
    beside = (middle[0], 0.05 + 0.033 / 2 + 0.002, middle[2])
    assert Camera(with_one_ball(beside, 0.05), eye).share_seen(np.zeros(6), pose) == 1.0
    behind = (0.1, 0.0, 0.05)
    assert Camera(with_one_ball(behind, 0.05), eye).share_seen(np.zeros(6), pose) == 1.0


def test_half_a_can_behind_a_wide_ball_is_half_seen():
    eye, pose = (1.2, 0.0, 0.9), np.array([0.4, 0.0, 0.0])
    # A ball as large as a house whose side is the plane through the eye and the can's axis.
    huge = (0.8, 50.0, 0.5)
    share = Camera(with_one_ball(huge, 50.0), eye).share_seen(np.zeros(6), pose)
    assert 0.3 < share < 0.7


def test_the_arm_hides_the_can_when_it_stands_before_it_and_not_from_its_start():
    scene = small_tasks.shipped("lab01")
    can = np.array([0.40, 0.0, 0.0])
    camera = Camera(World(scene), (0.9, 0.0, 0.9))
    assert camera.sees(scene.robot.start, np.array(scene.start))
    before, beside = (small_tasks.joints_at(scene.robot, (0.40 + x, y, 0.015)) for x, y in ((0.05, 0.0), (0.0, 0.05)))
    assert not camera.sees(before, can)
    assert camera.sees(beside, np.array([0.40, 0.0, 0.0]))
