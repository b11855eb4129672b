"""Which objects roll, and which only slide or tip."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from oimppi_warp.geometry.rolling import LEVEL, rolling, rolling_of_points
from oimppi_warp.scene import Collider
from oimppi_warp.usd import load_scene

LYING = np.array([0.0, 0.0, 0.0, math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)])
UPRIGHT = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])

KINDS = {
    "a ball": (Collider("/a", "sphere", UPRIGHT, (0.04,)), "every way"),
    "a rod that lies down": (Collider("/a", "cylinder", LYING, (0.015, 0.1)), "one way"),
    "a capsule that lies down": (Collider("/a", "capsule", LYING, (0.02, 0.05)), "one way"),
    "a can that stands": (Collider("/a", "cylinder", UPRIGHT, (0.033, 0.05)), ""),
    "a slim bottle that stands": (Collider("/a", "cylinder", UPRIGHT, (0.02, 0.1)), ""),
    "a box": (Collider("/a", "box", UPRIGHT, (0.05, 0.03, 0.02)), ""),
    "a thin plate on edge": (Collider("/a", "box", UPRIGHT, (0.05, 0.002, 0.05)), ""),
}


@pytest.mark.parametrize("kind", KINDS)
def test_what_rolls_is_told_from_what_slides_or_falls_over(kind):
    collider, rolls = KINDS[kind]
    body = replace(load_scene("task01").object, colliders=(collider,), center_of_mass=np.zeros(3))
    assert rolling(body) == rolls


@pytest.mark.parametrize("sides", [6, 8, 10, 12, 24])
@pytest.mark.parametrize("turned", [0.0, 0.3])
def test_a_prism_rolls_if_it_is_hardly_lifted_from_side_to_side(sides, turned):
    angles = np.pi * (2.0 * np.arange(sides) + 1.0) / sides - np.pi / 2.0
    across = 0.02 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    y, z = np.tile(across, (2, 1)).T
    x = np.repeat([-0.1, 0.1], sides)
    points = np.stack([math.cos(turned) * x - math.sin(turned) * y, math.sin(turned) * x + math.cos(turned) * y, z]).T
    lift = 1.0 / math.cos(math.pi / sides) - 1.0  # from the middle of a side, at r cos(pi / n), to its edge, at r
    assert rolling_of_points(points) == ("one way" if lift < LEVEL else "")


def test_a_half_ball_rocks_and_does_not_roll():
    ring = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    down = np.linspace(0.0, np.pi / 2.0, 20)
    points = 0.05 * np.stack(
        [np.outer(np.cos(ring), np.cos(down)), np.outer(np.sin(ring), np.cos(down)), -np.tile(np.sin(down), (60, 1))],
        axis=-1,
    ).reshape(-1, 3)
    assert rolling_of_points(points + (0.0, 0.0, 3.0 / 8.0 * 0.05)) == ""  # its centre of mass is 3/8 r below the top


@pytest.mark.parametrize("half_angle", [5.0, 15.0, 30.0, 40.0])
@pytest.mark.parametrize("cut", [0.0, 0.5])
def test_a_cone_rolls_on_its_side_and_not_on_its_base(half_angle, cut):
    height, slope = 0.1, math.radians(half_angle)
    ring = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    circle = np.stack([np.cos(ring), np.sin(ring), np.zeros_like(ring)], axis=1)
    radius, top = height * math.tan(slope), (0.0, 0.0, height * (1.0 - cut))
    points = np.concatenate([radius * circle, radius * cut * circle + top])
    middle = height * (1.0 + 2.0 * cut + 3.0 * cut**2) / (1.0 + cut + cut**2) / 4.0 * (1.0 - cut)  # of a frustum
    points -= (0.0, 0.0, middle)
    assert rolling_of_points(points) == ""
    down = slope + math.pi / 2.0  # turns the side's normal, (cos, 0, sin) of the half angle, to (0, 0, -1)
    turn = np.array([[math.cos(down), 0.0, math.sin(down)], [0.0, 1.0, 0.0], [-math.sin(down), 0.0, math.cos(down)]])
    assert turn @ (math.cos(slope), 0.0, math.sin(slope)) == pytest.approx((0.0, 0.0, -1.0), abs=1e-12)
    assert rolling_of_points(points @ turn.T) == "one way"
