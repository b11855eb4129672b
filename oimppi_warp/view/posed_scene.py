"""Poses a scene by joint positions and object transform, for display in Newton's viewers.

The robot, the table and everything unchanged from the scene's file are displayed as in that file. Moved obstacles keep
their appearance; new or changed ones, and an object with another shape, are drawn as their colliders.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from oimppi_warp.scene import Scene
from oimppi_warp.view.shapes import GHOSTS


class PosedScene:
    """The Newton model of a scene with its display geometry, used by viewers only, not for the physics.

    Args:
        scene: The task.

    Attributes:
        model: The model.
        state: The model's state, as last posed.
    """

    def __init__(self, scene: Scene) -> None:
        import newton

        from oimppi_warp.usd.editing import stage_of

        self._newton = newton
        builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
        found = builder.add_usd(
            stage_of(scene), load_visual_shapes=True, enable_self_collisions=False, ignore_paths=[GHOSTS]
        )
        joints = [found["path_joint_map"][joint.path] for joint in scene.robot.joints]
        self._joints = np.array([builder.joint_q_start[joint] for joint in joints])
        body = found["path_body_map"][scene.object.path]
        self._object = builder.joint_q_start[builder.joint_child.index(body)] + np.arange(7)
        self.model = builder.finalize(device="cpu")
        self.state = self.model.state()
        self._coords = self.model.joint_q.numpy().copy()

    def pose(self, joints: np.ndarray, object_transform: np.ndarray) -> None:
        """Moves arm and object.

        Args:
            joints: Joint positions, shape [dof] [rad; m for a prismatic joint].
            object_transform: Position [m] and quaternion xyzw of the object's frame, shape [7].
        """
        self._coords[self._joints] = joints
        self._coords[self._object] = object_transform
        coords = wp.array(self._coords, dtype=float, device="cpu")
        self._newton.eval_fk(self.model, coords, self.model.joint_qd, self.state)  # pyright: ignore[reportArgumentType]
