"""A display that keeps what is drawn on it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from oimppi_warp.scene import Scene


class Drawn:
    """A :class:`oimppi_warp.view.display.Display` without a picture.

    Attributes:
        scenes: The scenes that were loaded.
        segments: The latest line segments by name, shape [n, 2, 3] [m].
        dots: The latest points by name, shape [n, 3] [m].
        colors: All colours of lines and points.
    """

    def __init__(self) -> None:
        self.scenes: list[Scene] = []
        self.segments: dict[str, np.ndarray] = {}
        self.dots: dict[str, np.ndarray] = {}
        self.colors: set[tuple[float, float, float]] = set()

    @contextmanager
    def frame(self, time: float) -> Iterator[None]:
        yield

    def load(self, scene: Scene) -> None:
        self.scenes.append(scene)

    def pose(self, joints: np.ndarray, object_transform: np.ndarray) -> None:
        pass

    def lines(self, name: str, segments: np.ndarray, colors: np.ndarray, width: float) -> None:
        assert colors.shape == (len(segments), 3)
        self.segments[name] = segments
        self.colors |= {(red, green, blue) for red, green, blue in np.unique(colors, axis=0).tolist()}

    def points(self, name: str, points: np.ndarray, radius: float, color: tuple[float, float, float]) -> None:
        self.dots[name] = points
        self.colors.add(color)
