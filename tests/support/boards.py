"""Views of a calibration board: before a camera, on the table, and held by the arm."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation
from support.rendered import Patch, Renderer

from oimppi_warp.geometry.kinematics import link_frames
from oimppi_warp.perception.board import Board
from oimppi_warp.perception.calibration import board_on_table
from oimppi_warp.perception.camera_model import CameraModel
from oimppi_warp.scene import Robot

__all__ = ["BOARD", "SMALL", "before_the_lens", "board_on_table", "held_by_the_arm", "patch", "write_images"]

BOARD, SMALL = Board(), Board(square=0.030)
HELD = np.array([0.02, -0.06, 0.05])
"""Where the arm holds the board, in its last link [m]."""


def matrix(pose: np.ndarray) -> np.ndarray:
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = Rotation.from_quat(pose[3:]).as_matrix(), pose[:3]
    return made


def patch(board: Board, board_in_world: np.ndarray) -> Patch:
    """The print of a board whose frame has a pose, shape [4, 4], on a white sheet."""
    sheet = np.pad(board.image(40), 30, constant_values=255)
    size = tuple(side * board.square / 40 for side in sheet.shape[::-1])
    center = board_in_world @ [board.size[0] / 2, board.size[1] / 2, 0.0, 1.0]
    turn = Rotation.from_matrix(board_in_world[:3, :3]).as_quat()
    return Patch(np.clip(sheet, 25, 235), size, np.concatenate([center[:3], turn]))


def seen_whole(camera: CameraModel, board: Board, board_in_world: np.ndarray) -> bool:
    """Whether a board is in the image, faces the camera, and is not seen at a grazing angle."""
    assert camera.pose is not None
    corners = np.array([[x, y, 0.0] for x in (0.0, board.size[0]) for y in (0.0, board.size[1])])
    pixels = camera.project(corners @ board_in_world[:3, :3].T + board_in_world[:3, 3])
    sight = camera.pose[:3] - board_in_world[:3, 3]
    facing = sight @ board_in_world[:3, 2] / np.linalg.norm(sight)
    return bool((pixels > 8).all() and (pixels < np.array(camera.image_size) - 8).all() and facing > 0.6)


def before_the_lens(camera: CameraModel, count: int, seed: int = 0) -> list[np.ndarray]:
    """Poses of a board held before a camera, tilted to all sides, near and far, shape [4, 4]."""
    assert camera.pose is not None
    random, found = np.random.default_rng(seed), []
    while len(found) < count:
        tilt = Rotation.from_euler("xyz", [np.pi, 0, 0]) * Rotation.from_rotvec(random.uniform(-0.7, 0.7, 3))
        pose = np.eye(4)
        pose[:3, :3] = tilt.as_matrix()
        middle = np.array([random.uniform(-0.25, 0.25), random.uniform(-0.2, 0.2), random.uniform(0.35, 0.7)])
        pose[:3, 3] = middle - pose[:3, :3] @ [BOARD.size[0] / 2, BOARD.size[1] / 2, 0.0]
        pose = matrix(camera.pose) @ pose
        if seen_whole(camera, BOARD, pose):
            found.append(pose)
    return found


def held_by_the_arm(camera: CameraModel, robot: Robot, count: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Joint positions in which the camera sees the board that the arm holds, and the board's poses."""
    on = np.eye(4)
    on[:3, :3], on[:3, 3] = Rotation.from_euler("xyz", [np.pi - 0.2, 0.1, 0.3]).as_matrix(), HELD
    random, joints, boards = np.random.default_rng(seed), [], []
    while len(joints) < count:
        drawn = robot.start + random.uniform(-0.6, 0.6, robot.dof) * [0.8, 0.5, 0.5, 1.0, 1.0, 1.5]
        rotations, positions = link_frames(robot, drawn)
        flange = np.eye(4)
        flange[:3, :3], flange[:3, 3] = rotations[-1], positions[-1]
        if seen_whole(camera, SMALL, flange @ on):
            joints.append(drawn)
            boards.append(flange @ on)
    return np.array(joints), np.array(boards)


def write_images(
    folder: Path, camera: CameraModel, poses: list[np.ndarray] | np.ndarray, *, board: Board = BOARD
) -> list[str]:
    """Writes rendered images of a board at some poses; their names."""
    folder.mkdir(parents=True)
    renderer, names = Renderer(camera, seed=6), [f"{number:02d}.png" for number in range(len(poses))]
    for name, pose in zip(names, poses, strict=True):
        cv2.imwrite(str(folder / name), renderer.image([patch(board, pose)]))
    return names
