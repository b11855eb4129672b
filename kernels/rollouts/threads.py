"""Inputs and outputs of rollouts by MuJoCo's C engine: control sequences, and the forces read from its sensors."""

from functools import lru_cache

import warp as wp

from oimppi_warp.kernels.kinematics import Arm

wp.set_module_options({"enable_backward": False})


@lru_cache
def make_expand_controls(dof: int) -> wp.Kernel:
    """Returns the kernel that converts joint velocities to drive commands, for an arm of ``dof`` joints."""
    vec = wp.types.vector(length=dof, dtype=float)

    @wp.kernel(module=f"oimppi_warp.kernels.expand_controls_{dof}", enable_backward=False)
    def expand_controls(
        # in:
        first: int,
        controls: wp.array2d[vec],
        per_sample: int,
        start: wp.array[vec],
        arm: Arm,
        dt: float,
        substeps: int,
        drive: wp.array[int],
        # out:
        drives: wp.array3d[wp.float64],
    ):
        """Converts joint velocities to drive commands, held for the substeps of a control step.

        They keep within the limits of joint velocity and position, as in the plant. Shapes:
        ``controls`` [sample, horizon] [rad/s], ``start`` [1] [rad], ``drive`` (entry of each joint in the commands)
        [dof], ``drives`` [rollout, horizon * substeps, drive].
        """
        n = first + wp.tid()
        q = start[0]
        for h in range(controls.shape[1]):
            u = controls[n / per_sample, h]
            for j in range(dof):
                v = wp.clamp(u[j], (arm.lower[j] - q[j]) / dt, (arm.upper[j] - q[j]) / dt)
                v = wp.clamp(v, -arm.speed[j], arm.speed[j])
                q[j] = q[j] + dt * v
                for s in range(substeps):
                    drives[n, h * substeps + s, drive[j]] = wp.float64(v)

    return expand_controls


@wp.kernel
def read_forces(
    # in:
    first: int,
    sensed: wp.array3d[wp.float64],
    group: wp.array[int],
    substeps: int,
    times: wp.array[wp.float64],
    end: wp.float64,
    # out:
    forces: wp.array2d[wp.vec2],
    lost: wp.array[int],
):
    """Finds the largest contact forces within each control step, and whether the simulation diverged.

    Shapes: ``sensed`` [rollout, horizon * substeps, 3 * sensor] [N], ``group`` [sensor]: 0 for lambda_2, 1 for
    lambda_3, ``times`` [rollout]: time at the end of each rollout [s], earlier than ``end`` if it diverged,
    ``forces`` [rollout, horizon] [N], ``lost`` [rollout].
    """
    n = first + wp.tid()
    for h in range(forces.shape[1]):
        most = wp.vec2()
        for s in range(substeps):
            sums = wp.vec2()
            for i in range(group.shape[0]):
                x = float(sensed[n, h * substeps + s, 3 * i])
                y = float(sensed[n, h * substeps + s, 3 * i + 1])
                z = float(sensed[n, h * substeps + s, 3 * i + 2])
                force = wp.sqrt(x * x + y * y + z * z)
                sums[group[i]] = sums[group[i]] + force
            most = wp.max(most, sums)
        forces[n, h] = most
    lost[n] = 0
    if times[n] < end:
        lost[n] = 1
