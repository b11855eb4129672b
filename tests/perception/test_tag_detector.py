"""The object's pose from images of its tags, rendered as the lab's camera sees them: how exactly, and when not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support import rendered, small_tasks
from support.rendered import Conditions, Renderer

from oimppi_warp.errors import ConfigError
from oimppi_warp.geometry.footprint import wrap_angle
from oimppi_warp.perception.tag_detector import TagDetector
from oimppi_warp.perception.tags import Tag, TagLayout, layout_of
from oimppi_warp.scene import Scene

POSITION, YAW = 0.003, np.radians(1.0)
"""Bounds of the median errors [m, rad]."""
POSITION_P95, YAW_P95 = 0.004, np.radians(2.0)
"""Bounds of the errors in 95 of 100 images [m, rad]."""
POSE = np.array([0.42, 0.11, 0.6])


@pytest.fixture(scope="module")
def scene() -> Scene:
    return small_tasks.shipped("lab01")


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer(rendered.lab_camera(), seed=1)


def detector(scene: Scene, layout: TagLayout | None = None) -> TagDetector:
    return TagDetector(rendered.lab_camera(), layout or layout_of(scene.object), scene.object.rest_height)


def errors(scene: Scene, renderer: Renderer, layout: TagLayout, conditions: Conditions, count: int) -> np.ndarray:
    """Errors of position [m] and yaw [rad] at drawn poses, shape [found, 2]."""
    random, found, finds = np.random.default_rng(7), [], detector(scene, layout)
    for _ in range(count):
        pose = rendered.drawn_pose(random)
        seen = finds.detect(renderer.image(rendered.standing(pose, layout, scene), conditions))
        if seen.pose is not None:
            off = seen.pose - pose
            found.append((np.hypot(off[0], off[1]), abs(wrap_angle(off[2]))))
    return np.array(found)


def assert_close(pose: np.ndarray | None, expected: np.ndarray, *, position: float = 0.002, yaw: float = 0.04) -> None:
    """Fails unless two poses agree within bounds [m, rad]."""
    assert pose is not None
    off = pose - expected
    assert np.hypot(off[0], off[1]) <= position and abs(wrap_angle(off[2])) <= yaw, off


def report(found: np.ndarray, count: int) -> str:
    """The errors in words."""
    unit = found * [1e3, np.degrees(1.0)]
    middle, most = np.median(unit, axis=0), np.percentile(unit, 95, axis=0)
    return (
        f"{len(found)} of {count} found; position median {middle[0]:.2f} mm, p95 {most[0]:.2f} mm; "
        f"yaw median {middle[1]:.2f} degrees, p95 {most[1]:.2f} degrees"
    )


@pytest.mark.parametrize(
    ("family", "conditions", "share"),
    [
        ("apriltag36h11", rendered.ORDINARY, 0.99),
        ("apriltag36h11", Conditions(noise=6.0, light=0.3, slope=0.8), 0.8),
        pytest.param("apriltag36h11", Conditions(blur=1.0), 0.8, marks=pytest.mark.slow),
        ("aruco6x6", Conditions(blur=1.2), 0.9),
    ],
    ids=["ordinary", "dark and noisy", "blurred", "aruco, more blurred"],
)
def test_the_can_is_found_within_three_millimetres_and_a_degree(scene, renderer, family, conditions, share):
    count = 60 if conditions == rendered.ORDINARY else 30
    found = errors(scene, renderer, layout_of(scene.object, family=family), conditions, count)
    print(report(found, count))
    assert len(found) >= share * count
    assert np.median(found[:, 0]) <= POSITION and np.median(found[:, 1]) <= YAW, report(found, count)
    assert np.percentile(found[:, 0], 95) <= POSITION_P95, report(found, count)
    assert np.percentile(found[:, 1], 95) <= YAW_P95, report(found, count)


def test_a_camera_two_millimetres_beside_its_calibration_moves_the_pose_by_as_much(scene, renderer):
    camera = rendered.lab_camera()
    assert camera.pose is not None
    off = TagDetector(
        camera.placed(camera.pose + [0.002, 0, 0, 0, 0, 0, 0]), layout_of(scene.object), scene.object.rest_height
    )
    seen = off.detect(renderer.image(rendered.standing(POSE, off.layout, scene))).pose
    assert_close(seen, POSE + [0.002, 0.0, 0.0], position=0.0005)


def test_tags_anywhere_on_the_object_give_the_pose_of_its_frame(scene, renderer):
    aside = TagLayout("apriltag36h11", (Tag(4, 0.024, (0.008, -0.006, 0.0505), 2.5),))
    seen = detector(scene, aside).detect(renderer.image(rendered.standing(POSE, aside, scene))).pose
    assert_close(seen, POSE)


def test_with_two_tags_the_one_that_is_not_hidden_suffices_and_both_are_used(scene, renderer):
    two = TagLayout("aruco5x5", (Tag(1, 0.024, (0.0, 0.015, 0.0505)), Tag(2, 0.024, (0.0, -0.015, 0.0505), np.pi / 2)))
    one = replace(two, tags=two.tags[:1])
    finds = detector(scene, two)
    both = finds.detect(renderer.image(rendered.standing(POSE, two, scene)))
    single = finds.detect(renderer.image(rendered.standing(POSE, one, scene)))
    assert sorted(tag.id for tag in both.tags) == [1, 2] and [tag.id for tag in single.tags] == [1]
    for seen in (both, single):
        assert_close(seen.pose, POSE)


def test_a_tag_with_a_hidden_corner_is_not_found_and_the_reason_is_told(scene, renderer):
    finds = detector(scene)
    x, y, _ = POSE
    thumb = rendered.Patch(np.full((2, 2), 150, np.uint8), (0.03, 0.03), np.array([x + 0.025, y, 0.104, 0, 0, 0, 1]))
    seen = finds.detect(renderer.image([*rendered.standing(POSE, finds.layout, scene), thumb]))
    assert seen.pose is None and np.isnan(seen.error)
    assert "no tag is seen" in seen.problem and "hidden" in seen.problem


def test_an_image_without_the_object_gives_no_pose(scene, renderer):
    seen = detector(scene).detect(renderer.image([]))
    assert seen.pose is None and "no tag is seen, of apriltag36h11 0" in seen.problem


def test_an_image_out_of_focus_gives_no_pose(scene, renderer):
    finds = detector(scene)
    seen = finds.detect(renderer.image(rendered.standing(POSE, finds.layout, scene), Conditions(blur=3.0)))
    assert seen.pose is None and "blurred" in seen.problem


def test_a_tag_of_another_object_is_named_and_not_taken(scene, renderer):
    other = TagLayout("apriltag36h11", (Tag(5, 0.037, (0.0, 0.0, 0.0505)),))
    seen = detector(scene).detect(renderer.image(rendered.standing(POSE, other, scene)))
    assert seen.pose is None
    assert seen.problem == "the tags 5 are seen, but none of the object's, apriltag36h11 0"


def test_a_mirrored_image_is_recognised(scene, renderer):
    finds = detector(scene)
    image = renderer.image(rendered.standing(POSE, finds.layout, scene))
    seen = finds.detect(image[:, ::-1].copy())
    assert seen.pose is None and "mirror" in seen.problem


def test_the_same_tag_twice_gives_no_pose(scene, renderer):
    finds = detector(scene)
    other = rendered.standing(POSE + [0.0, -0.2, 0.0], finds.layout, scene)
    seen = finds.detect(renderer.image([*other, *rendered.standing(POSE, finds.layout, scene)]))
    assert seen.pose is None and "only once" in seen.problem


@pytest.mark.parametrize("tilt", [0.35, -0.35])
def test_an_object_that_leans_over_gives_no_pose(scene, renderer, tilt):
    finds = detector(scene)
    for yaw in np.linspace(0.0, 2.0 * np.pi, 6, endpoint=False):
        pose = np.array([0.42, 0.11, yaw])
        seen = finds.detect(renderer.image(rendered.standing(pose, finds.layout, scene, tilt=tilt)))
        assert seen.pose is None
        assert "flat" in seen.problem or "no tag" in seen.problem


def test_images_of_another_size_than_calibrated_are_refused(scene):
    with pytest.raises(ConfigError, match="320 x 240 pixels, the calibration is for 640 x 480"):
        detector(scene).detect(np.zeros((240, 320, 3), np.uint8))


def test_a_camera_whose_place_is_unknown_is_refused(scene):
    with pytest.raises(ConfigError, match="where the camera stands"):
        TagDetector(replace(rendered.lab_camera(), pose=None), layout_of(scene.object), 0.05)


def test_the_renderer_draws_a_point_where_the_lens_equations_put_it():
    # Brown's model: x'' = x' (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x' y' + p2 (r^2 + 2 x'^2), u = fx x'' + cx.
    camera = rendered.lab_camera()
    spot, size = np.array([0.15, 0.50, 0.0]), 0.02
    dark, bright = (
        rendered.Patch(np.full((2, 2), value, np.uint8), (side, side), np.array([*spot, 0, 0, 0, 1]))
        for value, side in ((0, 5.0 * size), (255, size))
    )
    still = Conditions(noise=0.0, blur=0.3, light=1.0, slope=0.0)
    picture = Renderer(camera).image([dark, bright], still)[..., 0]
    x, y, z = camera.in_camera(spot[None])[0]
    x, y = x / z, y / z
    k1, k2, p1, p2, k3 = camera.distortion
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = 554.0 * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + 322.3
    v = 554.0 * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + 236.8
    rows, columns = np.nonzero(picture > 200)
    assert len(rows) > 30
    around = np.s_[rows.min() - 3 : rows.max() + 4, columns.min() - 3 : columns.max() + 4]
    weight, (down, across) = picture[around].astype(float), np.mgrid[around]
    assert (weight * across).sum() / weight.sum() == pytest.approx(u, abs=0.05)
    assert (weight * down).sum() / weight.sum() == pytest.approx(v, abs=0.05)
