"""The part of ``pyrealsense2`` that is used, with a camera of which every image is grey."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np


class FakeRealSense:
    """Stands for the module, and for a camera whose images are a thirtieth of a second apart.

    Attributes:
        asked: What the camera was asked for.
        stopped: Whether it was stopped.
    """

    timestamp_domain = SimpleNamespace(global_time="global", system_time="system", hardware_clock="hardware")
    stream, format = SimpleNamespace(color="color"), SimpleNamespace(bgr8="bgr8")

    def __init__(self, domain: str = "global", broken: bool = False) -> None:
        self.domain, self.broken, self.stopped = domain, broken, False
        self.asked: tuple[Any, ...] = ()
        self._count = 0

    def config(self) -> SimpleNamespace:
        return SimpleNamespace(enable_stream=lambda *asked: setattr(self, "asked", asked))

    def pipeline(self) -> FakeRealSense:
        return self

    def start(self, config: object) -> None:
        if self.broken:
            raise RuntimeError("No device connected")

    def stop(self) -> None:
        self.stopped = True

    def wait_for_frames(self, timeout: int) -> SimpleNamespace:
        _, width, height, *_ = self.asked
        stamp = 1_700_000_000_250.0 + 1e3 * self._count / 30
        self._count += 1
        color = SimpleNamespace(
            get_data=lambda: np.full((height, width, 3), 128, np.uint8),
            get_timestamp=lambda: stamp,
            get_frame_timestamp_domain=lambda: self.domain,
        )
        return SimpleNamespace(get_color_frame=lambda: color)
