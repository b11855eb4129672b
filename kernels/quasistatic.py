"""Rollouts of the robot level in one kernel: arm, contact, object, obstacles and costs, one thread a sample."""

from functools import lru_cache

import warp as wp

from oimppi_warp.kernels.cost import CostTerms, RobotWeights, robot_cost
from oimppi_warp.kernels.geometry import SpaceField, planar_field, rotate, space_field
from oimppi_warp.kernels.kinematics import Arm, turn_about_z
from oimppi_warp.kernels.pushing import ObjectModel, push, settle

wp.set_module_options({"enable_backward": False})

GIVE = wp.constant(5.0e-4)
"""Depth that a contact may grow by before the arm is held back [m]."""


@wp.struct
class Surroundings:
    """What the arm must keep clear of.

    Attributes:
        obstacles: Distance to the obstacles [m].
        top: Height above which nothing is near [m].
        tool_radius: [m].
    """

    obstacles: SpaceField
    top: float
    tool_radius: float


@lru_cache
def make_robot_rollout(dof: int) -> wp.Kernel:
    """The rollout kernel for an arm of ``dof`` joints."""
    vec = wp.types.vector(length=dof, dtype=float)

    @wp.kernel(module=f"oimppi_warp.kernels.robot_rollout_{dof}", enable_backward=False)
    def robot_rollout(
        # in:
        arm: Arm,
        model: ObjectModel,
        surroundings: Surroundings,
        weights: RobotWeights,
        start_joints: wp.array[vec],
        start_object: wp.array[wp.vec3],
        goal: wp.array[wp.vec3],
        reference: wp.array[wp.vec3],
        align_ahead: int,
        controls: wp.array2d[vec],
        dt: float,
        contact_steps: int,
        # out:
        costs: wp.array[float],
        terms: wp.array[CostTerms],
        tips: wp.array2d[wp.vec3],
        poses: wp.array2d[wp.vec3],
    ):
        """Cost of each joint velocity sequence; its terms, tips and poses where those arrays have room for them.

        Shapes: ``start_joints`` [1], ``start_object`` [1], ``goal`` [1], ``reference`` [horizon + 1 + align_ahead],
        ``controls`` [sample, horizon] [rad/s], ``costs`` [sample], ``terms`` [sample] or empty, ``tips`` and ``poses``
        [sample, horizon + 1] or empty.
        """
        k = wp.tid()
        q = start_joints[0]
        pose = start_object[0]
        tip = wp.vec3()
        up = wp.vec3()
        room = float(1.0)
        total = CostTerms()

        for h in range(-1, controls.shape[1]):
            # h = -1 only places the arm, to know where the tool starts and how much room it has.
            old_q = q
            old_tip = tip
            old_up = up
            old_room = room
            speed_squared = float(0.0)
            if h >= 0:
                u = controls[k, h]
                for j in range(dof):
                    speed = wp.clamp(u[j], -arm.speed[j], arm.speed[j])
                    speed_squared += speed * speed
                    q[j] = wp.clamp(q[j] + dt * speed, wp.min(arm.lower[j], q[j]), wp.max(arm.upper[j], q[j]))

            room = float(1.0)
            r = wp.identity(n=3, dtype=float)
            p = wp.vec3()
            for j in range(dof):
                p = p + r * arm.position[j]
                r = turn_about_z(r * arm.rotation[j], q[j])
                for s in range(arm.first_sphere[j], arm.first_sphere[j + 1]):
                    ball = arm.sphere[s]
                    height = p[2] + r[2, 0] * ball[0] + r[2, 1] * ball[1] + r[2, 2] * ball[2]
                    room = wp.min(room, height - ball[3])
                    if height - ball[3] < surroundings.top:
                        at = p + r * wp.vec3(ball[0], ball[1], ball[2])
                        room = wp.min(room, space_field(surroundings.obstacles, at) - ball[3])
            tip = p + r * arm.tip_position
            up = wp.transpose(arm.tip_rotation) * wp.vec3(r[2, 0], r[2, 1], r[2, 2])
            room = wp.min(room, tip[2])

            if h >= 0:
                # A step that would carry the arm further into an obstacle or the table, or the tool down onto the
                # object, is not taken: the arm stalls.
                stalled = room < -GIVE and room < old_room
                above = float(0.0)
                if tip[2] >= model.top or old_tip[2] >= model.top:
                    c = wp.cos(pose[2])
                    s_ = wp.sin(pose[2])
                    local = rotate(c, -s_, wp.vec2(tip[0] - pose[0], tip[1] - pose[1]))
                    if planar_field(model.body, local)[0] < surroundings.tool_radius:
                        above = 1.0
                        if tip[2] < model.top:
                            stalled = True
                pressed = float(0.0)
                force = float(0.0)
                new_pose = pose
                if not stalled:
                    if tip[2] < model.top and old_tip[2] < model.top:
                        last = wp.vec2(old_tip[0], old_tip[1])
                        move = (wp.vec2(tip[0], tip[1]) - last) / float(contact_steps)
                        for _ in range(contact_steps):
                            new_pose = push(model, new_pose, last, last + move, surroundings.tool_radius)
                            last = last + move
                    if new_pose[0] != pose[0] or new_pose[1] != pose[1] or new_pose[2] != pose[2]:
                        settled = settle(model, new_pose, dt)
                        new_pose = settled.pose
                        force = settled.force
                        if force > 0.0:
                            # The obstacle pushed back: what is left between tool and object is a jam.
                            c = wp.cos(new_pose[2])
                            s_ = wp.sin(new_pose[2])
                            local = rotate(c, -s_, wp.vec2(tip[0] - new_pose[0], tip[1] - new_pose[1]))
                            pressed = wp.max(surroundings.tool_radius - planar_field(model.body, local)[0], 0.0)
                            stalled = pressed > 2.0e-3
                if stalled:
                    q = old_q
                    tip = old_tip
                    up = old_up
                else:
                    pose = new_pose

                total += robot_cost(
                    weights,
                    tip,
                    up,
                    pose,
                    0.5 * model.top,
                    goal[0],
                    reference[h + 1],
                    reference[h + 1 + align_ahead],
                    force,
                    room,
                    above,
                    pressed,
                    speed_squared,
                )
                if stalled:
                    room = old_room

            if k < tips.shape[0]:
                tips[k, h + 1] = tip
                poses[k, h + 1] = pose

        cost = float(0.0)
        for i in range(wp.static(len(CostTerms()))):
            cost += total[i]
        costs[k] = cost
        if k < terms.shape[0]:
            terms[k] = total

    return robot_rollout
