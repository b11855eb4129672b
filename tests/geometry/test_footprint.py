"""Footprints of colliders of every kind, and limit surfaces against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from scipy.spatial.transform import Rotation
from support.small_tasks import block, box, post, shipped

from oimppi_warp.geometry.footprint import (
    GRAVITY,
    Piece,
    core_points,
    footprint,
    height_range,
    limit_surface,
    outline,
    planar_points,
    rotation_matrix,
    transform_points,
    wrap_angle,
)
from oimppi_warp.scene import Collider, PushedObject

SAMPLING_ERROR = 0.02
"""The mean over about 4000 points of the support is this good, relatively."""


def collider(kind, size=(), *, at=(0.0, 0.0, 0.0), turn: Rotation | None = None, vertices=None) -> Collider:
    quaternion = (turn or Rotation.identity()).as_quat()
    return Collider("/c", kind, np.array([*at, *quaternion]), size, vertices)


def test_a_yawed_box_leaves_a_yawed_rectangle():
    (piece,) = footprint([box(0.3, 0.1, (0.2, 0.1, 0.05), yaw=0.5)])
    corners = planar_points((0.3, 0.1, 0.5), 0.5 * np.array([[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]]))
    for corner in corners:
        assert np.linalg.norm(piece.vertices - corner, axis=1).min() < 1e-8
    assert shapely.area(piece.polygon()) == pytest.approx(0.02)


def test_a_box_on_its_edge_leaves_its_diagonal():
    (piece,) = footprint([collider("box", (0.03, 0.05, 0.04), turn=Rotation.from_euler("y", np.arctan2(3, 4)))])
    low, high = piece.vertices.min(axis=0), piece.vertices.max(axis=0)
    np.testing.assert_allclose(high - low, [2 * (0.03 * 0.8 + 0.04 * 0.6), 0.10])


@pytest.mark.parametrize(
    ("shape", "area"),
    [
        (collider("sphere", (0.04,)), np.pi * 0.04**2),
        (collider("cylinder", (0.04, 0.1)), np.pi * 0.04**2),
        (collider("capsule", (0.04, 0.1)), np.pi * 0.04**2),
        (collider("cylinder", (0.04, 0.1), turn=Rotation.from_euler("x", np.pi / 2)), 0.08 * 0.2),
        (collider("capsule", (0.04, 0.1), turn=Rotation.from_euler("x", np.pi / 2)), 0.08 * 0.2 + np.pi * 0.04**2),
        (collider("mesh", vertices=np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.02, 0.02, 0.3]])), 0.005),
    ],
    ids=["sphere", "can", "standing capsule", "lying can", "lying capsule", "tetrahedron"],
)
def test_each_kind_of_collider_leaves_its_shadow(shape, area):
    (piece,) = footprint([shape])
    assert shapely.area(piece.polygon()) == pytest.approx(area, rel=0.01)


def test_vertices_run_counter_clockwise():
    for shape in (box(0.3, 0.1, (0.2, 0.1, 0.05), yaw=2.0), collider("cylinder", (0.04, 0.1))):
        (piece,) = footprint([shape])
        x, y = piece.vertices.T
        assert len(x) == 1 or np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) > 0.0


def test_shapes_outside_of_the_height_range_are_left_out():
    low = post(0.1, 0.0, 0.02, 0.05)
    high = replace(low, transform=np.array([0.2, 0, 0.3, 0, 0, 0, 1]))
    assert height_range([low]) == pytest.approx((0.0, 0.05))
    assert height_range([low, high]) == pytest.approx((0.0, 0.325))
    assert len(footprint([low, high])) == 2
    assert [len(footprint([low, high], lower=a, upper=b)) for a, b in ((0.0, 0.1), (0.1, 1.0), (0.1, 0.2))] == [1, 1, 0]


def test_the_outline_of_the_t_is_its_bar_and_stem():
    shape = outline(footprint(shipped("task01").object.colliders))
    assert shapely.area(shape) == pytest.approx(0.20 * 0.05 + 0.05 * 0.10)
    assert tuple(shapely.bounds(shape)) == pytest.approx((-0.10, -0.125, 0.10, 0.025))


def test_a_moved_piece_keeps_its_shape():
    (piece,) = footprint([box(0.02, 0.0, (0.2, 0.1, 0.05))])
    moved = Piece(piece.vertices, 0.01).moved((0.5, -0.2, 1.0))
    assert shapely.area(moved.polygon()) == pytest.approx(shapely.area(Piece(piece.vertices, 0.01).polygon()))
    np.testing.assert_allclose(moved.vertices.mean(axis=0), planar_points((0.5, -0.2, 1.0), np.array([[0.02, 0.0]]))[0])


def test_rotations_are_scipys():
    for turn in Rotation.random(5, rng=np.random.default_rng(2)):
        np.testing.assert_allclose(rotation_matrix(turn.as_quat()), turn.as_matrix(), atol=1e-12)
        points = np.arange(6.0).reshape(2, 3)
        moved = transform_points(np.array([1.0, 2.0, 3.0, *turn.as_quat()]), points)
        np.testing.assert_allclose(moved, turn.apply(points) + [1.0, 2.0, 3.0])


def test_angles_are_wrapped_on_the_host():
    np.testing.assert_allclose(wrap_angle(np.array([0.1, 2 * np.pi + 0.1, -7.0])), [0.1, 0.1, 2 * np.pi - 7.0])


def test_a_cylinders_core_is_inscribed_by_half_a_percent_at_most():
    points, radius = core_points(collider("cylinder", (0.04, 0.1)))
    assert radius == 0.0
    assert 0.995 * 0.04 <= np.linalg.norm(points[:, :2], axis=1).min() <= 0.04 + 1e-12


# Limit surfaces: friction torque over friction force is the mean distance of the pressure to the friction centre


def can(radius: float) -> PushedObject:
    return replace(block(), colliders=(collider("cylinder", (radius, 0.02)),))


def test_a_disc_under_uniform_pressure_has_two_thirds_of_its_radius():
    assert limit_surface(can(0.05), support="area").radius == pytest.approx(2 / 3 * 0.05, rel=SAMPLING_ERROR)


@pytest.mark.parametrize(("a", "b"), [(0.10, 0.10), (0.20, 0.05), (0.05, 0.20)])
def test_a_rectangle_under_uniform_pressure_has_its_mean_distance(a, b):
    d = np.hypot(a, b)
    # The mean of |r| over an a x b rectangle about its middle, integrated in polar coordinates.
    mean = d / 6 + b**2 / (12 * a) * np.log((a + d) / b) + a**2 / (12 * b) * np.log((b + d) / a)
    found = limit_surface(block((a, b, 0.05)), support="area").radius
    assert found == pytest.approx(mean, rel=SAMPLING_ERROR)


def test_a_disc_that_stands_on_its_rim_has_its_whole_radius():
    assert limit_surface(can(0.05), support="corners").radius == pytest.approx(0.05, rel=1e-6)


def test_a_rectangle_that_stands_on_its_corners_has_its_half_diagonal():
    assert limit_surface(block((0.20, 0.05, 0.05)), support="corners").radius == pytest.approx(np.hypot(0.10, 0.025))


@pytest.mark.parametrize("support", ["corners", "area"])
def test_a_limit_surface_scales_with_the_object(support):
    small, large = (limit_surface(block(size), support=support) for size in ((0.10, 0.06, 0.05), (0.20, 0.12, 0.05)))
    assert large.radius == pytest.approx(2 * small.radius, rel=SAMPLING_ERROR)


def test_the_scene_may_give_the_limit_surface():
    given = replace(block(), limit_surface_radius=0.03)
    assert limit_surface(given).radius == 0.03
    assert limit_surface(given.scaled(2.0)).radius == 0.06
    assert limit_surface(given).force == limit_surface(block()).force
    np.testing.assert_allclose(limit_surface(given).mobility[2] / limit_surface(given).mobility[0], 1 / 0.03**2)


def test_the_friction_force_is_mu_m_g():
    heavy = limit_surface(replace(block(), mass=2.0, friction=0.7))
    assert heavy.force == pytest.approx(2.0 * 0.7 * GRAVITY)


@pytest.mark.parametrize("support", ["corners", "area"])
def test_a_limit_surface_is_centred_under_the_centre_of_mass(support):
    surface = limit_surface(shipped("task01").object, support=support)
    np.testing.assert_allclose(surface.center, [0.0, -0.025], atol=1e-6)
    shifted = limit_surface(replace(block(), center_of_mass=np.array([0.03, 0.0, 0.01])), support=support)
    np.testing.assert_allclose(shifted.center, [0.03, 0.0])
    assert shifted.radius > limit_surface(block(), support=support).radius
