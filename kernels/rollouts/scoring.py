"""Stage costs of trajectories from a physics engine: MuJoCo's C engine or Newton's batched worlds."""

from functools import lru_cache

import warp as wp

from oimppi_warp.kernels.costs.stage_costs import make_robot_cost, terms_vector
from oimppi_warp.kernels.costs.terms import NOT_PUSHED, ExtraTerms, module_of
from oimppi_warp.kernels.geometry import rotate
from oimppi_warp.kernels.kinematics import make_place_arm
from oimppi_warp.kernels.pushing import over_object
from oimppi_warp.kernels.task import RobotTask, above_penalty, stage_at

wp.set_module_options({"enable_backward": False})


@wp.struct
class PhysicsOutcome:
    """Contact forces and failures of rollouts by a physics engine.

    Attributes:
        forces: lambda_2 and lambda_3 in each control step, [rollout, horizon] [N].
        lost: 1 where the simulation diverged, [rollout].
    """

    forces: wp.array2d[wp.vec2]
    lost: wp.array[int]


@lru_cache
def make_stage_costs(chain: str, precision: type, extra: ExtraTerms) -> wp.Kernel:
    """Returns the kernel that computes the stage costs of an engine's trajectories.

    Args:
        chain: The chain of joints, like ``"RRRRRR"``.
        precision: Type of the states' numbers: ``wp.float32`` or ``wp.float64``.
        extra: Cost terms from outside the package.
    """
    dof = len(chain)
    vec = wp.types.vector(length=dof, dtype=float)
    vector = terms_vector(len(extra))
    joints_type = wp.types.vector(length=dof, dtype=precision)
    object_type = wp.types.vector(length=7, dtype=precision)
    place_arm = make_place_arm(chain)
    robot_cost = make_robot_cost(extra)
    bits = 8 * wp.types.type_size_in_bytes(precision)

    @wp.kernel(**module_of(f"stage_costs_{chain}_{bits}", extra), enable_backward=False)
    def stage_costs(
        # in:
        first: int,
        task: RobotTask,
        controls: wp.array2d[vec],
        per_sample: int,
        start_joints: wp.array[vec],
        joints: wp.array2d[joints_type],
        objects: wp.array2d[object_type],
        outcome: PhysicsOutcome,
        # out:
        costs: wp.array[float],
        terms: wp.array[vector],
        tips: wp.array2d[wp.vec3],
        poses: wp.array2d[wp.vec3],
    ):
        """Computes the cost of each rollout, with its terms, tips and poses.

        The cost is ``S = sum_h l_o + l_r + l_c`` (equation 10, l_c as in equation 14); there is no terminal cost l_f.

        Shapes: ``controls`` [sample, horizon] [rad/s], ``start_joints`` [1]: before them, ``joints`` and ``objects``
        (position, quaternion wxyz) [rollout, horizon]: states after each control step, ``costs`` and ``terms``
        [rollout], ``tips`` and ``poses`` [rollout, horizon].
        """
        n = first + wp.tid()
        arm = task.arm
        environment = task.environment
        total = vector()
        last = place_arm(arm, environment, arm.tip_position, start_joints[0]).tip
        for h in range(controls.shape[1]):
            q = vec()
            speed_squared = float(0.0)
            u = controls[n / per_sample, h]
            for j in range(dof):
                q[j] = float(joints[n, h][j])
                speed = wp.clamp(u[j], -arm.speed[j], arm.speed[j])
                speed_squared += speed * speed
            placed = place_arm(arm, environment, arm.tip_position, q)
            at = objects[n, h]
            qw = float(at[3])
            qx = float(at[4])
            qy = float(at[5])
            qz = float(at[6])
            yaw = wp.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
            c = wp.cos(yaw)
            s = wp.sin(yaw)
            middle = rotate(c, s, task.model.center) + wp.vec2(float(at[0]), float(at[1]))
            pose = wp.vec3(middle[0], middle[1], yaw)
            stage = stage_at(task, h, placed, pose)
            if placed.tip[2] >= task.model.top:
                if over_object(task.model, pose, placed.tip, environment.tool_radius):
                    stage.above = above_penalty(task, placed.tip)
            stage.velocity = wp.vec2(placed.tip[0] - last[0], placed.tip[1] - last[1]) / task.dt
            stage.force = outcome.forces[n, h][0]
            stage.collision = outcome.forces[n, h][1]
            stage.arm_clearance = placed.arm_clearance
            stage.gap = NOT_PUSHED
            stage.speed_squared = speed_squared
            total += robot_cost(task.weights, stage)
            last = placed.tip
            tips[n, h] = placed.tip
            poses[n, h] = pose
        terms[n] = total
        cost = float(0.0)
        for i in range(wp.static(len(vector()))):
            cost += total[i]
        if outcome.lost[n] != 0:
            cost = wp.inf
        costs[n] = cost

    return stage_costs


@lru_cache
def make_pick_trace(count: int) -> wp.Kernel:
    """Returns the kernel that copies the trace of the cheapest sample, for ``count`` cost terms."""
    vector = wp.types.vector(length=count, dtype=float)

    @wp.kernel(module=f"oimppi_warp.kernels.pick_trace_{count}", enable_backward=False)
    def pick_trace(
        # in:
        costs: wp.array[float],
        per_sample: int,
        all_terms: wp.array[vector],
        all_tips: wp.array2d[wp.vec3],
        all_poses: wp.array2d[wp.vec3],
        # out:
        terms: wp.array[vector],
        tips: wp.array[wp.vec3],
        poses: wp.array[wp.vec3],
    ):
        """Copies the trace of the cheapest sample; launched with one block (on the CPU: one thread).

        It is that of the sample's first rollout. Shapes: ``costs`` [sample], ``all_terms`` [rollout], ``all_tips`` and
        ``all_poses`` [rollout, horizon], ``terms`` [1], ``tips`` and ``poses`` [horizon].
        """
        i = wp.tid()
        least = float(wp.inf)
        best = int(0)
        for k in range(i, costs.shape[0], wp.block_dim()):
            if costs[k] < least:
                least = costs[k]
                best = k
        winner = wp.tile_argmin(wp.tile(least))[0]
        if i == winner:
            n = best * per_sample
            terms[0] = all_terms[n]
            for h in range(tips.shape[0]):
                tips[h] = all_tips[n, h]
                poses[h] = all_poses[n, h]

    return pick_trace
