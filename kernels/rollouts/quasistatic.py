"""Rollouts of the robot level in one kernel: arm, contact, object, obstacles and costs, one thread per rollout."""

from functools import lru_cache

import warp as wp

from oimppi_warp.kernels.costs.stage_costs import make_robot_cost, terms_vector
from oimppi_warp.kernels.costs.terms import NOT_PUSHED, ExtraTerms, module_of
from oimppi_warp.kernels.kinematics import make_place_arm
from oimppi_warp.kernels.pushing import ObjectModel, phi_1, push, settle
from oimppi_warp.kernels.rollouts.uncertainty import Draw
from oimppi_warp.kernels.task import RobotTask, above_penalty, over_object, stage_at

wp.set_module_options({"enable_backward": False})

PENETRATION_TOLERANCE = wp.constant(5.0e-4)
"""Penetration depth beyond which the arm is stopped [m]."""


@lru_cache
def make_robot_rollout(chain: str, extra: ExtraTerms) -> wp.Kernel:
    """Returns the rollout kernel for an arm and a set of cost terms.

    Args:
        chain: The chain of joints, like ``"RRRRRR"``.
        extra: Cost terms from outside the package.
    """
    dof = len(chain)
    vec = wp.types.vector(length=dof, dtype=float)
    vector = terms_vector(len(extra))
    place_arm = make_place_arm(chain)
    robot_cost = make_robot_cost(extra)

    @wp.kernel(**module_of(f"robot_rollout_{chain}", extra), enable_backward=False)
    def robot_rollout(
        # in:
        first: int,
        task: RobotTask,
        draws: wp.array[Draw],
        per_sample: int,
        contact_steps: int,
        start_joints: wp.array[vec],
        start_object: wp.array[wp.vec3],
        controls: wp.array2d[vec],
        # out:
        costs: wp.array[float],
        terms: wp.array[vector],
        tips: wp.array2d[wp.vec3],
        poses: wp.array2d[wp.vec3],
    ):
        """Computes the cost of each rollout, and its terms, tips and poses unless their arrays are empty.

        The arm moves by ``x_r <- x_r + dt u_r``: equation 1 with ``f_r = x_r`` and ``g_r = dt``. Its force term
        ``h_r w_r`` is modelled as a stall: a step against something that cannot yield is not taken, which also replaces
        ``0 <= lambda_3 _|_ phi_3 >= 0`` (equation 4). Velocities and positions within their limits are the set C of
        equation 8. The object moves by :func:`push` and :func:`settle` (equation 2). The cost is
        ``S = sum_h l_o + l_r + l_c`` (equation 10, l_c as in equation 14); there is no terminal cost l_f.

        Shapes: ``draws`` [draw] (rollout n is in draw n modulo their number), ``start_joints`` and ``start_object``
        [1], ``controls`` [sample, horizon] [rad/s], ``costs`` [sample * per_sample], ``terms`` [rollout] or empty,
        ``tips`` and ``poses`` [rollout, horizon + 1] or empty.
        """
        n = first + wp.tid()
        k = n / per_sample
        draw = draws[n % draws.shape[0]]
        arm = task.arm
        model = task.model
        environment = task.environment
        dt = task.dt
        body = ObjectModel()
        body.force = model.force * draw.force
        body.radius = model.radius
        body.tool_friction = model.tool_friction * draw.tool_friction
        body.top = model.top
        body.clearance = model.clearance
        body.body = model.body
        body.slack = model.slack
        tool = arm.tip_position + arm.tip_rotation * wp.vec3(draw.tool[0], draw.tool[1], 0.0)
        q = start_joints[0]
        pose = start_object[0] + draw.pose
        placed = place_arm(arm, environment, tool, q)
        total = vector()
        if n < tips.shape[0]:
            tips[n, 0] = placed.tip
            poses[n, 0] = pose

        for h in range(controls.shape[1]):
            old_q = q
            old = placed
            speed_squared = float(0.0)
            u = controls[k, h]
            for j in range(dof):
                speed = wp.clamp(u[j], -arm.speed[j], arm.speed[j])
                speed_squared += speed * speed
                q[j] = wp.clamp(q[j] + dt * speed, wp.min(arm.lower[j], q[j]), wp.max(arm.upper[j], q[j]))
            placed = place_arm(arm, environment, tool, q)
            tip = placed.tip
            arm_clearance = placed.arm_clearance

            # The arm stalls: a step that would move it further into an obstacle or the table, or the tool down onto
            # the object, is not taken.
            stalled = arm_clearance < -PENETRATION_TOLERANCE and arm_clearance < old.arm_clearance
            above = float(0.0)
            if tip[2] >= body.top or old.tip[2] >= body.top:
                if over_object(task, tip, pose):
                    above = above_penalty(task, tip)
                    if tip[2] < body.top:
                        stalled = True
            pressed = float(0.0)
            force = float(0.0)
            gap = NOT_PUSHED
            rise = float(0.0)
            new_pose = pose
            if not stalled:
                if tip[2] < body.top and old.tip[2] < body.top:
                    last = wp.vec2(old.tip[0], old.tip[1])
                    move = (wp.vec2(tip[0], tip[1]) - last) / float(contact_steps)
                    for _ in range(contact_steps):
                        new_pose = push(body, new_pose, last, last + move, environment.tool_radius)
                        last = last + move
                if new_pose[0] != pose[0] or new_pose[1] != pose[1] or new_pose[2] != pose[2]:
                    settled = settle(body, new_pose, dt)
                    new_pose = settled.pose
                    force = settled.force
                    gap = settled.clearance
                    rise = wp.max(tip[2] - old.tip[2], 0.0) / dt
                    if force > 0.0:
                        # The obstacle pushed the object back: any remaining overlap of tool and object is a jam.
                        gap_to_tool = phi_1(body, new_pose, wp.vec2(tip[0], tip[1]))
                        pressed = wp.max(environment.tool_radius - gap_to_tool, 0.0)
                        stalled = pressed > 2.0e-3
            if stalled:
                q = old_q
                placed = old
            else:
                pose = new_pose

            stage = stage_at(task, h, placed, pose)
            stage.velocity = wp.vec2(tip[0] - old.tip[0], tip[1] - old.tip[1]) / dt
            stage.force = force
            stage.arm_clearance = arm_clearance
            stage.above = above
            stage.pressed = pressed
            stage.gap = gap
            stage.rise = rise
            stage.speed_squared = speed_squared
            total += robot_cost(task.weights, stage)
            if n < tips.shape[0]:
                tips[n, h + 1] = placed.tip
                poses[n, h + 1] = pose

        cost = float(0.0)
        for i in range(wp.static(len(vector()))):
            cost += total[i]
        costs[n] = cost
        if n < terms.shape[0]:
            terms[n] = total

    return robot_rollout
