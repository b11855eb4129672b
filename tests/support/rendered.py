"""Images of flat, printed patterns as a camera sees them, made by tracing the ray of every pixel, with known truth.

It shares no code with what is tested but OpenCV's inverse of the lens distortion, and the test of the renderer checks
that one against its own formula. Light, blur and noise are those of an ordinary webcam indoors.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from oimppi_warp.config.lab import LabConfig
from oimppi_warp.perception.camera_model import CameraModel
from oimppi_warp.perception.tags import FAMILIES, TagLayout
from oimppi_warp.scene import Scene

SIZE = (640, 480)
"""Width and height of the images [px]."""
FOCAL_LENGTH = 554.0
"""Focal length of a webcam with a horizontal field of view of 60 degrees at 640 px [px]."""
TARGET = (0.40, 0.0, 0.05)
"""Point that the lab's camera looks at, in the middle of where the lab's tasks take place [m]."""
WEBCAM = (0.05, -0.10, 0.001, -0.0008, 0.02)
"""Distortion of an ordinary webcam's lens: some pixels at the edge of the image."""
_SUB = 4
"""Rays per pixel, along each axis."""


def looking(position: tuple[float, float, float], at: tuple[float, float, float], roll: float = 0.0) -> np.ndarray:
    """Pose of a camera that looks at a point, its image upright up to a roll [rad]; position, quaternion xyzw."""
    z = np.subtract(at, position)
    z = z / np.linalg.norm(z)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x = x / np.linalg.norm(x)
    rotation = Rotation.from_matrix(np.column_stack([x, np.cross(z, x), z])) * Rotation.from_euler("z", roll)
    return np.concatenate([position, rotation.as_quat()])


def lab_camera(distortion: tuple[float, ...] = WEBCAM) -> CameraModel:
    """The lab's camera, where the simulated lab has it."""
    camera = CameraModel(SIZE, (FOCAL_LENGTH, FOCAL_LENGTH), (322.3, 236.8), distortion)
    return camera.placed(looking(LabConfig().camera, TARGET))


@dataclass(frozen=True, eq=False)
class Patch:
    """A printed rectangle or disc.

    Attributes:
        print: Grey values, the first row at the largest y, shape [rows, columns].
        size: Extent in x and y [m].
        pose: Position [m] and quaternion xyzw of the centre in the world; the print is on the side of positive z.
        round: Whether only the inscribed disc is there.
    """

    print: np.ndarray
    size: tuple[float, float]
    pose: np.ndarray
    round: bool = False


@dataclass(frozen=True)
class Conditions:
    """Light, lens and sensor.

    Attributes:
        noise: Standard deviation of the sensor's noise [grey values].
        blur: Standard deviation of the blur by lens and focus [px].
        light: Factor of all grey values.
        slope: Relative difference of the light between left and right.
    """

    noise: float = 3.0
    blur: float = 0.6
    light: float = 0.75
    slope: float = 0.3


ORDINARY = Conditions()


@lru_cache(maxsize=2)
def _rays(
    size: tuple[int, int], focal: tuple[float, float], center: tuple[float, float], distortion: tuple[float, ...]
) -> np.ndarray:
    """The rays of a lens in the camera's frame, several per pixel, shape [rows, columns, 3]."""
    across, down = (np.arange(count * _SUB) / _SUB + (0.5 / _SUB - 0.5) for count in size)
    pixels = np.stack(np.meshgrid(across, down), axis=-1)
    matrix = np.array([[focal[0], 0.0, center[0]], [0.0, focal[1], center[1]], [0.0, 0.0, 1.0]])
    exact = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-10)
    flat = cv2.undistortPointsIter(pixels.reshape(-1, 1, 2), matrix, np.array(distortion), np.eye(3), np.eye(3), exact)
    return np.column_stack([flat[:, 0], np.ones(len(flat))]).reshape(*pixels.shape[:2], 3)


@dataclass
class Renderer:
    """A camera that takes images.

    Attributes:
        camera: The camera, at its true pose.
        seed: Seed of the noise and of the table's texture.
    """

    camera: CameraModel
    seed: int = 0
    _random: np.random.Generator = field(init=False)
    _rays: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)
        width, height = self.camera.image_size
        assert self.camera.pose is not None
        camera = self.camera
        rays = _rays(camera.image_size, camera.focal_length, camera.principal_point, camera.distortion)
        self._rays = rays @ Rotation.from_quat(self.camera.pose[3:]).as_matrix().T
        coarse = self._random.uniform(70, 150, (height // 12, width // 12)).astype(np.float32)
        self._table = cv2.resize(coarse, (width, height))

    def image(
        self, patches: list[Patch], conditions: Conditions = ORDINARY, *, balls: np.ndarray | None = None
    ) -> np.ndarray:
        """An image in colour of some patches, the last one in front, shape [height, width, 3].

        Before them are balls, shape [n, 4] (centre, radius) [m], such as those of an arm.
        """
        picture = self._table.copy()
        for patch in patches:
            self._draw(picture, patch)
        for x, y, z, radius in () if balls is None else balls:
            at = self.camera.project(np.array([[x, y, z]]))[0]
            away = float(self.camera.in_camera(np.array([[x, y, z]]))[0, 2])
            size = self.camera.focal_length[0] * radius / away
            cv2.circle(picture, tuple(np.rint(16 * at).astype(int)), round(16 * size), 180.0, -1, cv2.LINE_8, 4)
        width, height = self.camera.image_size
        picture = cv2.GaussianBlur(picture, (0, 0), conditions.blur)
        slope = conditions.slope * np.linspace(-0.5, 0.5, width, dtype=np.float32)
        picture *= conditions.light * (1.0 + slope)
        picture += conditions.noise * self._random.standard_normal((height, width), dtype=np.float32)
        return cv2.cvtColor(np.clip(np.rint(picture), 0, 255).astype(np.uint8), cv2.COLOR_GRAY2BGR)

    def _draw(self, picture: np.ndarray, patch: Patch) -> None:
        """Draws a patch where it is in sight of the camera."""
        assert self.camera.pose is not None
        rotation = Rotation.from_quat(patch.pose[3:]).as_matrix()
        eye = (self.camera.pose[:3] - patch.pose[:3]) @ rotation
        if eye[2] <= 0.0:
            return
        half = np.array(patch.size) / 2.0
        corners = [[x, y, 0.0] for x in (-half[0], half[0]) for y in (-half[1], half[1])]
        around = self.camera.project(patch.pose[:3] + corners @ rotation.T)
        low = np.clip(np.floor(around.min(axis=0)).astype(int) - 3, 0, None)
        high = np.clip(np.ceil(around.max(axis=0)).astype(int) + 4, 0, self.camera.image_size)
        if (high <= low).any():
            return
        here = (slice(low[1] * _SUB, high[1] * _SUB), slice(low[0] * _SUB, high[0] * _SUB))
        rays = self._rays[here] @ rotation
        spot = eye[:2] - rays[..., :2] * (eye[2] / rays[..., 2:])
        rows, columns = patch.print.shape
        u = ((spot[..., 0] / patch.size[0] + 0.5) * columns).astype(int)
        v = ((0.5 - spot[..., 1] / patch.size[1]) * rows).astype(int)
        inside = (np.abs(spot) <= half).all(axis=-1) & (rays[..., 2] < 0.0)
        if patch.round:
            inside &= (spot**2).sum(axis=-1) <= (min(patch.size) / 2.0) ** 2
        seen = patch.print[np.clip(v, 0, rows - 1), np.clip(u, 0, columns - 1)].astype(float)
        part = picture[low[1] : high[1], low[0] : high[0]]
        shape = (part.shape[0], _SUB, part.shape[1], _SUB)
        share = inside.reshape(shape).mean(axis=(1, 3))
        part *= 1.0 - share
        part += (seen * inside).reshape(shape).mean(axis=(1, 3))


def printed_tag(family: str, number: int) -> np.ndarray:
    """Grey values of a printed tag, 40 pixels per module: the black of a printer, and paper."""
    name, modules = FAMILIES[family]
    known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    return np.where(cv2.aruco.generateImageMarker(known, number, 40 * modules) > 0, 235, 25).astype(np.uint8)


def standing(pose: np.ndarray, layout: TagLayout, scene: Scene, *, tilt: float = 0.0) -> list[Patch]:
    """An upright cylinder with tags on its white top, such as the lab's can.

    Args:
        pose: Planar pose of the cylinder.
        layout: The tags.
        scene: The scene with the cylinder.
        tilt: Angle by which it leans over towards its own x [rad].
    """
    (can,) = scene.object.colliders
    assert can.kind == "cylinder"
    radius, half = can.size
    turn = Rotation.from_euler("z", pose[2]) * Rotation.from_euler("y", tilt)
    foot = np.array([pose[0], pose[1], scene.object.rest_height])

    def at(place: tuple[float, float, float], yaw: float = 0.0) -> np.ndarray:
        return np.concatenate([foot + turn.apply(place), (turn * Rotation.from_euler("z", yaw)).as_quat()])

    grey, white = np.full((2, 2), 90, np.uint8), np.full((2, 2), 235, np.uint8)
    across = (2.0 * radius, 2.0 * radius)
    side = [Patch(grey, across, at((0.0, 0.0, z)), round=True) for z in np.linspace(-half, half - 0.004, 18)]
    tags = [
        Patch(printed_tag(layout.family, tag.id), (tag.size, tag.size), at(tag.position, tag.yaw))
        for tag in layout.tags
    ]
    return [*side, Patch(white, across, at((0.0, 0.0, half)), round=True), *tags]


def drawn_pose(random: np.random.Generator) -> np.ndarray:
    """A pose somewhere where the lab's object may be, with any yaw."""
    return np.array([random.uniform(0.25, 0.60), random.uniform(-0.45, 0.45), random.uniform(-np.pi, np.pi)])
