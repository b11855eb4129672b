"""The camera's model: pixels and points, and the file with its calibration."""

from __future__ import annotations

import re
import sys

import cv2
import numpy as np
import pytest
from support import rendered

from oimppi_warp.errors import ConfigError
from oimppi_warp.perception import opencv
from oimppi_warp.perception.camera_model import CameraModel, load_camera

LENS = (
    "image_size = [640, 480]\nfocal_length = [554, 554]\nprincipal_point = [320, 240]\ndistortion = [0, 0, 0, 0, 0]\n"
)


def test_a_camera_that_looks_straight_down_sees_a_point_where_similar_triangles_say():
    # u = cx + fx X / Z: 0.1 m beside the axis, 0.5 m away. Image x is world x, image y is -world y.
    camera = CameraModel((640, 480), (500.0, 500.0), (320.0, 240.0)).placed(np.array([0.4, 0.1, 0.6, 1, 0, 0, 0]))
    np.testing.assert_allclose(camera.project(np.array([[0.5, 0.1, 0.1]])), [[420.0, 240.0]], atol=1e-9)
    np.testing.assert_allclose(camera.project(np.array([[0.4, 0.2, 0.1]])), [[320.0, 140.0]], atol=1e-9)


def test_a_pixel_of_a_point_leads_back_to_the_point():
    camera = rendered.lab_camera()
    points = np.array([[0.3, 0.2, 0.1], [0.5, -0.4, 0.1], [0.38, 0.0, 0.1]])
    np.testing.assert_allclose(camera.on_plane(camera.project(points), 0.1), points[:, :2], atol=1e-5)


def test_a_calibration_is_the_same_after_writing_and_reading(tmp_path):
    camera = rendered.lab_camera()
    camera.save(tmp_path / "deep" / "camera.toml")
    read = load_camera(tmp_path / "deep" / "camera.toml")
    assert (read.image_size, read.focal_length) == (camera.image_size, camera.focal_length)
    np.testing.assert_allclose(read.distortion, camera.distortion, atol=1e-12)
    assert read.pose is not None and camera.pose is not None
    np.testing.assert_allclose(read.pose, camera.pose, atol=1e-9)


def test_a_calibration_of_the_lens_alone_has_no_place(tmp_path):
    (tmp_path / "camera.toml").write_text(LENS)
    camera = load_camera(tmp_path / "camera.toml")
    assert camera.pose is None
    with pytest.raises(ConfigError, match="oimppi perceive calibrate table"):
        camera.project(np.zeros((1, 3)))


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("image_size = [640", "cannot be read"),
        (LENS.replace("[640, 480]", "640"), "image_size = 640 cannot be used"),
        (LENS.replace("[0, 0, 0, 0, 0]", "[0, 0]"), "a list of 5 numbers"),
        (LENS.replace("[554, 554]", "[554, nan]"), "focal_length"),
        (LENS.replace("[554, 554]", "[554, 0]"), "above zero"),
        (LENS.replace("principal_point", "center"), "center is no entry"),
        ("\n".join(LENS.splitlines()[:2]), "principal_point is missing"),
        (LENS + "position = [0, 0, 1]\n", "quaternion is missing"),
        (LENS + "position = [0, 0, 1]\nquaternion = [1, 1, 0, 0]\n", "length 1.414"),
    ],
)
def test_a_broken_calibration_is_refused_with_its_name(tmp_path, text: str, wrong: str):
    file = tmp_path / "camera.toml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=wrong) as refused:
        load_camera(file)
    assert str(file) in str(refused.value)


def test_a_missing_calibration_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="there is no such file"):
        load_camera(tmp_path / "camera.toml")


def test_without_opencv_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "cv2", None)
    opencv.load_opencv.cache_clear()
    with pytest.raises(ConfigError) as refused:
        rendered.lab_camera().project(np.zeros((1, 3)))
    assert "pip install 'oimppi-warp[perception]'" in str(refused.value)


@pytest.mark.parametrize("version", ["4.6.0", "5.0.1"])
def test_another_version_of_opencv_is_refused(monkeypatch, version: str):
    monkeypatch.setattr(cv2, "__version__", version)
    opencv.load_opencv.cache_clear()
    with pytest.raises(ConfigError, match=f"OpenCV {re.escape(version)} cannot be used"):
        opencv.load_opencv()


def test_an_opencv_that_lacks_a_library_of_the_system_is_not_called_missing(tmp_path, monkeypatch):
    (tmp_path / "cv2.py").write_text("raise ImportError('libGL.so.1: cannot open shared object file')")
    monkeypatch.delitem(sys.modules, "cv2", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    opencv.load_opencv.cache_clear()
    with pytest.raises(ConfigError, match=r"libGL\.so\.1(.|\n)*apt install"):
        opencv.load_opencv()
