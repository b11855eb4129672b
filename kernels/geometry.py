"""Planar geometry and distance field look-ups, shared by all kernels."""

import warp as wp

wp.set_module_options({"enable_backward": False})

PI = wp.constant(3.14159265358979)


@wp.struct
class PlanarField:
    """A scalar over (x, y), bilinear between nodes and clamped outside.

    Attributes:
        values: [nx, ny].
        origin: Position of node (0, 0) [m].
        inv_step: Nodes per metre.
    """

    values: wp.array2d[float]
    origin: wp.vec2
    inv_step: float


@wp.struct
class PoseField:
    """A scalar over planar poses, trilinear between nodes, clamped in x and y, periodic in yaw.

    Attributes:
        values: [nyaw, nx, ny]; node (i, j, k) is at yaw ``i * 2 pi / nyaw``.
        origin: Position of node (0, 0) [m].
        inv_step: Nodes per metre.
        inv_yaw_step: Nodes per radian.
    """

    values: wp.array3d[float]
    origin: wp.vec2
    inv_step: float
    inv_yaw_step: float


@wp.struct
class SpaceField:
    """A scalar over (x, y, z), trilinear between nodes; ``outside`` beyond its box.

    Attributes:
        values: [nx, ny, nz].
        origin: Position of node (0, 0, 0) [m].
        inv_step: Nodes per metre.
        outside: Value beyond the box [m].
    """

    values: wp.array3d[float]
    origin: wp.vec3
    inv_step: float
    outside: float


@wp.func
def wrap_angle(a: float) -> float:
    """Wraps an angle to [-pi, pi) [rad]."""
    return a - 2.0 * PI * wp.floor((a + PI) / (2.0 * PI))


@wp.func
def angle_of(y: float, x: float) -> float:
    """Returns the angle of (x, y) from the x axis, from -pi to pi [rad]: ``wp.atan2`` to 3e-7, without branches.

    The library function took a seventh of a rollout on the CPU. The polynomial is a minimax fit to ``atan(t) / t`` over
    [0, 1], in powers of ``t^2``.
    """
    least = wp.min(wp.abs(x), wp.abs(y))
    most = wp.max(wp.abs(x), wp.abs(y))
    t = least / wp.max(most, 1.0e-30)
    s = t * t
    p = 0.021863258 - 0.004054634 * s
    p = -0.05591287 + s * p
    p = 0.096422486 + s * p
    p = -0.13908656 + s * p
    p = 0.19946574 + s * p
    p = -0.33329862 + s * p
    a = t * (0.99999934 + s * p)
    a = wp.where(wp.abs(y) > wp.abs(x), 0.5 * PI - a, a)
    a = wp.where(x < 0.0, PI - a, a)
    return wp.where(y < 0.0, -a, a)


@wp.func
def rotate(c: float, s: float, v: wp.vec2) -> wp.vec2:
    """Rotates ``v`` by the angle with cosine ``c`` and sine ``s``."""
    return wp.vec2(c * v[0] - s * v[1], s * v[0] + c * v[1])


@wp.func
def planar_field(field: PlanarField, p: wp.vec2) -> wp.vec3:
    """Returns value and gradient (value, d/dx, d/dy) of the field at ``p``."""
    nx = field.values.shape[0]
    ny = field.values.shape[1]
    fx = wp.clamp((p[0] - field.origin[0]) * field.inv_step, 0.0, float(nx - 1) - 1.0e-3)
    fy = wp.clamp((p[1] - field.origin[1]) * field.inv_step, 0.0, float(ny - 1) - 1.0e-3)
    i = int(fx)
    j = int(fy)
    ax = fx - float(i)
    ay = fy - float(j)
    v00 = field.values[i, j]
    v01 = field.values[i, j + 1]
    v10 = field.values[i + 1, j]
    v11 = field.values[i + 1, j + 1]
    low = v00 + ay * (v01 - v00)
    high = v10 + ay * (v11 - v10)
    dy = (1.0 - ax) * (v01 - v00) + ax * (v11 - v10)
    return wp.vec3(low + ax * (high - low), (high - low) * field.inv_step, dy * field.inv_step)


@wp.struct
class PoseCell:
    """A planar pose in the grid of a :class:`PoseField`: the cell, and where in it the pose is.

    Attributes:
        i, j: Lower nodes in x and y.
        t0, t1: Nodes in yaw before and after.
        ax, ay, at: Shares of the way to the next node in x, y and yaw, from 0 to 1.
    """

    i: int
    j: int
    t0: int
    t1: int
    ax: float
    ay: float
    at: float


@wp.func
def pose_cell(field: PoseField, pose: wp.vec3) -> PoseCell:
    """Returns where a planar pose is in the grid of a field, and of every other field with the same grid."""
    nyaw = field.values.shape[0]
    nx = field.values.shape[1]
    ny = field.values.shape[2]
    fx = wp.clamp((pose[0] - field.origin[0]) * field.inv_step, 0.0, float(nx - 1) - 1.0e-3)
    fy = wp.clamp((pose[1] - field.origin[1]) * field.inv_step, 0.0, float(ny - 1) - 1.0e-3)
    turns = pose[2] / (2.0 * PI)
    ft = (turns - wp.floor(turns)) * float(nyaw)
    cell = PoseCell()
    cell.i = int(fx)
    cell.j = int(fy)
    cell.t0 = wp.clamp(int(ft), 0, nyaw - 1)  # also if the yaw is NaN
    cell.t1 = cell.t0 + 1
    if cell.t1 == nyaw:
        cell.t1 = 0
    cell.ax = fx - float(cell.i)
    cell.ay = fy - float(cell.j)
    cell.at = ft - float(cell.t0)
    return cell


@wp.func
def field_in_cell(field: PoseField, cell: PoseCell) -> wp.vec4:
    """Returns value and gradient (value, d/dx, d/dy, d/dyaw) of the field at a pose given by its cell."""
    i = cell.i
    j = cell.j
    t0 = cell.t0
    t1 = cell.t1
    ax = cell.ax
    ay = cell.ay
    at = cell.at
    a00 = field.values[t0, i, j]
    a01 = field.values[t0, i, j + 1]
    a10 = field.values[t0, i + 1, j]
    a11 = field.values[t0, i + 1, j + 1]
    b00 = field.values[t1, i, j]
    b01 = field.values[t1, i, j + 1]
    b10 = field.values[t1, i + 1, j]
    b11 = field.values[t1, i + 1, j + 1]
    c00 = a00 + at * (b00 - a00)
    c01 = a01 + at * (b01 - a01)
    c10 = a10 + at * (b10 - a10)
    c11 = a11 + at * (b11 - a11)
    low = c00 + ay * (c01 - c00)
    high = c10 + ay * (c11 - c10)
    d_x = (high - low) * field.inv_step
    d_y = ((1.0 - ax) * (c01 - c00) + ax * (c11 - c10)) * field.inv_step
    d_t = (
        (1.0 - ax) * ((1.0 - ay) * (b00 - a00) + ay * (b01 - a01)) + ax * ((1.0 - ay) * (b10 - a10) + ay * (b11 - a11))
    ) * field.inv_yaw_step
    return wp.vec4(low + ax * (high - low), d_x, d_y, d_t)


@wp.func
def pose_field(field: PoseField, pose: wp.vec3) -> wp.vec4:
    """Returns value and gradient (value, d/dx, d/dy, d/dyaw) of the field at a planar pose."""
    return field_in_cell(field, pose_cell(field, pose))


@wp.func
def space_slope(field: SpaceField, p: wp.vec3) -> wp.vec3:
    """Returns value and horizontal gradient (value, d/dx, d/dy) of the field at ``p``; the gradient is zero outside."""
    fx = (p[0] - field.origin[0]) * field.inv_step
    fy = (p[1] - field.origin[1]) * field.inv_step
    fz = wp.max((p[2] - field.origin[2]) * field.inv_step, 0.0)
    out = wp.vec3(field.outside, 0.0, 0.0)
    if (
        fx >= 0.0
        and fy >= 0.0
        and fx < float(field.values.shape[0] - 1)
        and fy < float(field.values.shape[1] - 1)
        and fz < float(field.values.shape[2] - 1)
    ):
        i = int(fx)
        j = int(fy)
        k = int(fz)
        ax = fx - float(i)
        ay = fy - float(j)
        az = fz - float(k)
        c00 = wp.lerp(field.values[i, j, k], field.values[i, j, k + 1], az)
        c01 = wp.lerp(field.values[i, j + 1, k], field.values[i, j + 1, k + 1], az)
        c10 = wp.lerp(field.values[i + 1, j, k], field.values[i + 1, j, k + 1], az)
        c11 = wp.lerp(field.values[i + 1, j + 1, k], field.values[i + 1, j + 1, k + 1], az)
        low = wp.lerp(c00, c01, ay)
        high = wp.lerp(c10, c11, ay)
        out = wp.vec3(
            wp.lerp(low, high, ax), (high - low) * field.inv_step, wp.lerp(c01 - c00, c11 - c10, ax) * field.inv_step
        )
    return out


@wp.func
def space_field(field: SpaceField, p: wp.vec3) -> float:
    """Returns the value of the field at ``p``."""
    return space_slope(field, p)[0]
