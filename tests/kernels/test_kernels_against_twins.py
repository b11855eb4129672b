"""The kernels of geometry, costs, object and arm against their float64 twins."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation
from support import probes, reference
from support.device import DEVICE
from support.reference import ANGLE_TOLERANCE, LENGTH_TOLERANCE, RELATIVE_TOLERANCE, Body, Grid
from support.small_tasks import (
    DT,
    Pushing,
    Rollouts,
    block,
    box,
    joints_at,
    object_level,
    post,
    roll_wrenches,
    shipped,
    straight,
    task,
)

from oimppi_warp.config.settings import ObjectCost, RobotCost
from oimppi_warp.geometry.fields import pose_field_at
from oimppi_warp.geometry.footprint import Piece
from oimppi_warp.geometry.pose_grid import pack_pieces
from oimppi_warp.kernels.costs.stage_costs import TERMS
from oimppi_warp.kernels.geometry import PlanarField, PoseField, SpaceField
from oimppi_warp.kernels.pushing import ObjectModel
from oimppi_warp.planning.engines.packing import object_model, pack_weights
from oimppi_warp.scene import Scene

RANDOM = np.random.default_rng(3)
T = TypeVar("T", ObjectCost, RobotCost)


def launch(kernel: Callable[..., Any], inputs: list[Any], cases: int, *types: Any) -> list[np.ndarray]:
    """Runs a probe over its cases and returns its outputs, float64."""
    outputs = [wp.zeros(cases, dtype=kind, device=DEVICE) for kind in types]
    wp.launch(kernel, dim=cases, inputs=inputs, outputs=outputs, device=DEVICE)
    return [out.numpy().astype(float) for out in outputs]


def on_device(values: np.ndarray, kind: Any) -> wp.array:
    return wp.array(np.asarray(values, dtype=np.float32), dtype=kind, device=DEVICE)


def random_poses(count: int, *, lower: tuple[float, float], upper: tuple[float, float]) -> np.ndarray:
    """Float32-exact poses, their yaw over several turns."""
    low, high = np.array([*lower, -9.0]), np.array([*upper, 9.0])
    return RANDOM.uniform(low, high, size=(count, 3)).astype(np.float32).astype(float)


# Look-ups


def test_the_angle_of_a_vector_is_that_of_the_library():
    around = RANDOM.uniform(-np.pi, np.pi, 20000)
    scales = 10.0 ** RANDOM.uniform(-6.0, 3.0, len(around))
    points = scales[:, None] * np.column_stack([np.cos(around), np.sin(around)])
    special = [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)]
    points = np.concatenate([points, special]).astype(np.float32)
    (angles,) = launch(probes.angle_of_probe, [on_device(points, wp.vec2)], len(points), float)
    np.testing.assert_allclose(angles, np.arctan2(points[:, 1].astype(float), points[:, 0]), rtol=0.0, atol=3e-7)


def test_angles_are_wrapped_into_one_turn():
    angles = np.array([0.0, 3.0, -3.0, 3.2, -3.2, 7.0, -40.0, 40.0])
    (wrapped,) = launch(probes.wrap_angle_probe, [on_device(angles, float)], len(angles), float)
    np.testing.assert_allclose(wrapped, reference.wrap_angle(angles), atol=ANGLE_TOLERANCE)
    (edge,) = launch(probes.wrap_angle_probe, [on_device(np.array([np.pi, -np.pi]), float)], 2, float)
    np.testing.assert_allclose(np.abs(edge), np.pi, atol=ANGLE_TOLERANCE)


def test_a_matrix_turns_about_its_own_z_axis():
    before = Rotation.random(20, rng=np.random.default_rng(1))
    angles = RANDOM.uniform(-4.0, 4.0, 20)
    inputs = [on_device(before.as_matrix(), wp.mat33), on_device(angles, float)]
    (found,) = launch(probes.turn_about_z_probe, inputs, 20, wp.mat33)
    expected = (before * Rotation.from_euler("z", angles[:, None])).as_matrix()
    np.testing.assert_allclose(found, expected, atol=1e-6)


def planar_field() -> PlanarField:
    field = PlanarField()
    field.values = on_device(RANDOM.normal(size=(7, 5)), float)
    field.origin, field.inv_step = wp.vec2(-0.3, 0.1), 10.0
    return field


def pose_field() -> PoseField:
    field = PoseField()
    field.values = on_device(RANDOM.normal(size=(8, 6, 7)), float)
    field.origin, field.inv_step, field.inv_yaw_step = wp.vec2(-0.3, 0.1), 10.0, 8 / (2 * np.pi)
    return field


def test_the_planar_look_up_has_its_twins_value_and_gradient_inside_and_out():
    field = planar_field()
    points = random_poses(200, lower=(-0.6, -0.2), upper=(0.6, 0.8))[:, :2]
    (found,) = launch(probes.planar_field_probe, [field, on_device(points, wp.vec2)], 200, wp.vec3)
    twin = [reference.planar_grid(field).at(point) for point in points]
    expected = np.array([[value, *gradient] for value, gradient in twin])
    np.testing.assert_allclose(found, expected, rtol=RELATIVE_TOLERANCE, atol=1e-4)


def test_the_pose_look_up_has_its_twins_value_and_gradient_around_the_turn():
    field = pose_field()
    poses = random_poses(300, lower=(-0.6, -0.2), upper=(0.6, 0.9))
    (found,) = launch(probes.pose_field_probe, [field, on_device(poses, wp.vec3)], 300, wp.vec4)
    twin = [reference.pose_grid(field).at(pose) for pose in poses]
    expected = np.array([[value, *gradient] for value, gradient in twin])
    np.testing.assert_allclose(found, expected, rtol=RELATIVE_TOLERANCE, atol=3e-4)


def test_the_pose_look_up_on_the_host_is_that_of_the_kernels():
    field = pose_field()
    poses = random_poses(50, lower=(-0.6, -0.2), upper=(0.6, 0.9))
    (found,) = launch(probes.pose_field_probe, [field, on_device(poses, wp.vec3)], 50, wp.vec4)
    np.testing.assert_allclose([pose_field_at(field, pose) for pose in poses], found[:, 0], atol=1e-4)


def test_the_pose_look_up_has_no_seam_at_a_full_turn():
    field = pose_field()
    seam = np.array([[0.0, 0.3, yaw] for yaw in (2 * np.pi - 1e-4, 1e-4, -1e-4, 0.0, 2 * np.pi)])
    (found,) = launch(probes.pose_field_probe, [field, on_device(seam, wp.vec3)], len(seam), wp.vec4)
    np.testing.assert_allclose(found[:, 0], found[0, 0], atol=2e-3)


@pytest.mark.parametrize("strange", [np.nan, np.inf, -np.inf, 1e30])
def test_a_look_up_of_what_is_no_place_reads_nothing_outside_of_its_field(strange):
    poses = on_device(np.array([[strange, 0.3, 0.1], [0.0, strange, 0.1], [0.0, 0.3, strange]]), wp.vec3)
    (found,) = launch(probes.pose_field_probe, [pose_field(), poses], 3, wp.vec4)
    points = on_device(np.array([[strange, 0.3], [0.0, strange]]), wp.vec2)
    (flat,) = launch(probes.planar_field_probe, [planar_field(), points], 2, wp.vec3)
    values = np.array([*found[:, 0], *flat[:, 0]])
    assert (np.isnan(values) | (np.abs(values) < 6.0)).all()


def test_the_space_look_up_has_its_twins_value_and_nothing_near_outside():
    field = SpaceField()
    field.values = on_device(RANDOM.normal(size=(5, 6, 7)), float)
    field.origin, field.inv_step, field.outside = wp.vec3(0.1, -0.2, 0.0), 10.0, 0.9
    points = RANDOM.uniform([0.0, -0.3, -0.2], [0.6, 0.4, 0.7], size=(300, 3)).astype(np.float32)
    (found,) = launch(probes.space_field_probe, [field, on_device(points, wp.vec3)], 300, float)
    expected = [reference.space_field(field, point.astype(float)) for point in points]
    np.testing.assert_allclose(found, expected, atol=1e-4)
    assert 20 < np.sum(found == np.float32(0.9)) < 280


# Distances of pieces


def random_piece(corners: int, radius: float) -> Piece:
    around = np.sort(RANDOM.uniform(0.0, 2.0 * np.pi, corners))
    if corners == 1:
        return Piece(np.array([[0.01, 0.02]]), radius)
    around = np.linspace(0.0, 2.0 * np.pi, corners, endpoint=False) + RANDOM.uniform(0.0, 0.6, corners)
    return Piece(np.stack([0.10 * np.cos(around), 0.06 * np.sin(around)], axis=1), radius)


@pytest.mark.parametrize(("corners_a", "corners_b"), [(4, 4), (3, 6), (1, 5), (1, 1), (5, 1)])
def test_the_distance_of_pieces_apart_is_shapelys(corners_a, corners_b, device):
    a, b = random_piece(corners_a, 0.01), random_piece(corners_b, 0.02)
    poses_a, poses_b = (random_poses(120, lower=(-0.3, -0.3), upper=(0.3, 0.3)) for _ in range(2))
    packed_a, packed_b = (pack_pieces([piece], device) for piece in (a, b))
    inputs = [packed_a, on_device(poses_a, wp.vec3), packed_b, on_device(poses_b, wp.vec3)]
    (found,) = launch(probes.piece_distance_probe, inputs, 120, float)
    pairs = zip(poses_a, poses_b, strict=True)
    expected = np.array([reference.piece_distance(a.moved(x), b.moved(y)) for x, y in pairs])
    apart = expected > -0.03 + 1e-6  # the cores do not overlap
    assert apart.sum() > 20
    np.testing.assert_allclose(found[apart], expected[apart], atol=LENGTH_TOLERANCE)
    assert (found[~apart] < -0.03 + LENGTH_TOLERANCE).all()


def test_overlapping_squares_are_as_deep_as_their_shortest_way_out(device: str):
    square = Piece(0.05 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]))
    shifts = np.array([[0.09, 0.01, 0.0], [0.02, -0.07, 0.0], [0.0, 0.0, 0.0]])
    packed = pack_pieces([square], device)
    inputs = [packed, on_device(shifts, wp.vec3), packed, on_device(np.zeros((3, 3)), wp.vec3)]
    (found,) = launch(probes.piece_distance_probe, inputs, 3, float)
    np.testing.assert_allclose(found, [-0.01, -0.03, -0.10], atol=LENGTH_TOLERANCE)


# Costs


def random_case(kind: Any) -> dict[str, Any]:
    vectors = {"tip", "up", "pose", "goal", "reference", "target"}
    sizes = dict.fromkeys(vectors, 3) | {"lean": 2, "velocity": 2, "waypoint": 4}
    return {
        name: RANDOM.uniform(-0.6, 0.6, sizes[name]) if name in sizes else float(RANDOM.uniform(-0.02, 0.05))
        for name in kind.vars
    }


def packed_cases(cases: list[dict[str, Any]], kind: Any) -> wp.array:
    structs = []
    for case in cases:
        struct = kind()
        for name, value in case.items():
            vector = isinstance(value, np.ndarray)
            setattr(struct, name, wp.types.vector(len(value), float)(*value) if vector else value)
        structs.append(struct)
    return wp.array(structs, dtype=kind, device=DEVICE)


def different_weights(kind: type[T]) -> T:
    """All weights and thresholds at numbers of their own, so that none can stand in for another."""
    numbers: dict[str, Any] = {item.name: 1.0 + 0.37 * i for i, item in enumerate(fields(kind)) if item.name != "extra"}
    small = {"f_0": 0.01, "margin": 0.02, "r_0": 0.3, "gamma_0": 0.4, "align_fade": 0.5, "stance_fade": 0.4,
             "height": 0.2, "arm_clearance": 0.03, "push_ring": (0.3, 0.5), "align_ahead": 2,
             "contact_slack": 0.01}  # fmt: skip
    return kind(**(numbers | {name: value for name, value in small.items() if name in numbers}))


def test_the_objects_stage_cost_is_equation_15():
    weights = different_weights(ObjectCost)
    packed = object_level(task(), **vars(weights))[0]._weights
    cases = [random_case(probes.ObjectCase) for _ in range(100)]
    (found,) = launch(probes.object_cost_probe, [packed, packed_cases(cases, probes.ObjectCase)], 100, float)
    expected = [
        reference.object_cost(weights, c["pose"], c["goal"], c["force"], c["clearance"], c["to_go"]) for c in cases
    ]
    np.testing.assert_allclose(found, expected, rtol=RELATIVE_TOLERANCE, atol=1e-6)


@pytest.mark.parametrize("fade", [0.0, 0.5])
def test_the_robots_stage_cost_is_equations_15_to_19_term_by_term(fade):
    weights = replace(different_weights(RobotCost), align_fade=fade)
    cases = [random_case(probes.Stage) for _ in range(100)]
    rotations = Rotation.random(100, rng=np.random.default_rng(5)).as_matrix()
    for case, rotation in zip(cases, rotations, strict=True):
        case["up"] = rotation[2]
        case["lean"] = -rotation[:2, 2] / max(-rotation[2, 2], 0.1)
        case["velocity"] = RANDOM.uniform(-0.5, 0.5, 2)
        case["top"] = 0.1
        case["speed_squared"] = abs(case["speed_squared"])
    edge = (np.array([-0.2, -0.3]), np.array([0.4, 0.1]))
    packed = pack_weights(weights, edge)
    packed.topple_speed, packed.size = 0.15, 0.2
    inputs = [packed, packed_cases(cases, probes.Stage)]
    (found,) = launch(probes.robot_cost_probe, inputs, 100, probes.CostTerms)
    for terms, case, rotation in zip(found, cases, rotations, strict=True):
        known = {name: value for name, value in case.items() if name not in ("up", "lean")}
        known |= {"topple_speed": 0.15, "size": 0.2}
        expected = reference.robot_cost(weights, rotation=rotation, edge=edge, **known)
        np.testing.assert_allclose(
            terms, [expected[name] for name in TERMS], rtol=RELATIVE_TOLERANCE, atol=1e-5, err_msg=str(TERMS)
        )


def test_a_tool_straight_down_has_no_tilt_and_a_level_one_a_right_angle():
    down = Rotation.from_euler("x", np.pi)
    for turn in np.linspace(0.0, 6.0, 5):
        assert reference.tilt_cost((Rotation.from_euler("z", turn) * down).as_matrix()) == pytest.approx(0.0, abs=1e-9)
    for axis in "xy":
        level = (Rotation.from_euler(axis, np.pi / 2) * down).as_matrix()
        assert reference.tilt_cost(level) == pytest.approx(np.pi / 2)


# The object


def body_of(scene: Scene) -> tuple[ObjectModel, Body]:
    """The object's model on a scene, and its twin."""
    model = object_model(Pushing.on(scene).geometry, tool_friction=scene.object.tool_friction, slack=0.002)
    return model, Body.of(model)


@pytest.mark.parametrize("friction", [0.0, 0.3, 1.5])
def test_a_push_is_its_twins(friction):
    scene = task(pushed=replace(shipped("task01").object, tool_friction=friction))
    model, body = body_of(scene)
    poses = random_poses(400, lower=(0.3, -0.2), upper=(0.5, 0.2))
    ends = poses[:, :2] + RANDOM.uniform(-0.13, 0.13, (400, 2))
    starts = ends - RANDOM.normal(scale=0.01, size=(400, 2))
    starts, ends = (x.astype(np.float32).astype(float) for x in (starts, ends))
    inputs = [model, on_device(poses, wp.vec3), on_device(starts, wp.vec2), on_device(ends, wp.vec2), 0.008]
    (found,) = launch(probes.push_probe, inputs, 400, wp.vec3)
    cases = zip(poses, starts, ends, strict=True)
    expected = np.array([reference.push(body, pose, start, end, 0.008) for pose, start, end in cases])
    moved = np.abs(expected - poses).max(axis=1) > 0
    assert 50 < moved.sum() < 350
    np.testing.assert_array_equal(found[~moved], poses[~moved])
    # Close to the outline's corners and inside of the body the gradient jumps from cell to cell; float32 decides there.
    near = np.abs(expected - poses)[:, :2].max(axis=1) < 0.03
    off = np.abs(found - expected)[moved & near].max(axis=1)
    assert np.quantile(off, 0.95) < 2 * ANGLE_TOLERANCE, f"95th percentile {np.quantile(off, 0.95):.1e}"


def test_settling_is_its_twins():
    model, body = body_of(shipped("task02"))
    poses = random_poses(300, lower=(0.30, -0.15), upper=(0.70, 0.25))
    settled, force, clearance = launch(
        probes.settle_probe, [model, on_device(poses, wp.vec3), DT], 300, wp.vec3, float, float
    )
    twin = [reference.settle(body, pose, DT) for pose in poses]
    assert 30 < np.sum(force > 0) < 270
    np.testing.assert_allclose(clearance, [t[2] for t in twin], atol=LENGTH_TOLERANCE)
    off = np.abs(settled - np.array([t[0] for t in twin])).max(axis=1)
    assert np.quantile(off, 0.97) < 2 * ANGLE_TOLERANCE
    close = off < 2 * ANGLE_TOLERANCE
    np.testing.assert_allclose(force[close], np.array([t[1] for t in twin])[close], rtol=5e-3, atol=1e-3)


@pytest.mark.parametrize("to_go_weight", [0.0, 2.0])
def test_an_object_rollout_is_its_twins(to_go_weight):
    scene = shipped("task02")
    goal = np.array([0.5, 0.2, 0.6])
    dynamics, weights, geometry = object_level(scene, goal=goal, w_to_go=to_go_weight)
    start = np.array([0.42, -0.10, 0.4])
    wrenches = RANDOM.normal(size=(12, 20, 3)) * 0.6 * dynamics.bound + [0.0, 0.5 * dynamics.bound[1], 0.0]
    costs, poses = roll_wrenches(dynamics, start, wrenches)
    if to_go_weight:
        way = reference.pose_grid(dynamics.to_go)
    else:
        way = Grid(np.zeros((2, 2, 2)), np.zeros(3), np.ones(3))
    body = Body.of(object_model(geometry, tool_friction=0.0, edge=True))
    touched = 0
    for cost, path, sequence in zip(costs, poses, wrenches.astype(np.float32).astype(float), strict=True):
        expected, twin = reference.object_rollout(
            body, weights, start, goal, sequence, DT, lambda pose: reference.distance_to_go(way, pose, goal, 0.12)
        )
        touched += geometry.clearance_at(path[-1]) < 0.01
        np.testing.assert_allclose(path, twin, atol=20 * LENGTH_TOLERANCE)
        np.testing.assert_allclose(cost, expected, rtol=20 * RELATIVE_TOLERANCE)
    assert touched > 0, "no rollout came near the obstacle, so that settling was not compared"


# The arm


@pytest.mark.parametrize(
    ("name", "tip", "velocity", "term"),
    [
        ("task01", (0.40, -0.33, 0.02), (0.05, 0.20, 0.0), "track"),
        ("task02", (0.48, -0.24, 0.02), (0.02, 0.25, 0.0), "contact"),
        ("task03", (0.32, -0.20, 0.02), (0.0, 0.20, 0.0), "arm_clearance"),
        ("task01", (0.40, -0.30, 0.03), (0.0, 0.10, -0.10), "height"),
        ("task01", (0.40, -0.25, 0.06), (0.02, 0.15, -0.02), "above"),
    ],
    ids=["pushing", "pressing against an obstacle", "held back at a shelf", "sinking", "coming down on the object"],
)
def test_a_robot_rollout_is_its_twins(name, tip, velocity, term):
    pushing = Pushing.on(shipped(name), f_0=0.0, w_control=0.1)
    robot = pushing.scene.robot
    pose = np.array([0.46, -0.11, 0.3] if name == "task02" else [0.42, -0.20, 0.3])
    joints = joints_at(robot, tip).astype(np.float32).astype(float)
    goal = np.array([0.5, 0.3, 3.0])
    path = np.linspace(pose, goal, len(pushing.dynamics.reference.host))
    controls = straight(robot, joints, velocity, 20) + RANDOM.normal(scale=0.08, size=(12, 20, robot.dof))
    rolled = pushing.roll(joints, pose, controls, goal=goal, reference=path)
    world = pushing.twin()
    twins = [
        reference.robot_rollout(world, joints, pose, goal, path, sequence)
        for sequence in controls.astype(np.float32).astype(float)
    ]
    assert max(twin.terms[term] for twin in twins) > 0.0, "what this case is about did not happen"
    if term in ("track", "contact"):
        assert max(np.abs(twin.poses[-1] - pose).max() for twin in twins) > 0.02, "no rollout pushed the object"
    assert_alike(rolled, twins)


@pytest.mark.parametrize(
    ("name", "tip", "velocity", "term"),
    [
        ("task01", (0.40, -0.33, 0.012), (0.05, 0.20), "track"),
        ("task02", (0.48, -0.24, 0.012), (0.02, 0.25), "contact"),
        ("task03", (0.32, -0.20, 0.02), (0.0, 0.20), "arm_clearance"),
        ("task01", (0.40, -0.25, 0.07), (0.02, 0.10), "above"),
    ],
    ids=["pushing", "pressing against an obstacle", "held back at a shelf", "passing over the object"],
)
def test_a_rollout_of_an_upright_arm_is_its_twins(name, tip, velocity, term):
    pushing = Pushing.on(shipped(name), upright=True, f_0=0.0, w_control=0.1)
    upright = pushing.dynamics.task.upright
    assert upright is not None
    pose = np.array([0.46, -0.11, 0.3] if name == "task02" else [0.42, -0.20, 0.3])
    joints = joints_at(pushing.scene.robot, tip).astype(np.float32).astype(float)
    goal = np.array([0.5, 0.3, 3.0])
    path = np.linspace(pose, goal, len(pushing.dynamics.reference.host))
    controls = np.array([*velocity, 0.0]) + np.random.default_rng(7).normal(scale=0.08, size=(12, 20, 3))
    rolled = pushing.roll(joints, pose, controls, goal=goal, reference=path)
    world, start = pushing.twin(), reference.tip_frame(pushing.scene.robot, joints)[:3, 3]
    twins = [
        reference.upright_rollout(world, upright.packed, start, pose, goal, path, sequence)
        for sequence in controls.astype(np.float32).astype(float)
    ]
    assert max(twin.terms[term] for twin in twins) > 0.0, "what this case is about did not happen"
    if term in ("track", "contact"):
        assert max(np.abs(twin.poses[-1] - pose).max() for twin in twins) > 0.02, "no rollout pushed the object"
    assert_alike(rolled, twins)


def assert_alike(rolled: Rollouts, twins: list[reference.Rollout]) -> None:
    """Rollouts of the engine have tips, poses and terms of their twins."""
    agree = 0
    for k, twin in enumerate(twins):
        # Where a stall hangs on the last bit the two part ways; that may happen to one rollout in a dozen. The tip may
        # end in the same place, stalled or taken back from the object: then only one of the two has a force.
        contact = TERMS.index("contact")
        pressing = abs(rolled.terms[k][contact] - twin.terms["contact"]) > 0.15 * twin.terms["contact"] + 1e-3
        if pressing or np.abs(rolled.tips[k] - twin.tips).max() > 1e-3:
            continue
        agree += 1
        np.testing.assert_allclose(rolled.tips[k], twin.tips, atol=3 * LENGTH_TOLERANCE)
        np.testing.assert_allclose(rolled.poses[k], twin.poses, atol=10 * ANGLE_TOLERANCE)
        expected = np.array([twin.terms[name] for name in TERMS])
        # The force grows with the depth in an obstacle, and that is kept to a fraction of a millimetre.
        tolerance = np.where(np.array(TERMS) == "contact", 0.15, 0.01) * np.abs(expected) + 1e-3
        off = np.abs(rolled.terms[k] - expected)
        assert (off < tolerance).all(), np.array(TERMS)[off >= tolerance]
        assert rolled.costs[k] == pytest.approx(twin.cost, rel=5e-3)
    assert agree >= 11


def test_a_robot_rollout_costs_the_sum_of_its_terms():
    pushing = Pushing.on(task(post(0.5, 0.05, 0.05, 0.1), box(0.3, 0.3, (0.1, 0.1, 0.1)), pushed=block()))
    controls = RANDOM.normal(scale=0.3, size=(30, 25, 6))
    rolled = pushing.roll(pushing.scene.robot.start, np.array([0.42, -0.20, 0.3]), controls)
    np.testing.assert_allclose(rolled.terms.sum(axis=1), rolled.costs, rtol=1e-5)
    assert np.isfinite(rolled.costs).all()
