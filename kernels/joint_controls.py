"""Joint velocities that follow velocities of the tip, for engines that do not take the latter."""

from functools import lru_cache

import warp as wp

from oimppi_warp.kernels.bounds import TOUCHING, approach, keep_clear, least_clearance
from oimppi_warp.kernels.kinematics import Arm, Environment
from oimppi_warp.kernels.pushing import ObjectModel, phi_1
from oimppi_warp.kernels.upright import UprightArm, braking_at, fastest, place_upright
from oimppi_warp.kernels.upright_step import move_upright

wp.set_module_options({"enable_backward": False})

SEAM = wp.constant(1.5)
"""Difference of a joint's positions at neighbouring nodes beyond which they belong to different turns [rad]."""


@lru_cache
def make_joint_controls(dof: int) -> wp.Kernel:
    """Returns the kernel that converts velocities of the tip to joint velocities, for an arm of ``dof`` joints."""
    vec = wp.types.vector(length=dof, dtype=float)

    @wp.func(name=f"posture_{dof}", module=f"oimppi_warp.kernels.joint_controls_{dof}")
    def posture(postures: wp.array3d[vec], origin: wp.vec3, inv_step: float, tip: wp.vec3) -> vec:
        """Returns the joint positions of a tip position: linear between nodes or, across a seam, those of the nearest.

        At a seam, a joint's positions at neighbouring nodes belong to different turns.
        """
        fx = wp.clamp((tip[0] - origin[0]) * inv_step, 0.0, float(postures.shape[0] - 1) - 1.0e-3)
        fy = wp.clamp((tip[1] - origin[1]) * inv_step, 0.0, float(postures.shape[1] - 1) - 1.0e-3)
        fz = wp.clamp((tip[2] - origin[2]) * inv_step, 0.0, float(postures.shape[2] - 1) - 1.0e-3)
        i = int(fx)
        j = int(fy)
        k = int(fz)
        nearest = postures[int(wp.round(fx)), int(wp.round(fy)), int(wp.round(fz))]
        q = vec()
        seam = float(0.0)
        for c in range(8):
            a = c & 1
            b = (c >> 1) & 1
            d = (c >> 2) & 1
            w = wp.abs(1.0 - float(a) - (fx - float(i)))
            w *= wp.abs(1.0 - float(b) - (fy - float(j)))
            w *= wp.abs(1.0 - float(d) - (fz - float(k)))
            corner = postures[i + a, j + b, k + d]
            q = q + w * corner
            seam = wp.max(seam, wp.max(wp.abs(corner - nearest)))
        if seam > SEAM:
            q = nearest
        return q

    @wp.kernel(module=f"oimppi_warp.kernels.joint_controls_{dof}", enable_backward=False)
    def joint_controls(
        # in:
        first: int,
        arm: Arm,
        environment: Environment,
        upright: UprightArm,
        model: ObjectModel,
        postures: wp.array3d[vec],
        start_joints: wp.array[vec],
        start: wp.array[wp.vec3],
        waypoint: wp.array[wp.vec4],
        controls: wp.array2d[wp.vec3],
        dt: float,
        # out:
        joint_controls: wp.array2d[vec],
    ):
        """Converts velocities of the tip to joint velocities that follow them, from the current joint positions.

        Shapes: ``postures`` [nx, ny, nz], on the grid of ``upright.speed`` [rad], ``start_joints`` [1], ``start`` [2]:
        the tip's position and the object's pose, ``waypoint`` [1], ``controls`` [sample, horizon] [m/s],
        ``joint_controls`` likewise [rad/s].
        """
        n = first + wp.tid()
        placed = place_upright(upright, start[0])
        q = start_joints[0]
        origin = upright.speed.origin
        inv_step = upright.speed.inv_step
        repositioning = waypoint[0][3] > 0.0
        radius = environment.tool_radius
        # What the joints deviate from the posture by at first is kept: the servo removes it slowly.
        offset = q - posture(postures, origin, inv_step, placed.tip)
        last = placed.tip
        touched = bool(False)
        for h in range(controls.shape[1]):
            most = fastest(upright, last)
            braking = braking_at(upright, most)
            least = least_clearance(placed.arm_clearance, upright.arm_margin, braking, dt)
            u_tip = controls[n, h]
            moved = move_upright(upright, model, start[1], last, u_tip, most, repositioning, radius, braking, dt)
            placed = place_upright(upright, moved)
            if placed.arm_clearance < least:
                placed = keep_clear(upright.clearance, placed, least)
            # Once touched, the object is no longer where it was.
            touched = touched or phi_1(model, start[1], wp.vec2(last[0], last[1])) < radius + TOUCHING
            if not touched:
                placed.tip = approach(upright, model, start[1], last, placed.tip, radius, braking, dt)
            last = placed.tip
            wanted = posture(postures, origin, inv_step, placed.tip) + offset
            u = vec()
            for j in range(dof):
                u[j] = wp.clamp((wanted[j] - q[j]) / dt, -arm.speed[j], arm.speed[j])
            q = q + dt * u
            joint_controls[n, h] = u

    return joint_controls
