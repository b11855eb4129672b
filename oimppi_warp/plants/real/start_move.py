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
_SOFT = 0.001
"""Amount by which distances may be wrong [m]."""
_BLURRED = 0.015
"""Amount by which the object may seem to overlap the tool, since its detected pose is not exact [m]."""
_STEP = 0.02
"""Largest change of a joint between two postures that are checked [rad]."""
_LIFTS = (0.05, 0.1, 0.2)
"""Heights over which the tool is lifted first, if the straight way is not free [m]."""
_FAR = 5.0
"""Distance at which the object is out of the way [m]."""
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
        fixed, loose = (np.flatnonzero(np.isin(roles, kinds)) for kinds in (["table", "obstacle"], ["object"]))
        self._fixed = [(int(a), int(b)) for a in moving for b in fixed]
        self._loose = [(int(a), int(b)) for a in moving for b in loose]
        self._limits = np.array([(joint.lower, joint.upper) for joint in world.scene.robot.joints]).T

    def clearance(self, joints: np.ndarray, object_pose: np.ndarray) -> tuple[float, float]:
        """Returns the distances of arm and tool to table and obstacles, and to the object [m]; negative in an overlap.

        They are given up to twice the margin.

        Args:
            joints: Joint positions, shape [dof] [rad].
            object_pose: Planar pose of the object, shape [3] [m, m, rad].
        """
        x, y, yaw = map(float, object_pose)
        self._data.qpos[self._joints] = joints
        placed = planar_transform((x, y, yaw), self._scene.object.rest_height)
        self._data.qpos[self._object] = placed[[0, 1, 2, 6, 3, 4, 5]]
        self._mujoco.mj_kinematics(self._model, self._data)
        return self._least(self._fixed), self._least(self._loose)

    def path(self, begin: np.ndarray, end: np.ndarray, object_pose: np.ndarray) -> np.ndarray:
        """Returns postures from one to another, straight in between, shape [n, dof] [rad].

        If the straight way is not free, the tool is lifted first, and lowered at the end. Where the arm begins or ends
        closer than the margin to something, such as the object that it has just pushed, it only moves away from it, or
        towards it, there.

        Args:
            begin: Joint positions, shape [dof] [rad].
            end: Joint positions, shape [dof] [rad].
            object_pose: Planar pose of the object, shape [3] [m, m, rad].

        Raises:
            HardwareError: No such way is free.
        """
        for joints, where in ((begin, "here"), (end, "at its start posture")):
            fixed, loose = self.clearance(joints, object_pose)
            if fixed < -_SOFT or loose < -_BLURRED:
                what = "table or obstacles" if fixed < -_SOFT else "the object"
                raise HardwareError(
                    f"the arm touches {what} {where}\n"
                    "  to do:   move the arm and the object apart by hand, and check the measures in the scene"
                )
        for height in (0.0, *_LIFTS):
            legs = [begin, end] if height == 0.0 else [*self._lifted(begin, height), *self._lifted(end, height)[::-1]]
            if self._free(np.array(legs), object_pose):
                return np.array(legs)
        raise HardwareError(
            f"no straight way from here to the start posture keeps {1e3 * MARGIN:.0f} mm from everything\n"
            "  to do:   move the arm nearer to its start posture by hand (manual mode)"
        )

    def lift(self, begin: np.ndarray) -> np.ndarray:
        """Returns postures that lift the tool straight up, wherever the object is, shape [n, dof] [rad].

        Args:
            begin: Joint positions, shape [dof] [rad].

        Raises:
            HardwareError: Table, obstacles or the joints' limits are in the way.
        """
        away = np.array([_FAR, _FAR, 0.0])
        for height in _LIFTS[::-1]:
            path = np.array(self._lifted(begin, height))
            if self._free(path, away):
                return path
        raise HardwareError("the tool cannot be lifted here\n  to do:   move the arm up by hand (manual mode)")

    def _free(self, path: np.ndarray, object_pose: np.ndarray) -> bool:
        """Returns whether a way is within the joints' limits and keeps the margin, except near its ends."""
        lower, upper = self._limits
        if (path < lower - 1e-6).any() or (path > upper + 1e-6).any():
            return False
        between = [path[:1]]
        for a, b in pairwise(path):
            count = int(np.ceil(np.abs(b - a).max() / _STEP))
            between.append(a + np.linspace(0.0, 1.0, count + 1)[1:, None] * (b - a))
        gaps = np.array([self.clearance(joints, object_pose) for joints in np.concatenate(between)])
        so_far = np.maximum.accumulate(gaps, axis=0)
        from_here = np.maximum.accumulate(gaps[::-1], axis=0)[::-1]
        return bool((gaps >= np.minimum(MARGIN, np.minimum(so_far, from_here) - _SOFT)).all())

    def _least(self, pairs: list[tuple[int, int]]) -> float:
        ends = np.zeros(6)
        distances = (self._mujoco.mj_geomDistance(self._model, self._data, a, b, 2.0 * MARGIN, ends) for a, b in pairs)
        return min(distances, default=2.0 * MARGIN)

    def _lifted(self, joints: np.ndarray, height: float) -> list[np.ndarray]:
        """Returns the postures while the tool is lifted without turning, from a posture [dof] to the highest."""
        path = [joints.copy()]
        for _ in range(round(height / _LIFT_STEP)):
            jacobian = tip_jacobian(self._scene.robot, path[-1])
            square = jacobian @ jacobian.T + _DAMPING**2 * np.eye(6)
            path.append(path[-1] + jacobian.T @ np.linalg.solve(square, np.array([0, 0, _LIFT_STEP, 0, 0, 0])))
        return path
