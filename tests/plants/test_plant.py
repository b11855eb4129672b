"""The simulated plant is sound: what slides, turns, stops and weighs does so as mechanics says.

Settings that fail here are listed in docs/design.md; check these tests before any tuning.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np
import pytest

from oimppi_warp.geometry.footprint import GRAVITY
from oimppi_warp.geometry.kinematics import tip_frame, tip_jacobian
from oimppi_warp.physics.newton_model import ROLES
from oimppi_warp.physics.world import World
from oimppi_warp.plants.plant import SimulatedPlant
from oimppi_warp.scene import PlanarPose
from oimppi_warp.usd import load_scene

STILL = np.zeros(6)

OBJECTS = ("task01", "task05", "lab01")
"""Scenes with boxes, convex meshes and a cylinder to push."""

PUSH_HEIGHT = 0.012
"""Height of the tip above the table while it pushes [m]."""

BAR_FACE = 0.025
"""Far face of the T's bar, in its frame [m]."""


@pytest.fixture(scope="module")
def open_table() -> World:
    return World(load_scene("task01"))


@pytest.fixture(scope="module")
def with_cube() -> World:
    return World(load_scene("task02"))


def settled(world: World, start: PlanarPose, substeps: int = 20) -> SimulatedPlant:
    """A plant whose object has come to rest."""
    plant = SimulatedPlant(world, start=start, substeps=substeps)
    for _ in range(10):
        plant.apply(STILL)
    return plant


def set_object_velocity(world: World, plant: SimulatedPlant, vx: float, vy: float, yaw_rate: float) -> None:
    """Give the object a velocity [m/s, rad/s]."""
    plant.data.qvel[world.mujoco.object_qvel] = (vx, vy, 0.0, 0.0, 0.0, yaw_rate)


def kinetic_energy(world: World, plant: SimulatedPlant) -> float:
    """Kinetic energy of everything [J]."""
    momentum = np.zeros(plant.model.nv)
    mujoco.mj_mulM(plant.model, plant.data, momentum, plant.data.qvel)
    return 0.5 * float(momentum @ plant.data.qvel)


def tilt(plant: SimulatedPlant) -> float:
    """Angle between the object's z axis and the vertical [rad]."""
    qx, qy = plant.observe().object_transform[3:5]
    return 2 * math.asin(min(1.0, math.hypot(qx, qy)))


@dataclass
class Hand:
    """Moves the tool, kept vertical, by the damped inverse of its Jacobian."""

    world: World
    plant: SimulatedPlant

    def tip(self) -> np.ndarray:
        """Position of the tip [m]."""
        return tip_frame(self.world.scene.robot, self.plant.observe().joint_position)[1]

    def move(self, vx: float, vy: float, height: float) -> None:
        """One control step with a velocity of the tip [m/s], on the way to a height [m]."""
        joints = self.plant.observe().joint_position
        rotation, tip = tip_frame(self.world.scene.robot, joints)
        upright = 4.0 * np.cross(rotation[:, 2], (0.0, 0.0, -1.0))
        twist = np.array([vx, vy, np.clip(5.0 * (height - tip[2]), -0.2, 0.2), *upright])
        jacobian = tip_jacobian(self.world.scene.robot, joints)
        command = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-4 * np.eye(6), twist)
        self.plant.apply(np.clip(command, -1.0, 1.0))

    def go_to(self, x: float, y: float, height: float) -> None:
        """Move the tip in a straight line at 0.2 m/s at most."""
        for _ in range(400):
            tip = self.tip()
            way = np.array([x, y]) - tip[:2]
            distance = float(np.linalg.norm(way))
            if distance < 0.002 and abs(height - tip[2]) < 0.003:
                return
            self.move(*(way * min(4.0, 0.2 / max(distance, 1e-9))), height)
        pytest.fail(f"the tip does not reach ({x:.3f}, {y:.3f}, {height:.3f})")

    def come_down_at(self, x: float, y: float) -> None:
        """Go there above everything, then down to push."""
        self.go_to(*self.tip()[:2], 0.12)
        self.go_to(x, y, 0.12)
        self.go_to(x, y, PUSH_HEIGHT)


def test_arm_stands_still_without_command(open_table):
    plant = SimulatedPlant(open_table)
    for _ in range(40):
        plant.apply(STILL)
    np.testing.assert_allclose(plant.observe().joint_position, open_table.scene.robot.start, atol=1e-4)


@pytest.mark.parametrize("name", OBJECTS)
def test_object_lies_on_the_table_with_its_weight(name):
    world = World(load_scene(name))
    plant = settled(world, (0.45, 0.0, 0.3))
    assert plant.contacts.object_table == pytest.approx(world.scene.object.mass * GRAVITY, rel=0.01)
    assert plant.contacts.tool_object == plant.contacts.object_obstacle == plant.contacts.robot_obstacle == 0.0
    np.testing.assert_allclose(plant.observe().object_pose, (0.45, 0.0, 0.3), atol=1e-4)
    assert plant.observe().object_transform[2] == pytest.approx(world.scene.object.rest_height, abs=5e-4)


@pytest.mark.parametrize("name", OBJECTS)
@pytest.mark.parametrize("yaw_rate", [0.0, 5.0])
def test_sliding_object_gains_no_energy_and_stays_flat(name, yaw_rate):
    world = World(load_scene(name))
    plant = settled(world, (0.4, -0.1, 0.0))
    set_object_velocity(world, plant, 0.5, 0.0, yaw_rate)
    energy = start = kinetic_energy(world, plant)
    for step in range(800):
        mujoco.mj_step(plant.model, plant.data)
        assert kinetic_energy(world, plant) < start
        assert tilt(plant) < 0.02
        if step % 20 == 19:
            before, energy = energy, kinetic_energy(world, plant)
            assert energy < max(before, 1e-5 * start)  # rocking on a corner by micrometres
    assert energy < 1e-5 * start


def test_sliding_object_stops_where_friction_stops_it(open_table):
    plant = settled(open_table, (0.4, -0.1, 0.0))
    set_object_velocity(open_table, plant, 0.5, 0.0, 0.0)
    for _ in range(20):
        plant.apply(STILL)
    expected = 0.5**2 / (2 * open_table.scene.object.friction * GRAVITY)  # v^2 / (2 mu g)
    travel = plant.observe().object_pose - (0.4, -0.1, 0.0)
    assert travel[0] == pytest.approx(expected, rel=0.03)
    np.testing.assert_allclose(travel[1:], 0.0, atol=5e-3)


def test_torque_turns_the_object_when_the_friction_at_its_corners_gives_way(open_table):
    # The T stands on the corners of its two boxes; in MuJoCo the load moves outward as it starts to turn.
    corners = np.array([(0.1, 0.025), (0.1, -0.025), (0.025, -0.025), (0.025, -0.125)])
    arms = np.linalg.norm(corners - open_table.scene.object.center_of_mass[:2], axis=1)
    assert arms.mean() < break_away_radius(open_table) < arms.max()


@pytest.mark.parametrize("offset", [-0.08, -0.05, -0.02, 0.02, 0.05, 0.08])
def test_off_centre_push_turns_the_object_as_the_limit_surface_says(open_table, offset):
    plant, tips = pushed_bar(open_table, offset)
    turned = plant.observe().object_pose[2]
    # Eight corners make no ellipsoid: small turns meet less torque than pure rotation does.
    least, most = sorted(quasistatic_turn(open_table, tips, radius) for radius in (0.060, 0.085))
    assert least - 0.01 < turned < most + 0.01


def test_pushes_left_and_right_of_the_centre_mirror_each_other(open_table):
    left, right = (pushed_bar(open_table, offset)[0].observe().object_pose for offset in (-0.05, 0.05))
    assert left[2] == pytest.approx(-right[2], rel=0.02)


@pytest.mark.parametrize("substeps", [10, 40])
def test_travel_does_not_depend_on_the_length_of_a_substep(open_table, substeps):
    start = np.array((0.45, 0.0, 0.0))
    usual, other = (
        pushed_bar(open_table, 0.05, speed=0.15, substeps=count)[0].observe().object_pose - start
        for count in (20, substeps)
    )
    assert np.linalg.norm(other[:2]) == pytest.approx(np.linalg.norm(usual[:2]), rel=0.05)
    assert other[2] == pytest.approx(usual[2], rel=0.05)


def pushed_bar(
    world: World, offset: float, *, speed: float = 0.05, substeps: int = 20
) -> tuple[SimulatedPlant, np.ndarray]:
    """The T pushed for 6 cm of the tool's way, towards -y, on the far face of its bar.

    Args:
        world: The open table.
        offset: Of the tool from the bar's centre [m].
        speed: Of the tool [m/s].
        substeps: Of the plant.

    Returns:
        The plant, and where the tip was before each control step and after the last, shape [step, 2].
    """
    plant = SimulatedPlant(world, start=(0.45, 0.0, 0.0), substeps=substeps)
    hand = Hand(world, plant)
    hand.come_down_at(0.45 + offset, BAR_FACE + world.scene.robot.tool_radius + 0.004)
    tips = [hand.tip()[:2]]
    for _ in range(round(0.06 / (speed * plant.control_period))):
        hand.move(0.0, -speed, PUSH_HEIGHT)
        tips.append(hand.tip()[:2])
    return plant, np.array(tips)


def quasistatic_turn(world: World, tips: np.ndarray, radius: float) -> float:
    """How far :func:`pushed_bar` turns the T by an ellipsoidal limit surface of that radius.

    The face yields along its normal by as much as the disc presses. The push ``f`` at ``c`` (from the centre of mass)
    and the motion there obey ``motion = (I + l l^T / radius^2) f`` with ``l = (-c_y, c_x)``, and ``f`` stays within the
    friction cone.
    """
    mu, center = world.scene.object.tool_friction, world.scene.object.center_of_mass[:2]
    position, yaw = np.array((0.45, 0.0)), 0.0
    steps = np.arange(0.0, len(tips) - 1, 0.05)
    fine = np.stack([np.interp(steps, np.arange(len(tips)), axis) for axis in tips.T], axis=1)
    for tip, after in pairwise(fine):
        where, way = rotation(yaw).T @ (tip - position), rotation(yaw).T @ (after - tip)
        pressed = BAR_FACE + world.scene.robot.tool_radius - where[1] - way[1]
        if pressed <= 0:
            continue
        lever = np.array([center[1] - BAR_FACE, where[0] - center[0]])
        compliance = np.eye(2) + np.outer(lever, lever) / radius**2
        push = np.linalg.solve(compliance, (way[0], -pressed))
        if abs(push[0]) > -mu * push[1]:
            edge = np.array([math.copysign(mu, push[0]), -1.0])
            push = edge * pressed / -(compliance @ edge)[1]
        position = position + rotation(yaw) @ (center + push)
        yaw += lever @ push / radius**2
        position = position - rotation(yaw) @ center
    return yaw


def rotation(angle: float) -> np.ndarray:
    """Planar rotation matrix."""
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


def break_away_radius(world: World) -> float:
    """Torque at which the object begins to turn, over mu m g [m]."""
    plant = settled(world, (0.4, -0.1, 0.0))
    torque, step = 0.0, plant.model.opt.timestep
    while abs(plant.data.qvel[world.mujoco.object_qvel[5]]) < 0.3:
        torque += 0.1 * step
        plant.data.xfrc_applied[world.mujoco.object_body, 5] = torque
        mujoco.mj_step(plant.model, plant.data)
    return torque / (world.scene.object.friction * world.scene.object.mass * GRAVITY)


def test_object_stops_at_the_wall(with_cube):
    (cube,) = (obstacle.colliders[0] for obstacle in with_cube.scene.obstacles)
    face = cube.transform[1] - cube.size[1]
    start = face - 0.125 - 0.03  # the stem's end points at the wall, 3 cm before it
    plant = settled(with_cube, (cube.transform[0], start, math.pi))
    mass, friction = with_cube.scene.object.mass, with_cube.scene.object.friction
    extra = 2.0
    plant.data.xfrc_applied[with_cube.mujoco.object_body, 1] = friction * mass * GRAVITY + extra
    for _ in range(40):
        plant.apply(STILL)
    assert plant.observe().object_pose[1] + 0.125 == pytest.approx(face, abs=1e-3)
    # At rest, the wall bears what the table's friction does not; friction may lean either way.
    assert extra - 0.1 < plant.contacts.object_obstacle < extra + 2 * friction * mass * GRAVITY
    assert not plant.tipped


def test_contact_forces_are_the_largest_of_all_physics_steps(with_cube):
    (cube,) = (obstacle.colliders[0] for obstacle in with_cube.scene.obstacles)
    missed = []
    for gap in (0.001, 0.0015, 0.002, 0.0025):
        start = (cube.transform[0], cube.transform[1] - cube.size[1] - 0.125 - gap, math.pi)
        plant, stepped = settled(with_cube, start), settled(with_cube, start)
        for each in (plant, stepped):
            each.data.qvel[with_cube.mujoco.object_qvel[1]] = 0.3
        plant.apply(STILL)
        roles, data, forces = with_cube.mujoco.roles, stepped.data, []
        for _ in range(20):
            mujoco.mj_step(stepped.model, data)
            pairs = [{ROLES[role] for role in roles[geoms]} for geoms in data.contact.geom]
            at_wall = [pair == {"object", "obstacle"} for pair in pairs]
            forces.append(float(data.efc_force[data.contact.efc_address[at_wall]].sum()))
        assert plant.contacts.object_obstacle == pytest.approx(max(forces))
        missed.append(max(forces) / max(forces[4::5]))
    assert max(missed) > 1.2, "the peak of a bump is missed if only every fifth step is read"


def test_object_caught_between_tool_and_wall_stays_out_of_both(with_cube):
    (cube,) = (obstacle.colliders[0] for obstacle in with_cube.scene.obstacles)
    face = cube.transform[1] - cube.size[1]
    plant = SimulatedPlant(with_cube, start=(cube.transform[0], face - 0.125 - 0.01, math.pi))
    hand = Hand(with_cube, plant)
    hand.come_down_at(cube.transform[0], face - 0.125 - 0.01 - BAR_FACE - 0.02)
    for _ in range(20):
        hand.move(0.0, 0.1, PUSH_HEIGHT)
    assert plant.contacts.tool_object > 5.0
    assert plant.contacts.object_obstacle > 5.0
    assert plant.observe().object_pose[1] + 0.125 < face + 2e-3
    assert plant.observe().object_transform[2] == pytest.approx(0.025, abs=2e-3)
    assert not plant.tipped


def test_pushing_takes_as_much_force_as_friction_gives(open_table):
    plant, _ = pushed_bar(open_table, 0.0)
    weight = open_table.scene.object.mass * GRAVITY
    assert plant.contacts.tool_object == pytest.approx(open_table.scene.object.friction * weight, rel=0.1)


def tracking_error(world: World, velocities: np.ndarray) -> float:
    """Largest distance between the tip and where joint velocities [step, dof] lead by kinematics alone [m]."""
    plant, robot = SimulatedPlant(world, start=(0.3, -0.6, 0.0)), world.scene.robot
    for _ in range(10):
        plant.apply(np.array([0.0, -1.0, 0.0, 0.0, 0.0, 0.0]))  # up, where nothing is in the way
    plant.apply(STILL)
    commanded, worst = plant.observe().joint_position, 0.0
    for velocity in velocities:
        plant.apply(velocity)
        commanded = commanded + velocity * plant.control_period
        wanted, actual = (tip_frame(robot, joints)[1] for joints in (commanded, plant.observe().joint_position))
        worst = max(worst, float(np.linalg.norm(wanted - actual)))
    assert plant.contacts.robot_obstacle == 0.0
    return worst


@pytest.mark.parametrize("seed", range(3))
def test_tool_tracks_smooth_joint_velocities(open_table, seed):
    random, time = np.random.default_rng(seed), 0.05 * np.arange(160)[:, None, None]
    frequency, phase = random.uniform(0.2, 1.0, (3, 6)), random.uniform(0.0, 2 * math.pi, (3, 6))
    waves = np.sin(2 * math.pi * frequency * time + phase).mean(axis=1)
    assert tracking_error(open_table, waves * (0.5, 0.25, 0.25, 0.5, 0.5, 0.5)) < 1.5e-3


def test_tool_tracks_joint_velocities_that_jump(open_table):
    jumps = np.random.default_rng(0).uniform(-0.5, 0.5, (80, 6))
    jumps[1::2] = -jumps[::2]
    assert tracking_error(open_table, jumps) < 5e-3


def test_t_pushed_at_random_for_20_seconds_neither_tips_nor_sinks(open_table):
    random, pushed = np.random.default_rng(0), 0.0
    while pushed < 20.0:
        start = (random.uniform(0.42, 0.5), random.uniform(-0.1, 0.1), random.uniform(-math.pi, math.pi))
        angle = random.choice((-0.5, 0.5)) * math.pi + random.uniform(-0.4, 0.4)
        ahead, aside = rotation(angle).T
        plant = SimulatedPlant(open_table, start=start)
        hand = Hand(open_table, plant)
        hand.come_down_at(*(start[:2] - 0.18 * ahead + random.uniform(-0.06, 0.06) * aside))
        speed = random.uniform(0.1, 0.3)
        for _ in range(round(0.3 / (speed * plant.control_period))):
            hand.move(*(speed * ahead), PUSH_HEIGHT)
            pushed += plant.control_period
            assert tilt(plant) < 0.05
            assert plant.observe().object_transform[2] == pytest.approx(open_table.scene.object.rest_height, abs=1e-3)
        assert np.linalg.norm(plant.observe().object_pose[:2] - start[:2]) > 0.01


def test_joints_stop_at_their_limits(open_table):
    plant = SimulatedPlant(open_table)
    upper = open_table.scene.robot.joints[2].upper
    for _ in range(60):
        plant.apply(np.array([0.0, -0.3, 1.0, 0.0, 0.0, 0.0]))
    assert plant.observe().joint_position[2] == pytest.approx(upper, abs=5e-3)


def test_tool_pressed_on_the_table_is_felt_and_stays_above_it(open_table):
    plant = SimulatedPlant(open_table)
    hand = Hand(open_table, plant)
    for _ in range(60):
        hand.move(0.0, 0.0, -0.01)
    assert plant.contacts.robot_obstacle > 1.0
    assert hand.tip()[2] > -2e-3


def test_command_that_is_not_finite_is_refused(open_table):
    with pytest.raises(ValueError, match="finite"):
        SimulatedPlant(open_table).apply(np.array([0.0, np.nan, 0.0, 0.0, 0.0, 0.0]))


def test_object_on_its_side_counts_as_tipped(open_table):
    plant = SimulatedPlant(open_table)
    assert not plant.tipped
    plant.data.qpos[open_table.mujoco.object_qpos[3:]] = (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0)
    assert plant.tipped


def test_same_commands_give_the_same_bits(open_table):
    first, second = (pushed_bar(open_table, 0.05)[0].observe().object_transform for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_time_passes_by_control_periods(open_table):
    plant = SimulatedPlant(open_table, control_period=0.04, substeps=16)
    for _ in range(25):
        plant.apply(STILL)
    assert plant.observe().time == pytest.approx(1.0)
