"""The simulated lab with a camera whose images are rendered, and the tag detector in place of the simulated one."""

from __future__ import annotations

import numpy as np
from support import rendered

from oimppi_warp.config.lab import LabConfig
from oimppi_warp.geometry.kinematics import collider_spheres, link_frames
from oimppi_warp.observation import Observation
from oimppi_warp.perception.tag_detector import TagDetector
from oimppi_warp.perception.tags import layout_of
from oimppi_warp.physics.world import World
from oimppi_warp.plants.detector import Detection, Detector
from oimppi_warp.plants.lab import LabPlant
from oimppi_warp.scene import Scene


def arm_balls(scene: Scene, joints: np.ndarray) -> np.ndarray:
    """Balls that cover the arm and its tool, shape [n, 4] (centre, radius) [m]."""
    rotations, positions = link_frames(scene.robot, joints)
    balls = [np.zeros((0, 4))]
    for link, rotation, position in zip(scene.robot.links, rotations, positions, strict=True):
        for own in map(collider_spheres, link.colliders):
            balls.append(np.column_stack([own[:, :3] @ rotation.T + position, own[:, 3]]))
    return np.concatenate(balls)


class RenderedDetector(Detector):
    """The lab's camera with rendered images: the can with its tag, the arm before it, blur and noise.

    Attributes:
        errors: Distance between each detection and the truth [m].
        hidden: Number of images in which the object was not found.
    """

    def __init__(self, world: World, config: LabConfig) -> None:
        super().__init__(world, config, seed=0)
        self._scene, self._delay = world.scene, config.delay
        self._layout = layout_of(world.scene.object)
        self._renderer = rendered.Renderer(rendered.lab_camera(), seed=3)
        self._tags = TagDetector(rendered.lab_camera(), self._layout, world.scene.object.rest_height)
        self.errors: list[float] = []
        self.hidden = 0

    def detect(self, state: Observation, time: float) -> Detection | None:
        can = rendered.standing(state.object_pose, self._layout, self._scene)
        seen = self._tags.detect(self._renderer.image(can, balls=arm_balls(self._scene, state.joint_position)))
        if seen.pose is None:
            self.hidden += 1
            return None
        self.errors.append(float(np.hypot(*(seen.pose - state.object_pose)[:2])))
        return Detection(time, time + self._delay, seen.pose, False)


def camera_lab(scene: Scene, config: LabConfig, *, control_period: float) -> tuple[LabPlant, RenderedDetector]:
    """The lab, and the detector from which it has the object's poses."""
    world = World(scene)
    plant = LabPlant(world, config, start=scene.start, control_period=control_period)
    detector = RenderedDetector(world, config)
    plant._detector, plant._next_picture = detector, 0
    plant._pictures.clear()
    plant._take_picture()
    return plant, detector
