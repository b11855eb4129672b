"""Straight pushes: the arcs they move an object along, which of them are possible, and which is the best."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import shapely
from support.device import DEVICE
from support.small_tasks import block, box, shipped, task

from oimppi_warp.config.overrides import set_option
from oimppi_warp.config.presets import best
from oimppi_warp.geometry.fields import build_geometry
from oimppi_warp.geometry.footprint import planar_points
from oimppi_warp.planning.object_level import distance
from oimppi_warp.planning.pushes import SPACING, Pushes
from oimppi_warp.planning.stance import Outline
from oimppi_warp.record.metrics import summarize
from oimppi_warp.runtime.episode import Episode
from oimppi_warp.scene import Scene

POSE = np.array([0.40, 0.0, 0.3])
LONG = (0.16, 0.04, 0.05)
YAW_LENGTH = 0.15
GAP = 0.012
NOWHERE: Callable[[np.ndarray], np.ndarray] = lambda at: np.zeros(len(at), dtype=bool)  # noqa: E731


def pushes_of(scene: Scene, blocked: Callable[[np.ndarray], np.ndarray] = NOWHERE) -> Pushes:
    geometry = build_geometry(scene, DEVICE)
    outline = Outline(scene, geometry.surface, yaw_length=YAW_LENGTH)
    return Pushes(geometry, outline, radius=scene.robot.tool_radius, gap=GAP, blocked=blocked)


def test_a_push_is_an_arc_with_evenly_spaced_poses():
    paths, possible = pushes_of(task(pushed=block(LONG))).possible(POSE)
    assert possible.all()
    paths = np.concatenate([np.broadcast_to(POSE, (*paths.shape[:2], 1, 3)), paths], axis=2)
    c, s = np.cos(paths[..., :-1, 2]), np.sin(paths[..., :-1, 2])
    step = np.diff(paths, axis=2)
    x, y, turn = np.moveaxis(step, -1, 0)
    own = np.stack([c * x + s * y, c * y - s * x, turn], axis=-1)  # in the object's axes before the step
    np.testing.assert_allclose(own, np.broadcast_to(own[..., :1, :], own.shape), atol=1e-9)
    lengths = np.linalg.norm(step * [1.0, 1.0, YAW_LENGTH], axis=-1)
    np.testing.assert_allclose(lengths, SPACING, rtol=0.01)
    assert np.abs(turn).max() > 0.05 and np.abs(turn).min() < 0.01


def test_the_object_moves_with_the_twist_of_the_limit_surface():
    scene = task(pushed=block(LONG))
    geometry = build_geometry(scene, DEVICE)
    outline = Outline(scene, geometry.surface, yaw_length=YAW_LENGTH)
    surface = geometry.surface
    for share in (-1.0, 0.0, 0.5):
        twists = outline.twists(share)
        np.testing.assert_allclose(np.linalg.norm(twists * [1.0, 1.0, YAW_LENGTH], axis=1), 1.0)
        wrench = twists / (surface.mobility * surface.force)
        moment = outline.points[:, 0] * wrench[:, 1] - outline.points[:, 1] * wrench[:, 0]
        np.testing.assert_allclose(wrench[:, 2], moment, atol=1e-9)
        along = np.einsum("ij,ij->i", wrench[:, :2], outline.normals)
        across = outline.normals[:, 0] * wrench[:, 1] - outline.normals[:, 1] * wrench[:, 0]
        np.testing.assert_allclose(across / along, share * scene.object.tool_friction, atol=1e-9)


def test_a_push_ends_before_it_brings_the_object_into_an_obstacle():
    wall = box(POSE[0] + 0.2, 0.0, (0.1, 1.0, 0.1))  # 5 cm to the right of a block of 20 cm
    pushes = pushes_of(task(wall, pushed=block((0.2, 0.2, 0.05))))
    pose = np.array([POSE[0], 0.0, 0.0])
    paths, possible = pushes.possible(pose)
    assert possible.any(axis=-1).all(), "there is room for a small push everywhere"
    ahead = paths[..., 0] + 0.1 * (np.abs(np.cos(paths[..., 2])) + np.abs(np.sin(paths[..., 2])))
    assert ahead[possible].max() < POSE[0] + 0.15
    assert (~possible[ahead > POSE[0] + 0.152]).all()
    assert (possible[..., 1:] <= possible[..., :-1]).all(), "what is behind the obstacle is not reached through it"


def test_an_object_beside_an_obstacle_may_be_pushed_away_and_along_but_not_closer():
    wall = box(POSE[0] + 0.151, 0.0, (0.1, 1.0, 0.1))  # a millimetre to the right of a block of 20 cm
    pushes = pushes_of(task(wall, pushed=block((0.2, 0.2, 0.05))))
    pose = np.array([POSE[0], 0.0, 0.0])
    paths, possible = pushes.possible(pose)
    assert possible[..., -1].any()
    right = paths[..., 0] + 0.1 * (np.abs(np.cos(paths[..., 2])) + np.abs(np.sin(paths[..., 2])))
    assert right[possible].max() < POSE[0] + 0.1015


def test_a_push_is_possible_only_where_the_tool_has_room_all_the_way():
    scene = task(pushed=block(LONG))
    free, blocked = pushes_of(scene), pushes_of(scene, lambda at: at[:, 1] < -0.02)
    _, everywhere = free.possible(POSE)
    _, possible = blocked.possible(POSE)
    assert everywhere.all() and possible.any() and not possible.all()
    tips = planar_points(POSE, blocked._places)
    assert not possible[tips[:, 1] < -0.02].any(), "no push begins there"
    begins = tips[:, 1] > 0.0
    assert possible[begins, :, 0].all() and not possible[begins, :, -1].all(), "none brings the tool there"


def test_the_tool_is_in_no_part_of_the_object_when_a_push_begins():
    scene = shipped("task02")
    outline = Outline(scene, build_geometry(scene, DEVICE).surface, yaw_length=YAW_LENGTH)
    radius = scene.robot.tool_radius
    assert shapely.distance(outline.shape, shapely.points(outline.beside(radius))).min() < radius - 0.003, "a corner"
    pushes = pushes_of(scene)
    for places in (pushes._contact, pushes._places):
        assert len(places) > 40
        assert shapely.distance(outline.shape, shapely.points(places)).min() > radius - 0.001


def test_the_best_push_leaves_the_least_way_to_go():
    scene = task(pushed=block(LONG))
    goal = POSE + np.array([-0.02, 0.05, 0.2])
    pushes = pushes_of(scene)

    def to_go(pose: np.ndarray) -> float:
        return distance(pose, goal, YAW_LENGTH)

    found = pushes.best(POSE, to_go, [])
    assert found is not None
    paths, possible = pushes.possible(POSE)
    assert to_go(found.path[-1]) == pytest.approx(min(map(to_go, paths[possible])))
    np.testing.assert_array_equal(found.path[0], POSE)
    assert to_go(found.path[-1]) < 0.03
    other = pushes.best(POSE, to_go, [found.place])
    assert other is not None and np.linalg.norm(other.place - found.place) > 0.03


def test_an_object_that_no_push_moves_otherwise_may_graze_obstacles():
    def aside(at: np.ndarray) -> np.ndarray:
        """Blocks the tool everywhere but to the left of the block."""
        return (at[:, 0] > POSE[0] - 0.06) | (np.abs(at[:, 1]) > 0.1)

    wall = box(POSE[0] + 0.157, 0.0, (0.1, 1.0, 0.1))  # 7 mm to the right of a block of 20 cm
    pushes = pushes_of(task(wall, pushed=block((0.2, 0.2, 0.05))), aside)
    straight, turned = np.array([POSE[0], 0.0, 0.0]), np.array([POSE[0], 0.0, 0.06])
    assert not pushes.possible(straight)[1].any()
    assert pushes.best(straight, lambda at: -at[0], []) is None
    assert not pushes.possible(turned)[1].any(), "a corner is a millimetre from the wall"
    found = pushes.best(turned, lambda at: abs(at[2]), [])
    assert found is not None and found.path[-1][2] < turned[2], "turning back, it grazes the wall"


@pytest.mark.parametrize(
    ("name", "method", "start"),
    [
        # The T stands astride the robot's base, where the arm does not reach behind it.
        ("task02", "cloi", (0.1552, -0.0688, -2.776)),
        pytest.param("task02", "soi", (0.1689, -0.0386, -2.6312), marks=pytest.mark.slow),
        # Two of its ends are less than a millimetre from the walls of the gap.
        pytest.param("task03", "cloi", (0.508, -0.05, -2.331), marks=pytest.mark.slow),
    ],
)
def test_an_object_that_nothing_freed_gets_to_its_goal(name: str, method: str, start: tuple[float, ...], device: str):
    scene = replace(shipped(name), start=start)
    config = set_option(best(method), "episode.max_sim_seconds=40")
    log = Episode(scene, config, engine="quasistatic", method=method, device=device).run()
    metrics = summarize(log)
    assert metrics.success, (metrics.position_error_m, metrics.yaw_error_rad)
    assert metrics.max_contact_tool_object_n < 50.0
