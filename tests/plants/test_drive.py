"""Commands to a plant change smoothly: the joints' acceleration and jerk are limited at every physics step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.small_tasks import shipped

from oimppi_warp.config.presets import best, paper
from oimppi_warp.config.settings import Safety
from oimppi_warp.observation import Observation
from oimppi_warp.physics.world import World
from oimppi_warp.plants.drive import Drive
from oimppi_warp.plants.lab import LabPlant
from oimppi_warp.plants.plant import SimulatedPlant, StreamingPlant
from oimppi_warp.runtime.episode import Episode

XARM = Safety()
"""1145 deg/s^2 and 28647 deg/s^3."""
STILL = np.zeros(6)


class Noting:
    """A plant that notes what it is sent: ``ticks`` velocities per period."""

    def __init__(self, period: float = 0.05, ticks: int = 20) -> None:
        self.control_period, self.ticks = period, ticks
        self.velocities = np.zeros((0, 6))

    def observe(self) -> Observation:
        raise NotImplementedError

    def apply(self, joint_velocity: np.ndarray) -> None:
        self.stream(np.tile(joint_velocity, (self.ticks, 1)))

    def stream(self, joint_velocities: np.ndarray) -> None:
        self.velocities = np.vstack([self.velocities, joint_velocities])

    @property
    def peaks(self) -> tuple[float, float]:
        """Largest acceleration and jerk, from rest on."""
        tick = self.control_period / self.ticks
        velocities = np.vstack([np.zeros((2, 6)), self.velocities])
        accelerations = np.diff(velocities, axis=0) / tick
        return np.abs(accelerations).max(), np.abs(np.diff(accelerations, axis=0)).max() / tick


class Plain:
    """A plant that takes one joint velocity per period."""

    def __init__(self) -> None:
        self.control_period, self.commands = 0.05, []

    def observe(self) -> Observation:
        raise NotImplementedError

    def apply(self, joint_velocity: np.ndarray) -> None:
        self.commands.append(joint_velocity)


@pytest.mark.parametrize("period", [0.01, 0.02, 0.05, 0.1])
@pytest.mark.parametrize("smoothing", [0.03, 0.05, 0.12])
def test_whatever_is_commanded_the_joints_stay_within_the_limits(period: float, smoothing: float):
    safety = replace(XARM, smoothing=smoothing)
    plant = Noting(period)
    drive = Drive(plant, 6, safety)
    rng = np.random.default_rng(3)
    for _ in range(200):
        drive.apply(rng.uniform(-1.5, 1.5, 6))
        assert drive.peak_acceleration <= safety.acceleration_limit + 1e-6
        assert drive.peak_jerk <= safety.jerk_limit + 1e-6
    acceleration, jerk = plant.peaks
    assert acceleration <= safety.acceleration_limit + 1e-6
    assert 0.25 * safety.jerk_limit < jerk <= safety.jerk_limit + 1e-6, "and make use of them"


def test_a_command_that_lasts_is_reached_and_the_arm_lags_by_half_of_the_smoothing():
    plant = Noting()
    drive = Drive(plant, 6, XARM)
    wanted = np.array([0.9, -0.6, 0.3, 0.0, 0.1, -0.9])
    for _ in range(20):
        reached = drive.apply(wanted)
    np.testing.assert_allclose(reached, wanted)
    np.testing.assert_allclose(plant.velocities[-1], wanted)
    # Every command is carried out, half of the smoothing time later.
    far = plant.velocities.sum(axis=0) * plant.control_period / plant.ticks
    smooth = Drive(Noting(), 6, XARM)
    commanded = plant.control_period * sum(smooth.apply(wanted) for _ in range(20))
    np.testing.assert_allclose(far, commanded - drive.latency * wanted, atol=1e-9)
    assert drive.latency == pytest.approx(0.5 * (XARM.smoothing - plant.control_period / plant.ticks))


@pytest.mark.parametrize("latency", [0.0, 0.02, 0.045, 0.05, 0.12])
def test_what_is_pending_is_what_the_arm_does_until_the_next_command_takes_effect(latency: float):
    plant = Noting()
    plant.latency = latency  # type: ignore[attr-defined]
    drive = Drive(plant, 6, XARM)
    rng = np.random.default_rng(5)
    for _ in range(10):
        last = drive.apply(rng.uniform(-0.2, 0.2, 6))
    pending = drive.pending()
    assert sum(duration for duration, _ in pending) == pytest.approx(drive.latency)
    moved = sum((duration * velocity for duration, velocity in pending), STILL)
    for _ in range(4):
        drive.apply(last)
    times = latency + plant.control_period / plant.ticks * np.arange(len(plant.velocities) + 1)
    positions = np.vstack([STILL, np.cumsum(plant.velocities, axis=0)]) * plant.control_period / plant.ticks
    now, then = (np.array([np.interp(at, times, joint) for joint in positions.T]) for at in (0.5, 0.5 + drive.latency))
    np.testing.assert_allclose(moved, then - now, atol=1e-9)


def test_a_change_that_is_too_large_is_scaled_down_for_all_joints_alike():
    drive = Drive(Noting(), 6, XARM)
    wanted = np.array([1.2, -0.6, 0.3, 0.0, 0.0, 0.0])
    first = drive.allowed(wanted)
    np.testing.assert_allclose(first / first[0], wanted / wanted[0])
    assert first[0] == pytest.approx(0.25 * XARM.jerk_limit * XARM.smoothing**2)
    np.testing.assert_array_equal(drive.apply(wanted), first)
    assert drive.limited
    drive.apply(first)
    assert not drive.limited


def test_an_arm_that_is_stopped_brakes_within_the_limits_and_ends_at_rest():
    plant = Noting()
    drive = Drive(plant, 6, XARM)
    for _ in range(10):
        drive.apply(np.full(6, 1.2))
    drive.stop()
    np.testing.assert_allclose(plant.velocities[-1], STILL, atol=1e-12)
    assert plant.peaks[1] <= XARM.jerk_limit + 1e-6


@pytest.mark.parametrize(("period", "smoothing"), [(0.002, 0.05), (0.05, 0.01), (0.1, 0.05)])
def test_the_arm_brakes_within_the_limits_however_long_it_takes(period: float, smoothing: float):
    plant = Noting(period)
    drive = Drive(plant, 6, replace(XARM, smoothing=smoothing))
    for _ in range(2000):
        drive.apply(np.full(6, 0.5))
    drive.stop()
    np.testing.assert_allclose(plant.velocities[-1], STILL, atol=1e-12)
    assert plant.peaks[1] <= XARM.jerk_limit + 1e-5


def test_after_an_interrupted_period_the_arm_goes_on_within_the_limits():
    class Interrupted(Noting):
        def stream(self, joint_velocities: np.ndarray) -> None:
            super().stream(joint_velocities)
            if len(self.velocities) == 200:
                raise KeyboardInterrupt

    plant = Interrupted()
    drive = Drive(plant, 6, XARM)
    with pytest.raises(KeyboardInterrupt):
        for step in range(20):
            drive.apply(np.full(6, 0.9 if step < 9 else 0.6))
    drive.stop()
    np.testing.assert_allclose(plant.velocities[-1], STILL, atol=1e-12)
    assert plant.peaks[1] <= XARM.jerk_limit + 1e-6


def test_a_plant_that_raises_an_error_while_it_brakes_is_sent_zeros():
    class Broken(Noting):
        def __init__(self) -> None:
            super().__init__()
            self.last = np.ones(6)

        def apply(self, joint_velocity: np.ndarray) -> None:
            self.last = joint_velocity

        def stream(self, joint_velocities: np.ndarray) -> None:
            raise OSError("no connection")

    plant = Broken()
    with pytest.raises(OSError, match="no connection"):
        Drive(plant, 6, XARM).stop()
    np.testing.assert_array_equal(plant.last, STILL)


def test_an_exact_report_that_cannot_be_true_stops_the_arm_and_the_record_says_why(device: str):
    class Faulty(SimulatedPlant):
        reports = 0

        def observe(self) -> Observation:
            self.reports += 1
            seen = super().observe()
            return replace(seen, joint_position=np.full(6, np.nan)) if 8 <= self.reports < 10 else seen

        def truth(self) -> Observation:
            return super().observe()

    scene, config = shipped("task01"), best("mppi")
    config = replace(config, episode=replace(config.episode, max_sim_seconds=1.0))
    plant = Faulty(World(scene), start=scene.start)
    log = Episode(scene, config, plant=plant, method="mppi", engine="quasistatic", device=device, threads=1).run()
    assert log["stopped"].sum() >= 1
    assert log.header["problems"] and "joint" in log.header["problems"][0][1]
    assert np.isfinite(log["command"]).all()


def test_without_smoothing_a_command_is_sent_as_it_is():
    for safety in (None, replace(XARM, smoothing=0.0), paper().safety):
        plant = Noting()
        drive = Drive(plant, 6, safety)
        np.testing.assert_array_equal(drive.apply(np.full(6, 1.2)), np.full(6, 1.2))
        np.testing.assert_array_equal(plant.velocities, np.full((20, 6), 1.2))
        assert drive.latency == 0.0 and not drive.limited


def test_a_plant_that_takes_one_velocity_per_period_is_limited_in_acceleration():
    plant = Plain()
    assert not isinstance(plant, StreamingPlant)
    drive = Drive(plant, 6, replace(XARM, acceleration_limit=4.0))
    for _ in range(8):
        drive.apply(np.full(6, 1.0))
    np.testing.assert_allclose([command[0] for command in plant.commands], [0.2, 0.4, 0.6, 0.8, 1.0, 1.0, 1.0, 1.0])
    assert drive.latency == 0.0


def test_a_command_that_is_not_finite_is_refused():
    plant = Noting()
    with pytest.raises(ValueError, match="finite"):
        Drive(plant, 6, XARM).apply(np.full(6, np.nan))
    assert not len(plant.velocities)


@pytest.mark.parametrize("kind", ["ideal", "lab"])
def test_both_simulated_plants_take_a_stream_of_the_right_length(kind: str):
    world, config = World(shipped("lab01")), best()
    plant = SimulatedPlant(world) if kind == "ideal" else LabPlant(world, config.lab)
    assert isinstance(plant, StreamingPlant)
    start = plant.observe().joint_position
    plant.stream(np.tile(np.full(6, 0.1), (plant.ticks, 1)))
    assert (plant.observe().joint_position > start - 0.01).all()
    with pytest.raises(ValueError, match=f"expected {plant.ticks} joint velocities"):
        plant.stream(np.zeros((plant.ticks + 1, 6)))
    with pytest.raises(ValueError, match="finite"):
        plant.stream(np.full((plant.ticks, 6), np.inf))


@pytest.mark.parametrize("method", ["mppi", "cloi"])
def test_an_episode_keeps_the_limits_and_its_record_says_so(method: str, device: str):
    config = best(method)
    optimizer = replace(config.robot.optimizer, samples=256)
    config = replace(
        config,
        robot=replace(config.robot, optimizer=optimizer),
        object=replace(config.object, optimizer=replace(config.object.optimizer, samples=128)),
        episode=replace(config.episode, max_sim_seconds=4.0),
    )
    scene = shipped("task02")
    driven: list[np.ndarray] = []

    class Watched(SimulatedPlant):
        def stream(self, joint_velocities: np.ndarray) -> None:
            driven.append(joint_velocities)
            super().stream(joint_velocities)

    plant = Watched(World(scene), start=scene.start)
    log = Episode(scene, config, plant=plant, method=method, engine="quasistatic", device=device, threads=1).run()
    sent = np.concatenate([np.zeros((2, 6)), *driven])
    tick = plant.control_period / plant.ticks
    acceleration = np.diff(sent, axis=0) / tick
    assert 2.0 < np.abs(acceleration).max() <= XARM.acceleration_limit + 1e-6
    assert np.abs(np.diff(acceleration, axis=0)).max() / tick <= XARM.jerk_limit + 1e-6
    assert np.nanmax(log["joint_acceleration"]) == pytest.approx(np.abs(acceleration).max())
    assert np.nanmax(log["joint_jerk"]) <= XARM.jerk_limit + 1e-6
    # The command in the record is what the arm was given.
    np.testing.assert_allclose(log["command"], [stream[-1] for stream in driven[: len(log)]], atol=1e-9)
    np.testing.assert_allclose(sent[-1], STILL, atol=1e-9)


def test_after_a_rest_it_goes_on_from_rest():
    plant = Noting()
    drive = Drive(plant, 6, XARM)
    for _ in range(5):
        drive.apply(np.full(6, 0.3))
    drive.rest()
    plant.velocities = np.zeros((0, 6))
    drive.apply(STILL)
    assert not plant.velocities.any()
    assert not np.any(drive.command)
