"""Rollouts of the robot level in one kernel: arm, contact, object, obstacles and costs, one thread per rollout.

Controls are joint velocities (:func:`make_robot_rollout`), or velocities of the tip of an arm that holds its tool
upright (:func:`make_upright_rollout`). They differ in how the arm moves; contact, object and costs are the same.
"""

from functools import lru_cache

import warp as wp

from oimppi_warp.kernels.contact import Contact, touch
from oimppi_warp.kernels.costs.stage_costs import make_robot_cost, terms_vector
from oimppi_warp.kernels.costs.terms import ExtraTerms, module_of
from oimppi_warp.kernels.kinematics import ArmPlacement, make_place_arm
from oimppi_warp.kernels.pushing import ObjectModel
from oimppi_warp.kernels.rollouts.uncertainty import Draw
from oimppi_warp.kernels.task import RobotTask, Stage, above_penalty, stage_at
from oimppi_warp.kernels.upright import place_upright
from oimppi_warp.kernels.upright_step import step_upright

wp.set_module_options({"enable_backward": False})

JAM = wp.constant(2.0e-3)
"""Depth of the tool in an object that cannot yield, beyond which the arm stalls [m]."""


@wp.func
def object_in_draw(model: ObjectModel, draw: Draw) -> ObjectModel:
    """Returns the object with the friction of a draw of the world."""
    body = ObjectModel()
    body.force = model.force * draw.force
    body.radius = model.radius
    body.tool_friction = model.tool_friction * draw.tool_friction
    body.top = model.top
    body.size = model.size
    body.clearance = model.clearance
    body.body = model.body
    body.slack = model.slack
    return body


@wp.func
def stage_of(
    task: RobotTask,
    h: int,
    placed: ArmPlacement,
    tried: ArmPlacement,
    start: wp.vec3,
    pose: wp.vec3,
    contact: Contact,
) -> Stage:
    """Returns the stage after a control step that began with the tip at ``start``.

    ``placed`` is the arm and ``pose`` the object as they came to rest, ``tried`` the arm without what stopped it.
    """
    stage = stage_at(task, h, placed, pose)
    stage.velocity = wp.vec2(tried.tip[0] - start[0], tried.tip[1] - start[1]) / task.dt
    stage.force = contact.force
    stage.arm_clearance = tried.arm_clearance
    if contact.above:
        stage.above = above_penalty(task, tried.tip)
    stage.pressed = contact.pressed
    stage.gap = contact.gap
    stage.rise = contact.rise
    return stage


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
        environment = task.environment
        dt = task.dt
        body = object_in_draw(task.model, draw)
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
            tried = place_arm(arm, environment, tool, q)
            contact = touch(body, pose, old, tried, environment.tool_radius, dt, contact_steps)
            if contact.stopped or contact.pressed > JAM:
                q = old_q
                placed = old
            else:
                placed = tried
                pose = contact.pose
            stage = stage_of(task, h, placed, tried, old.tip, pose, contact)
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


@lru_cache
def make_upright_rollout(extra: ExtraTerms) -> wp.Kernel:
    """Returns the rollout kernel whose controls are velocities of the tip, for a set of cost terms.

    Args:
        extra: Cost terms from outside the package.
    """
    vector = terms_vector(len(extra))
    robot_cost = make_robot_cost(extra)

    @wp.kernel(**module_of("upright_rollout", extra), enable_backward=False)
    def upright_rollout(
        # in:
        first: int,
        task: RobotTask,
        draws: wp.array[Draw],
        per_sample: int,
        contact_steps: int,
        start_tip: wp.array[wp.vec3],
        start_object: wp.array[wp.vec3],
        controls: wp.array2d[wp.vec3],
        # out:
        costs: wp.array[float],
        terms: wp.array[vector],
        tips: wp.array2d[wp.vec3],
        poses: wp.array2d[wp.vec3],
    ):
        """Computes the cost of each rollout, and its terms, tips and poses unless their arrays are empty.

        The arm moves by :func:`step_upright`; everything else is as in the kernel of :func:`make_robot_rollout`.

        Shapes: ``start_tip`` [1], ``controls`` [sample, horizon] [m/s], the others as there.
        """
        n = first + wp.tid()
        k = n / per_sample
        draw = draws[n % draws.shape[0]]
        upright = task.upright
        radius = task.environment.tool_radius
        repositioning = task.waypoint[0][3] > 0.0
        body = object_in_draw(task.model, draw)
        placed = place_upright(upright, start_tip[0] + wp.vec3(draw.tool[0], draw.tool[1], 0.0))
        pose = start_object[0] + draw.pose
        total = vector()
        if n < tips.shape[0]:
            tips[n, 0] = placed.tip
            poses[n, 0] = pose

        ahead = controls[k, 0]  # controls are read a step early, since a GPU waits for memory
        for h in range(controls.shape[1]):
            old = placed
            u = ahead
            ahead = controls[k, wp.min(h + 1, controls.shape[1] - 1)]
            step = step_upright(upright, body, pose, old, u, repositioning, radius, task.dt, contact_steps)
            placed = step.placed
            pose = step.contact.pose
            stage = stage_of(task, h, placed, step.tried, old.tip, pose, step.contact)
            stage.speed_squared = wp.length_sq(u)
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

    return upright_rollout
