"""Images with their times: recorded ones, videos, and cameras that are not there."""

from __future__ import annotations

import json
import sys
import time

import cv2
import numpy as np
import pytest
from support.fake_realsense import FakeRealSense

from oimppi_warp.errors import ConfigError, HardwareError
from oimppi_warp.perception.video import STAMPS, Frame, Recorder, open_frames

SIZE = (64, 48)


def pictures(count: int) -> list[np.ndarray]:
    return [np.full((SIZE[1], SIZE[0], 3), 10 + 20 * i, np.uint8) for i in range(count)]


def read_all(name: str) -> list[Frame]:
    frames, found = open_frames(name), []
    while (frame := frames.read()) is not None:
        found.append(frame)
    frames.close()
    return found


def test_recorded_images_come_back_with_their_times(tmp_path):
    recorder = Recorder(tmp_path / "run")
    frames = [Frame(image, 1000.0 + 0.25 * i) for i, image in enumerate(pictures(4))]
    for frame in frames:
        recorder.write(frame)
    recorder.close()
    found = read_all(str(tmp_path / "run"))
    assert [frame.stamp for frame in found] == [frame.stamp for frame in frames]
    for again, frame in zip(found, frames, strict=True):
        np.testing.assert_array_equal(again.image, frame.image)
    assert not open_frames(str(tmp_path / "run")).live


def test_images_without_times_are_thirty_per_second(tmp_path):
    for number, image in enumerate(pictures(3)):
        cv2.imwrite(str(tmp_path / f"{number}.jpg"), image)
    (tmp_path / "notes.txt").write_text("no image")
    stamps = [frame.stamp for frame in read_all(str(tmp_path))]
    np.testing.assert_allclose(np.diff(stamps), 1 / 30, atol=1e-6)


def test_a_video_is_read_at_its_rate(tmp_path):
    file = tmp_path / "run.avi"
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, SIZE)
    for image in pictures(5):
        writer.write(image)
    writer.release()
    found = read_all(str(file))
    np.testing.assert_allclose(np.diff([frame.stamp for frame in found]), 0.1, atol=1e-6)
    assert [round(float(frame.image.mean()) / 10) for frame in found] == [1, 3, 5, 7, 9]


def test_a_recording_never_mixes_with_what_is_in_a_folder(tmp_path):
    (tmp_path / "000000.png").write_text("")
    with pytest.raises(ConfigError, match="there is something in this folder"):
        Recorder(tmp_path)


@pytest.mark.parametrize("listed", ["[1, 2]", "{", '{"0.png": "noon"}'])
def test_times_that_cannot_be_read_are_refused(tmp_path, listed: str):
    cv2.imwrite(str(tmp_path / "0.png"), pictures(1)[0])
    (tmp_path / STAMPS).write_text(listed)
    with pytest.raises(ConfigError, match=STAMPS):
        open_frames(str(tmp_path))


def test_an_image_without_a_time_among_others_is_refused(tmp_path):
    for name in ("0.png", "1.png"):
        cv2.imwrite(str(tmp_path / name), pictures(1)[0])
    (tmp_path / STAMPS).write_text(json.dumps({"0.png": 1.0}))
    with pytest.raises(ConfigError, match=r"there is no time for 1\.png"):
        open_frames(str(tmp_path))


def test_what_is_no_image_and_no_video_is_refused(tmp_path):
    (tmp_path / "0.png").write_text("text")
    with pytest.raises(ConfigError, match="no image that OpenCV can read"):
        open_frames(str(tmp_path)).read()
    (tmp_path / "run.mp4").write_text("text")
    with pytest.raises(ConfigError, match="no video that OpenCV can read"):
        open_frames(str(tmp_path / "run.mp4"))
    (tmp_path / "empty").mkdir()
    with pytest.raises(ConfigError, match="there are no images"):
        open_frames(str(tmp_path / "empty"))
    with pytest.raises(ConfigError, match="allowed: the number of a camera"):
        open_frames(str(tmp_path / "none"))


def test_a_camera_that_is_not_there_is_refused_with_what_to_look_for():
    with pytest.raises(HardwareError, match="camera 97 cannot be opened\n  to do:   see that it is plugged in"):
        open_frames("97")


def test_without_the_wheel_of_realsense_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(ConfigError, match="pip install pyrealsense2"):
        open_frames("realsense")


class FakeVideo:
    """A camera that OpenCV has opened."""

    def __init__(self, milliseconds: float, *, images: int = 1) -> None:
        self._milliseconds, self._images, self.set = milliseconds, images, lambda *_: True

    def isOpened(self) -> bool:
        return True

    def get(self, _) -> float:
        return self._milliseconds

    def read(self):
        self._images -= 1
        return (True, pictures(1)[0]) if self._images >= 0 else (False, None)

    def release(self) -> None:
        pass


def test_an_image_has_the_time_that_the_driver_tells(monkeypatch):
    driver = 1e3 * (time.monotonic() - 0.3)
    monkeypatch.setattr(cv2, "VideoCapture", lambda _: FakeVideo(driver))
    frame = open_frames("0").read()
    assert frame is not None and time.time() - frame.stamp >= 0.3


@pytest.mark.parametrize("told", [0.0, 1e15])
def test_an_image_whose_driver_tells_nothing_has_the_time_of_arrival(monkeypatch, told: float):
    monkeypatch.setattr(cv2, "VideoCapture", lambda _: FakeVideo(told))
    before = time.time()
    frame = open_frames("0").read()
    assert frame is not None and before <= frame.stamp <= time.time()


def test_a_camera_that_delivers_nothing_any_more_is_told(monkeypatch):
    monkeypatch.setattr(cv2, "VideoCapture", lambda _: FakeVideo(0.0, images=1))
    frames = open_frames("0")
    assert frames.read() is not None
    with pytest.raises(HardwareError, match="camera 0 delivers no images\n  to do:   plug it in again"):
        frames.read()


def test_a_realsense_is_read_with_the_time_of_its_images(monkeypatch):
    camera = FakeRealSense()
    monkeypatch.setitem(sys.modules, "pyrealsense2", camera)
    frames = open_frames("realsense", size=(1280, 720))
    assert frames.live and camera.asked == ("color", 1280, 720, "bgr8", 30)
    frame = frames.read()
    assert frame is not None and frame.stamp == pytest.approx(1_700_000_000.25)
    assert frame.image.shape == (720, 1280, 3)
    frames.close()
    assert camera.stopped


def test_a_realsense_whose_clock_is_its_own_gives_the_time_of_arrival(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyrealsense2", FakeRealSense(domain="hardware"))
    before = time.time()
    frame = open_frames("realsense").read()
    assert frame is not None and before <= frame.stamp <= time.time()


def test_a_realsense_that_is_not_connected_is_refused(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyrealsense2", FakeRealSense(broken=True))
    with pytest.raises(HardwareError, match="cannot be started: No device connected"):
        open_frames("realsense")
