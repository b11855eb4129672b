"""Poses a robot at the start of an episode."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdPhysics

from oimppi_warp.authoring.prims import attribute, matrix_quat, set_pose
from oimppi_warp.geometry.kinematics import link_frames
from oimppi_warp.usd.robot import read_robot
from oimppi_warp.usd.stage import SceneStage


def pose_robot(stage: Usd.Stage, path: str, joints: Sequence[float]) -> None:
    """Writes joint positions as a robot's start, together with the corresponding poses of its links.

    Args:
        stage: The scene, which is saved.
        path: The robot's prim, located at the world's origin.
        joints: Joint positions, length dof [rad; m for a sliding joint].
    """
    stage.Save()
    robot = read_robot(SceneStage(Path(stage.GetRootLayer().realPath)))
    rotations, positions = link_frames(robot, np.asarray(joints, dtype=float))
    frames = {link.path: frame for link, *frame in zip(robot.links, rotations, positions, strict=True)}
    last = robot.links[-1].path
    welded = {part: _relative_pose(stage, last, part) for part in _bodies(stage, path) - {robot.base.path, *frames}}
    frames |= {part: [frames[last][0] @ r, frames[last][1] + frames[last][0] @ p] for part, (r, p) in welded.items()}
    for part, (rotation, position) in frames.items():
        set_pose(stage.OverridePrim(part), position, matrix_quat(rotation))
    attribute(stage.OverridePrim(path), "oimppi:startJoints", Sdf.ValueTypeNames.DoubleArray, list(joints))


def _bodies(stage: Usd.Stage, path: str) -> set[str]:
    """Returns the paths of the rigid bodies below a prim."""
    prims = Usd.PrimRange(stage.GetPrimAtPath(path))
    return {str(prim.GetPath()) for prim in prims if prim.HasAPI(UsdPhysics.RigidBodyAPI)}


def _relative_pose(stage: Usd.Stage, link: str, part: str) -> tuple[np.ndarray, np.ndarray]:
    """Returns rotation and position [m] of a prim in the frame of another, as given in the file."""
    cache = UsdGeom.XformCache()
    frame = cache.GetLocalToWorldTransform(stage.GetPrimAtPath(part))
    matrix = np.array(frame * cache.GetLocalToWorldTransform(stage.GetPrimAtPath(link)).GetInverse())
    return matrix[:3, :3].T, matrix[3, :3]
