"""A calibrated camera: how it maps points of the world to pixels, and the file with its calibration."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from oimppi_warp.errors import ConfigError
from oimppi_warp.geometry.footprint import rotation_matrix
from oimppi_warp.perception.opencv import load_opencv

_NUMBERS = {"image_size": 2, "focal_length": 2, "principal_point": 2, "distortion": 5}
"""Number of values of each entry of a calibration that describes the lens."""
_PLACE = {"position": 3, "quaternion": 4}
"""Number of values of each entry that describes where the camera stands."""


@dataclass(frozen=True, eq=False)
class CameraModel:
    """A camera with a lens, by OpenCV's pinhole model, and its place.

    The camera's frame has its origin at the optical centre; x points right in the image, y down, and z forwards.

    Attributes:
        image_size: Width and height of the images [px].
        focal_length: Focal lengths fx and fy [px].
        principal_point: Pixel cx, cy on the optical axis; the centre of the first pixel is (0, 0) [px].
        distortion: Radial and tangential distortion k1, k2, p1, p2, k3.
        pose: Position [m] and quaternion xyzw of the camera's frame in the world, shape [7]; ``None`` if unknown.
    """

    image_size: tuple[int, int]
    focal_length: tuple[float, float]
    principal_point: tuple[float, float]
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    pose: np.ndarray | None = None

    @property
    def matrix(self) -> np.ndarray:
        """Returns the camera matrix, shape [3, 3] [px]."""
        (fx, fy), (cx, cy) = self.focal_length, self.principal_point
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    def placed(self, pose: np.ndarray) -> CameraModel:
        """Returns the camera at a pose: position [m] and quaternion xyzw, shape [7]."""
        return replace(self, pose=np.asarray(pose, dtype=float))

    def in_camera(self, points: np.ndarray) -> np.ndarray:
        """Returns points of the world in the camera's frame.

        Args:
            points: Points in the world, shape [n, 3] [m].

        Raises:
            ConfigError: It is not known where the camera stands.
        """
        position, rotation = self._place()
        return (np.asarray(points, dtype=float) - position) @ rotation

    def project(self, points: np.ndarray) -> np.ndarray:
        """Returns the pixels at which points of the world appear, shape [n, 2] [px].

        Args:
            points: Points in the world, shape [n, 3] [m], in front of the camera.

        Raises:
            ConfigError: It is not known where the camera stands.
        """
        cv2, none = load_opencv(), np.zeros(3)
        return cv2.projectPoints(self.in_camera(points), none, none, self.matrix, np.array(self.distortion))[0][:, 0]

    def on_plane(self, pixels: np.ndarray, height: float) -> np.ndarray:
        """Returns the points that appear at pixels, given their height above the table, shape [n, 2] [m].

        Args:
            pixels: Pixels, shape [n, 2] [px].
            height: z of the points in the world [m].

        Raises:
            ConfigError: It is not known where the camera stands.
        """
        cv2 = load_opencv()
        position, rotation = self._place()
        flat = cv2.undistortPoints(np.asarray(pixels, dtype=float)[:, None], self.matrix, np.array(self.distortion))
        rays = np.column_stack([flat[:, 0], np.ones(len(flat))]) @ rotation.T
        return position[:2] + rays[:, :2] * ((height - position[2]) / rays[:, 2:])

    def _place(self) -> tuple[np.ndarray, np.ndarray]:
        """Returns position [m] and rotation of the camera's frame in the world."""
        if self.pose is None:
            raise ConfigError(
                "the calibration does not say where the camera stands\n"
                "  to do:   oimppi perceive calibrate table (or hand-eye)"
            )
        return self.pose[:3], rotation_matrix(self.pose[3:])

    def save(self, file: Path) -> None:
        """Writes the calibration to a TOML file."""
        lines = [
            "# A camera's calibration (docs/perception.md).",
            "",
            "# The lens, by OpenCV's pinhole model, in pixels",
        ]
        lines += [_entry(name, getattr(self, name)) for name in _NUMBERS]
        if self.pose is not None:
            lines += ["", "# The camera's frame in the world: x right in the image, y down, z forwards; metres, xyzw"]
            lines += [_entry("position", self.pose[:3]), _entry("quaternion", self.pose[3:])]
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("\n".join(lines) + "\n")


def load_camera(file: Path) -> CameraModel:
    """Reads a calibration from a TOML file.

    Raises:
        ConfigError: The file does not exist, or is no calibration of a camera.
    """
    try:
        found = tomllib.loads(file.read_text())
    except FileNotFoundError:
        raise ConfigError(
            f"{file}: there is no such file\n"
            "  to do:   calibrate the camera with `oimppi perceive calibrate` (docs/perception.md)"
        ) from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{file}: the calibration cannot be read: {error}") from None
    expected = _NUMBERS | (_PLACE if _PLACE.keys() & found.keys() else {})
    for name in found.keys() - expected.keys():
        raise ConfigError(f"{file}: {name} is no entry of a calibration\n  allowed: {', '.join(_NUMBERS | _PLACE)}")
    values = {name: _numbers(file, name, found.get(name), count) for name, count in expected.items()}
    width, height = values["image_size"]
    camera = CameraModel(
        (round(width), round(height)),
        (values["focal_length"][0], values["focal_length"][1]),
        (values["principal_point"][0], values["principal_point"][1]),
        values["distortion"],
    )
    if min(*camera.image_size, *camera.focal_length) <= 0:
        raise ConfigError(f"{file}: image_size and focal_length must be above zero")
    if "position" not in values:
        return camera
    quaternion = np.array(values["quaternion"])
    if abs(np.linalg.norm(quaternion) - 1.0) > 1e-3:
        raise ConfigError(f"{file}: quaternion has the length {np.linalg.norm(quaternion):.3f}\n  allowed: 1")
    return camera.placed(np.concatenate([values["position"], quaternion / np.linalg.norm(quaternion)]))


def _numbers(file: Path, name: str, found: object, count: int) -> tuple[float, ...]:
    """Returns an entry of a calibration, checked."""
    numbers = found if isinstance(found, list) else []
    if len(numbers) != count or not all(type(each) in (int, float) and math.isfinite(each) for each in numbers):
        what = "is missing" if found is None else f"= {found} cannot be used"
        raise ConfigError(f"{file}: {name} {what}\n  allowed: a list of {count} numbers")
    return tuple(map(float, numbers))


def _entry(name: str, values: object) -> str:
    """Returns a line of a calibration."""
    return f"{name} = [{', '.join(f'{value:.10g}' for value in np.asarray(values).tolist())}]"
