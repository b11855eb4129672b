"""Stage costs of trajectories that a physics engine rolled out: MuJoCo's C engine, or Newton's batched worlds."""

from functools import lru_cache

import warp as wp

from oimppi_warp.kernels.cost import FREE, OVER, CostTerms, RobotWeights, robot_cost
from oimppi_warp.kernels.geometry import PoseField, planar_field, pose_field, rotate
from oimppi_warp.kernels.kinematics import Arm, Surroundings, make_place_arm
from oimppi_warp.kernels.pushing import ObjectModel

wp.set_module_options({"enable_backward": False})


@lru_cache
def make_stage_costs(chain: str, precision: type) -> wp.Kernel:
    """The kernel for a chain like ``"RRRRRR"`` and states in ``precision``, ``wp.float32`` or ``wp.float64``."""
    dof = len(chain)
    vec = wp.types.vector(length=dof, dtype=float)
    joints_type = wp.types.vector(length=dof, dtype=precision)
    object_type = wp.types.vector(length=7, dtype=precision)
    place_arm = make_place_arm(chain)
    bits = 8 * wp.types.type_size_in_bytes(precision)

    @wp.kernel(module=f"oimppi_warp.kernels.stage_costs_{chain}_{bits}", enable_backward=False)
    def stage_costs(
        # in:
        first: int,
        arm: Arm,
        model: ObjectModel,
        surroundings: Surroundings,
        weights: RobotWeights,
        center: wp.vec2,
        goal: wp.array[wp.vec3],
        reference: wp.array[wp.vec3],
        guide: wp.array[wp.vec4],
        to_go: PoseField,
        align_ahead: int,
        controls: wp.array2d[vec],
        dt: float,
        start_joints: wp.array[vec],
        per_sample: int,
        joints: wp.array2d[joints_type],
        objects: wp.array2d[object_type],
        forces: wp.array2d[wp.vec2],
        lost: wp.array[int],
        # out:
        costs: wp.array[float],
        terms: wp.array[CostTerms],
        tips: wp.array2d[wp.vec3],
        poses: wp.array2d[wp.vec3],
    ):
        """Cost of each rollout, its terms, tips and poses.

        Shapes: ``center`` is the friction centre in the object's frame [m], ``goal`` and ``guide`` [1], ``reference``
        [horizon + 1 + align_ahead], ``controls`` [sample, horizon] [rad/s], ``start_joints`` [1]: before them,
        ``joints`` and ``objects`` (position, quaternion wxyz) [rollout, horizon]: states after each control step,
        ``forces`` [rollout, horizon]: lambda_2 and lambda_3 in it [N], ``lost`` [rollout]: 1 where the simulation
        diverged, ``costs`` and ``terms`` [rollout], ``tips`` and ``poses`` [rollout, horizon].
        """
        n = first + wp.tid()
        total = CostTerms()
        last = place_arm(arm, surroundings, arm.tip_position, start_joints[0]).tip
        for h in range(controls.shape[1]):
            q = vec()
            speed_squared = float(0.0)
            u = controls[n / per_sample, h]
            for j in range(dof):
                q[j] = float(joints[n, h][j])
                speed = wp.clamp(u[j], -arm.speed[j], arm.speed[j])
                speed_squared += speed * speed
            placed = place_arm(arm, surroundings, arm.tip_position, q)
            at = objects[n, h]
            qw = float(at[3])
            qx = float(at[4])
            qy = float(at[5])
            qz = float(at[6])
            yaw = wp.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
            c = wp.cos(yaw)
            s = wp.sin(yaw)
            middle = rotate(c, s, center) + wp.vec2(float(at[0]), float(at[1]))
            pose = wp.vec3(middle[0], middle[1], yaw)
            above = float(0.0)
            if placed.tip[2] >= model.top:
                local = rotate(c, -s, wp.vec2(placed.tip[0] - pose[0], placed.tip[1] - pose[1]))
                if planar_field(model.body, local)[0] < surroundings.tool_radius:
                    if guide[0][3] <= 0.0 or placed.tip[2] < model.top + OVER:
                        above = 1.0
            way = float(0.0)
            if weights.w_to_go > 0.0:
                way = pose_field(to_go, pose)[0]
            total += robot_cost(
                weights,
                placed.tip,
                placed.up,
                placed.lean,
                wp.vec2(placed.tip[0] - last[0], placed.tip[1] - last[1]) / dt,
                pose,
                model.top,
                goal[0],
                reference[h + 1],
                reference[h + 1 + align_ahead],
                way,
                forces[n, h][0],
                placed.room,
                above,
                0.0,
                FREE,
                0.0,
                speed_squared,
                forces[n, h][1],
                guide[0],
            )
            last = placed.tip
            tips[n, h] = placed.tip
            poses[n, h] = pose
        terms[n] = total
        cost = float(0.0)
        for i in range(wp.static(len(CostTerms()))):
            cost += total[i]
        if lost[n] != 0:
            cost = wp.inf
        costs[n] = cost

    return stage_costs


@wp.kernel
def pick_trace(
    # in:
    costs: wp.array[float],
    per_sample: int,
    all_terms: wp.array[CostTerms],
    all_tips: wp.array2d[wp.vec3],
    all_poses: wp.array2d[wp.vec3],
    # out:
    terms: wp.array[CostTerms],
    tips: wp.array[wp.vec3],
    poses: wp.array[wp.vec3],
):
    """Takes out what the cheapest sample led to; launched with one block (on the CPU: one thread).

    Of its rollouts the first is taken. Shapes: ``costs`` [sample], ``all_terms`` [rollout], ``all_tips`` and
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
