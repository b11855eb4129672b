"""Detection of the object in a camera's images, with the errors of a laboratory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oimppi_warp.config.lab import LabConfig
from oimppi_warp.observation import Observation
from oimppi_warp.physics.world import World
from oimppi_warp.plants.camera import Camera


@dataclass(frozen=True, eq=False)
class Detection:
    """A detection of the object in one image.

    Attributes:
        taken: Time at which the image was taken [s].
        due: Time at which the detection becomes available [s].
        pose: Detected planar pose, shape [3] [m, m, rad].
        outlier: Whether the detection is an outlier.
    """

    taken: float
    due: float
    pose: np.ndarray
    outlier: bool


class Detector:
    """A camera and the detection of the object in its images: at a low rate, late, with noise and outliers.

    Args:
        world: The scene.
        config: Errors and rate of the detection.
        seed: Seed of noise and outliers.

    Attributes:
        camera: The camera.
    """

    def __init__(self, world: World, config: LabConfig, *, seed: int) -> None:
        self.camera = Camera(world, config.camera)
        self._config = config
        self._random = np.random.default_rng([seed, 2])

    def detect(self, state: Observation, time: float) -> Detection | None:
        """Takes an image; returns what is detected in it, ``None`` if the arm hides the object.

        Args:
            state: The exact state.
            time: The present time, which the detection carries [s].
        """
        config, random = self._config, self._random
        # All random numbers are drawn for every image, so that its result does not depend on earlier ones.
        noise = random.normal(size=3) * (config.position_noise, config.position_noise, config.yaw_noise)
        outlier, direction = random.uniform() < config.outlier_probability, random.uniform(-np.pi, np.pi)
        away, turn = random.uniform(0.5, 1.5) * config.outlier_size, random.uniform(-np.pi, np.pi)
        if not self.camera.sees(state.joint_position, state.object_pose):
            return None
        pose = state.object_pose + noise
        if outlier:
            pose = pose + np.array([away * np.cos(direction), away * np.sin(direction), turn])
        return Detection(time, time + config.delay, pose, outlier)
