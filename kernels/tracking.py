"""Tracking of the object: predicts its motion, step by step, from the measured path of the arm that pushes it."""

from functools import lru_cache

import warp as wp

from oimppi_warp.kernels.geometry import planar_field, rotate
from oimppi_warp.kernels.kinematics import Arm, Environment, make_place_arm
from oimppi_warp.kernels.pushing import ObjectModel, push, settle

wp.set_module_options({"enable_backward": False})


@wp.func
def gap_to(model: ObjectModel, pose: wp.vec3, point: wp.vec2, tool_radius: float) -> float:
    """Returns the distance of a round tool at ``point`` to the object [m]; outside the field, a lower bound."""
    local = rotate(wp.cos(pose[2]), -wp.sin(pose[2]), point - wp.vec2(pose[0], pose[1]))
    x = local[0] - model.body.origin[0]
    y = local[1] - model.body.origin[1]
    width = wp.float32(model.body.values.shape[0] - 1) / model.body.inv_step
    depth = wp.float32(model.body.values.shape[1] - 1) / model.body.inv_step
    outside = wp.max(wp.max(-x, x - width), wp.max(-y, y - depth))
    return planar_field(model.body, local)[0] - tool_radius + wp.max(outside, 0.0)


@lru_cache
def make_track_object(chain: str) -> wp.Kernel:
    """Returns the kernel that tracks the object, for an arm with a chain of joints such as ``"RRRRRR"``."""
    dof = len(chain)
    vec = wp.types.vector(length=dof, dtype=float)
    place_arm = make_place_arm(chain)

    @wp.kernel(module=f"oimppi_warp.kernels.track_object_{chain}", enable_backward=False)
    def track_object(
        # in:
        arm: Arm,
        model: ObjectModel,
        environment: Environment,
        joints: wp.array[vec],
        begin: wp.array[int],
        contact_steps: int,
        # out:
        poses: wp.array[wp.vec3],
        gaps: wp.array[float],
    ):
        """Computes the object's poses along a path of joint positions; launched with one thread.

        The tool is a stick: it pushes with its tip and with its point at the height of the object's top, which is
        nearer to the object when the stick leans over it.

        Shapes: ``joints`` [n] [rad]; ``begin`` [2]: the step whose pose is known, and the one after the last to
        compute; ``poses`` [n]: of the friction centre, from the first of these steps to the last; ``gaps`` [n]:
        between stick and object, after each step [m].
        """
        pose = poses[begin[0]]
        old = place_arm(arm, environment, arm.tip_position, joints[begin[0]])
        for i in range(begin[0] + 1, begin[1]):
            new = place_arm(arm, environment, arm.tip_position, joints[i])
            gap = float(1.0)
            if new.tip[2] < model.top and old.tip[2] < model.top:
                before = pose
                for part in range(2):
                    last = wp.vec2(old.tip[0], old.tip[1]) + wp.float32(part) * (model.top - old.tip[2]) * old.lean
                    end = wp.vec2(new.tip[0], new.tip[1]) + wp.float32(part) * (model.top - new.tip[2]) * new.lean
                    move = (end - last) / float(contact_steps)
                    for _ in range(contact_steps):
                        pose = push(model, pose, last, last + move, environment.tool_radius)
                        last = last + move
                    gap = wp.min(gap, gap_to(model, pose, end, environment.tool_radius))
                if pose[0] != before[0] or pose[1] != before[1] or pose[2] != before[2]:
                    pose = settle(model, pose, 1.0).pose
            poses[i] = pose
            gaps[i] = gap
            old = new

    return track_object
