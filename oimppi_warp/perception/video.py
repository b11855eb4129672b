"""Images with the times at which they were taken: from a camera, a video, or a folder of recorded images."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

import numpy as np

from oimppi_warp.errors import ConfigError, HardwareError
from oimppi_warp.perception.opencv import load_opencv

IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
"""File types of images."""
STAMPS = "stamps.json"
"""File in a folder of recorded images: the name of each, and the time at which it was taken, in seconds since 1970."""
_RATE = 30.0
"""Rate of images that say nothing about it [1/s]."""
_LATE = 1.0
"""Age beyond which the driver's time of an image is taken for something else [s]."""
_TRIES = 10
"""Number of images that a camera may fail to deliver in a row."""
_WAIT = 2000
"""Longest time to wait for an image of a RealSense camera [ms]."""


@dataclass(frozen=True, eq=False)
class Frame:
    """An image with its time.

    Attributes:
        image: BGR, shape [height, width, 3], dtype uint8.
        stamp: Time at which it was taken, in seconds since 1970.
    """

    image: np.ndarray
    stamp: float


class FrameSource(Protocol):
    """Takes images, or reads recorded ones."""

    @property
    def live(self) -> bool:
        """Returns whether a camera takes the images now."""
        ...

    def read(self) -> Frame | None:
        """Returns the next image, ``None`` after the last one.

        Raises:
            HardwareError: The camera delivers no images any more.
        """
        ...

    def close(self) -> None:
        """Ends it."""
        ...


class DeviceFrames:
    """A camera that the system knows, such as a webcam.

    Args:
        index: Its number, from 0.
        size: Width and height of the images [px]; ``None``: the camera's default.

    Raises:
        ConfigError: OpenCV is not installed.
        HardwareError: There is no such camera, or it has no images of that size.
    """

    live = True

    def __init__(self, index: int, size: tuple[int, int] | None = None) -> None:
        self._cv2, self._index = load_opencv(), index
        self._video = self._cv2.VideoCapture(index)
        if not self._video.isOpened():
            raise HardwareError(
                f"camera {index} cannot be opened\n"
                "  to do:   see that it is plugged in (ls /dev/video*), that you may use it (group video), and that no "
                "other program does"
            )
        if size is not None:
            self._video.set(self._cv2.CAP_PROP_FRAME_WIDTH, size[0])
            self._video.set(self._cv2.CAP_PROP_FRAME_HEIGHT, size[1])
        self._video.set(self._cv2.CAP_PROP_BUFFERSIZE, 1)  # the newest image, not one that waited

    def read(self) -> Frame:
        """Returns the next image.

        Raises:
            HardwareError: The camera delivers no images any more.
        """
        for _ in range(_TRIES):
            found, image = self._video.read()
            if found:
                return Frame(image, time.time() - self._age())
        raise HardwareError(f"camera {self._index} delivers no images\n  to do:   plug it in again")

    def close(self) -> None:
        """Releases the camera."""
        self._video.release()

    def _age(self) -> float:
        """Returns the time since the latest image was taken, as far as the driver tells it [s]."""
        # Video4Linux gives the time of the image on the monotonic clock; other drivers give 0 or something else.
        age = time.monotonic() - 1e-3 * self._video.get(self._cv2.CAP_PROP_POS_MSEC)
        return age if 0.0 <= age <= _LATE else 0.0


class RealSenseFrames:
    """The colour camera of an Intel RealSense, through ``pyrealsense2``.

    Args:
        size: Width and height of the images [px].

    Raises:
        ConfigError: ``pyrealsense2`` is not installed.
        HardwareError: There is no such camera.
    """

    live = True

    def __init__(self, size: tuple[int, int] | None = None) -> None:
        try:
            import pyrealsense2 as realsense  # pyright: ignore[reportMissingImports]
        except ImportError:
            raise ConfigError(
                "pyrealsense2 is not installed\n"
                "  to do:   pip install pyrealsense2, or give the number of the camera's colour device"
            ) from None
        self._module: ModuleType = realsense
        width, height = size or (640, 480)
        config = realsense.config()
        config.enable_stream(realsense.stream.color, width, height, realsense.format.bgr8, round(_RATE))
        self._pipeline: Any = realsense.pipeline()
        try:
            self._pipeline.start(config)
        except RuntimeError as error:
            raise HardwareError(
                f"the RealSense camera cannot be started: {error}\n  to do:   see `rs-enumerate-devices`"
            ) from None

    def read(self) -> Frame:
        """Returns the next image.

        Raises:
            HardwareError: The camera delivers no images any more.
        """
        try:
            frame = self._pipeline.wait_for_frames(_WAIT).get_color_frame()
        except RuntimeError as error:
            raise HardwareError(f"the RealSense camera delivers no images: {error}") from None
        domains = self._module.timestamp_domain
        known = frame.get_frame_timestamp_domain() in (domains.global_time, domains.system_time)
        return Frame(np.array(frame.get_data()), 1e-3 * frame.get_timestamp() if known else time.time())

    def close(self) -> None:
        """Stops the camera."""
        self._pipeline.stop()


class VideoFrames:
    """A recorded video.

    Args:
        file: The file.

    Raises:
        ConfigError: It cannot be read, or OpenCV is not installed.
    """

    live = False

    def __init__(self, file: Path) -> None:
        cv2 = load_opencv()
        self._video = cv2.VideoCapture(str(file))
        if not self._video.isOpened():
            raise ConfigError(f"{file}: this is no video that OpenCV can read")
        self._period = 1.0 / (self._video.get(cv2.CAP_PROP_FPS) or _RATE)
        self._began, self._count = file.stat().st_mtime, 0

    def read(self) -> Frame | None:
        """Returns the next image; the first one was taken when the file was written, as far as is known."""
        found, image = self._video.read()
        if not found:
            return None
        self._count += 1
        return Frame(image, self._began + (self._count - 1) * self._period)

    def close(self) -> None:
        """Closes the file."""
        self._video.release()


class FolderFrames:
    """A folder of images, in the order of their names, or as :class:`Recorder` wrote them.

    Args:
        folder: The folder.

    Raises:
        ConfigError: There are no images in it, its stamps cannot be read, or OpenCV is not installed.
    """

    live = False

    def __init__(self, folder: Path) -> None:
        self._cv2 = load_opencv()
        files = image_files(folder)
        stamps: dict[str, float] = {}
        if (listed := folder / STAMPS).exists():
            try:
                stamps = {str(name): float(stamp) for name, stamp in json.loads(listed.read_text()).items()}
            except (OSError, ValueError, AttributeError, TypeError):
                raise ConfigError(f"{listed}: allowed are names of images, each with its time in seconds") from None
            missing = [file.name for file in files if file.name not in stamps]
            if missing:
                raise ConfigError(
                    f"{listed}: there is no time for {missing[0]}\n"
                    f"  to do:   add it, or remove {STAMPS}: then the rate is {_RATE:g} images per second"
                )
        began = files[0].stat().st_mtime
        times = (stamps.get(file.name, began + number / _RATE) for number, file in enumerate(files))
        self._frames: Iterator[tuple[Path, float]] = iter(list(zip(files, times, strict=True)))

    def read(self) -> Frame | None:
        """Returns the next image, ``None`` after the last one.

        Raises:
            ConfigError: An image cannot be read.
        """
        file, stamp = next(self._frames, (None, 0.0))
        return None if file is None else Frame(read_image(file), stamp)

    def close(self) -> None:
        """Does nothing."""


class Recorder:
    """Writes images and their times to a folder, for :class:`FolderFrames`.

    Args:
        folder: The folder; it is made, and must be empty.

    Raises:
        ConfigError: There is something in the folder.
    """

    def __init__(self, folder: Path) -> None:
        self._cv2 = load_opencv()
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise ConfigError(f"{folder}: there is something in this folder\n  to do:   choose another one")
        self._folder = folder
        self._stamps: dict[str, float] = {}

    def write(self, frame: Frame) -> None:
        """Writes an image.

        Raises:
            OSError: It cannot be written.
        """
        name = f"{len(self._stamps):06d}.png"
        (self._folder / name).write_bytes(self._cv2.imencode(".png", frame.image)[1].tobytes())
        self._stamps[name] = frame.stamp

    def close(self) -> None:
        """Writes the times."""
        (self._folder / STAMPS).write_text(json.dumps(self._stamps, indent=0) + "\n")


def open_frames(camera: str, *, size: tuple[int, int] | None = None) -> FrameSource:
    """Returns a source of images by its name.

    Args:
        camera: Number of a camera, ``realsense``, a video file, or a folder of images.
        size: Width and height that a camera's images shall have [px].

    Raises:
        ConfigError: There is no such source, or a package that it needs is not installed.
        HardwareError: The camera cannot be used.
    """
    if camera.isdecimal():
        return DeviceFrames(int(camera), size)
    if camera == "realsense":
        return RealSenseFrames(size)
    path = Path(camera)
    if path.is_dir():
        return FolderFrames(path)
    if path.is_file():
        return VideoFrames(path)
    raise ConfigError(
        f"--camera {camera}: there is no such file or folder\n"
        "  allowed: the number of a camera (0 is the first), realsense, a video file, or a folder of images"
    )


def image_files(folder: Path) -> list[Path]:
    """Returns the images in a folder, in the order of their names.

    Raises:
        ConfigError: There is no such folder, or no image in it.
    """
    if not folder.is_dir():
        raise ConfigError(f"{folder}: there is no such folder")
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() in IMAGES)
    if not files:
        raise ConfigError(f"{folder}: there are no images in this folder\n  allowed: {', '.join(IMAGES)}")
    return files


def read_image(file: Path) -> np.ndarray:
    """Returns an image as BGR, shape [height, width, 3].

    Raises:
        ConfigError: It cannot be read, or OpenCV is not installed.
    """
    image = load_opencv().imread(str(file))
    if image is None:
        raise ConfigError(f"{file}: this is no image that OpenCV can read")
    return image
