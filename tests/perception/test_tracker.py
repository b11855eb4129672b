"""The object's poses from images, in the background: as a source of poses, and published."""

from __future__ import annotations

import time

import numpy as np
import pytest
from support import rendered, small_tasks

from oimppi_warp.errors import HardwareError
from oimppi_warp.perception.pose_source import PoseSource
from oimppi_warp.perception.tag_detector import TagDetector
from oimppi_warp.perception.tags import layout_of
from oimppi_warp.perception.tracker import CameraPoses
from oimppi_warp.perception.video import Frame

PATH = np.array([[0.40, 0.10 + 0.02 * i, 0.2] for i in range(6)])
STAMP = 1000.0


class Images:
    """A source of images in memory."""

    live = False

    def __init__(self, frames: list[Frame], *, failing: bool = False) -> None:
        self._frames, self._failing, self.closed = iter(frames), failing, False

    def read(self) -> Frame | None:
        frame = next(self._frames, None)
        if frame is None and self._failing:
            raise HardwareError("the cable is out\n  to do:   plug it in")
        return frame

    def close(self) -> None:
        self.closed = True


@pytest.fixture(scope="module")
def detector() -> TagDetector:
    scene = small_tasks.shipped("lab01")
    return TagDetector(rendered.lab_camera(), layout_of(scene.object), scene.object.rest_height)


@pytest.fixture(scope="module")
def frames(detector: TagDetector) -> list[Frame]:
    """The can on its way, a fifth of a second apart; in the last image it is gone."""
    renderer, scene = rendered.Renderer(rendered.lab_camera(), seed=4), small_tasks.shipped("lab01")
    images = [renderer.image(rendered.standing(pose, detector.layout, scene)) for pose in PATH] + [renderer.image([])]
    return [Frame(image, STAMP + 0.2 * i) for i, image in enumerate(images)]


def test_poses_are_published_with_the_times_of_their_images(detector, frames):
    published: list[tuple[np.ndarray, float]] = []
    images = Images(frames)
    poses: PoseSource = CameraPoses(
        images, detector, publish=[lambda pose, stamp: published.append((pose, stamp))], hurry=True
    )
    assert isinstance(poses, CameraPoses)
    poses.wait(30.0)
    assert not poses.running and images.closed
    np.testing.assert_allclose([pose[:2] for pose, _ in published], PATH[:, :2], atol=0.003)
    np.testing.assert_allclose([stamp for _, stamp in published], STAMP + 0.2 * np.arange(6), atol=1e-9)
    assert (poses.images, poses.found) == (7, 6)


def test_the_newest_poses_are_there_for_a_plant_and_the_reason_when_there_are_none(detector, frames):
    poses = CameraPoses(Images(frames[:-1]), detector, hurry=True)
    poses.wait(30.0)
    np.testing.assert_allclose([each.pose[:2] for each in poses.poses], PATH[-4:, :2], atol=0.003)
    assert poses.poses[-1].stamp == pytest.approx(STAMP + 1.0)
    assert poses.problem == "there are no more images"
    empty = CameraPoses(Images(frames[-1:]), detector, hurry=True, limit=1)
    empty.wait(30.0)
    assert empty.poses == [] and "no tag is seen" in empty.problem


def test_replayed_images_keep_their_pace_and_have_the_present_time(detector, frames):
    began = time.time()
    poses = CameraPoses(Images(frames[:3]), detector)
    poses.wait(30.0)
    stamps = [each.stamp for each in poses.poses]
    np.testing.assert_allclose(np.diff(stamps), 0.2, atol=1e-6)
    assert stamps[0] >= began
    assert all(each.age >= 0.0 for each in poses.poses)
    assert poses.poses[-1].arrived - poses.poses[0].arrived > 0.2


def test_a_camera_that_fails_is_told_to_whoever_waits_and_whoever_asks(detector, frames):
    poses = CameraPoses(Images(frames[:1], failing=True), detector, hurry=True)
    with pytest.raises(HardwareError, match="the cable is out"):
        poses.wait(30.0)
    assert poses.problem == "the cable is out" and poses.found == 1


def test_closing_ends_it_between_two_images(detector, frames):
    far_apart = [frames[0], Frame(frames[1].image, STAMP + 4.0)]
    images = Images(far_apart)
    poses = CameraPoses(images, detector)
    poses.close()
    assert not poses.running and images.closed and poses.images <= 1
