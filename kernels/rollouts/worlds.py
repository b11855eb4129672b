"""Inputs and outputs of batched worlds that MuJoCo Warp steps: states, commands and contact forces."""

from functools import lru_cache

import warp as wp

from oimppi_warp.kernels.kinematics import Arm

wp.set_module_options({"enable_backward": False})

Transform = wp.types.vector(length=7, dtype=float)
"""Position and quaternion wxyz, in MuJoCo's order."""


@wp.struct
class Places:
    """Indices of a world's joints, drives and object in its state and its commands.

    Attributes:
        joint_qpos, joint_qvel: Index of each joint in ``qpos`` and ``qvel``, [dof].
        drive: Index of each joint's drive in ``ctrl``, [dof].
        object_qpos: Index of the object's first coordinate in ``qpos``.
    """

    joint_qpos: wp.array[int]
    joint_qvel: wp.array[int]
    drive: wp.array[int]
    object_qpos: int


@lru_cache
def make_place_worlds(dof: int) -> wp.Kernel:
    """Returns the kernel that sets the states of all worlds, for an arm of ``dof`` joints."""
    vec = wp.types.vector(length=dof, dtype=float)

    @wp.kernel(module=f"oimppi_warp.kernels.place_worlds_{dof}", enable_backward=False)
    def place_worlds(
        # in:
        joints: wp.array[vec],
        velocities: wp.array[vec],
        pushed: wp.array[Transform],
        errors: wp.array[wp.vec3],
        places: Places,
        # out:
        qpos: wp.array2d[float],
        qvel: wp.array2d[float],
        warm_start: wp.array2d[float],
        overflow: wp.array[int],
    ):
        """Sets all worlds to one state, with the object offset by each world's error, and clears the warm start.

        Shapes: ``joints``, ``velocities`` and ``pushed`` [1], ``errors`` [draw] (x, y, yaw), ``qpos``, ``qvel`` and
        ``warm_start`` [world, n], ``overflow`` [world].
        """
        w = wp.tid()
        object_qpos = places.object_qpos
        for i in range(qvel.shape[1]):
            qvel[w, i] = 0.0
            warm_start[w, i] = 0.0
        for j in range(dof):
            qpos[w, places.joint_qpos[j]] = joints[0][j]
            qvel[w, places.joint_qvel[j]] = velocities[0][j]
        at = pushed[0]
        off = errors[w % errors.shape[0]]
        at[0] = at[0] + off[0]
        at[1] = at[1] + off[1]
        c = wp.cos(0.5 * off[2])
        s = wp.sin(0.5 * off[2])
        qpos[w, object_qpos] = at[0]
        qpos[w, object_qpos + 1] = at[1]
        qpos[w, object_qpos + 2] = at[2]
        qpos[w, object_qpos + 3] = c * at[3] - s * at[6]
        qpos[w, object_qpos + 4] = c * at[4] - s * at[5]
        qpos[w, object_qpos + 5] = c * at[5] + s * at[4]
        qpos[w, object_qpos + 6] = c * at[6] + s * at[3]
        overflow[w] = 0

    return place_worlds


@lru_cache
def make_drive_worlds(dof: int) -> wp.Kernel:
    """Returns the kernel that sets the commands of all worlds, for an arm of ``dof`` joints."""
    vec = wp.types.vector(length=dof, dtype=float)

    @wp.kernel(module=f"oimppi_warp.kernels.drive_worlds_{dof}", enable_backward=False)
    def drive_worlds(
        # in:
        h: int,
        controls: wp.array2d[vec],
        per_sample: int,
        arm: Arm,
        dt: float,
        places: Places,
        qpos: wp.array2d[float],
        # out:
        ctrl: wp.array2d[float],
        joints: wp.array2d[vec],
        objects: wp.array2d[Transform],
    ):
        """Stores the states at the end of control step ``h - 1`` and sets the commands of step ``h``.

        Commands keep within the limits of joint velocity and position, as in the plant. Shapes:
        ``controls`` [sample, horizon] [rad/s], ``qpos`` and ``ctrl`` [world, n], ``joints`` and ``objects``
        [world, horizon].
        """
        w = wp.tid()
        q = vec()
        for j in range(dof):
            q[j] = qpos[w, places.joint_qpos[j]]
        if h > 0:
            joints[w, h - 1] = q
            at = Transform()
            for i in range(7):
                at[i] = qpos[w, places.object_qpos + i]
            objects[w, h - 1] = at
        if h < controls.shape[1]:
            u = controls[w / per_sample, h]
            for j in range(dof):
                v = wp.clamp(u[j], (arm.lower[j] - q[j]) / dt, (arm.upper[j] - q[j]) / dt)
                ctrl[w, places.drive[j]] = wp.clamp(v, -arm.speed[j], arm.speed[j])

    return drive_worlds


@wp.kernel
def feel_contacts(
    # in:
    step: int,
    contacts: wp.array[int],
    geom: wp.array[wp.vec2i],
    world: wp.array[int],
    row: wp.array2d[int],
    force: wp.array2d[float],
    group: wp.array2d[int],
    # out:
    sensed: wp.array2d[wp.vec2],
):
    """Adds up the normal forces of one physics step.

    Shapes: ``contacts`` [1] is their number, ``geom``, ``world`` and ``row`` (of the normal force among the
    constraints; negative if there is none) of each [contact], ``force`` [world, constraint] [N], ``group``
    [geom, geom]: 0 for lambda_2, 1 for lambda_3, else negative, ``sensed`` [world, physics step] [N].
    """
    c = wp.tid()
    if c < contacts[0]:
        which = group[geom[c][0], geom[c][1]]
        if which >= 0 and row[c, 0] >= 0:
            w = world[c]
            normal = force[w, row[c, 0]]
            wp.atomic_add(sensed, w, step, wp.vec2(float(1 - which) * normal, float(which) * normal))


@wp.kernel
def take_forces(
    # in:
    sensed: wp.array2d[wp.vec2],
    substeps: int,
    qpos: wp.array2d[float],
    overflow: wp.array[int],
    # out:
    forces: wp.array2d[wp.vec2],
    lost: wp.array[int],
    overflows: wp.array[int],
):
    """Finds the largest contact forces within each control step, diverged worlds, and overflows of any world.

    Shapes: ``sensed`` [world, horizon * substeps] [N], ``qpos`` [world, n], ``overflow`` [world], ``forces``
    [world, horizon] [N], ``lost`` [world], ``overflows`` [1].
    """
    w = wp.tid()
    for h in range(forces.shape[1]):
        most = wp.vec2()
        for s in range(substeps):
            most = wp.max(most, sensed[w, h * substeps + s])
        forces[w, h] = most
    bad = int(0)
    for i in range(qpos.shape[1]):
        if not wp.isfinite(qpos[w, i]) or wp.abs(qpos[w, i]) > 1.0e3:
            bad = 1
    lost[w] = bad
    if overflow[w] != 0:
        wp.atomic_or(overflows, 0, overflow[w])
