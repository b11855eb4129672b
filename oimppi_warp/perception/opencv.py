"""OpenCV, which the extra ``perception`` installs, loaded when it is needed."""

from __future__ import annotations

from functools import cache
from types import ModuleType

from oimppi_warp.errors import ConfigError


@cache
def load_opencv() -> ModuleType:
    """Returns the module ``cv2``, limited to one thread: the planner needs the others.

    Raises:
        ConfigError: OpenCV is not installed, or cannot be loaded.
    """
    try:
        import cv2
    except ImportError as error:
        if error.name == "cv2":
            raise ConfigError("OpenCV is not installed\n  to do:   pip install 'oimppi-warp[perception]'") from None
        raise ConfigError(
            f"OpenCV cannot be loaded: {error}\n"
            "  to do:   install the library that is missing (on Debian and Ubuntu: apt install libgl1 libglib2.0-0)"
        ) from None
    cv2.setNumThreads(1)
    return cv2
