"""Calibration of a camera with views of a ChArUco board: its lens, and where it stands.

Transforms are 4 x 4 matrices here: ``board_in_camera`` maps points in the board's frame to the camera's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from oimppi_warp.errors import ConfigError
from oimppi_warp.geometry.kinematics import link_frames
from oimppi_warp.perception.board import BoardView
from oimppi_warp.perception.camera_model import CameraModel
from oimppi_warp.perception.opencv import load_opencv
from oimppi_warp.scene import Robot

FEWEST_LENS, FEWEST_HAND_EYE = 8, 6
"""Smallest number of views for the lens, and for hand-eye calibration."""
_LARGEST_ERROR = 1.5
"""Root mean square distance of corners beyond which a calibration is refused [px]."""
_STEPS = 40
"""Largest number of steps of the fit for hand-eye calibration, which takes less than ten if the data fit together."""
_FLATTEST = np.radians(15.0)
"""Smallest angle that the views must span: between boards for the lens, between flanges for hand-eye [rad]."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibrated camera, and how well it fits.

    Attributes:
        camera: The camera.
        error: Root mean square distance between the seen corners and the fitted ones [px].
        errors: The same for each view, shape [view] [px].
        uncertainty: Standard deviations of what was fitted, in words.
    """

    camera: CameraModel
    error: float
    errors: np.ndarray
    uncertainty: str


def calibrate_lens(views: Sequence[BoardView]) -> Calibration:
    """Returns a camera without a place, from views of the board at many angles.

    Args:
        views: The views, of images of one size.

    Raises:
        ConfigError: There are too few views, they have different sizes, all show the board at the same angle, or they
            do not fit together.
    """
    if len(views) < FEWEST_LENS:
        raise ConfigError(
            f"the board was found in {len(views)} images, and {FEWEST_LENS} are needed\n"
            "  to do:   take more images: the whole board sharp, near and far, tilted to all sides"
        )
    sizes = {view.image_size for view in views}
    if len(sizes) > 1:
        raise ConfigError(f"the images have different sizes: {sizes}\n  to do:   take all images with one setting")
    cv2, size = load_opencv(), views[0].image_size
    error, matrix, distortion, turns, _, deviations, _, errors = cv2.calibrateCameraExtended(
        [view.points.astype(np.float32) for view in views],
        [view.pixels.astype(np.float32) for view in views],
        size,
        np.eye(3),
        np.zeros(5),
    )
    normals = Rotation.from_rotvec(np.array(turns).reshape(-1, 3)).apply([0.0, 0.0, 1.0])
    _refuse_if_flat(normals, "the images show the board", "tilt it by 30 degrees and more, to all sides")
    _refuse_if_wrong(error, errors.ravel(), views)
    camera = CameraModel(
        size,
        (float(matrix[0, 0]), float(matrix[1, 1])),
        (float(matrix[0, 2]), float(matrix[1, 2])),
        tuple(map(float, distortion.ravel()[:5])),
    )
    fx, fy, cx, cy = deviations.ravel()[:4]
    uncertainty = f"focal length +- {max(fx, fy):.2f} px, principal point +- {max(cx, cy):.2f} px"
    return Calibration(camera, float(error), errors.ravel(), uncertainty)


def place_by_board(camera: CameraModel, views: Sequence[BoardView], board_in_world: np.ndarray) -> Calibration:
    """Returns the camera at its place, from views of the board that lies at known places.

    Args:
        camera: The camera's lens.
        views: Views of the board.
        board_in_world: Pose of the board's frame in the world, shape [4, 4] [m], or one for each view, shape
            [view, 4, 4].

    Raises:
        ConfigError: There is no view, the images have another size than the lens was calibrated with, or the views do
            not fit together.
    """
    _check(camera, views, 1)
    boards = np.broadcast_to(board_in_world, (len(views), 4, 4))
    place = boards[0] @ _inverse(_board_in_camera(camera, views[0].points, views[0].pixels))

    def off(change: np.ndarray) -> list[np.ndarray]:
        seen = _inverse(_moved(place, change))
        return [_reprojection(camera, seen @ board, view) for board, view in zip(boards, views, strict=True)]

    fit = least_squares(lambda change: np.concatenate(off(change)).ravel(), np.zeros(6), x_scale="jac", loss="soft_l1")
    return _result(camera, _moved(place, fit.x), fit, views, off(fit.x))


def place_by_arm(camera: CameraModel, views: Sequence[BoardView], robot: Robot, joints: np.ndarray) -> Calibration:
    """Returns the camera at its place, from views of the board that is fixed to the arm's last link (hand-eye).

    Where on the link the board is fixed is found as well. The closed solution of the transforms starts a fit that
    minimizes the distances of the corners in all images.

    Args:
        camera: The camera's lens.
        views: Views of the board in different postures of the arm.
        robot: The arm.
        joints: Joint positions at each view, shape [view, dof] [rad].

    Raises:
        ConfigError: There are too few views, the images have another size than the lens was calibrated with, the arm
            turned the board too little, or the views do not fit together.
    """
    _check(camera, views, FEWEST_HAND_EYE)
    cv2 = load_opencv()
    rotations, positions = link_frames(robot, np.asarray(joints, dtype=float))
    flanges = np.tile(np.eye(4), (len(views), 1, 1))
    flanges[:, :3, :3], flanges[:, :3, 3] = rotations[:, -1], positions[:, -1]
    _refuse_if_still(flanges[:, :3, :3])
    boards = np.array([_board_in_camera(camera, view.points, view.pixels) for view in views])
    back = np.array([_inverse(flange) for flange in flanges])
    turn, shift = cv2.calibrateHandEye(
        list(back[:, :3, :3]),
        list(back[:, :3, 3]),
        list(boards[:, :3, :3]),
        list(boards[:, :3, 3]),
        method=cv2.CALIB_HAND_EYE_PARK,
    )
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = turn, shift.ravel()
    held = back[0] @ place @ boards[0]

    def off(change: np.ndarray) -> list[np.ndarray]:
        seen, on = _inverse(_moved(place, change[:6])), _moved(held, change[6:])
        return [_reprojection(camera, seen @ flange @ on, view) for flange, view in zip(flanges, views, strict=True)]

    fit = least_squares(
        lambda change: np.concatenate(off(change)).ravel(),
        np.zeros(12),
        x_scale="jac",
        loss="soft_l1",  # an image with wrong joint positions stands out, instead of spoiling the others
        max_nfev=_STEPS,
    )
    return _result(camera, _moved(place, fit.x[:6]), fit, views, off(fit.x))


def board_on_table(x: float, y: float, yaw: float, height: float = 0.0) -> np.ndarray:
    """Returns the pose of a board that lies on the table, face up, shape [4, 4] [m].

    Args:
        x, y: Position of the board's origin in the world [m].
        yaw: Angle from the world's x to the board's x [rad].
        height: Height of the printed side above the table's top [m].
    """
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("z", yaw).as_matrix()
    pose[:3, 3] = x, y, height
    return pose


def _check(camera: CameraModel, views: Sequence[BoardView], fewest: int) -> None:
    """Raises ConfigError if views cannot be used to find the place of a camera."""
    if len(views) < fewest:
        images = "image is" if fewest == 1 else "images are"
        raise ConfigError(
            f"the board was found in {len(views)} images, and {fewest} {images} needed\n"
            "  to do:   take more images with the whole board in them, sharp and larger"
        )
    for size in {view.image_size for view in views} - {camera.image_size}:
        raise ConfigError(
            f"the images have {size[0]} x {size[1]} pixels, the calibration of the lens is for "
            f"{camera.image_size[0]} x {camera.image_size[1]}\n  to do:   take all images with one setting"
        )


def _board_in_camera(camera: CameraModel, points: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Returns the pose of the board's frame in the camera's from its corners, shape [4, 4] [m]."""
    cv2 = load_opencv()
    _, turns, shifts, errors = cv2.solvePnPGeneric(
        points, pixels, camera.matrix, np.array(camera.distortion), flags=cv2.SOLVEPNP_IPPE
    )
    best = int(np.argmin(np.ravel(errors)))  # a flat board has two mirrored solutions
    turn, shift = cv2.solvePnPRefineLM(
        points, pixels, camera.matrix, np.array(camera.distortion), turns[best], shifts[best]
    )
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_rotvec(turn.ravel()).as_matrix(), shift.ravel()
    return pose


def _reprojection(camera: CameraModel, board_in_camera: np.ndarray, view: BoardView) -> np.ndarray:
    """Returns the distances of the fitted corners from the seen ones, shape [n, 2] [px]."""
    turn = Rotation.from_matrix(board_in_camera[:3, :3]).as_rotvec()
    fitted, _ = load_opencv().projectPoints(
        view.points, turn, board_in_camera[:3, 3], camera.matrix, np.array(camera.distortion)
    )
    return fitted[:, 0] - view.pixels


def _moved(pose: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Returns a pose, shape [4, 4], changed by a rotation vector [rad] in its own frame and a shift [m], shape [6]."""
    moved = pose.copy()
    moved[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec(change[:3]).as_matrix()
    moved[:3, 3] += change[3:]
    return moved


def _inverse(pose: np.ndarray) -> np.ndarray:
    """Returns the inverse of a pose, shape [4, 4]."""
    inverse = np.eye(4)
    inverse[:3, :3] = pose[:3, :3].T
    inverse[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return inverse


def _result(
    camera: CameraModel, place: np.ndarray, fit: Any, views: Sequence[BoardView], offs: list[np.ndarray]
) -> Calibration:
    """Returns the calibration of a fit whose first six parameters are changes of the camera's place."""
    errors = np.array([np.sqrt((off**2).sum(axis=1).mean()) for off in offs])
    every = np.concatenate(offs)
    error = float(np.sqrt((every**2).sum(axis=1).mean()))
    _refuse_if_wrong(error, errors, views)
    slopes = fit.jac
    spread = (every**2).sum() / max(every.size - slopes.shape[1], 1)
    deviations = np.sqrt(np.diag(np.linalg.pinv(slopes.T @ slopes)) * spread)
    uncertainty = (
        f"position +- {1e3 * np.linalg.norm(deviations[3:6]):.2f} mm, "
        f"direction +- {np.degrees(np.linalg.norm(deviations[:3])):.3f} degrees"
    )
    pose = np.concatenate([place[:3, 3], Rotation.from_matrix(place[:3, :3]).as_quat()])
    return Calibration(camera.placed(pose), error, errors, uncertainty)


def _refuse_if_flat(normals: np.ndarray, what: str, remedy: str) -> None:
    """Raises ConfigError if no two directions, shape [n, 3], differ by more than a small angle."""
    largest = np.arccos(np.clip(normals @ normals.T, -1.0, 1.0)).max()
    if largest < _FLATTEST:
        raise ConfigError(
            f"{what} at angles that differ by {np.degrees(largest):.0f} degrees at most, and "
            f"{np.degrees(_FLATTEST):.0f} are needed\n  to do:   {remedy}"
        )


def _refuse_if_still(rotations: np.ndarray) -> None:
    """Raises ConfigError unless the rotations, shape [n, 3, 3], turn about two axes by more than a small angle."""
    turns = Rotation.from_matrix(rotations[0].T @ rotations).as_rotvec()
    along = np.linalg.svd(turns, compute_uv=False)[1] / np.sqrt(len(turns))
    if along < _FLATTEST / 3.0:
        raise ConfigError(
            "the arm turned the board about one axis only, or hardly at all\n"
            "  to do:   turn it by 20 degrees and more about at least two axes, also by the wrist"
        )


def _refuse_if_wrong(error: float, errors: np.ndarray, views: Sequence[BoardView]) -> None:
    """Raises ConfigError if a fit is bad, and names the worst view."""
    if error > _LARGEST_ERROR:
        raise ConfigError(
            f"the corners are {error:.1f} px from where they should be, at most {_LARGEST_ERROR:g} are allowed; "
            f"{views[int(np.argmax(errors))].name} fits worst\n"
            "  to do:   see that the size of the squares and the joint positions are right, the board is flat, and "
            "nothing moved while the images were taken"
        )
