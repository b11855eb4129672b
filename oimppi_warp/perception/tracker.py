"""The object's poses from a camera, detected in the background: a source of poses for a plant, or for a server."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack

import numpy as np

from oimppi_warp.errors import OimppiError
from oimppi_warp.perception.pose_source import StampedPose
from oimppi_warp.perception.tag_detector import Sighting, TagDetector
from oimppi_warp.perception.video import Frame, FrameSource

Publish = Callable[[np.ndarray, float], None]
"""Sends a planar pose, shape [3] [m, m, rad], that the object had at a time in seconds since 1970."""
_KEPT = 4
"""Number of the latest poses that are kept."""
_LONGEST_GAP = 5.0
"""Longest time that is waited between two recorded images [s]."""


class CameraPoses:
    """Detects the object in the images of a camera, in a thread of its own; a :class:`PoseSource`.

    Recorded images are replayed at the pace at which they were taken, with the present time, unless ``hurry`` is set.

    Args:
        frames: Source of the images, which is closed at the end.
        detector: Detects the object in them.
        publish: Functions that are called with each pose.
        on_sighting: Is called with each image and what was found in it; ``None``: nobody looks.
        hurry: Whether recorded images are worked through without waiting, and keep their times.
        limit: Number of images after which to stop; ``None``: none.

    Attributes:
        images: Number of images so far.
        found: Number of images in which the object was found.
    """

    def __init__(
        self,
        frames: FrameSource,
        detector: TagDetector,
        *,
        publish: Sequence[Publish] = (),
        on_sighting: Callable[[Frame, Sighting], None] | None = None,
        hurry: bool = False,
        limit: int | None = None,
    ) -> None:
        self._frames, self._detector, self._publish, self._on_sighting = frames, detector, publish, on_sighting
        self._paced, self._limit = not frames.live and not hurry, limit
        self._poses: deque[StampedPose] = deque(maxlen=_KEPT)
        self._problem = "no image has arrived yet"
        self._failure: Exception | None = None
        self.images = self.found = 0
        self._stop, self._ended = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="oimppi-camera", daemon=True)
        self._thread.start()

    @property
    def poses(self) -> list[StampedPose]:
        """Returns the newest poses, the latest last."""
        return list(self._poses)

    @property
    def problem(self) -> str:
        """Returns why no poses arrive at present; empty if none is known."""
        return self._problem

    @property
    def running(self) -> bool:
        """Returns whether there may be more images."""
        return not self._ended.is_set()

    def wait(self, timeout: float | None = None) -> None:
        """Waits until there are no more images.

        Args:
            timeout: Longest time to wait [s].

        Raises:
            OimppiError: The images cannot be used, or do not come any more.
        """
        # Not a join: one that Ctrl-C interrupts takes the thread for ended (Python 3.11, bpo-45274).
        self._ended.wait(timeout)
        if self._failure is not None:
            raise self._failure

    def close(self) -> None:
        """Stops detecting."""
        self._stop.set()
        if self._ended.wait(5.0):
            self._thread.join()

    def _run(self) -> None:
        with ExitStack() as at_the_end:
            at_the_end.callback(self._ended.set)
            at_the_end.callback(self._frames.close)
            try:
                self._detect_all()
            except OimppiError as error:
                self._problem, self._failure = str(error).partition("\n")[0], error
            except Exception as error:  # it must not end in silence: whoever waits gets it
                self._problem, self._failure = f"the detection failed: {error!r}", error

    def _detect_all(self) -> None:
        shift = None
        while not self._stop.is_set() and self.images != self._limit:
            frame = self._frames.read()
            if frame is None:
                self._problem = "there are no more images"
                return
            if self._paced:
                if shift is None or frame.stamp + shift > time.time() + _LONGEST_GAP:
                    shift = time.time() - frame.stamp
                self._stop.wait(max(frame.stamp + shift - time.time(), 0.0))
                frame = Frame(frame.image, frame.stamp + shift)
            self._take(frame)

    def _take(self, frame: Frame) -> None:
        """Detects the object in an image."""
        sighting = self._detector.detect(frame.image)
        self.images += 1
        self._problem = sighting.problem
        if sighting.pose is not None:
            self.found += 1
            self._poses.append(StampedPose(sighting.pose, time.monotonic(), time.time() - frame.stamp, frame.stamp))
            for publish in self._publish:
                publish(sighting.pose, frame.stamp)
        if self._on_sighting is not None:
            self._on_sighting(frame, sighting)
