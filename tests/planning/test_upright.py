"""The arm with its tool upright: its fields, its servo on the plant, and engines that take joint velocities."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from support import reference
from support.device import DEVICE, run
from support.small_tasks import DT, block, box, joints_at, observe, rollout_task, shipped, task

from oimppi_warp.config.presets import best
from oimppi_warp.config.settings import Config, Mppi, RobotLevel, Safety
from oimppi_warp.errors import ConfigError
from oimppi_warp.geometry.fields import build_geometry, to_center
from oimppi_warp.geometry.kinematics import tip_frame, tip_jacobian
from oimppi_warp.geometry.reach import tip_rates
from oimppi_warp.kernels.upright_step import allowed_velocity
from oimppi_warp.observation import Observation
from oimppi_warp.planning.engines.packing import environment, object_model, velocity_bound
from oimppi_warp.planning.engines.quasistatic import QuasistaticDynamics
from oimppi_warp.planning.engines.tip_controls import TipControls
from oimppi_warp.planning.factory import make_planner
from oimppi_warp.planning.upright import ToolServo, UprightModel, build_upright
from oimppi_warp.plants.plant import ideal_plant
from oimppi_warp.scene import Scene

HEIGHT = Config().cost.height


def upright_model(scene: Scene, most_change: float = np.inf) -> UprightModel:
    geometry, level, cost = build_geometry(scene, DEVICE), RobotLevel(), best().cost
    limits = velocity_bound(scene, level)
    return build_upright(
        scene, geometry, environment(scene, geometry, cost), level, limits=limits, most_change=most_change,
        height=HEIGHT, device=DEVICE,
    )  # fmt: skip


class Follower:
    """The first control on its way to the arm: the servo follows the velocity that the tip is allowed."""

    def __init__(self, scene: Scene, period: float = DT) -> None:
        self.scene, self.period = scene, period
        self.geometry = build_geometry(scene, DEVICE)
        self.packed = upright_model(scene).packed
        self.model = object_model(self.geometry, tool_friction=scene.object.tool_friction)
        self.servo = ToolServo(scene.robot, limits=velocity_bound(scene, RobotLevel()), period=period)

    def allowed(
        self,
        tip: np.ndarray,
        pose: np.ndarray,
        velocity: np.ndarray,
        *,
        before: np.ndarray | None = None,
        repositioning: bool = False,
    ) -> np.ndarray:
        """The velocity of the tip that is left of the wanted one, given that before, shape [3] [m/s]."""
        vectors = [np.array([tip, pose, velocity if before is None else before]), np.array([velocity])]
        start, command = (wp.array(each.astype(np.float32), dtype=wp.vec3, device=DEVICE) for each in vectors)
        waypoint = wp.array(np.array([[0.0, 0.0, 0.0, repositioning]], np.float32), dtype=wp.vec4, device=DEVICE)
        out = wp.zeros(1, dtype=wp.vec3, device=DEVICE)
        rates = wp.zeros(0, dtype=wp.vec3, device=DEVICE)  # no limit of the acceleration
        inputs = [self.packed, self.model, self.scene.robot.tool_radius, start, rates, 0.0, waypoint, command]
        inputs += [self.period, 8]
        wp.launch(allowed_velocity, 1, inputs=inputs, outputs=[out], device=DEVICE)
        return out.numpy()[0].astype(float)

    def joint_velocity(
        self, joints: np.ndarray, pose: np.ndarray, velocity: np.ndarray, *, repositioning: bool = False
    ) -> np.ndarray:
        tip = tip_frame(self.scene.robot, joints)[1]
        return self.servo.joint_velocity(
            self.servo.rates(joints), self.allowed(tip, pose, velocity, repositioning=repositioning)
        )


def test_the_clearance_is_that_of_the_arm_which_is_negative_out_of_reach():
    scene = task(box(0.45, 0.1, (0.1, 0.1, 0.2)))
    model = upright_model(scene)
    geometry = build_geometry(scene, DEVICE)
    twin = reference.World(
        robot=scene.robot,
        speed=np.ones(6),
        body=None,  # pyright: ignore[reportArgumentType]
        obstacles=geometry.space,
        top=geometry.space_top,
        weights=best().cost,
        dt=DT,
        contact_steps=1,
    )
    for tip in [(0.36, -0.1, 0.02), (0.38, 0.04, 0.02), (0.3, 0.3, 0.06), (0.45, 0.1, 0.04), (0.5, -0.2, 0.1)]:
        joints = joints_at(scene.robot, tip)
        found = reference.space_field(model.packed.clearance, np.array(tip))
        expected = twin.arm_clearance(joints, table=-9.0)  # the servo keeps the tip off the table
        # Beyond 5 cm the kernel's clearance is a lower bound.
        assert found == pytest.approx(expected, abs=2e-3) or 0.05 <= found <= expected + 2e-3
    assert reference.space_field(model.packed.clearance, np.array([0.72, 0.0, 0.02])) < 0.0


def test_the_clearance_at_the_height_of_pushing_is_looked_up_for_many_places_at_once():
    model = upright_model(task(box(0.45, 0.1, (0.1, 0.1, 0.2))))
    places = np.random.default_rng(2).uniform(-0.9, 0.9, size=(300, 2))
    expected = [reference.space_field(model.packed.clearance, np.append(place, HEIGHT)) for place in places]
    np.testing.assert_allclose(model.clearance_at(places), expected, atol=1e-4)
    close, far, ahead = model.clearance_at(np.array([[0.15, 0.0], [2.0, 0.0], [0.3, -0.2]]))
    assert close < 0.0 and far < 0.0 < ahead, "neither behind the arm's base nor out of its reach"


def test_the_servo_holds_the_tool_upright_and_at_its_height_on_the_plant():
    scene = replace(shipped("task01"), start=(0.5, 0.45, 0.0))
    plant, follow = ideal_plant(scene, Config()), Follower(scene)
    pose = np.array(scene.start)
    plant.place(joints_at(scene.robot, (0.35, -0.25, 0.05)), observe(scene).object_transform)
    heights, tilts, tips = [], [], []
    for step in range(80):
        direction = 2.0 * np.pi * step / 80
        seen = plant.observe()
        velocity = 0.2 * np.array([np.cos(direction), np.sin(direction), 0.0])
        plant.apply(follow.joint_velocity(seen.joint_position, pose, velocity))
        rotation, tip = tip_frame(scene.robot, plant.observe().joint_position)
        heights.append(tip[2])
        tilts.append(np.arccos(np.clip(-rotation[2, 2], -1.0, 1.0)))
        tips.append(tip)
    assert np.abs(np.array(heights[20:]) - HEIGHT).max() < 1e-3
    assert max(tilts) < 0.02
    speeds = np.linalg.norm(np.diff(tips, axis=0)[20:, :2], axis=1) / DT
    np.testing.assert_allclose(speeds, 0.2, rtol=0.05)


def wall(*, gap: float) -> tuple[Scene, Follower]:
    """A block in front of a wall along y, at a gap [m]; its pose is (0.42, 0, 0)."""
    scene = task(box(0.48 + gap, 0.0, (0.02, 0.4, 0.1)), pushed=block((0.10, 0.06, 0.05)))
    return scene, Follower(scene)


@pytest.mark.parametrize("gap", [0.001, 0.004, 0.02])
@pytest.mark.parametrize("speed", [0.1, 0.3])
def test_a_push_at_a_wall_ends_before_the_object_touches_it(gap: float, speed: float):
    scene, follow = wall(gap=gap)
    pose, tip = np.array([0.42, 0.0, 0.0]), np.array([0.361, 0.0, HEIGHT])
    for _ in range(40):
        velocity = follow.allowed(tip, pose, np.array([speed, 0.0, 0.0]))
        tip = tip + DT * velocity
        pose[0] = max(pose[0], tip[0] + scene.robot.tool_radius + 0.05)  # what the block does in front of the tool
    clearance = follow.geometry.clearance_at(pose)
    assert clearance > min(gap, 0.002) - 1.5e-3
    assert clearance < gap + 1e-4 if gap < 0.002 else clearance < 0.006, "the wall is not kept further off than said"


def test_a_push_along_a_wall_goes_on():
    _, follow = wall(gap=0.001)
    pose, tip = np.array([0.42, 0.0, 0.0]), np.array([0.42, -0.0385, HEIGHT])
    velocity = follow.allowed(tip, pose, np.array([0.0, 0.2, 0.0]))
    np.testing.assert_allclose(velocity[:2], [0.0, RobotLevel().touch_speed], atol=0.01)


@pytest.mark.parametrize("gap", [0.002, 0.01, 0.03, 0.06])
def test_an_object_beside_an_obstacle_is_pushed_slowly(gap: float):
    _, follow = wall(gap=gap)
    pose, tip = np.array([0.42, 0.0, 0.0]), np.array([0.42, -0.0385, HEIGHT])
    level = RobotLevel()
    fastest = level.touch_speed + 8.0 * (gap - level.object_margin)
    velocity = follow.allowed(tip, pose, np.array([0.0, 0.3, 0.0]))
    assert velocity[1] == pytest.approx(min(0.3, fastest), abs=0.03)
    away = follow.allowed(tip, pose, np.array([0.0, -0.3, 0.0]))
    assert away[1] == pytest.approx(-0.3, abs=1e-3), "the tool leaves it as fast as it likes"


@pytest.mark.parametrize("along", [-0.15, 0.15])
def test_a_tool_slides_along_an_object_that_cannot_yield(along: float):
    """A tool that may not press a block onto a wall can still move along the face of the block."""
    scene, follow = wall(gap=0.0)
    pose = np.array([0.42, 0.0, 0.0])
    tip = np.array([pose[0] - 0.05 - scene.robot.tool_radius, 0.0, HEIGHT])
    velocity = follow.allowed(tip, pose, np.array([0.1, along, 0.0]))
    assert velocity[0] < 5e-3
    assert velocity[1] / along > 0.3


def test_the_arm_does_not_go_through_its_stretched_posture():
    """A stretched arm could fold its elbow to the other side, where the clearance field is wrong."""
    scene = replace(shipped("task01"), start=(0.2, -0.5, 0.0))
    follow, joints = Follower(scene), joints_at(shipped("task01").robot, (0.52, 0.26, HEIGHT))
    before, outward = joints.copy(), np.array([0.3, 0.15, 0.0])
    for step in range(240):
        wanted = outward if step < 120 else -outward
        velocity = follow.joint_velocity(joints, np.array(scene.start), wanted)
        joints = joints + DT * velocity
        if step == 119:
            singular = np.linalg.svd(tip_jacobian(scene.robot, joints)[:2], compute_uv=False)[-1]
            assert np.hypot(*tip_frame(scene.robot, joints)[1][:2]) > 0.66, "it reaches far"
            assert singular > 0.05
        if step > 120 and np.hypot(*tip_frame(scene.robot, joints)[1][:2]) < 0.581:
            break
    np.testing.assert_allclose(joints, before, atol=0.15)


def test_a_tool_that_presses_an_object_on_a_wall_is_taken_back():
    scene, follow = wall(gap=0.001)
    pose = np.array([0.4215, 0.0, 0.0])  # half a millimetre in the wall
    tip = np.array([pose[0] - 0.05 - scene.robot.tool_radius + 5e-4, 0.0, HEIGHT])
    assert follow.allowed(tip, pose, np.array([0.2, 0.0, 0.0]))[0] < 1e-3
    assert follow.allowed(tip, pose, np.array([-0.2, 0.0, 0.0]))[0] == pytest.approx(-0.2, abs=0.02)


@pytest.mark.parametrize("height", [0.025, 0.04])
def test_a_tip_that_is_too_high_comes_down_before_it_touches_the_object(height: float):
    scene = task(pushed=block((0.10, 0.06, 0.05)))
    follow = Follower(scene)
    pose, tip = np.array([0.42, 0.0, 0.0]), np.array([0.335, 0.0, height])
    touched_at = None
    for _ in range(30):
        tip = tip + DT * follow.allowed(tip, pose, np.array([0.3, 0.0, 0.0]))
        if touched_at is None and tip[0] + scene.robot.tool_radius > 0.37 - 1e-4:
            touched_at = tip[2]
    assert touched_at is not None, "it pushes in the end"
    assert touched_at <= HEIGHT + 0.008 + 1e-4


@pytest.mark.parametrize("speed", [0.05, 0.15, 0.3])
def test_the_tool_touches_the_object_slowly_and_pushes_it_fast(speed: float):
    scene = task(pushed=block((0.10, 0.06, 0.05)))
    follow = Follower(scene)
    pose, tip = np.array([0.42, 0.0, 0.0]), np.array([0.30, 0.0, HEIGHT])
    at_touch, speeds, velocity = None, [], np.zeros(3)
    while pose[0] < 0.50:
        velocity = follow.allowed(tip, pose, np.array([speed, 0.0, 0.0]), before=velocity)
        tip = tip + DT * velocity
        speeds.append(velocity[0])
        ahead = tip[0] + scene.robot.tool_radius + 0.05
        if ahead > pose[0]:
            pose[0] = ahead  # what the block does in front of the tool
            at_touch = velocity[0] if at_touch is None else at_touch
    assert at_touch is not None
    assert at_touch <= RobotLevel().touch_speed + 0.01
    assert max(speeds) == pytest.approx(speed, abs=1e-3)
    assert speeds[-1] == pytest.approx(speed, abs=1e-3), "once it touches, it pushes as fast as it is told"
    touched = speeds.index(at_touch)
    assert np.diff(speeds[touched:]).max() < 0.031, "after it has become faster little by little"
    # Past the object it is as fast as ever.
    beside = np.array([0.42, 0.0385, HEIGHT])
    assert follow.allowed(beside, np.array([0.42, 0.0, 0.0]), np.array([speed, 0.0, 0.0]))[0] > 0.9 * speed


def test_the_tip_changes_its_velocity_as_fast_as_the_joints_may():
    """The velocity that the tip is allowed is on the straight way from that before to the wanted one."""
    scene = replace(task(), start=(0.4, -0.45, 0.0))
    servo = ToolServo(scene.robot, limits=velocity_bound(scene, RobotLevel()), period=DT)
    joints = joints_at(scene.robot, (0.45, 0.1, HEIGHT))
    rates = servo.rates(joints).follow
    linear = tip_jacobian(scene.robot, joints)[:3]
    np.testing.assert_allclose(linear @ rates, np.eye(3), atol=1e-3)
    model, packed = object_model(build_geometry(scene, DEVICE), tool_friction=0.2), upright_model(scene).packed
    tip = tip_frame(scene.robot, joints)[1]
    before, wanted = np.array([0.25, 0.0, 0.0]), np.array([-0.2, 0.2, 0.0])

    def allowed(most: float) -> np.ndarray:
        start = wp.array(np.array([tip, scene.start, before], np.float32), dtype=wp.vec3, device=DEVICE)
        columns = wp.array(rates.astype(np.float32), dtype=wp.vec3, device=DEVICE)
        waypoint = wp.zeros(1, dtype=wp.vec4, device=DEVICE)
        command = wp.array(wanted[None].astype(np.float32), dtype=wp.vec3, device=DEVICE)
        out = wp.zeros(1, dtype=wp.vec3, device=DEVICE)
        inputs = [packed, model, scene.robot.tool_radius, start, columns, most, waypoint, command, DT, 8]
        wp.launch(allowed_velocity, 1, inputs=inputs, outputs=[out], device=DEVICE)
        return out.numpy()[0].astype(float)

    np.testing.assert_allclose(allowed(np.inf), wanted, atol=1e-5)
    most = Safety().most_change(DT)
    changed = rates[:, :2] @ (allowed(most) - before)[:2]
    assert np.abs(changed).max() == pytest.approx(most, rel=1e-3)
    way = rates[:, :2] @ (wanted - before)[:2]
    np.testing.assert_allclose(changed / most, way / np.abs(way).max(), atol=1e-3)


def test_an_object_is_not_pushed_off_the_table():
    scene = task(pushed=block((0.10, 0.06, 0.05)))
    edge = replace(scene, table=replace(scene.table, upper=(0.55, 0.8)))
    follow = Follower(edge)
    pose, tip = np.array([0.42, 0.0, 0.0]), np.array([0.361, 0.0, HEIGHT])
    for _ in range(40):
        tip = tip + DT * follow.allowed(tip, pose, np.array([0.3, 0.0, 0.0]))
        pose[0] = max(pose[0], tip[0] + scene.robot.tool_radius + 0.05)
    assert 0.0 < 0.55 - (pose[0] + 0.05) < 0.006


def test_the_arm_slides_along_an_obstacle_and_keeps_its_margin():
    scene = replace(task(box(0.5, 0.0, (0.1, 0.3, 0.2))), start=(0.4, -0.45, 0.0))
    follow = Follower(scene)
    pose, tip = np.array([0.4, -0.45, 0.0]), np.array([0.38, -0.05, HEIGHT])
    for _ in range(20):
        tip = tip + DT * follow.allowed(tip, pose, np.array([0.3, 0.1, 0.0]))
    kept = reference.space_field(follow.packed.clearance, tip)
    assert RobotLevel().arm_margin - 5e-4 < kept < RobotLevel().arm_margin + 2e-3
    assert tip[1] > 0.0, "it slides on"


def test_a_tip_above_the_object_is_not_lowered_and_one_beside_it_is():
    scene = shipped("task01")
    top = build_geometry(scene, DEVICE).top
    for place, sinks in (((0.42, -0.2), False), ((0.42, 0.15), True)):
        joints = joints_at(scene.robot, (*place, top + 0.02))
        pose = np.array([0.42, -0.2, 0.3])
        rates = Follower(scene).joint_velocity(joints, pose, np.zeros(3))
        fell = tip_frame(scene.robot, joints + DT * rates)[1][2] < top + 0.02 - 1e-3
        assert fell == sinks


def test_the_tool_is_not_lowered_onto_the_object_faster_than_it_can_stop():
    """A tip that comes down while it moves over the object's edge stops above its top."""
    scene = task(pushed=block((0.10, 0.06, 0.05)))
    follow = Follower(scene)
    pose, top = np.array([0.42, 0.0, 0.0]), follow.geometry.top
    tip, speeds = np.array([0.42, 0.0, top + 0.06]), []
    for _ in range(40):
        velocity = follow.allowed(tip, pose, np.array([0.0, 0.0, -0.3]), repositioning=True)
        tip = tip + DT * velocity
        speeds.append(-velocity[2])
    assert top < tip[2] < top + 0.006
    assert speeds[0] > 0.15, "it comes down fast"
    braked = -np.diff(speeds)
    slower = 0.5 * follow.packed.agility * reference.space_field(follow.packed.speed, tip)
    assert braked.max() < 1.6 * slower, "and brakes as the arm can"
    beside = np.array([0.42, 0.03 + scene.robot.tool_radius + 0.011, top + 0.02])
    assert follow.allowed(beside, pose, np.array([0.0, 0.0, -0.3]), repositioning=True)[2] == pytest.approx(
        -0.3, abs=1e-3
    )
    for height in (0.005, 0.02):
        near = np.array([0.42, 0.03 + scene.robot.tool_radius + 0.004, top + height])
        moved = near + DT * follow.allowed(near, pose, np.array([0.0, -0.2, 0.0]), repositioning=True)
        over = moved[1] < 0.03 + scene.robot.tool_radius
        assert over == (height > 0.01), "a tip that may come down further keeps off the side"


def test_the_servo_keeps_the_direction_where_a_joint_is_at_its_limit():
    scene = shipped("task01")
    joints = joints_at(scene.robot, (0.6, 0.1, HEIGHT))
    wanted = np.array([2.0, -1.0, 0.0])
    limits = velocity_bound(scene, RobotLevel())
    servo = ToolServo(scene.robot, limits=limits, period=DT)
    rates = servo.joint_velocity(servo.rates(joints), wanted)
    assert np.abs(rates).max() <= RobotLevel().joint_velocity_limit + 1e-9
    moved = tip_frame(scene.robot, joints + 1e-3 * rates)[1] - tip_frame(scene.robot, joints)[1]
    np.testing.assert_allclose(moved[1] / moved[0], wanted[1] / wanted[0], rtol=0.02)


@pytest.mark.parametrize("repositioning", [False, True])
def test_a_tip_that_is_led_into_the_table_and_towards_the_base_does_not_sink(repositioning: bool):
    scene = replace(shipped("task01"), start=(0.5, 0.45, 0.0))
    plant, follow = ideal_plant(scene, Config()), Follower(scene)
    plant.place(joints_at(scene.robot, (0.35, -0.05, 0.06)), observe(scene).object_transform)
    for _ in range(40):
        seen = plant.observe()
        down = np.array([-0.25, 0.0, -0.3])
        plant.apply(
            follow.joint_velocity(seen.joint_position, np.array(scene.start), down, repositioning=repositioning)
        )
        rotation, tip = tip_frame(scene.robot, plant.observe().joint_position)
        assert np.arccos(np.clip(-rotation[2, 2], -1.0, 1.0)) < 0.05
        assert tip[2] > HEIGHT - 2e-3
    assert tip[2] < HEIGHT + 0.02, "near the base the arm does not come down all the way"


def test_an_engine_with_joint_velocities_predicts_what_one_with_tip_velocities_does():
    scene = shipped("task01")
    level = RobotLevel(optimizer=Mppi(samples=40, horizon=20))
    pose = np.array([0.42, -0.20, 0.3])
    joints = joints_at(scene.robot, (0.40, -0.33, HEIGHT))
    seen = observe(scene, joints=joints, pose=pose)
    rng = np.random.default_rng(2)
    noise = np.array([0.03, 0.15, 0.0]) + rng.normal(scale=0.05, size=(40, 1, 3))
    controls = np.repeat(noise, 20, axis=1).astype(np.float32)
    outcomes = []
    for direct in (True, False):
        made = rollout_task(scene, level=level, upright=True)
        engine = QuasistaticDynamics(made) if direct else JointEngine(made)
        rollouts = engine if direct else TipControls(engine)
        rollouts.set_state(seen, np.array(scene.goal))
        engine.reference.host[:] = np.array([0.45, 0.1, 0.6])
        packed = wp.array(controls, dtype=wp.vec3, device=DEVICE)
        costs = wp.zeros(40, dtype=float, device=DEVICE)
        run(engine.compute, rollouts.rollout(packed, costs))
        tips = rollouts.paths(packed, np.arange(40))[0]
        outcomes.append((costs.numpy(), tips))
    direct, converted = outcomes
    np.testing.assert_allclose(converted[1], direct[1], atol=2e-3)
    assert np.corrcoef(direct[0], converted[0])[0, 1] > 0.98


class JointEngine(QuasistaticDynamics):
    """The quasi-static engine, asked for joint velocities."""

    takes_tip_velocities = False


def test_an_arm_that_cannot_hold_its_tool_upright_is_told_what_to_do():
    scene = shipped("task01")
    stiff = tuple(replace(joint, lower=-0.01, upper=0.01) for joint in scene.robot.joints)
    robot = replace(scene.robot, joints=stiff, start=np.zeros(6))
    with pytest.raises(ConfigError, match=r"robot\.controls = tool: .*\n.*--set robot\.controls=joint"):
        upright_model(replace(scene, robot=robot))


@pytest.mark.parametrize("controls", ["tool", "joint"])
def test_a_plan_of_either_kind_of_controls_gives_joint_velocities_within_the_limit(controls: str):
    scene = shipped("task02")
    base = best("cloi")
    level = replace(base.robot, controls=controls, optimizer=replace(base.robot.optimizer, samples=128))
    planner = make_planner(scene, replace(base, robot=level), device=DEVICE)
    seen: Observation = observe(scene)
    planner.start(seen)
    for _ in range(3):
        plan = planner.plan(seen)
        assert plan.command.shape == (6,)
        assert 0.0 < np.abs(plan.command).max() <= level.joint_velocity_limit + 1e-6
    samples = planner.samples(8)
    np.testing.assert_allclose(
        samples.tips[:, 0], np.tile(tip_frame(scene.robot, seen.joint_position)[1], (8, 1)), atol=1e-5
    )
    center = to_center(planner.geometry.surface, seen.object_pose)
    np.testing.assert_allclose(to_center(planner.geometry.surface, plan.object_poses[0]), center, atol=1e-5)


def test_a_robot_that_cannot_lift_its_tool_samples_no_vertical_velocity():
    point = make_planner(shipped("point01"), best("mppi"), method="mppi", device=DEVICE)
    np.testing.assert_array_equal(np.diag(point._noise(point.scene.robot.start, repositioning=True))[2], 0.0)


@pytest.mark.parametrize("period", [0.05, 0.5, 1.0])
def test_a_tip_that_is_being_lifted_stays_above_its_height_with_any_control_period(period: float):
    scene = shipped("task01")
    follow = Follower(scene, period)
    joints = joints_at(scene.robot, (0.42, 0.15, 0.1))
    rates = follow.joint_velocity(joints, np.array(scene.start), np.array([0.0, 0.0, -0.3]), repositioning=True)
    linear = tip_rates(scene.robot, joints)[0]
    assert 0.1 + period * (linear @ rates)[2] > HEIGHT - 1e-3


def test_a_thick_tool_is_lowered_far_from_the_object():
    """The object's distance field ends nearby; beyond, it must not look as if the tool were over the object."""
    scene = shipped("task01")
    scene = replace(scene, robot=replace(scene.robot, tool_radius=0.01))
    top = build_geometry(scene, DEVICE).top
    for place in ((0.35, 0.2), (0.5, 0.1), (0.3, -0.1)):
        joints = joints_at(scene.robot, (*place, top + 0.02))
        rates = Follower(scene).joint_velocity(joints, np.array([0.42, -0.4, 0.3]), np.zeros(3))
        assert tip_frame(scene.robot, joints + DT * rates)[1][2] < top + 0.02 - 1e-3
