"""The simulated lab: the simulated arm and object, known and moved as imperfectly as in a laboratory.

Behind the seam of a plant, as hardware would be: the object is seen now and then by a camera, late, with noise,
sometimes wrongly, and not at all while the arm is in the way; joint positions come often, with noise; commands arrive
late, and joints do not change their speed at once.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from oimppi_warp.config.lab import LabConfig
from oimppi_warp.config.settings import Config
from oimppi_warp.errors import ConfigError
from oimppi_warp.observation import Observation, planar_transform
from oimppi_warp.physics.world import World
from oimppi_warp.plants.camera import Camera
from oimppi_warp.plants.plant import Contacts, SimulatedPlant
from oimppi_warp.scene import PlanarPose, Scene

TICK = 0.01
"""Time between two reports of the joints, 100 Hz as on the xArm's real-time port [s]."""
_SUBSTEPS = 4
"""Steps of the physics in it."""


@dataclass(frozen=True, eq=False)
class _Detection:
    """What the camera made of one picture.

    Attributes:
        taken: When it was taken [s].
        due: When its result is there [s].
        pose: Planar pose that was recognised in it, shape [3].
        outlier: Whether that is something else than the object.
    """

    taken: float
    due: float
    pose: np.ndarray
    outlier: bool


class LabPlant:
    """The scene in a simulated lab.

    Args:
        world: The scene.
        config: How imperfect the lab is.
        start: Where the object starts; default: the scene's start.
        control_period: [s]; a multiple of :data:`TICK`.
        seed: Of noise, wrong detections and nothing else: the same seed and commands give the same observations.

    Raises:
        ConfigError: The control period is no multiple of :data:`TICK`, or the latency longer than it.

    Attributes:
        camera: What sees the object.
        latency: Time from a command to its effect [s].
        wrong_detections: Wrong detections that were delivered so far.
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
        self._ticks = round(control_period / TICK)
        if self._ticks < 1 or abs(self._ticks * TICK - control_period) > 1e-9:
            raise ConfigError(
                f"control_period = {control_period:g}: joints are reported every {TICK:g} s in the lab\n"
                f"  allowed: a multiple of that"
            )
        if config.command_latency > control_period + 1e-9:
            raise ConfigError(
                f"lab.command_latency = {config.command_latency:g}: longer than a control period\n"
                f"  allowed: up to {control_period:g} s"
            )
        self.control_period = control_period
        self.latency = config.command_latency
        self.camera = Camera(world, config.camera)
        self.wrong_detections = 0
        self._config = config
        self._scene = world.scene
        self._plant = SimulatedPlant(world, start=start, control_period=TICK, substeps=_SUBSTEPS)
        self._joint_noise, self._sight_noise = (np.random.default_rng([seed, stream]) for stream in (1, 2))
        self._tick = 0
        self._commands: deque[tuple[int, np.ndarray]] = deque()
        self._wanted = np.zeros(world.scene.robot.dof)
        self._driven = np.zeros(world.scene.robot.dof)
        self._pictures: deque[_Detection] = deque()
        self._seen = _Detection(np.nan, 0.0, np.full(3, np.nan), False)
        self._next_picture = 0
        self._contacts = self._plant.contacts
        self._trail = [self._measure()]
        self._take_picture()

    def observe(self) -> Observation:
        """What is known now: the newest report of the joints, all since the last call, the newest detection."""
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
        """Puts everything somewhere at once, at rest; see :meth:`oimppi_warp.plants.plant.SimulatedPlant.place`."""
        self._plant.place(joint_position, object_transform)
        self._trail = [self._measure()]

    def knock(self, impulse: np.ndarray) -> None:
        """Knocks at the object with an impulse [3] [N s]."""
        self._plant.knock(impulse)

    @property
    def contact_points(self) -> np.ndarray:
        """Contact points and forces now; see :attr:`oimppi_warp.plants.plant.SimulatedPlant.contact_points`."""
        return self._plant.contact_points

    def truth(self) -> Observation:
        """The exact state, for the record; nothing that plans may ask for it."""
        return self._plant.observe()

    def apply(self, joint_velocity: np.ndarray) -> None:
        """Send joint velocities [rad/s], shape [dof], and let one control period pass.

        Raises:
            ValueError: The command is not finite.
            FloatingPointError: The simulation diverged.
        """
        command = np.array(joint_velocity, dtype=float)
        if not np.isfinite(command).all():
            raise ValueError(f"a joint velocity must be finite, got {command}")
        self._commands.append((self._tick + round(self.latency / TICK), command))
        forces = []
        for _ in range(self._ticks):
            while self._commands and self._commands[0][0] <= self._tick:
                self._wanted = self._commands.popleft()[1]
            most = self._config.acceleration_limit * TICK
            self._driven = self._driven + np.clip(self._wanted - self._driven, -most, most)
            self._plant.apply(self._driven)
            forces.append(vars(self._plant.contacts))
            self._tick += 1
            self._trail.append(self._measure())
            self._take_picture()
        self._contacts = Contacts(**{name: max(force[name] for force in forces) for name in forces[0]})

    @property
    def driven(self) -> np.ndarray:
        """Joint velocities that are driven now, shape [dof] [rad/s]."""
        return self._driven

    @property
    def contacts(self) -> Contacts:
        """Largest contact forces within the last control period."""
        return self._contacts

    @property
    def tipped(self) -> bool:
        """Whether the object no longer stands as it did."""
        return self._plant.tipped

    @property
    def _time(self) -> float:
        return self._tick * TICK

    def _measure(self) -> np.ndarray:
        """Time [s] and measured joint positions [rad], shape [1 + dof]."""
        joints = self._plant.observe().joint_position
        noise = self._joint_noise.normal(0.0, self._config.joint_noise, len(joints))
        return np.concatenate([[self._time], joints + noise])

    def _take_picture(self) -> None:
        """Take a picture if it is time."""
        if self._tick < self._next_picture:
            return
        config, random = self._config, self._sight_noise
        self._next_picture += max(round(1.0 / (config.rate * TICK)), 1)
        state = self._plant.observe()
        # All draws are made for every picture, so that what one shows does not depend on those before.
        noise = random.normal(size=3) * (config.position_noise, config.position_noise, config.yaw_noise)
        outlier, direction = random.uniform() < config.outlier_probability, random.uniform(-np.pi, np.pi)
        away, turn = random.uniform(0.5, 1.5) * config.outlier_size, random.uniform(-np.pi, np.pi)
        if not self.camera.sees(state.joint_position, state.object_pose):
            return
        pose = state.object_pose + noise
        if outlier:
            pose = pose + np.array([away * np.cos(direction), away * np.sin(direction), turn])
        self._pictures.append(_Detection(self._time, self._time + config.delay, pose, outlier))


def lab_plant(scene: Scene, config: Config, *, seed: int = 0) -> LabPlant:
    """Makes the plant ``lab`` with the settings ``config.lab``."""
    return LabPlant(World(scene), config.lab, start=scene.start, control_period=config.control_period, seed=seed)
