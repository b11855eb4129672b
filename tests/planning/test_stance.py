"""The stance field: the way of the tool around the object to where a push moves it as wanted."""

from __future__ import annotations

import numpy as np
import pytest
from support import reference
from support.device import DEVICE
from support.small_tasks import block, shipped, task

from oimppi_warp.config.settings import RobotCost
from oimppi_warp.geometry.fields import build_geometry
from oimppi_warp.planning.engines.packing import object_model
from oimppi_warp.planning.stance import Outline, build_stance

ORIGIN = np.zeros(3)


def way_of(scene, tips, motion) -> np.ndarray:
    """The way [m] of tips [n, 2] for an object at the origin that should move by ``motion``."""
    field = build_stance(scene, build_geometry(scene, DEVICE), RobotCost().w_theta, DEVICE)
    return np.array([reference.stance(field, np.append(tip, 0.0), ORIGIN, np.asarray(motion)) for tip in tips])


def test_the_best_place_is_behind_the_object():
    scene = task(pushed=block((0.2, 0.1, 0.05)))
    radius = scene.robot.tool_radius
    behind, beside, before = way_of(
        scene, [[-0.1 - radius, 0.0], [0.0, 0.05 + radius], [0.1 + radius, 0.0]], [0.05, 0.0, 0.0]
    )
    assert behind < 0.01
    assert behind + 0.05 < beside < before
    # From the front the tool has to go around: half the length, the width, half the length again.
    assert before == pytest.approx(0.2 + 0.1 + 2 * radius, abs=0.06)


@pytest.mark.parametrize("turn", [0.5, -0.5])
def test_for_a_turn_the_best_places_are_at_the_ends(turn: float):
    scene = task(pushed=block((0.2, 0.06, 0.05)))
    edge = 0.03 + scene.robot.tool_radius
    along = np.linspace(-0.09, 0.09, 7)
    ways = way_of(scene, np.column_stack([along, np.full(7, -edge)]), [0.0, 0.0, turn])
    assert int(np.argmin(ways)) == (6 if turn > 0 else 0)
    assert ways.min() + 0.1 < ways[3]


def test_far_away_the_way_grows_with_the_distance():
    scene = task(pushed=block((0.2, 0.1, 0.05)))
    near, far = way_of(scene, [[-0.3, 0.0], [-0.6, 0.0]], [1.0, 0.0, 0.0])
    assert far - near == pytest.approx(0.3, abs=0.01)


def test_the_length_of_the_wanted_motion_does_not_matter():
    scene = shipped("task01")
    tips = np.array([[0.1, 0.05], [-0.12, 0.02]])
    np.testing.assert_allclose(
        way_of(scene, tips, [0.1, 0.04, 0.3]), way_of(scene, tips, [1e-4, 4e-5, 3e-4]), rtol=1e-3
    )


def test_a_push_agrees_best_with_the_motion_that_it_causes():
    scene = shipped("task01")
    geometry = build_geometry(scene, DEVICE)
    outline = Outline(scene, geometry.surface, yaw_length=0.15)
    body = reference.Body.of(object_model(geometry, tool_friction=scene.object.tool_friction))
    radius = scene.robot.tool_radius
    scores = []
    for k in range(0, len(outline.points), 5):
        begin = outline.beside(radius)[k]
        moved = reference.push(body, np.zeros(3), begin, begin + 1e-3 * outline.normals[k], radius)
        scores.append(outline.alignment(moved)[k])
    # In the T's inner corners the tool touches another side.
    assert np.median(scores) > 0.99 and np.mean(np.array(scores) > 0.95) > 0.8
