"""Draws on one of Newton's viewers: into a USD file, or in Rerun."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from oimppi_warp.compute.loading import quick_compilation
from oimppi_warp.scene import Scene
from oimppi_warp.view.display import Color
from oimppi_warp.view.posed_scene import PosedScene

if TYPE_CHECKING:
    from newton.viewer import ViewerBase

_WIDTH = 1e-3
"""Width of a line in the units of these viewers, per pixel."""
_NO_LENGTH = 1e-5
"""Length given to segments without one, since viewers divide by it [m]."""


class NewtonDisplay:
    """One of Newton's viewers as a :class:`oimppi_warp.view.display.Display`.

    Args:
        viewer: The viewer.
    """

    def __init__(self, viewer: ViewerBase) -> None:
        self._viewer: Any = viewer

    @contextmanager
    def frame(self, time: float) -> Iterator[None]:
        """Shows at once what is drawn within the block, at a time since the start of the episode [s]."""
        self._viewer.begin_frame(time)
        yield
        self._viewer.end_frame()

    def load(self, scene: Scene) -> None:
        """Replaces the scene."""
        with quick_compilation():  # of Newton's kernels; a planner compiles some of them like this, too
            self._posed = PosedScene(scene)
            self._viewer.set_model(self._posed.model)
        self._first = True

    def pose(self, joints: np.ndarray, object_transform: np.ndarray) -> None:
        """Moves arm and object; see :meth:`oimppi_warp.view.display.Display.pose`."""
        if self._first:
            self._first = False
            with quick_compilation():
                self._log(joints, object_transform)
            with quick_compilation():  # the second call needs a kernel whose module the first call imports
                self._log(joints, object_transform)
        else:
            self._log(joints, object_transform)

    def lines(self, name: str, segments: np.ndarray, colors: np.ndarray, width: float) -> None:
        """Draws line segments; see :meth:`oimppi_warp.view.display.Display.lines`."""
        ends = segments[:, 1].copy()
        ends[np.all(segments[:, 0] == ends, axis=1), 2] += _NO_LENGTH
        arrays = [_vectors(values) for values in (segments[:, 0], ends, colors)]
        self._viewer.log_lines(f"/oimppi/{name}", *arrays, width=_WIDTH * width)

    def points(self, name: str, points: np.ndarray, radius: float, color: Color) -> None:
        """Draws points of one colour; see :meth:`oimppi_warp.view.display.Display.points`."""
        radii = wp.full(len(points), radius, dtype=float, device="cpu")
        colors = _vectors(np.tile(color, (len(points), 1)))
        self._viewer.log_points(f"/oimppi/{name}", _vectors(points), radii, colors)

    def _log(self, joints: np.ndarray, object_transform: np.ndarray) -> None:
        self._posed.pose(joints, object_transform)
        self._viewer.log_state(self._posed.state)


def _vectors(values: np.ndarray) -> wp.array:
    return wp.array(np.asarray(values, dtype=np.float32), dtype=wp.vec3, device="cpu")
