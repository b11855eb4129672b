"""An image with what was seen drawn into it: the tags, the object's outline and axes, and its pose in words."""

from __future__ import annotations

import numpy as np
import shapely

from oimppi_warp.geometry.footprint import footprint, height_range, outline, planar_points
from oimppi_warp.perception.opencv import load_opencv
from oimppi_warp.perception.tag_detector import Sighting, TagDetector
from oimppi_warp.scene import PushedObject

_OURS, _OTHER, _SHAPE = (60, 220, 60), (60, 60, 230), (230, 180, 40)
_X, _Y = (50, 50, 255), (50, 200, 50)
"""Colours, BGR."""
_FINE = 16
"""Fractions of a pixel in which OpenCV draws."""


def annotated(image: np.ndarray, sighting: Sighting, detector: TagDetector, pushed: PushedObject) -> np.ndarray:
    """Returns a copy of an image with what was found in it.

    Args:
        image: BGR, shape [height, width, 3], dtype uint8.
        sighting: What was found.
        detector: What found it.
        pushed: The object.
    """
    cv2, drawn = load_opencv(), image.copy()

    def line(pixels: np.ndarray, color: tuple[int, int, int], *, closed: bool = True) -> None:
        points = np.round(pixels * _FINE).astype(np.int32)
        cv2.polylines(drawn, [points[:, None]], closed, color, 1, cv2.LINE_AA, 4)

    ours = {tag.id for tag in detector.layout.tags}
    for tag in sighting.tags:
        color = _OURS if tag.id in ours else _OTHER
        line(tag.corners, color)
        _write(drawn, str(tag.id), tag.corners.max(axis=0) + 3.0, color)
    if sighting.pose is not None:
        low, high = (height + pushed.rest_height for height in height_range(pushed.colliders))
        for part in shapely.get_parts(outline(footprint(pushed.colliders))):
            around = planar_points(sighting.pose, np.asarray(part.exterior.coords)[:, :2])
            for height in (low, high):
                line(detector.camera.project(np.column_stack([around, np.full(len(around), height)])), _SHAPE)
        reach = np.sqrt(max(shapely.area(outline(footprint(pushed.colliders))), 1e-6))
        for end, color in (((reach, 0.0), _X), ((0.0, reach), _Y)):
            axis = planar_points(sighting.pose, np.array([(0.0, 0.0), end]))
            line(detector.camera.project(np.column_stack([axis, np.full(2, high)])), color, closed=False)
        x, y, yaw = sighting.pose
        text, color = f"{x:.3f} m  {y:.3f} m  {yaw:.2f} rad  ({sighting.error:.2f} px)", _OURS
    else:
        text, color = sighting.problem, _OTHER
    _write(drawn, text, np.array([8.0, image.shape[0] - 10.0]), color)
    return drawn


def _write(image: np.ndarray, text: str, at: np.ndarray, color: tuple[int, int, int]) -> None:
    """Writes text into an image, with a dark edge."""
    cv2, place = load_opencv(), (round(float(at[0])), round(float(at[1])))
    size = min(0.5, 0.5 * (image.shape[1] - 16) / max(cv2.getTextSize(text, 0, 0.5, 1)[0][0], 1))
    for shade, thickness in (((0, 0, 0), 3), (color, 1)):
        cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, shade, thickness, cv2.LINE_AA)
