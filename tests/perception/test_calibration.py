"""Calibration with the board: lens, and place by table or arm, from rendered views and from projected corners."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from support import rendered, small_tasks
from support.boards import BOARD, SMALL, before_the_lens, held_by_the_arm, patch
from support.rendered import Conditions, Renderer

from oimppi_warp.errors import ConfigError
from oimppi_warp.perception.board import Board, BoardFinder, BoardView
from oimppi_warp.perception.calibration import board_on_table, calibrate_lens, place_by_arm, place_by_board
from oimppi_warp.perception.camera_model import CameraModel
from oimppi_warp.scene import Robot

NOISE = 0.1
"""Standard deviation of the error of a corner in a sharp image [px]."""
LENS = 0.5
"""Bound of the distance between the pixels of a point by the true and the calibrated lens, inside a 40 px edge [px]."""
PLACE = 0.002
"""Bound of the errors that a calibrated place makes of points where the objects are [m]."""
ONE_BOARD = 0.004
"""The same for a place that was found from one place of the board on the table [m]."""


def projected(camera: CameraModel, board: Board, board_in_world: np.ndarray, random: np.random.Generator) -> BoardView:
    """What an ideal finder sees of a board, with noise."""
    points = board.corners()
    pixels = camera.project(points @ board_in_world[:3, :3].T + board_in_world[:3, 3])
    return BoardView(points, pixels + random.normal(0.0, NOISE, pixels.shape), camera.image_size)


def rendered_views(camera: CameraModel, board: Board, poses: list[np.ndarray] | np.ndarray) -> list[BoardView]:
    renderer, finder = Renderer(camera, seed=5), BoardFinder(board)
    found = [finder.find(renderer.image([patch(board, pose)]), f"{number}.png") for number, pose in enumerate(poses)]
    return [view for view in found if view is not None]


def assert_place(camera: CameraModel, truth: CameraModel, bound: float = PLACE) -> None:
    """Fails unless the camera sees points where the lab's objects are, at their tops, where they are."""
    assert camera.pose is not None and truth.pose is not None
    spots = np.array([[x, y, 0.1] for x in (0.25, 0.45, 0.60) for y in (-0.45, -0.2, 0.0, 0.2, 0.45)])
    off = camera.on_plane(truth.project(spots), 0.1) - spots[:, :2]
    away = np.linalg.norm(off, axis=1)
    print(
        f"points {1e3 * away.max():.2f} mm away at most, {1e3 * np.median(away):.2f} mm in the median; camera "
        f"{1e3 * np.linalg.norm(camera.pose[:3] - truth.pose[:3]):.2f} mm"
    )
    assert away.max() <= bound, away


@pytest.fixture(scope="module")
def robot() -> Robot:
    return small_tasks.shipped("lab01").robot


def test_the_corners_of_a_rendered_board_are_found_to_a_fifth_of_a_pixel():
    camera = rendered.lab_camera()
    pose = board_on_table(0.30, -0.15, 0.4)
    (view,) = rendered_views(camera, BOARD, [pose])
    assert len(view.pixels) == (BOARD.columns - 1) * (BOARD.rows - 1)
    truth = camera.project(view.points @ pose[:3, :3].T + pose[:3, 3])
    off = view.pixels - truth
    print("corners", np.sqrt((off**2).sum(axis=1).mean()), off.mean(axis=0))
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.2 and np.abs(off.mean(axis=0)).max() < 0.1


def test_the_lens_is_recovered_from_rendered_images():
    truth = rendered.lab_camera()
    views = rendered_views(truth, BOARD, before_the_lens(truth, 20))
    assert len(views) >= 18
    found = calibrate_lens(views)
    assert found.error < 0.3
    grid = np.stack(np.meshgrid(np.linspace(40, 600, 9), np.linspace(40, 440, 7)), axis=-1).reshape(-1, 2)
    assert truth.pose is not None
    spots = np.column_stack([truth.on_plane(grid, 0.0), np.zeros(len(grid))])
    # A small turn of the camera looks the same as a shift of the principal point, and the place will make up for it.
    own = place_by_board(found.camera, [BoardView(spots, grid, truth.image_size)], np.eye(4))
    apart = np.linalg.norm(own.camera.project(spots) - grid, axis=1)
    print(
        f"focal length {found.camera.focal_length[0]:.1f} px, at most {apart.max():.2f} px apart, {found.uncertainty}"
    )
    assert found.camera.focal_length == pytest.approx(truth.focal_length, rel=0.005)
    assert found.camera.principal_point == pytest.approx(truth.principal_point, abs=3.0)
    assert apart.max() < LENS


def test_the_camera_is_placed_by_the_board_on_the_table():
    truth = rendered.lab_camera()
    board_in_world = board_on_table(0.28, -0.12, 0.1, height=0.005)
    views = rendered_views(truth, BOARD, [board_in_world] * 3)
    found = place_by_board(replace(truth, pose=None), views, board_in_world)
    print(found.uncertainty)
    assert found.error < 0.3
    assert_place(found.camera, truth, ONE_BOARD)


def test_the_board_at_several_places_is_more_exact():
    truth = rendered.lab_camera()
    places = [(0.28, -0.12, 0.1), (0.40, 0.15, 0.8), (0.30, -0.40, -0.2), (0.45, 0.25, -0.6)]
    boards = np.array([board_on_table(*place) for place in places])
    views = rendered_views(truth, BOARD, boards)
    assert len(views) == len(places)
    found = place_by_board(replace(truth, pose=None), views, boards)
    print(found.uncertainty)
    assert_place(found.camera, truth)


def test_the_camera_is_placed_by_the_arm_that_holds_the_board(robot):
    truth = rendered.lab_camera()
    joints, boards = held_by_the_arm(truth, robot, 12)
    views = rendered_views(truth, SMALL, boards)
    kept = [int(view.name.partition(".")[0]) for view in views]
    assert len(kept) >= 10
    found = place_by_arm(replace(truth, pose=None), views, robot, joints[kept])
    print(found.uncertainty)
    assert found.error < 0.4
    assert_place(found.camera, truth)


def test_with_exact_corners_the_arm_gives_the_exact_place_whatever_holds_the_board(robot):
    truth = rendered.lab_camera()
    joints, boards = held_by_the_arm(truth, robot, 6, seed=3)
    quiet = np.random.default_rng(0)
    views = [projected(truth, SMALL, pose, quiet) for pose in boards]
    exact = [
        replace(view, pixels=truth.project(view.points @ pose[:3, :3].T + pose[:3, 3]))
        for view, pose in zip(views, boards, strict=True)
    ]
    assert_place(place_by_arm(replace(truth, pose=None), exact, robot, joints).camera, truth, 1e-5)


def test_the_uncertainty_of_the_place_is_that_of_repeated_calibrations(robot):
    truth = rendered.lab_camera()
    joints, boards = held_by_the_arm(truth, robot, 10)
    random, off, told = np.random.default_rng(2), [], []
    for _ in range(12):
        views = [projected(truth, SMALL, pose, random) for pose in boards]
        found = place_by_arm(truth, views, robot, joints)
        assert found.camera.pose is not None and truth.pose is not None
        off.append(np.linalg.norm(found.camera.pose[:3] - truth.pose[:3]))
        told.append(1e-3 * float(found.uncertainty.split()[2]))
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(np.mean(told), rel=0.5)


def test_too_few_views_are_refused(robot):
    camera = rendered.lab_camera()
    view = projected(camera, BOARD, board_on_table(0.3, -0.1, 0.0), np.random.default_rng(0))
    with pytest.raises(ConfigError, match="found in 3 images, and 8 are needed"):
        calibrate_lens([view] * 3)
    with pytest.raises(ConfigError, match="found in 0 images, and 1 image is needed"):
        place_by_board(camera, [], np.eye(4))
    with pytest.raises(ConfigError, match="found in 2 images, and 6 images are needed"):
        place_by_arm(camera, [view] * 2, robot, np.zeros((2, 6)))


def test_a_board_that_is_never_tilted_is_refused_for_the_lens():
    camera, random = rendered.lab_camera(), np.random.default_rng(0)
    views = [projected(camera, BOARD, board_on_table(0.3 + 0.01 * i, -0.15, 0.0), random) for i in range(10)]
    with pytest.raises(ConfigError, match="tilt it by 30 degrees"):
        calibrate_lens(views)


def test_an_arm_that_does_not_turn_the_board_is_refused(robot):
    camera, random = rendered.lab_camera(), np.random.default_rng(0)
    joints, boards = held_by_the_arm(camera, robot, 1)
    still = np.tile(joints, (8, 1)) + 0.02 * random.standard_normal((8, 6))
    views = [projected(camera, SMALL, boards[0], random)] * 8
    with pytest.raises(ConfigError, match="at least two axes"):
        place_by_arm(camera, views, robot, still)


def test_joint_positions_of_other_images_are_refused_and_the_worst_image_is_named(robot):
    camera, random = rendered.lab_camera(), np.random.default_rng(0)
    joints, boards = held_by_the_arm(camera, robot, 10)
    views = [replace(projected(camera, SMALL, pose, random), name=f"{i}.png") for i, pose in enumerate(boards)]
    joints[4] += 0.15
    with pytest.raises(ConfigError, match=r"4\.png fits worst"):
        place_by_arm(camera, views, robot, joints)


def test_squares_of_another_size_than_told_put_the_camera_elsewhere():
    # The image fits as well with a board twice as large at twice the distance: only the ruler can tell.
    camera, random = rendered.lab_camera(), np.random.default_rng(0)
    pose = board_on_table(0.3, -0.1, 0.0)
    view = projected(camera, BOARD, pose, random)
    found = place_by_board(camera, [replace(view, points=1.05 * view.points)], pose)
    assert camera.pose is not None and found.camera.pose is not None
    far = np.linalg.norm(found.camera.pose[:3] - pose[:3, 3]) / np.linalg.norm(camera.pose[:3] - pose[:3, 3])
    assert far == pytest.approx(1.05, abs=0.003)


def test_images_of_several_sizes_are_refused(robot):
    camera, random = rendered.lab_camera(), np.random.default_rng(0)
    views = [projected(camera, BOARD, pose, random) for pose in before_the_lens(camera, 8)]
    other = [*views[:-1], replace(views[-1], image_size=(320, 240))]
    with pytest.raises(ConfigError, match="different sizes"):
        calibrate_lens(other)
    with pytest.raises(ConfigError, match="320 x 240 pixels"):
        place_by_board(camera, other[-1:], np.eye(4))


def test_a_board_that_is_hardly_seen_is_not_used():
    camera = rendered.lab_camera()
    image = Renderer(camera).image([patch(BOARD, board_on_table(0.3, -0.15, 0.0))])
    assert BoardFinder(BOARD).find(image) is not None
    assert BoardFinder(BOARD).find(np.full_like(image, 128)) is None
    one_row = image.copy()
    one_row[:, cv2.boundingRect((image[..., 0] > 200).astype(np.uint8))[0] + 60 :] = 100
    found = BoardFinder(BOARD).find(one_row)
    assert found is None or len(np.unique(found.points[:, 0].round(6))) > 1


@pytest.mark.parametrize(("columns", "square", "wrong"), [(2, 0.03, "2 x 4 squares"), (7, 0.001, "0.001 m large")])
def test_boards_that_nobody_can_print_are_refused(columns, square, wrong):
    with pytest.raises(ConfigError, match=wrong):
        Board(columns, 4, square)


def test_a_place_from_a_blurred_image_is_told_to_be_less_certain():
    camera, pose = rendered.lab_camera(), board_on_table(0.28, -0.12, 0.1)
    told = []
    for conditions in (rendered.ORDINARY, Conditions(blur=0.9, noise=5.0)):
        view = BoardFinder(BOARD).find(Renderer(camera).image([patch(BOARD, pose)], conditions))
        assert view is not None
        told.append(float(place_by_board(camera, [view], pose).uncertainty.split()[2]))
    assert told[1] > 1.3 * told[0]
