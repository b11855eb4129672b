"""The way of the arm to its start posture, checked against everything that it might touch."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from oimppi_warp.errors import HardwareError
from oimppi_warp.geometry.kinematics import tip_jacobian
from oimppi_warp.observation import planar_transform
from oimppi_warp.physics.newton_model import ROLES
from oimppi_warp.physics.world import World

MARGIN = 0.01
"""Distance that the arm keeps on its way, unless it begins or ends closer [m]."""
_STEP = 0.02
"""Largest change of a joint between two postures that are checked [rad]."""
_LIFTS = (0.05, 0.1, 0.2)
"""Heights over which the tool is lifted first, if the straight way is not free [m]."""
_LIFT_STEP = 0.005
_DAMPING = 1e-3


class StartMove:
    """Finds a way between two postures that is free of table, obstacles, object and the arm itself.

    Args:
        world: The scene.
    """

    def __init__(self, world: World) -> None:
        import mujoco

        made = world.mujoco
        self._scene, self._mujoco = world.scene, mujoco
        self._model, self._data = made.model, mujoco.MjData(made.model)
        self._joints, self._object = made.joint_qpos, made.object_qpos
        roles = np.array([ROLES[role] for role in made.roles])
        moving = np.flatnonzero(np.isin(roles, ["arm", "tool"]))
        still = np.flatnonzero(np.isin(roles, ["table", "obstacle", "object"]))
        self._pairs = [(int(a), int(b)) for a in moving for b in still]
        self._limits = np.array([(joint.lower, joint.upper) for joint in world.scene.robot.joints]).T

    def clearance(self, joints: np.ndarray, object_pose: np.ndarray) -> float:
        """Returns the distance of arm and tool to everything else [m], negative where they overlap.

        Args:
            joints: Joint positions, shape [dof] [rad].
            object_pose: Planar pose of the object, shape [3] [m, m, rad].
        """
        x, y, yaw = map(float, object_pose)
        self._data.qpos[self._joints] = joints
        placed = planar_transform((x, y, yaw), self._scene.object.rest_height)
        self._data.qpos[self._object] = placed[[0, 1, 2, 6, 3, 4, 5]]
        self._mujoco.mj_kinematics(self._model, self._data)
        ends = np.zeros(6)
        return min(
            self._mujoco.mj_geomDistance(self._model, self._data, a, b, 2.0 * MARGIN, ends) for a, b in self._pairs
        )

    def path(self, begin: np.ndarray, end: np.ndarray, object_pose: np.ndarray) -> np.ndarray:
        """Returns postures from one to another, straight in between, shape [n, dof] [rad].

        If the straight way is not free, the tool is lifted first, and lowered at the end.

        Args:
            begin: Joint positions, shape [dof] [rad].
            end: Joint positions, shape [dof] [rad].
            object_pose: Planar pose of the object, shape [3] [m, m, rad].

        Raises:
            HardwareError: No such way is free.
        """
        least = min(MARGIN, self.clearance(begin, object_pose) - 1e-4, self.clearance(end, object_pose) - 1e-4)
        if least < 0.0:
            raise HardwareError(
                "the arm touches something, here or at its start posture\n"
                "  to do:   move it and the object apart by hand, and check the scene's measures"
            )
        for height in (0.0, *_LIFTS):
            legs = [begin, end] if height == 0.0 else [*self._lifted(begin, height), *self._lifted(end, height)[::-1]]
            if self._free(np.array(legs), object_pose, least):
                return np.array(legs)
        raise HardwareError(
            f"no straight way from here to the start posture keeps {1e3 * least:.0f} mm from everything\n"
            "  to do:   move the arm nearer to its start posture by hand (manual mode)"
        )

    def _free(self, path: np.ndarray, object_pose: np.ndarray, least: float) -> bool:
        lower, upper = self._limits
        if (path < lower - 1e-6).any() or (path > upper + 1e-6).any():
            return False
        for a, b in pairwise(path):
            count = int(np.ceil(np.abs(b - a).max() / _STEP)) + 1
            if any(self.clearance(a + share * (b - a), object_pose) < least for share in np.linspace(0.0, 1.0, count)):
                return False
        return True

    def _lifted(self, joints: np.ndarray, height: float) -> list[np.ndarray]:
        """Returns the postures while the tool is lifted without turning, from a posture [dof] to the highest."""
        path = [joints.copy()]
        for _ in range(round(height / _LIFT_STEP)):
            jacobian = tip_jacobian(self._scene.robot, path[-1])
            square = jacobian @ jacobian.T + _DAMPING**2 * np.eye(6)
            path.append(path[-1] + jacobian.T @ np.linalg.solve(square, np.array([0, 0, _LIFT_STEP, 0, 0, 0])))
        return path
