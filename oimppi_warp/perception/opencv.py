"""OpenCV, which the extra ``perception`` installs, loaded when it is needed."""

from __future__ import annotations

import math
from functools import cache
from types import ModuleType

import numpy as np

from oimppi_warp.errors import ConfigError, missing_package

_PIXELS = 3e6
"""Number of pixels up to which images are enlarged."""
_LARGEST_ZOOM = 3
"""Largest factor by which images are enlarged."""


@cache
def load_opencv() -> ModuleType:
    """Returns the module ``cv2``, limited to one thread: the planner needs the others.

    Raises:
        ConfigError: OpenCV is not installed, cannot be loaded, or has another version than is needed.
    """
    try:
        import cv2
    except ImportError as error:
        if error.name == "cv2":
            raise missing_package("perception", "OpenCV", "perception") from None
        raise ConfigError(
            f"OpenCV cannot be loaded: {error}\n"
            "  to do:   install the library that is missing (on Debian and Ubuntu: apt install libgl1 libglib2.0-0)"
        ) from None
    version = tuple(map(int, cv2.__version__.split(".")[:2]))
    if not (4, 13) <= version < (5, 0):
        raise ConfigError(
            f"OpenCV {cv2.__version__} cannot be used: allowed are versions from 4.13 to below 5\n"
            "  to do:   pip install 'oimppi-warp[perception]', without opencv-python-headless beside it"
        )
    cv2.setNumThreads(1)
    return cv2


def enlarged(grey: np.ndarray) -> tuple[np.ndarray, int]:
    """Enlarges a small image, in which small markers are found, and their edges fitted, more exactly.

    A pixel p of the given image is at ``(p + 0.5) * zoom - 0.5`` in the enlarged one.

    Returns:
        The enlarged image, and the whole factor by which it is larger.
    """
    cv2, zoom = load_opencv(), int(np.clip(math.sqrt(_PIXELS / grey.size), 1, _LARGEST_ZOOM))
    if zoom == 1:
        return grey, 1
    return cv2.resize(grey, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC), zoom


def marker_parameters(*, edges: bool) -> object:
    """Returns OpenCV's parameters for finding markers that are small and somewhat blurred.

    Args:
        edges: Whether to fit lines along the markers' edges, which is the most exact for single markers.
    """
    aruco = load_opencv().aruco
    parameters = aruco.DetectorParameters()
    parameters.polygonalApproxAccuracyRate = 0.05  # blurred corners are round
    parameters.perspectiveRemovePixelPerCell = 8
    parameters.perspectiveRemoveIgnoredMarginPerCell = 0.3  # blurred modules run into each other at their edges
    if edges:
        parameters.cornerRefinementMethod = aruco.CORNER_REFINE_CONTOUR
    return parameters
