"""The simulated lab: the simulated arm and object with the imperfect sensing and actuation of a laboratory.

It has the same interface as hardware would. A camera detects the object at a low rate, with delay, noise, occasional
outliers, and occlusion by the arm; joint positions are reported at a high rate, with noise; commands are delayed, and
joint accelerations are limited.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from oimppi_warp.config.lab import LabConfig
from oimppi_warp.config.settings import Config
from oimppi_warp.errors import ConfigError
from oimppi_warp.observation import Observation, planar_transform
from oimppi_warp.physics.world import World
from oimppi_warp.plants.detector import Detection, Detector
from oimppi_warp.plants.plant import Contacts, SimulatedPlant, checked_stream
from oimppi_warp.scene import PlanarPose, Scene

TICK = 0.01
"""Interval of joint reports, at 100 Hz like the xArm's real-time port [s]."""
_SUBSTEPS = 4
"""Physics steps per tick."""


class LabPlant:
    """The scene in a simulated lab.

    Args:
        world: The scene.
        config: Imperfections of the lab.
        start: The object's start pose; ``None``: the scene's.
        control_period: Control period [s], a multiple of :data:`TICK`.
        seed: Seed of noise and outliers only; the same seed and commands give the same observations.

    Raises:
        ConfigError: The control period is not a multiple of :data:`TICK`, or is shorter than the latency.

    Attributes:
        camera: The camera.
        latency: Time from a command to its effect [s].
        ticks: Number of joint velocities per control period: one per :data:`TICK`.
        wrong_detections: Number of outliers delivered so far.
    """

    def __init__(
        self,
        world: World,
        config: LabConfig,
        *,
        start: PlanarPose | None = None,
        control_period: float = 0.05,
        seed: int = 0,
    ) -> None:
        self.ticks = round(control_period / TICK)
        self._knock = np.zeros(3)  # an impulse that is spread over the next control period [N s]
        if self.ticks < 1 or abs(self.ticks * TICK - control_period) > 1e-9:
            raise ConfigError(
                f"control_period = {control_period:g}: the lab reports joint positions every {TICK:g} s\n"
                f"  allowed: a multiple of this interval"
            )
        if config.command_latency > control_period + 1e-9:
            raise ConfigError(
                f"lab.command_latency = {config.command_latency:g}: longer than the control period\n"
                f"  allowed: up to {control_period:g} s"
            )
        self.control_period = control_period
        self.latency = config.command_latency
        self._detector = Detector(world, config, seed=seed)
        self.camera = self._detector.camera
        self.wrong_detections = 0
        self._config = config
        self._scene = world.scene
        self._plant = SimulatedPlant(world, start=start, control_period=TICK, substeps=_SUBSTEPS)
        self._joint_noise = np.random.default_rng([seed, 1])
        self._tick = 0
        self._commands: deque[tuple[int, np.ndarray]] = deque()
        self._wanted = np.zeros(world.scene.robot.dof)
        self._driven = np.zeros(world.scene.robot.dof)
        self._pictures: deque[Detection] = deque()
        self._seen = Detection(np.nan, 0.0, np.full(3, np.nan), False)
        self._next_picture = 0
        self._contacts = self._plant.contacts
        self._trail = [self._measure()]
        self._take_picture()

    def observe(self) -> Observation:
        """Returns the newest joint report, all joint reports since the last call, and the newest detection."""
        trail, self._trail = np.array(self._trail), self._trail[-1:]
        last = trail[-1, 1:]
        velocity = np.zeros_like(last)
        if len(trail) > 1:
            velocity = (last - trail[0, 1:]) / (trail[-1, 0] - trail[0, 0])
        while self._pictures and self._pictures[0].due <= self._time + 1e-9:
            self._seen = self._pictures.popleft()
            self.wrong_detections += self._seen.outlier
        x, y, yaw = self._seen.pose
        return Observation(
            time=self._time,
            joint_position=last,
            joint_velocity=velocity,
            object_pose=self._seen.pose,
            object_transform=planar_transform((x, y, yaw), self._scene.object.rest_height),
            object_time=self._seen.taken,
            trail=trail,
        )

    def place(self, joint_position: np.ndarray, object_transform: np.ndarray) -> None:
        """Places arm and object, at rest; see :meth:`oimppi_warp.plants.plant.SimulatedPlant.place`."""
        self._plant.place(joint_position, object_transform)
        self._trail = [self._measure()]

    def knock(self, impulse: np.ndarray) -> None:
        """Applies an impulse to the object's centre of mass, spread over the next control period.

        Args:
            impulse: Impulse in the world frame, shape [3] [N s].
        """
        self._knock += np.asarray(impulse)

    @property
    def contact_points(self) -> np.ndarray:
        """Returns the contact points and forces; see :attr:`oimppi_warp.plants.plant.SimulatedPlant.contact_points`."""
        return self._plant.contact_points

    def truth(self) -> Observation:
        """Returns the exact state, for the record; planners must not use it."""
        return self._plant.observe()

    def apply(self, joint_velocity: np.ndarray) -> None:
        """Sends joint velocities, shape [dof] [rad/s], and runs one control period.

        Raises:
            ValueError: The command is not finite.
            FloatingPointError: The simulation diverged.
        """
        self.stream(np.tile(np.array(joint_velocity, dtype=float), (self.ticks, 1)))

    def stream(self, joint_velocities: np.ndarray) -> None:
        """Sends joint velocities, shape [ticks, dof] [rad/s], one per tick, and runs one control period.

        Raises:
            ValueError: A velocity is not finite, or their number is wrong.
            FloatingPointError: The simulation diverged.
        """
        forces = []
        for command in checked_stream(joint_velocities, self.ticks):
            self._commands.append((self._tick + round(self.latency / TICK), command))
            while self._commands and self._commands[0][0] <= self._tick:
                self._wanted = self._commands.popleft()[1]
            most = self._config.acceleration_limit * TICK
            self._driven = self._driven + np.clip(self._wanted - self._driven, -most, most)
            self._plant.knock(self._knock / self.ticks)
            self._plant.apply(self._driven)
            forces.append(vars(self._plant.contacts))
            self._tick += 1
            self._trail.append(self._measure())
            self._take_picture()
        self._knock = np.zeros(3)
        self._contacts = Contacts(**{name: max(force[name] for force in forces) for name in forces[0]})

    @property
    def driven(self) -> np.ndarray:
        """Returns the joint velocities that the drives currently follow, shape [dof] [rad/s]."""
        return self._driven

    @property
    def contacts(self) -> Contacts:
        """Returns the largest contact forces within the last control period."""
        return self._contacts

    @property
    def tipped(self) -> bool:
        """Returns whether the object has tipped over."""
        return self._plant.tipped

    @property
    def _time(self) -> float:
        return self._tick * TICK

    def _measure(self) -> np.ndarray:
        """Returns time [s] and measured joint positions [rad], shape [1 + dof]."""
        joints = self._plant.observe().joint_position
        noise = self._joint_noise.normal(0.0, self._config.joint_noise, len(joints))
        return np.concatenate([[self._time], joints + noise])

    def _take_picture(self) -> None:
        """Takes an image if one is due."""
        if self._tick < self._next_picture:
            return
        self._next_picture += max(round(1.0 / (self._config.rate * TICK)), 1)
        found = self._detector.detect(self._plant.observe(), self._time)
        if found is not None:
            self._pictures.append(found)


def lab_plant(scene: Scene, config: Config, *, seed: int = 0) -> LabPlant:
    """Makes the plant ``lab`` with the settings ``config.lab``."""
    return LabPlant(World(scene), config.lab, start=scene.start, control_period=config.control_period, seed=seed)
