"""A camera above the table, which sees the object unless the arm blocks the line of sight."""

from __future__ import annotations

from copy import copy

import numpy as np

from oimppi_warp.geometry.footprint import footprint, height_range, outline, planar_points
from oimppi_warp.physics.newton_model import ROLES
from oimppi_warp.physics.world import World

SEEN_SHARE = 0.5
"""Fraction of an object's test points that must be visible for it to be detected."""
_POINTS = 12
"""Number of test points on the outline of an object's top."""
_ROBOT = np.array([0, 1, 0, 0, 0, 0], dtype=np.uint8)
"""Groups of geoms that can hide the object: group 1 is the robot."""


class Camera:
    """A camera with the table in its field of view.

    Args:
        world: The task's physics.
        position: Position of the camera [m].
    """

    def __init__(self, world: World, position: tuple[float, float, float]) -> None:
        import mujoco

        self._mujoco, self._joint_qpos = mujoco, world.mujoco.joint_qpos
        robot = np.isin(world.mujoco.roles, [ROLES.index(role) for role in ("base", "arm", "tool")])
        self._model = copy(world.mujoco.model)
        self._model.geom_group[:] = robot
        self._data = mujoco.MjData(self._model)
        self._position = np.array(position)
        pushed = world.scene.object
        rim = outline(footprint(pushed.colliders)).convex_hull.boundary
        along = (np.arange(_POINTS) + 0.5) / _POINTS
        ring = np.array([rim.interpolate(share, normalized=True).coords[0] for share in along])
        self._ring = np.concatenate([ring, ring.mean(axis=0, keepdims=True)])
        self._height = pushed.rest_height + height_range(pushed.colliders)[1]

    def sees(self, joints: np.ndarray, pose: np.ndarray) -> bool:
        """Returns whether the arm leaves enough of the object visible: a fraction of at least :data:`SEEN_SHARE`.

        Args:
            joints: Joint positions of the arm, shape [dof] [rad; m for a prismatic joint].
            pose: Planar pose of the object, shape [3] [m, m, rad].
        """
        return self.share_seen(joints, pose) >= SEEN_SHARE

    def share_seen(self, joints: np.ndarray, pose: np.ndarray) -> float:
        """Returns the fraction of points on the object's top (outline and centre) that the arm does not hide."""
        top = planar_points(pose, self._ring)
        sight = np.column_stack([top, np.full(len(top), self._height)]) - self._position
        self._data.qpos[self._joint_qpos] = joints
        self._mujoco.mj_kinematics(self._model, self._data)
        hit, at = np.zeros(len(sight), dtype=np.int32), np.zeros(len(sight))
        self._mujoco.mj_multiRay(
            self._model,
            self._data,
            pnt=self._position,
            vec=sight.ravel(),
            geomgroup=_ROBOT,
            flg_static=True,
            bodyexclude=-1,
            geomid=hit,
            dist=at,
            normal=None,
            nray=len(sight),
            cutoff=self._mujoco.mjMAXVAL,
        )
        return float(np.mean((hit < 0) | (at > 1.0)))  # the test point itself is at distance 1
