"""The cost-to-go against Dijkstra's, and the ways that it leads."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from support import reference
from support.device import BLOCK, DEVICE
from support.reference import pose_grid
from support.small_tasks import block, box, task

from oimppi_warp.geometry.fields import build_geometry, pose_field_at
from oimppi_warp.kernels.fields import cost_to_go as kernels
from oimppi_warp.kernels.geometry import PoseField
from oimppi_warp.planning.cost_to_go import build_to_go, path_lengths, to_go_at

YAW_LENGTH = 0.1
"""Length that turning by one radian counts as [m]."""


def no_plan() -> wp.array:
    return wp.zeros(0, dtype=wp.vec3, device=DEVICE)


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of its own for every test."""
    monkeypatch.setenv("OIMPPI_CACHE", str(tmp_path))
    return tmp_path


def field_of(clearance: np.ndarray) -> PoseField:
    """A pose field with nodes a centimetre apart, the first at zero."""
    field = PoseField()
    field.values = wp.array(clearance.astype(np.float32), dtype=float, device=DEVICE)
    field.origin, field.inv_step = wp.vec2(0.0, 0.0), 100.0
    field.inv_yaw_step = clearance.shape[0] / (2.0 * np.pi)
    return field


def walled() -> np.ndarray:
    """phi_2 [yaw, x, y] with a wall to go around and a narrow place beside it, for some yaws."""
    clearance = np.full((8, 14, 11), 0.05)
    clearance[:, 6:8, :8] = -0.01
    clearance[2:5, 6:8, 8:] = 0.012
    return clearance


RING = (0.03, 0.13)
"""Distances from the base between which the arm pushes well [m]."""


def cost_per_metre(gap: float, distance: float) -> float:
    """What a metre costs at a clearance and a distance from the base."""
    crowded = 1.0 + 10.0 * np.clip((0.02 - gap) / 0.02, 0.0, 1.0) ** 2
    if gap < 0.0:
        return 120.0
    return crowded if RING[0] <= distance <= RING[1] else max(crowded, 10.0)


@pytest.mark.parametrize(
    "way",
    [
        np.array([[0.121, 0.033, 1.0]]),
        np.array([[0.02, 0.09, 3.0], [0.05, 0.09, 3.4], [0.09, 0.085, 3.9], [0.121, 0.033, 5.0]]),
    ],
    ids=["goal", "way to a goal"],
)
def test_the_cost_to_go_is_dijkstras(way, device):
    found = build_to_go(field_of(walled()), way, yaw_length=YAW_LENGTH, push_ring=RING, device=device).values.numpy()
    expected = reference.to_go(
        walled(), way, step=0.01, yaw_length=YAW_LENGTH, near=0.04, cost_per_metre=cost_per_metre
    )
    np.testing.assert_allclose(found, expected, atol=1e-3)


def test_the_cost_to_go_leads_around_a_wall(device: str):
    goal = np.array([0.121, 0.033, 1.0])
    pose = np.array([0.02, 0.02, 1.0])
    around, free = (
        pose_field_at(build_to_go(field_of(clearance), goal, yaw_length=YAW_LENGTH, device=device), pose)
        for clearance in (walled(), np.full((8, 14, 11), 0.05))
    )
    assert around > free + 0.05


@pytest.mark.parametrize("outwards", [False, True])
def test_a_pose_where_the_arm_pushes_badly_is_far_away_unless_the_goal_is_there_too(outwards: bool, device: str):
    inside, outside = np.array([0.05, 0.093, 1.0]), np.array([0.121, 0.093, 1.0])
    pose, goal = (inside, outside) if outwards else (outside, inside)
    field = field_of(np.full((8, 14, 11), 0.05))
    near, far = (
        pose_field_at(build_to_go(field, goal, yaw_length=YAW_LENGTH, push_ring=ring, device=device), pose)
        for ring in ((0.0, np.inf), (0.0, 0.10))
    )
    assert far == pytest.approx(near) if outwards else far > 2.0 * near


def travel_cost() -> kernels.TravelCost:
    """Costs like those of :func:`build_to_go` with its default ring."""
    travel = kernels.TravelCost()
    travel.yaw_length, travel.comfort, travel.crowded, travel.blocked = YAW_LENGTH, 0.02, 10.0, 120.0
    travel.ring_inner, travel.ring_outer, travel.far = 0.0, 1e3, 10.0
    return travel


def sweep(field, direction: int, to_go: wp.array, stale: wp.array) -> float:
    """Sweeps once and returns the largest improvement."""
    change = wp.zeros(1, dtype=float, device=to_go.device)
    inputs = [field, travel_cost(), direction]
    wp.launch(kernels.sweep_to_go, dim=1, inputs=inputs, outputs=[to_go, stale, change], device=to_go.device)
    return float(change.numpy()[0])


def test_sweeping_no_further_changes_a_cost_to_go_that_is_done(device: str):
    field = field_of(walled())
    to_go = build_to_go(field, np.array([0.03, 0.04, 0.0]), yaw_length=YAW_LENGTH, device=device)
    for direction in range(8):
        stale = wp.full(to_go.values.shape, 1, dtype=wp.uint8, device=device)
        assert sweep(field, direction, to_go.values, stale) < 1e-3


@pytest.mark.parametrize("seeds", [1, 5])
def test_skipping_the_nodes_whose_neighbours_have_not_improved_changes_nothing(seeds: int):
    random = np.random.default_rng(seeds)
    field = field_of(walled())
    start = np.full(field.values.shape, 1e6, dtype=np.float32)
    for _ in range(seeds):
        start[tuple(random.integers(0, start.shape))] = random.uniform(0.0, 0.1)
    skipping, complete = (wp.array(start, dtype=float, device=DEVICE) for _ in range(2))
    stale = wp.full(start.shape, 1, dtype=wp.uint8, device=DEVICE)
    visited = 0
    for number in range(16):
        visited += int(stale.numpy().sum())
        every = wp.full(start.shape, 1, dtype=wp.uint8, device=DEVICE)
        assert sweep(field, number % 8, skipping, stale) == sweep(field, number % 8, complete, every)
        np.testing.assert_array_equal(skipping.numpy(), complete.numpy())
    assert (skipping.numpy() < 1e5).all()
    assert visited < 0.5 * 16 * start.size


def test_a_cost_to_go_belongs_to_its_goal(cache, device):
    field = field_of(walled())
    first, second = (
        build_to_go(field, np.array([x, 0.03, 0.0]), yaw_length=YAW_LENGTH, device=device) for x in (0.02, 0.12)
    )
    assert len(list(cache.glob("togo-*.npy"))) == 2
    assert pose_field_at(first, np.array([0.02, 0.03, 0.0])) < 0.005
    assert pose_field_at(second, np.array([0.02, 0.03, 0.0])) > 0.1
    again = build_to_go(field, np.array([0.02, 0.03, 0.0]), yaw_length=YAW_LENGTH, device=device)
    np.testing.assert_array_equal(again.values.numpy(), first.values.numpy())
    assert len(list(cache.glob("togo-*.npy"))) == 2


def test_the_length_of_a_path_counts_its_turns_the_short_way():
    path = np.array([[0.0, 0.0, 3.0], [0.03, 0.04, 3.0], [0.03, 0.04, -3.0]])
    turn = YAW_LENGTH * (2.0 * np.pi - 6.0)
    np.testing.assert_allclose(path_lengths(path, YAW_LENGTH), [0.05, turn])


def followed(to_go: PoseField, pose: np.ndarray, goal: np.ndarray, *, step: float, steps: int) -> np.ndarray:
    """The way [steps + 1, 3] that a cost-to-go leads."""
    start, end = (wp.array(p[None].astype(np.float32), dtype=wp.vec3, device=DEVICE) for p in (pose, goal))
    way = wp.zeros((1, steps + 1), dtype=wp.vec3, device=DEVICE)
    wp.launch(
        kernels.descend,
        dim=BLOCK,
        inputs=[to_go, no_plan(), start, end, YAW_LENGTH, step],
        outputs=[way],
        device=DEVICE,
        block_dim=BLOCK,
    )
    return way.numpy()[0].astype(float)


def test_following_the_cost_to_go_brings_the_object_around_an_obstacle_to_its_goal(device: str):
    clearance = build_geometry(task(box(0.40, 0.0, (0.14, 0.06, 0.1)), pushed=block()), device).clearance
    goal = np.array([0.42, 0.2, 0.5])
    to_go = build_to_go(clearance, goal, yaw_length=YAW_LENGTH, device=device)
    pose = np.array([0.40, -0.2, 0.0])
    way = followed(to_go, pose, goal, step=0.006, steps=150)
    np.testing.assert_allclose(way[0], pose, atol=1e-6)
    np.testing.assert_allclose(way[-1], goal, atol=1e-3)
    grid = pose_grid(clearance)
    assert min(grid.at(pose)[0] for pose in way) > 0.0
    assert (path_lengths(way, YAW_LENGTH) < 0.006 + 1e-6).all()
    arrived = int(np.argmax(np.linalg.norm(way[:, :2] - goal[:2], axis=1) < 1e-3))
    straight = pose_field_at(to_go, pose)
    assert path_lengths(way[: arrived + 1], YAW_LENGTH).sum() < 1.1 * straight


def test_a_way_down_stops_nowhere_on_its_way(device: str):
    """From all over the table, corners of obstacles included: wherever it is, it gets on."""
    clearance = build_geometry(task(box(0.40, 0.0, (0.14, 0.06, 0.1)), pushed=block()), device).clearance
    goal = np.array([0.42, 0.2, 0.5])
    to_go = build_to_go(clearance, goal, yaw_length=YAW_LENGTH, device=device)
    random = np.random.default_rng(2)
    for pose in random.uniform([0.2, -0.3, -np.pi], [0.6, 0.3, np.pi], (60, 3)):
        way = followed(to_go, pose, goal, step=0.006, steps=250)
        left = np.linalg.norm((way[-1] - goal)[:2])
        assert left < 0.01, (pose, way[-1])
        assert abs(reference.wrap_angle(way[-1, 2] - goal[2])) < 0.05


def test_a_way_down_leads_through_a_gap_as_narrow_as_the_grid(device: str):
    """A free way one node wide that winds through the grid; beside it every node is blocked."""
    clearance = np.full((8, 30, 12), -0.01)
    free = [(2, i, 5) for i in range(3, 12)] + [(3, i, 6) for i in range(12, 18)] + [(2, i, 7) for i in range(18, 27)]
    for node in free:
        clearance[node] = 0.001
    field = field_of(clearance)
    goal, pose = (np.array([0.01 * i, 0.01 * j, t * np.pi / 4.0]) for t, i, j in (free[-1], free[0]))
    to_go = build_to_go(field, goal, yaw_length=0.01, device=device)
    start, end = (wp.array(p[None].astype(np.float32), dtype=wp.vec3, device=device) for p in (pose, goal))
    way = wp.zeros((1, 121), dtype=wp.vec3, device=device)
    inputs = [to_go, no_plan(), start, end, 0.01, 0.006]
    wp.launch(kernels.descend, dim=BLOCK, inputs=inputs, outputs=[way], device=device, block_dim=BLOCK)
    np.testing.assert_allclose(way.numpy()[0, -1], goal, atol=1e-3)
    left = np.linalg.norm(way.numpy()[0, :, :2] - goal[:2], axis=1)
    assert (left[5:] < left[:-5] + 1e-6).all(), "it does not turn around"


def test_a_way_leads_along_a_plan_past_a_shorter_one(device: str):
    """The plan makes a detour through free space, and crosses itself."""
    goal, pose = np.array([0.42, 0.2, 0.0]), np.array([0.39, -0.19, 0.1])
    corners = np.array([[0.40, -0.2, 0.0], [0.55, -0.05, 0.0], [0.55, 0.08, 0.0], [0.38, 0.08, 0.0], [0.42, 0.2, 0.0]])
    plan = np.vstack([np.linspace(a, b, 12)[:-1] for a, b in pairwise(corners)] + [goal])
    clearance = build_geometry(task(pushed=block()), device).clearance
    to_go = build_to_go(clearance, plan, yaw_length=YAW_LENGTH, device=device)
    start, end = (wp.array(p[None].astype(np.float32), dtype=wp.vec3, device=device) for p in (pose, goal))
    packed = wp.array(plan.astype(np.float32), dtype=wp.vec3, device=device)
    found = wp.zeros((1, 200), dtype=wp.vec3, device=device)
    inputs = [to_go, packed, start, end, YAW_LENGTH, 0.006]
    wp.launch(kernels.descend, dim=BLOCK, inputs=inputs, outputs=[found], device=device, block_dim=BLOCK)
    way = found.numpy()[0].astype(float)
    np.testing.assert_allclose(way[-1], goal, atol=1e-3)
    off = [np.linalg.norm(plan[:, :2] - p[:2], axis=1).min() for p in way]
    assert max(off) < 0.03, "it stays on the plan"
    passed = [np.linalg.norm(way[:, :2] - corner[:2], axis=1).min() for corner in corners]
    assert max(passed) < 0.045, "all around the detour"


def test_a_bound_to_start_from_changes_nothing(device: str):
    way = np.array([[0.02, 0.09, 3.0], [0.05, 0.09, 3.4], [0.09, 0.085, 3.9], [0.121, 0.033, 5.0]])
    bound = build_to_go(field_of(walled()), way[-1], yaw_length=YAW_LENGTH, push_ring=RING, device=device)
    found, expected = (
        build_to_go(field_of(walled()), way, yaw_length=YAW_LENGTH, push_ring=RING, bound=known, device=device)
        for known in (bound, None)
    )
    np.testing.assert_allclose(found.values.numpy(), expected.values.numpy(), atol=1e-3)


def test_on_the_host_the_cost_to_go_close_to_the_goal_is_the_straight_distance(device: str):
    field, goal = field_of(np.full((8, 14, 11), 0.05)), np.array([0.073, 0.052, 1.0])
    to_go = build_to_go(field, goal, yaw_length=YAW_LENGTH, device=device)
    values = to_go.values.numpy()
    for off in (0.0, 0.001, 0.004, 0.01):
        pose = goal + np.array([off, 0.0, 0.0])
        assert to_go_at(to_go, values, pose, goal, YAW_LENGTH) == pytest.approx(off, abs=1e-9)
    far = goal + np.array([0.045, 0.0, 0.0])
    assert to_go_at(to_go, values, far, goal, YAW_LENGTH) == pose_field_at(to_go, far, values)
