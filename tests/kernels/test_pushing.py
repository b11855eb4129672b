"""Pushing against closed forms, and what tool, object and arm may never do in a rollout."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from support import probes, reference
from support.device import DEVICE, assert_same
from support.reference import ANGLE_TOLERANCE, LENGTH_TOLERANCE
from support.small_tasks import (
    DT,
    Pushing,
    block,
    box,
    joints_at,
    object_level,
    post,
    reference_point,
    roll_wrenches,
    shipped,
    straight,
    task,
)

from oimppi_warp.config.settings import Config, ObjectLevel
from oimppi_warp.kernels.contact import PENETRATION_TOLERANCE
from oimppi_warp.kernels.pushing import ObjectModel
from oimppi_warp.planning.engines.packing import object_model

DEPTH = 1e-3
"""How deep the pushes of the closed forms go [m]."""
HALF = np.array([0.05, 0.03])
"""Half extents of the block that they push [m]."""
TOOL = 0.008
"""Radius of the tool that they push with [m]."""
CONTACT_ERROR = 0.002
"""The tool never enters the object further than this in a rollout [m]."""
SLOW = ObjectLevel(speed_limit=(0.12, 0.12, 1.0))
"""An object level whose steps of 6 mm are short enough for the linearization of phi_2."""
PENETRATION = 0.003
"""The object hardly ever enters an obstacle further than this in a rollout [m]."""
WEDGED = 0.008
"""... and never further than this, not even between two obstacles that it does not fit between [m]."""


def model_of(friction: float) -> ObjectModel:
    scene = task(pushed=block(tool_friction=friction))
    return object_model(Pushing.on(scene).geometry, tool_friction=friction)


def push_from_below(model: ObjectModel, offset: float, *, drag: float = 0.0, yaw: float = 0.0) -> np.ndarray:
    """How a block at (0.4, 0.1, yaw) moves, in its own frame, when pushed in its +y, ``offset`` from its centre.

    The tool begins in touch with the lower face and goes ``DEPTH`` forward and ``drag`` to the side.
    """
    pose = np.array([0.4, 0.1, yaw])
    turn = reference.planar_rotation(yaw)
    start = pose[:2] + turn @ np.array([offset, -HALF[1] - TOOL])
    end = start + turn @ np.array([drag, DEPTH])
    cases = [wp.array(x[None].astype(np.float32), dtype=t, device=DEVICE)
             for x, t in ((pose, wp.vec3), (start, wp.vec2), (end, wp.vec2))]  # fmt: skip
    out = wp.zeros(1, dtype=wp.vec3, device=DEVICE)
    wp.launch(probes.push_probe, dim=1, inputs=[model, *cases, TOOL], outputs=[out], device=DEVICE)
    moved = out.numpy()[0].astype(float) - pose
    return np.array([*(turn.T @ moved[:2]), moved[2]])


# Closed forms


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.0])
@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_a_push_through_the_friction_centre_does_not_turn_the_object(yaw, friction):
    moved = push_from_below(model_of(friction), 0.0, yaw=yaw)
    np.testing.assert_allclose(moved, [0.0, DEPTH, 0.0], atol=LENGTH_TOLERANCE)


@pytest.mark.parametrize("offset", [-0.04, -0.01, 0.02, 0.04])
def test_an_off_centre_push_turns_the_object_as_the_limit_surface_says(offset):
    model = model_of(0.0)
    c = model.radius
    # A force (0, 1) at (d, .) moves the contact by 1 + d^2 / c^2 along itself and turns the object by d / c^2.
    forward, turn = DEPTH * c**2 / (c**2 + offset**2), DEPTH * offset / (c**2 + offset**2)
    np.testing.assert_allclose(push_from_below(model, offset), [0.0, forward, turn], atol=5 * LENGTH_TOLERANCE)


def contact_motion(moved: np.ndarray, offset: float) -> np.ndarray:
    """Motion of the point of the block that the tool touches, in the block's frame."""
    return moved[:2] + moved[2] * np.array([HALF[1], offset])


def test_a_contact_inside_its_friction_cone_sticks():
    # Straight ahead the object would turn away under the tool; friction holds the contact point to the tool.
    moved = push_from_below(model_of(2.0), 0.03, drag=0.3 * DEPTH)
    np.testing.assert_allclose(contact_motion(moved, 0.03), [0.3 * DEPTH, DEPTH], atol=3 * LENGTH_TOLERANCE)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_contact_outside_its_friction_cone_slides_with_the_force_on_the_cones_edge(side):
    friction = 0.2
    model = model_of(friction)
    moved = push_from_below(model, 0.0, drag=3.0 * side * DEPTH)
    force = moved[:2]  # the limit surface yields along the force
    assert force[0] / force[1] == pytest.approx(side * friction, rel=0.02)
    along, forward = contact_motion(moved, 0.0)
    assert forward == pytest.approx(DEPTH, abs=3 * LENGTH_TOLERANCE)
    assert 0.0 < side * along < 3.0 * DEPTH, "the object is dragged along, but less far than the tool goes"


def test_a_frictionless_tool_drags_nothing_sideways():
    model = model_of(0.0)
    dragged, ahead = push_from_below(model, 0.0, drag=3.0 * DEPTH), push_from_below(model, 3.0 * DEPTH)
    assert dragged[0] == pytest.approx(0.0, abs=LENGTH_TOLERANCE)
    np.testing.assert_allclose(dragged, ahead, atol=LENGTH_TOLERANCE)


def test_a_tool_that_does_not_touch_moves_nothing():
    model = model_of(0.3)
    np.testing.assert_allclose(push_from_below(model, HALF[0] + 2 * TOOL), 0.0, atol=1e-7)


def test_the_turned_push_is_the_push_turned():
    model = model_of(0.3)
    straight_on = push_from_below(model, 0.02, drag=0.5 * DEPTH)
    for yaw in (0.5, 2.0, -1.2):
        turned = push_from_below(model, 0.02, drag=0.5 * DEPTH, yaw=yaw)
        np.testing.assert_allclose(turned, straight_on, atol=5 * LENGTH_TOLERANCE)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_wrench_moves_the_object_by_the_inverse_of_its_limit_surface(axis):
    dynamics, _, geometry = object_level(task(pushed=block()))
    start = np.array([0.45, 0.0, 0.3])
    size = 0.5 * dynamics.bound[axis]
    wrenches = np.zeros((1, 10, 3))
    wrenches[0, :, axis] = size
    _, poses = roll_wrenches(dynamics, start, wrenches)
    surface = geometry.surface
    resistance = surface.force * (surface.radius**2 if axis == 2 else 1.0)
    expected = start + np.eye(3)[axis] * 10 * DT * size / resistance
    np.testing.assert_allclose(poses[0, -1], expected, atol=LENGTH_TOLERANCE)


def test_the_bound_of_the_wrench_is_the_one_that_reaches_the_speed_limit():
    level = ObjectLevel(speed_limit=(0.1, 0.1, 0.8))
    dynamics, _, _ = object_level(task(pushed=block()), level=level)
    _, poses = roll_wrenches(dynamics, np.array([0.4, 0.0, 0.0]), dynamics.bound[None, None])
    np.testing.assert_allclose(poses[0, 1] - poses[0, 0], DT * np.array(level.speed_limit), atol=LENGTH_TOLERANCE)


# Obstacles


WALL = task(box(0.6, 0.0, (0.1, 1.0, 0.1)), pushed=block())
"""A wall whose face is at x = 0.55."""


def test_an_object_pressed_obliquely_into_a_wall_slides_along_it():
    dynamics, _, geometry = object_level(WALL, level=SLOW)
    start = np.array([0.47, -0.1, 0.0])  # 3 cm before the wall
    wrenches = np.tile([dynamics.bound[0], 0.5 * dynamics.bound[1], 0.0], (1, 30, 1))
    _, poses = roll_wrenches(dynamics, start, wrenches)
    end = poses[0, -1]
    assert end[0] == pytest.approx(0.55 - HALF[0], abs=PENETRATION), "it stops at the wall"
    expected = -0.1 + 30 * DT * dynamics.bound[1] / 2 / geometry.surface.force
    assert end[1] == pytest.approx(expected, abs=2e-3), "and goes on along it"
    assert abs(end[2]) < 0.02, "flat"


def test_a_wall_pushes_back_with_the_force_that_presses():
    dynamics, weights, _ = object_level(WALL, w_d=0.0, w_theta=0.0, w_margin=0.0, w_to_go=0.0, w_f=1.0, f_0=0.0)
    pressed = 0.5 * dynamics.bound[0]
    costs, _ = roll_wrenches(dynamics, np.array([0.5, 0.0, 0.0]), np.tile([pressed, 0.0, 0.0], (1, 10, 1)))
    assert costs[0] == pytest.approx(10 * weights.w_f * pressed**2, rel=0.05)


@pytest.mark.parametrize(
    ("name", "start"), [("task02", (0.45, -0.15, 1.2)), ("task03", (0.45, -0.15, 1.2)), ("task05", (0.5, 0.17, 1.2))]
)
def test_an_object_neither_enters_obstacles_nor_leaves_the_table(name, start):
    dynamics, _, _ = object_level(shipped(name), level=SLOW)
    random = np.random.default_rng(2)
    drift = dynamics.bound * random.choice([-1.0, -0.5, 0.5, 1.0], size=(150, 1, 3))
    wrenches = drift + dynamics.bound * random.normal(scale=0.4, size=(150, 60, 3))
    _, poses = roll_wrenches(dynamics, np.array(start), np.clip(wrenches, -dynamics.bound, dynamics.bound))
    clearance = reference.Body.of(dynamics._model).clearance
    found = np.array([clearance.at(pose)[0] for pose in poses[:, ::3].reshape(-1, 3)])
    assert (found < 0.002).mean() > 0.02, "hardly a rollout touched anything"
    assert np.quantile(found, 0.01) > -PENETRATION
    assert found.min() > -WEDGED


def test_an_object_in_an_obstacle_comes_out_of_it():
    dynamics, _, geometry = object_level(WALL)
    start = np.array([0.53, 0.0, 0.0])
    _, poses = roll_wrenches(dynamics, start, np.zeros((1, 5, 3)))
    assert geometry.clearance_at(start) < -0.02
    assert geometry.clearance_at(poses[0, -1]) > -1e-3
    assert poses[0, -1, 1] == pytest.approx(start[1], abs=1e-3), "the shortest way"
    assert poses[0, -1, 0] < 0.505


# The arm


T_POSE = np.array([0.42, -0.05, 0.0])
BEHIND = (0.42, -0.22, 0.02)
"""Where a tool stands behind that T's stem."""


@pytest.fixture(scope="module")
def open_table() -> Pushing:
    return Pushing.on(task())


def test_a_tool_pushes_the_object_before_it(open_table):
    robot = open_table.scene.robot
    joints = joints_at(robot, BEHIND)
    controls = straight(robot, joints, (0.0, 0.15, 0.0), 25)
    rolled = open_table.roll(joints, T_POSE, controls[None])
    moved = rolled.poses[0, -1] - T_POSE
    # The T's lowest point is 0.1 m below its friction centre.
    expected = rolled.tips[0, -1, 1] + robot.tool_radius + 0.1 - T_POSE[1]
    assert moved[1] == pytest.approx(expected, abs=CONTACT_ERROR)
    assert moved[1] > 0.05
    np.testing.assert_allclose(moved[[0, 2]], 0.0, atol=0.03)


def random_pushes(pushing: Pushing, joints: np.ndarray, count: int, steps: int = 25) -> np.ndarray:
    """Control sequences [count, steps, dof] that take the tool about, smoothly."""
    random = np.random.default_rng(7)
    robot = pushing.scene.robot
    sequences = []
    for _ in range(count):
        vx, vy = random.uniform(-0.25, 0.25, 2) + [0.0, 0.15]
        sequences.append(straight(robot, joints, (vx, vy, random.uniform(-0.02, 0.02)), steps))
    return np.array(sequences) + random.normal(scale=0.05, size=(count, steps, robot.dof))


@pytest.mark.parametrize("obstacles", [(), (post(0.45, 0.2, 0.05, 0.1), box(0.3, 0.05, (0.05, 0.2, 0.2)))])
def test_a_tool_never_enters_the_object(obstacles):
    pushing = Pushing.on(task(*obstacles))
    joints = joints_at(pushing.scene.robot, BEHIND)
    rolled = pushing.roll(joints, T_POSE, random_pushes(pushing, joints, 60))
    beside = rolled.tips[:, :, 2] < pushing.geometry.top
    assert pushing.gaps(rolled)[beside].min() > -CONTACT_ERROR
    pushed = np.linalg.norm(rolled.poses[:, -1, :2] - T_POSE[:2], axis=1) > 0.02
    assert pushed.sum() > 10


def test_a_tool_does_not_jump_through_a_thin_object():
    thin = replace(block((0.30, 0.012, 0.05)))
    pushing = Pushing.on(task(pushed=thin))
    robot = pushing.scene.robot
    joints = joints_at(robot, (0.45, -0.05, 0.02))
    pose = np.array([0.45, 0.0, 0.0])
    controls = straight(robot, joints, (0.0, 0.3, 0.0), 15)
    rolled = pushing.roll(joints, pose, controls[None])
    sides = [reference_point(p, t[:2])[1] for p, t in zip(rolled.poses[0], rolled.tips[0], strict=True)]
    assert max(sides) < 0.0, "the tool came out on the other side"
    assert rolled.poses[0, -1, 1] > 0.05


def test_an_object_is_not_pushed_into_an_obstacle_and_the_tool_stalls_behind_it():
    pushing = Pushing.on(task(box(0.42, 0.10, (0.4, 0.05, 0.1))), f_0=0.0)  # its face is at y = 0.075
    robot = pushing.scene.robot
    joints = joints_at(robot, BEHIND)
    rolled = pushing.roll(joints, T_POSE, straight(robot, joints, (0.0, 0.2, 0.0), 25)[None])
    # The bar's upper edge is 0.05 m above the friction centre; the step that would jam the object is not taken at all.
    step = DT * 0.2
    assert 0.025 - step - PENETRATION < rolled.poses[0, -1, 1] < 0.025 + PENETRATION
    assert pushing.gaps(rolled).min() > -CONTACT_ERROR
    assert rolled.term("contact")[0] > 0.0
    assert rolled.term("press")[0] > 0.0


def test_the_edge_of_the_table_stops_no_object_in_the_prediction():
    scene = task()
    pushing = Pushing.on(replace(scene, table=replace(scene.table, upper=(scene.table.upper[0], 0.08))))
    robot = pushing.scene.robot
    joints = joints_at(robot, BEHIND)
    rolled = pushing.roll(joints, T_POSE, straight(robot, joints, (0.0, 0.2, 0.0), 25)[None])
    assert rolled.poses[0, -1, 1] + 0.05 > 0.12, "it is pushed over the edge"
    assert rolled.term("contact")[0] == 0.0


def test_a_tool_above_the_object_does_not_push_it(open_table):
    robot = open_table.scene.robot
    joints = joints_at(robot, (0.42, -0.15, open_table.geometry.top + 0.01))
    rolled = open_table.roll(joints, T_POSE, straight(robot, joints, (0.0, 0.2, 0.0), 20)[None])
    assert rolled.tips[0, -1, 1] > 0.0, "the tool went over it"
    np.testing.assert_array_equal(rolled.poses[0], np.tile(T_POSE.astype(np.float32), (21, 1)))
    assert rolled.term("above")[0] >= 5 * open_table.config.cost.w_above


def test_a_tool_that_comes_down_on_the_object_stays_on_top(open_table):
    robot = open_table.scene.robot
    top = open_table.geometry.top
    joints = joints_at(robot, (0.42, -0.05, top + 0.03))
    rolled = open_table.roll(joints, T_POSE, straight(robot, joints, (0.0, 0.0, -0.1), 20)[None])
    assert top <= rolled.tips[0, -1, 2] < top + 0.01
    np.testing.assert_array_equal(rolled.poses[0, -1], T_POSE.astype(np.float32))


def test_a_tool_does_not_dive_into_the_table(open_table):
    robot = open_table.scene.robot
    joints = joints_at(robot, (0.35, 0.2, 0.03))
    down = straight(robot, joints, (0.0, 0.1, -0.1), 25)
    random = down + np.random.default_rng(3).normal(scale=0.2, size=(50, 25, robot.dof))
    rolled = open_table.roll(joints, T_POSE, np.concatenate([down[None], random]))
    assert rolled.tips[:, :, 2].min() >= -PENETRATION_TOLERANCE - 1e-6
    assert rolled.tips[0, -1, 2] < 0.006, "it went down as far as it may"


def test_a_tool_without_a_collider_does_not_dive_into_the_table_either():
    scene = task()
    bare = replace(scene.robot, links=tuple(replace(link, colliders=()) for link in scene.robot.links))
    pushing = Pushing.on(replace(scene, robot=bare))
    joints = joints_at(bare, (0.35, 0.2, 0.03))
    rolled = pushing.roll(joints, T_POSE, straight(bare, joints, (0.0, 0.1, -0.1), 25)[None])
    assert -PENETRATION_TOLERANCE - 1e-6 <= rolled.tips[0, -1, 2] < 0.006


def test_the_first_joint_stops_at_its_limit_and_its_speed(open_table):
    robot = open_table.scene.robot
    limit = robot.joints[0].upper
    joints = replace(robot, start=robot.start).start + (limit - 0.1 - robot.start[0]) * np.eye(robot.dof)[0]
    controls = np.zeros((1, 25, robot.dof))
    controls[0, :, 0] = 50.0
    rolled = open_table.roll(joints, T_POSE, controls)
    angles = np.unwrap(np.arctan2(rolled.tips[0, :, 1], rolled.tips[0, :, 0]))
    assert angles[1] - angles[0] == pytest.approx(DT * open_table.dynamics.bound[0], abs=ANGLE_TOLERANCE)
    assert angles[-1] - angles[0] == pytest.approx(0.1, abs=ANGLE_TOLERANCE)


@pytest.fixture(scope="module")
def shelves() -> Pushing:
    return Pushing.on(shipped("task03"))


def test_an_arm_is_held_back_at_a_shelf_by_its_links(shelves):
    # The box spans y from -0.075 to 0.175 at x = 0.3; the tool is thin, but wrist and forearm are below its top too.
    robot, world = shelves.scene.robot, shelves.twin()
    joints = joints_at(robot, (0.32, -0.20, 0.02))
    controls = straight(robot, joints, (0.0, 0.2, 0.0), 25)
    rolled = shelves.roll(joints, np.array([0.5, -0.4, 0.0]), controls[None])
    twin = reference.robot_rollout(
        world,
        joints,
        np.array([0.5, -0.4, 0.0]),
        np.array(shelves.scene.goal),
        np.tile(shelves.scene.goal, (len(shelves.dynamics.reference.host), 1)),
        controls,
    )
    assert min(world.arm_clearance(q) for q in twin.joints) > -PENETRATION_TOLERANCE - 1e-4
    np.testing.assert_allclose(rolled.tips[0], twin.tips, atol=3 * LENGTH_TOLERANCE)
    held_back = -0.075 - robot.tool_radius - rolled.tips[0, -1, 1]
    assert held_back > 0.005, "the tool alone would have reached the box"
    assert rolled.term("arm_clearance")[0] > 0.0


def test_an_arm_passes_over_a_low_obstacle(shelves):
    low = Pushing.on(task(box(0.3, 0.05, (0.2, 0.25, 0.05))))
    robot = low.scene.robot
    joints = joints_at(robot, (0.32, -0.20, 0.08))
    rolled = low.roll(joints, np.array([0.5, -0.4, 0.0]), straight(robot, joints, (0.0, 0.2, 0.0), 25)[None])
    assert rolled.tips[0, -1, 1] > 0.0


def test_an_arm_that_is_too_close_may_move_away(shelves):
    robot, world = shelves.scene.robot, shelves.twin()
    joints = joints_at(robot, (0.32, -0.07, 0.02))  # within the box
    assert world.arm_clearance(joints) < -PENETRATION_TOLERANCE
    away = straight(robot, joints, (0.0, -0.2, 0.0), 25)
    rolled = shelves.roll(joints, np.array([0.5, -0.4, 0.0]), np.array([away, -away]))
    assert rolled.tips[0, -1, 1] < -0.25
    assert rolled.tips[1, -1, 1] < -0.06, "but not further in"


def test_rollouts_of_zero_velocity_leave_everything_where_it_is():
    pushing = Pushing.on(shipped("task02"), Config())
    rolled = pushing.roll(pushing.scene.robot.start, np.array([0.3, -0.45, 0.1]), np.zeros((1, 25, 6)))
    assert_same(rolled.tips[0], np.tile(rolled.tips[0, 0], (26, 1)), cuda=1e-6)
    np.testing.assert_array_equal(rolled.poses[0], np.tile(rolled.poses[0, 0], (26, 1)))
