"""phi_2, the object's outline and the obstacles' distance against exact geometry, and their cache."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from support.reference import INTERPOLATION_ERROR, LENGTH_TOLERANCE, piece_distance, planar_grid, pose_grid, space_field
from support.small_tasks import block, box, post, shipped, task

from oimppi_warp.geometry.fields import (
    ExactClearance,
    Geometry,
    build_geometry,
    exact_nodes,
    from_center,
    multilinear,
    pose_field_at,
    to_center,
)
from oimppi_warp.geometry.footprint import collider_mesh, footprint, outline
from oimppi_warp.geometry.pose_grid import FURTHEST, NEGLIGIBLE, STEP, YAW_NODES, conservative
from oimppi_warp.geometry.reach import stretched_length
from oimppi_warp.scene import Collider, Scene

SCENES = ("task02", "task03", "task04", "task05", "lab02")
SURE_SIGN = 0.003
"""Beyond this distance from contact phi_2 has the right sign [m]."""


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A cache of our own: what an older kernel left behind must not pass for what this one makes."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OIMPPI_CACHE", str(folder))
        yield folder


@pytest.fixture(scope="module")
def geometry(cache, device):
    """The geometry of a shipped scene, made once."""
    made: dict[str, Geometry] = {}

    def get(name: str) -> Geometry:
        if name not in made:
            made[name] = build_geometry(shipped(name), device)
        return made[name]

    return get


def exact_clearance(scene: Scene, pose: np.ndarray) -> float:
    """phi_2 at a pose of the object's frame by shapely; where cores overlap only its sign is right [m]."""
    body = [piece.moved(pose) for piece in footprint(scene.object.colliders)]
    standing = [*(c for o in scene.obstacles for c in o.colliders), *scene.robot.base.colliders]
    obstacles = footprint(standing, lower=1e-3, upper=2 * scene.object.rest_height)
    points = np.concatenate([piece.vertices for piece in body])
    radius = max(piece.radius for piece in body)
    edge = min((points - scene.table.lower).min(), (scene.table.upper - points).min()) - radius
    return min(edge, FURTHEST, *(piece_distance(a, b) for a in body for b in obstacles))


def poses_near_contact(scene: Scene, field, count: int, seed: int) -> np.ndarray:
    """Random poses of the friction centre, off the grid's nodes, most of them close to something."""
    random = np.random.default_rng(seed)
    grid = pose_grid(field)
    upper = grid.origin + grid.step * np.array(grid.values.shape)
    poses = random.uniform(grid.origin[:2], upper[:2] - grid.step[:2], size=(40 * count, 2))
    poses = np.column_stack([poses, random.uniform(-np.pi, np.pi, len(poses))])
    values = np.array([grid.at(pose)[0] for pose in poses])
    near = poses[np.abs(values) < 0.06]
    return np.concatenate([near[:count], poses[: count // 4]])


@pytest.mark.parametrize("name", SCENES)
def test_phi_2_is_the_distance_that_shapely_finds(name, geometry):
    scene, field = shipped(name), geometry(name).clearance
    surface = geometry(name).surface
    errors = []
    for pose in poses_near_contact(scene, field, 120, seed=1):
        expected = exact_clearance(scene, from_center(surface, pose))
        found = pose_field_at(field, pose)
        if expected > 0.0:
            errors.append(abs(found - expected))
        if expected > SURE_SIGN or expected < 0.0:
            assert (found > 0.0) == (expected > 0.0) or abs(found) < SURE_SIGN, (pose, found, expected)
    assert len(errors) > 40
    assert np.max(errors) < INTERPOLATION_ERROR
    assert np.quantile(errors, 0.9) < 0.002


@pytest.mark.parametrize("name", ["task02", "task05"])
def test_phi_2_is_exact_at_most_nodes_and_never_too_large_at_the_others(name, geometry):
    scene, made = shipped(name), geometry(name)
    grid = pose_grid(made.clearance)
    random = np.random.default_rng(4)
    lowered = []
    for index in random.integers(0, grid.values.shape, size=(600, 3)):
        value = grid.values[tuple(index)]
        if 0.0 < value < 0.9 * FURTHEST:
            pose = grid.origin + grid.step * index
            lowered.append(exact_clearance(scene, from_center(made.surface, pose)) - value)
    assert len(lowered) > 40
    assert np.min(lowered) > -LENGTH_TOLERANCE
    assert np.quantile(lowered, 0.7) < 0.0003
    assert np.max(lowered) < INTERPOLATION_ERROR


@pytest.mark.parametrize("name", ["task02", "task05"])
def test_the_exact_nodes_are_what_shapely_finds(name, geometry):
    scene, made = shipped(name), geometry(name)
    values, grid = exact_nodes(scene), pose_grid(made.clearance)
    assert values.shape == made.clearance.values.shape
    random = np.random.default_rng(4)
    checked = 0
    for yaw, x, y in random.integers(0, values.shape, size=(600, 3)):
        if 0.0 < values[yaw, x, y] < 0.9 * FURTHEST:
            pose = grid.origin + grid.step * [x, y, yaw]
            expected = exact_clearance(scene, from_center(made.surface, pose))
            assert values[yaw, x, y] == pytest.approx(expected, abs=LENGTH_TOLERANCE)
            checked += 1
    assert checked > 40


@pytest.mark.parametrize("name", SCENES)
def test_phi_2_shows_no_more_room_than_there_is(name, geometry):
    made, exact = geometry(name), ExactClearance(shipped(name))
    values = made.clearance.values.numpy()
    grid = pose_grid(made.clearance)
    upper = grid.origin + grid.step * (np.array(grid.values.shape) - 1)
    poses = np.random.default_rng(9).uniform(grid.origin, upper, size=(100_000, 3))
    found = np.array([pose_field_at(made.clearance, pose, values) for pose in poses])
    near = np.abs(found) < 0.02
    actual = np.array([exact.at(from_center(made.surface, pose)) for pose in poses[near]])
    too_much = found[near] - actual
    assert len(actual) > 5_000
    assert np.quantile(too_much, 0.999) < 0.0003
    assert np.max(too_much) < 0.001


def test_many_poses_at_once_are_looked_up_as_one_is(geometry):
    made = geometry("task02")
    field, values = made.obstruction, made.obstruction.values.numpy()
    poses = np.random.default_rng(5).uniform((-0.9, -1.2, -9.0), (1.3, 1.2, 9.0), size=(40, 50, 3))
    expected = [pose_field_at(field, pose, values) for pose in poses.reshape(-1, 3)]
    np.testing.assert_allclose(made.obstruction_at(poses), np.reshape(expected, (40, 50)), atol=1e-4)
    assert float(made.obstruction_at(poses[0, 0])) == pytest.approx(expected[0], abs=1e-4)


def test_values_are_linear_between_nodes_and_held_beyond_them():
    values = np.array([[0.0, 1.0, 2.0], [10.0, 11.0, 12.0]])
    at = np.array([[0.5, 0.25], [1.0, 2.0], [-3.0, 0.5], [0.25, 7.0]])
    np.testing.assert_allclose(multilinear(values, at), [5.25, 12.0, 0.5, 4.5])


def test_a_corners_clearance_is_lowered_where_interpolation_would_show_too_much():
    def distance(estimate: np.ndarray, shift: np.ndarray, furthest: float) -> np.ndarray:
        del furthest
        _, x, y = np.indices(estimate.shape) + shift.reshape(3, 1, 1, 1)
        return STEP * np.hypot(x - 5.3, y - 4.6)  # to a corner between the nodes, without a turn

    exact = distance(np.zeros((4, 12, 12)), np.zeros(3), np.inf)
    lowered = conservative(exact, distance)
    middle = distance(exact, np.array([0.0, 0.5, 0.5]), np.inf)[0, :-1, :-1]

    def interpolated(values: np.ndarray) -> np.ndarray:
        return (values[0, :-1, :-1] + values[0, 1:, :-1] + values[0, :-1, 1:] + values[0, 1:, 1:]) / 4.0

    assert np.max(interpolated(exact) - middle) > 0.002
    assert np.max(interpolated(lowered) - middle) < NEGLIGIBLE + 1e-9
    assert np.max(lowered - exact) <= 0.0
    assert np.max(exact[0, 8:, 8:] - lowered[0, 8:, 8:]) < 0.0003  # four steps from the corner: almost linear


@pytest.mark.parametrize("name", SCENES)
def test_the_exact_clearance_is_the_distance_that_shapely_finds(name, geometry):
    scene, made, exact = shipped(name), geometry(name), ExactClearance(shipped(name))
    apart = 0
    for center in poses_near_contact(scene, made.clearance, 120, seed=2):
        pose = from_center(made.surface, center)
        expected = exact_clearance(scene, pose)
        if expected > LENGTH_TOLERANCE:
            assert exact.at(pose) == pytest.approx(expected, abs=LENGTH_TOLERANCE)
            apart += 1
        elif expected < -LENGTH_TOLERANCE:
            assert exact.at(pose) < 0.0
    assert apart > 40
    assert np.isnan(exact.at(np.array([np.nan, 0.0, 0.0])))


def test_the_exact_clearance_of_an_overlap_is_its_depth():
    scene = task(box(0.5, 0.1, (0.1, 0.1, 0.1)), pushed=block((0.10, 0.06, 0.05)))
    exact = ExactClearance(scene)
    assert exact.at(np.array([0.5, 0.1 - 0.05 - 0.03 + 0.003, 0.0])) == pytest.approx(-0.003, abs=LENGTH_TOLERANCE)
    corner = np.array([0.5 - 0.05 - 0.05 + 0.002, 0.1 - 0.05 - 0.03 + 0.001, 0.0])
    assert exact.at(corner) == pytest.approx(-0.001, abs=LENGTH_TOLERANCE)


def test_phi_2s_gradient_is_its_finite_difference(geometry):
    grid = pose_grid(geometry("task02").clearance)
    random = np.random.default_rng(5)
    nodes = random.integers(
        [20, 20, 0], [n - m for n, m in zip(grid.values.shape, (20, 20, 0), strict=True)], size=(50, 3)
    )
    for pose in grid.origin + grid.step * (nodes + random.uniform(0.2, 0.8, size=(50, 3))):
        _, gradient = grid.at(pose)
        for axis, step in enumerate(1e-5 * np.eye(3)):
            slope = (grid.at(pose + step)[0] - grid.at(pose - step)[0]) / 2e-5
            assert gradient[axis] == pytest.approx(slope, abs=1e-6)


def test_phi_2s_gradient_points_straight_away_from_a_wall(geometry, device):
    made = build_geometry(task(box(0.5, 0.0, (0.1, 0.6, 0.1)), pushed=block()), device)
    value, gradient = pose_grid(made.clearance).at(np.array([0.3634, 0.0123, 0.0]))
    assert value == pytest.approx(0.45 - 0.3634 - 0.05, abs=1e-4)
    np.testing.assert_allclose(gradient[:2], [-1.0, 0.0], atol=1e-3)


def test_phi_2_falls_to_zero_where_the_object_reaches_the_tables_edge(geometry, device):
    scene = replace(task(pushed=block()), table=replace(shipped("task01").table, lower=(-0.25, -0.5)))
    made = build_geometry(scene, device)
    assert made.clearance_at(np.array([0.5, -0.47, 0.0])) == pytest.approx(0.0, abs=LENGTH_TOLERANCE)
    assert made.clearance_at(np.array([0.5, -0.45, np.pi / 2])) == pytest.approx(0.0, abs=LENGTH_TOLERANCE)
    assert made.clearance_at(np.array([0.5, -0.49, 0.0])) == pytest.approx(-0.02, abs=1e-4)


def test_the_robots_base_is_an_obstacle_for_the_object(geometry):
    made = geometry("task01")
    assert made.clearance_at(np.array([0.12, 0.0, 0.0])) < 0.0
    assert made.clearance_at(np.array([0.5, 0.0, 0.0])) == pytest.approx(FURTHEST, abs=LENGTH_TOLERANCE)


def test_an_obstacle_above_the_object_is_none(geometry, device):
    high = replace(box(0.5, 0.0, (0.1, 0.1, 0.05)), transform=np.array([0.5, 0, 0.2, 0, 0, 0, 1.0]))
    made = build_geometry(task(high, pushed=block()), device)
    assert made.clearance_at(np.array([0.5, 0.0, 0.0])) == pytest.approx(FURTHEST, abs=LENGTH_TOLERANCE)


def test_the_poses_of_frame_and_friction_centre_belong_together(device: str):
    surface = build_geometry(shipped("task01"), device).surface
    poses = np.random.default_rng(6).normal(size=(10, 3))
    np.testing.assert_allclose(from_center(surface, to_center(surface, poses)), poses, atol=1e-12)
    np.testing.assert_allclose(to_center(surface, np.array([1.0, 2.0, np.pi / 2])), [1.025, 2.0, np.pi / 2], atol=1e-9)


def test_the_objects_outline_has_its_signed_distance(geometry):
    made = geometry("task02")
    shape = outline(footprint(shipped("task02").object.colliders))
    grid = planar_grid(made.body)
    upper = grid.origin + grid.step * (np.array(grid.values.shape) - 1)
    for local in np.random.default_rng(7).uniform(grid.origin, upper, size=(200, 2)):
        point = shapely.Point(local + made.surface.center)
        distance = shapely.distance(point, shapely.boundary(shape)) * (-1.0 if shapely.contains(shape, point) else 1.0)
        assert grid.at(local)[0] == pytest.approx(distance, abs=0.001)


# The obstacles over space


def box_distance(point: np.ndarray, center: np.ndarray, half: np.ndarray) -> float:
    """Signed distance to a box, in closed form [m]."""
    q = np.abs(point - center) - half
    return float(np.linalg.norm(np.maximum(q, 0.0)) + min(q.max(), 0.0))


def cylinder_distance(point: np.ndarray, shape: Collider) -> float:
    """Signed distance to an upright cylinder, in closed form [m]."""
    radial, axial = np.hypot(*(point - shape.transform[:3])[:2]), abs(point[2] - shape.transform[2])
    q = np.array([radial - shape.size[0], axial - shape.size[1]])
    return float(np.linalg.norm(np.maximum(q, 0.0)) + min(q.max(), 0.0))


def test_the_distance_over_space_is_that_of_a_box(device: str):
    shape = box(0.45, 0.05, (0.10, 0.20, 0.16))
    made = build_geometry(task(shape), device)
    for point in np.random.default_rng(8).uniform([0.35, -0.1, 0.0], [0.55, 0.2, 0.25], size=(200, 3)):
        expected = min(box_distance(point, shape.transform[:3], np.array(shape.size)), FURTHEST)
        assert space_field(made.space, point) == pytest.approx(expected, abs=0.004)
    assert made.space_top > 0.16


def test_the_distance_over_space_is_that_of_the_nearest_of_several_obstacles(device: str):
    ball = Collider("/ball", "sphere", np.array([0.4, -0.1, 0.05, 0, 0, 0, 1.0]), (0.05,))
    shapes = [post(0.5, 0.1, 0.06, 0.12), ball, box(0.53, 0.12, (0.1, 0.1, 0.08))]
    made = build_geometry(task(*shapes), device)
    points = np.random.default_rng(9).uniform([0.33, -0.17, 0.0], [0.6, 0.2, 0.2], size=(150, 3))
    found = np.array([space_field(made.space, point) for point in points])
    half = np.array(shapes[2].size)
    expected = np.array(
        [
            min(
                cylinder_distance(point, shapes[0]),
                np.linalg.norm(point - ball.transform[:3]) - ball.size[0],
                box_distance(point, shapes[2].transform[:3], half),
                FURTHEST,
            )
            for point in points
        ]
    )
    # Outside of a union the distance is that of the nearest part; inside, only the sign is compared.
    outside = expected > 0.0
    assert 20 < outside.sum() < 145
    np.testing.assert_allclose(found[outside], expected[outside], atol=0.004)
    assert (found[expected < -0.005] < 0.0).all()


def test_a_colliders_mesh_is_closed_and_has_its_volume():
    for shape, volume in (
        (box(0.4, 0.1, (0.1, 0.2, 0.3), yaw=0.4), 0.006),
        (post(0.4, 0.1, 0.05, 0.1), np.pi * 0.05**2 * 0.1),
        (Collider("/b", "sphere", np.array([0.4, 0, 0.1, 0, 0, 0, 1.0]), (0.05,)), 4 / 3 * np.pi * 0.05**3),
        (Collider("/c", "capsule", np.array([0.4, 0, 0.1, 0, 0, 0, 1.0]), (0.05, 0.1)), np.pi * 0.05**2 * 0.8 / 3),
    ):
        mesh = collider_mesh(shape)
        assert mesh.is_watertight
        assert mesh.volume == pytest.approx(volume, rel=0.05), shape.kind


def test_nothing_is_near_in_space_without_obstacles(device: str):
    made = build_geometry(task(), device)
    for point in ((0.5, 0.0, 0.02), (0.3, 0.3, 0.5), (0.0, 0.0, 0.0)):
        assert space_field(made.space, np.array(point)) == pytest.approx(FURTHEST)


# The grid and the cache


def test_the_grid_of_phi_2_covers_the_part_of_the_table_that_the_arm_reaches(geometry):
    scene, grid = shipped("task02"), pose_grid(geometry("task02").clearance)
    reach = stretched_length(scene.robot)
    assert grid.values.shape[2] == YAW_NODES
    np.testing.assert_allclose(grid.origin[:2], np.maximum(scene.table.lower, -reach), atol=1e-6)
    last = grid.origin[:2] + grid.step[:2] * (np.array(grid.values.shape[:2]) - 1)
    wanted = np.minimum(scene.table.upper, reach)
    assert (last <= wanted + 1e-6).all()
    assert (last > wanted - STEP - 1e-6).all()


def fields_of(folder: Path) -> set[Path]:
    return set(folder.glob("phi2-*.npy"))


def test_a_field_is_made_once_and_then_read(tmp_path, monkeypatch, device):
    monkeypatch.setenv("OIMPPI_CACHE", str(tmp_path))
    scene = task(box(0.5, 0.0, (0.1, 0.1, 0.1)), pushed=block(), table=0.3)
    build_geometry(scene, device)
    (file,) = fields_of(tmp_path)
    marked = np.full_like(np.load(file), 0.0123)
    np.save(file, marked)
    assert build_geometry(scene, device).clearance_at(np.array([0.1, 0.2, 0.3])) == pytest.approx(0.0123)
    assert fields_of(tmp_path) == {file}
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.parametrize("change", ["obstacle", "object", "table"])
def test_a_changed_scene_has_a_field_of_its_own(change, tmp_path, monkeypatch, device):
    monkeypatch.setenv("OIMPPI_CACHE", str(tmp_path))
    scene = task(box(0.25, 0.0, (0.1, 0.1, 0.1)), pushed=block(), table=0.3)
    build_geometry(scene, device)
    other = {
        "obstacle": task(box(0.25, 0.001, (0.1, 0.1, 0.1)), pushed=block(), table=0.3),
        "object": task(box(0.25, 0.0, (0.1, 0.1, 0.1)), pushed=block((0.10, 0.061, 0.05)), table=0.3),
        "table": task(box(0.25, 0.0, (0.1, 0.1, 0.1)), pushed=block(), table=0.301),
    }[change]
    build_geometry(other, device)
    assert len(fields_of(tmp_path)) == 2


def test_what_does_not_shape_the_field_does_not_make_it_anew(tmp_path, monkeypatch, device):
    monkeypatch.setenv("OIMPPI_CACHE", str(tmp_path))
    scene = task(pushed=block(), table=0.3)
    build_geometry(scene, device)
    build_geometry(replace(scene, object=replace(scene.object, mass=1.0, tool_friction=0.9)), device)
    assert len(fields_of(tmp_path)) == 1


@pytest.mark.parametrize("damage", [b"", b"\x93NUMPY", None], ids=["empty", "header only", "cut short"])
def test_a_damaged_field_is_made_anew(damage, tmp_path, monkeypatch, device):
    monkeypatch.setenv("OIMPPI_CACHE", str(tmp_path))
    scene = task(pushed=block(), table=0.3)
    pose = np.array([0.2, 0.1, 0.4])
    expected = build_geometry(scene, device).clearance_at(pose)
    (file,) = fields_of(tmp_path)
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2] if damage is None else damage)
    assert build_geometry(scene, device).clearance_at(pose) == expected
    assert file.read_bytes() == whole


def test_a_cache_that_cannot_be_written_costs_only_time(tmp_path, monkeypatch, device):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    monkeypatch.setenv("OIMPPI_CACHE", str(blocked))
    made = build_geometry(task(pushed=block(), table=0.3), device)
    assert made.clearance_at(np.array([0.22, 0.0, 0.0])) == pytest.approx(0.03, abs=1e-4)
