"""Finds the tags of an object in an image, and from them the object's planar pose.

The object stands on the table, so that the heights of its tags are known. Its pose is therefore fitted with three
parameters (x, y, yaw) to the corners of all tags that are seen. A free fit of six would have to decide, from a few
pixels, which of two mirrored tilts a small square has. How well the three parameters explain the corners says whether
the object stands on the table where the calibration has it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from oimppi_warp.errors import ConfigError
from oimppi_warp.geometry.footprint import planar_points
from oimppi_warp.perception.camera_model import CameraModel
from oimppi_warp.perception.opencv import enlarged, load_opencv, marker_parameters
from oimppi_warp.perception.tags import TagLayout, dictionary

_ERROR, _RELATIVE_ERROR = 0.7, 0.03
"""Largest root mean square distance between seen and fitted corners: in pixels, and relative to the tag's side."""
_STEPS = 6
"""Steps of the fit."""


@dataclass(frozen=True, eq=False)
class SeenTag:
    """A tag in an image.

    Attributes:
        id: Its number.
        corners: Its corners, clockwise from its top left, shape [4, 2] [px].
    """

    id: int
    corners: np.ndarray

    @property
    def side(self) -> float:
        """Returns the mean length of its sides [px]."""
        return float(np.linalg.norm(self.corners - np.roll(self.corners, 1, axis=0), axis=1).mean())


@dataclass(frozen=True, eq=False)
class Sighting:
    """Result of looking for the object in an image.

    Attributes:
        pose: Planar pose of the object's frame in the world, shape [3] [m, m, rad]; ``None`` if it was not found.
        problem: Why it was not found, in words; empty if it was.
        error: Root mean square distance between the seen corners of the object's tags and the fitted ones [px]; NaN if
            nothing was fitted.
        tags: All tags of the family that are in the image.
    """

    pose: np.ndarray | None
    problem: str
    error: float
    tags: tuple[SeenTag, ...]


class TagDetector:
    """Finds an object by its tags.

    Args:
        camera: The camera, with its place.
        layout: The tags on the object.
        rest_height: z of the object's frame when the object stands on the table [m].

    Raises:
        ConfigError: It is not known where the camera stands, or OpenCV is not installed.

    Attributes:
        camera: The camera.
        layout: The tags on the object.
    """

    def __init__(self, camera: CameraModel, layout: TagLayout, rest_height: float) -> None:
        self.camera, self.layout = camera, layout
        camera.in_camera(np.zeros((1, 3)))  # its place is known
        self._rest_height = rest_height
        self._tags = {tag.id: tag for tag in layout.tags}
        self._cv2 = load_opencv()
        parameters = marker_parameters(edges=True)
        self._finder = self._cv2.aruco.ArucoDetector(dictionary(layout.family), parameters)

    def detect(self, image: np.ndarray) -> Sighting:
        """Returns what is found in an image.

        Args:
            image: Grey or BGR, shape [height, width] or [height, width, 3], dtype uint8.

        Raises:
            ConfigError: The image has another size than those that the camera was calibrated with.
        """
        if (size := image.shape[1::-1]) != self.camera.image_size:
            raise ConfigError(
                f"the images have {size[0]} x {size[1]} pixels, the calibration is for "
                f"{self.camera.image_size[0]} x {self.camera.image_size[1]}\n"
                "  to do:   calibrate with images of this camera at this size"
            )
        grey = image if image.ndim == 2 else self._cv2.cvtColor(image, self._cv2.COLOR_BGR2GRAY)
        seen = self._find(grey)
        ours = [tag for tag in seen if tag.id in self._tags]
        ids = [tag.id for tag in ours]
        if not ours:
            return Sighting(None, self._missing(grey, seen), math.nan, seen)
        if len(set(ids)) < len(ids):
            return Sighting(None, f"the tags {_listed(ids)} are seen: each may be there only once", math.nan, seen)
        pose, error, limit = self._fit(ours)
        if not error <= limit:
            return Sighting(
                None,
                f"the corners of the tags are {error:.2f} px from where they can be, more than {limit:.2f} px: the "
                "object does not stand flat on the table, or the camera or the tag is not where it should be",
                error,
                seen,
            )
        return Sighting(pose, "", error, seen)

    def corners_at(self, pose: np.ndarray, ids: list[int] | None = None) -> np.ndarray:
        """Returns where the corners of tags appear with the object at a pose, shape [tag, 4, 2] [px].

        Args:
            pose: Planar pose of the object, shape [3] [m, m, rad].
            ids: Numbers of the tags; ``None``: all of the object's.
        """
        tags = self.layout.tags if ids is None else [self._tags[number] for number in ids]
        corners = np.concatenate([tag.corners for tag in tags])
        world = np.column_stack([planar_points(pose, corners[:, :2]), corners[:, 2] + self._rest_height])
        return self.camera.project(world).reshape(-1, 4, 2)

    def _find(self, grey: np.ndarray) -> tuple[SeenTag, ...]:
        """Returns the tags in a grey image."""
        large, zoom = enlarged(grey)
        found, ids, _ = self._finder.detectMarkers(large)
        if ids is None:
            return ()
        corners = [(_outer(each[0].astype(float)) + 0.5) / zoom - 0.5 for each in found]
        return tuple(map(SeenTag, ids.ravel().tolist(), corners))

    def _missing(self, grey: np.ndarray, seen: tuple[SeenTag, ...]) -> str:
        """Returns why none of the object's tags was found."""
        wanted = f"{self.layout.family} {_listed(list(self._tags))}"
        if seen:
            return f"the tags {_listed([tag.id for tag in seen])} are seen, but none of the object's, {wanted}"
        if any(tag.id in self._tags for tag in self._find(np.ascontiguousarray(grey[:, ::-1]))):
            return f"the image is mirrored: the tag {wanted} appears in it as in a mirror"
        return f"no tag is seen, of {wanted}: it is hidden, outside the image, too small in it, or blurred"

    def _fit(self, seen: list[SeenTag]) -> tuple[np.ndarray, float, float]:
        """Fits the object's pose to the corners of its tags.

        Returns:
            The pose, shape [3] [m, m, rad], the root mean square distance of the corners, and the largest that is
            allowed [px].
        """
        ids, pixels = [tag.id for tag in seen], np.array([tag.corners for tag in seen])
        pose = self._first_guess(ids, pixels)
        steps = np.diag([1e-5, 1e-5, 1e-4])
        for _ in range(_STEPS):  # Gauss and Newton's method, the derivatives by differences
            off = (self.corners_at(pose, ids) - pixels).ravel()
            slopes = [(self.corners_at(pose + step, ids) - pixels).ravel() - off for step in steps]
            change, *_ = np.linalg.lstsq(np.array(slopes).T, off, rcond=None)
            pose = pose - steps @ change
        off = self.corners_at(pose, ids) - pixels
        pose[2] = math.remainder(pose[2], 2.0 * math.pi)
        error = math.sqrt((off**2).sum(axis=-1).mean())
        return pose, error, max(_ERROR, _RELATIVE_ERROR * float(np.mean([tag.side for tag in seen])))

    def _first_guess(self, ids: list[int], pixels: np.ndarray) -> np.ndarray:
        """Returns the pose that best maps the tags' corners to the points of the table's plane that are seen."""
        tags = [self._tags[number] for number in ids]
        seen = np.concatenate(
            [
                self.camera.on_plane(corners, self._rest_height + tag.position[2])
                for tag, corners in zip(tags, pixels, strict=True)
            ]
        )
        own = np.concatenate([tag.corners[:, :2] for tag in tags])
        a, b = own - own.mean(axis=0), seen - seen.mean(axis=0)
        yaw = math.atan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
        return np.array([*(seen - planar_points((0.0, 0.0, yaw), own)).mean(axis=0), yaw])


def _outer(corners: np.ndarray) -> np.ndarray:
    """Returns the corners of a tag, shape [4, 2] [px], with its edges moved outwards by half a pixel.

    The edges were fitted to the centres of the outermost black pixels.
    """
    before, after = (corners - np.roll(corners, shift, axis=0) for shift in (1, -1))
    before /= np.linalg.norm(before, axis=1, keepdims=True)
    after /= np.linalg.norm(after, axis=1, keepdims=True)
    sine = np.abs(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0])
    return corners + 0.5 * (before + after) / np.maximum(sine, 0.1)[:, None]


def _listed(ids: list[int]) -> str:
    """Returns numbers as text."""
    return ", ".join(map(str, ids))
