"""The interface of a display: a page in the browser, or one of Newton's viewers."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Protocol

import numpy as np

from oimppi_warp.scene import Scene

Color = tuple[float, float, float]
"""Red, green and blue from 0 to 1."""


class Display(Protocol):
    """Shows a scene with its arm and object where they are, and lines and points by their names."""

    def frame(self, time: float) -> AbstractContextManager[None]:
        """Shows at once what is drawn within the block.

        Args:
            time: Time since the start of the episode [s].
        """
        ...

    def load(self, scene: Scene) -> None:
        """Replaces the scene."""
        ...

    def pose(self, joints: np.ndarray, object_transform: np.ndarray) -> None:
        """Moves arm and object.

        Args:
            joints: Joint positions, shape [dof] [rad; m for a prismatic joint].
            object_transform: Position [m] and quaternion xyzw of the object's frame, shape [7].
        """
        ...

    def lines(self, name: str, segments: np.ndarray, colors: np.ndarray, width: float) -> None:
        """Draws line segments; the arrays must not be changed afterwards.

        Args:
            name: Name of the lines; others of this name are replaced.
            segments: Their ends, shape [n, 2, 3] [m].
            colors: Their colours, shape [n, 3], from 0 to 1.
            width: Width [pixels]; displays without pixels take a millimetre for one.
        """
        ...

    def points(self, name: str, points: np.ndarray, radius: float, color: Color) -> None:
        """Draws points of one colour.

        Args:
            name: Name of the points; others of this name are replaced.
            points: Where they are, shape [n, 3] [m].
            radius: Their radius [m].
            color: Their colour.
        """
        ...
