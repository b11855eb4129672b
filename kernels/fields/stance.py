"""The stance field: how far the tool is from a place at which a push moves the object in a given direction.

The paper's psi_align (equation 18) compares two directions in the plane. It knows neither the object's shape nor its
yaw, and nothing of the way around the object. The stance field does: for a direction of the object's motion, yaw
included, it holds for every position of the tool the shortest way around the object to a place of contact, where a
worse place counts as a longer way.
"""

import warp as wp

from oimppi_warp.kernels.geometry import PI, PlanarField, angle_of, planar_field

wp.set_module_options({"enable_backward": False})

UNREACHED = wp.constant(1.0e3)
"""Initial value of a node [m]."""

INSIDE = wp.constant(8.0)
"""Cost of a metre through the object; finite, so that there is a way out of it."""

SKIN = wp.constant(0.004)
"""Depth to which the tool's disc may be in the object before a metre costs ``INSIDE`` [m]."""


@wp.struct
class StanceField:
    """Remaining way of the tool [m], over directions of the object's motion and the tool's position.

    A direction is a unit vector of (v_x, v_y, yaw_length * yaw rate) in the object's frame, given by its azimuth in the
    plane of the first two and its elevation above that plane.

    Attributes:
        values: [elevation * azimuth, nx, ny]: elevations from -pi/2 to pi/2, azimuths over a full turn.
        origin: Position of node (0, 0), from the friction centre in the object's axes [m].
        inv_step: Nodes per metre.
        azimuths, elevations: Numbers of directions.
        yaw_length: Length that a radian of yaw counts as [m].
    """

    values: wp.array3d[float]
    origin: wp.vec2
    inv_step: float
    azimuths: int
    elevations: int
    yaw_length: float


@wp.kernel
def compute_stance(
    # in:
    first: int,
    body: PlanarField,
    places: wp.array[wp.vec2],
    costs: wp.array2d[float],
    tool_radius: float,
    origin: wp.vec2,
    step: float,
    sweeps: int,
    # out:
    values: wp.array3d[float],
):
    """Computes the way of the tool around the object to the cheapest place of contact; one thread per direction.

    Shapes: ``places`` [place]: tool positions in contact, in the object's frame [m], ``costs`` [direction, place]: what
    each adds to the way [m], ``values`` [direction, nx, ny].
    """
    d = first + wp.tid()
    nx = values.shape[1]
    ny = values.shape[2]
    for i in range(nx):
        for j in range(ny):
            values[d, i, j] = UNREACHED
    for k in range(places.shape[0]):
        at = (places[k] - origin) / step
        i0 = int(wp.floor(at[0]))
        j0 = int(wp.floor(at[1]))
        for di in range(-1, 3):
            for dj in range(-1, 3):
                i = i0 + di
                j = j0 + dj
                if i >= 0 and i < nx and j >= 0 and j < ny:
                    way = step * wp.length(wp.vec2(float(i), float(j)) - at)
                    values[d, i, j] = wp.min(values[d, i, j], costs[d, k] + way)
    for sweep in range(sweeps):
        for a in range(nx):
            i = a
            if (sweep & 1) == 1:
                i = nx - 1 - a
            for b in range(ny):
                j = b
                if ((sweep >> 1) & 1) == 1:
                    j = ny - 1 - b
                per_metre = float(1.0)
                if planar_field(body, origin + step * wp.vec2(float(i), float(j)))[0] < tool_radius - SKIN:
                    per_metre = INSIDE
                best = values[d, i, j]
                for di in range(-1, 2):
                    for dj in range(-1, 2):
                        ii = i + di
                        jj = j + dj
                        if ii >= 0 and ii < nx and jj >= 0 and jj < ny:
                            length = step * wp.sqrt(float(di * di + dj * dj))
                            best = wp.min(best, values[d, ii, jj] + per_metre * length)
                values[d, i, j] = best


@wp.func
def at_direction(field: StanceField, direction: int, i: int, j: int, ax: float, ay: float) -> float:
    """Returns the value between four nodes for one direction."""
    low = wp.lerp(field.values[direction, i, j], field.values[direction, i, j + 1], ay)
    high = wp.lerp(field.values[direction, i + 1, j], field.values[direction, i + 1, j + 1], ay)
    return wp.lerp(low, high, ax)


@wp.func
def stance_field(field: StanceField, tool: wp.vec2, motion: wp.vec3) -> float:
    """Returns the remaining way of the tool [m]; outside the grid, that of the nearest node and the way there.

    ``tool`` is its position from the friction centre and ``motion`` the wanted motion (v_x, v_y, yaw rate), both in the
    object's axes; the length of ``motion`` does not matter.
    """
    nx = field.values.shape[1]
    ny = field.values.shape[2]
    x = (tool[0] - field.origin[0]) * field.inv_step
    y = (tool[1] - field.origin[1]) * field.inv_step
    fx = wp.clamp(x, 0.0, float(nx - 1) - 1.0e-3)
    fy = wp.clamp(y, 0.0, float(ny - 1) - 1.0e-3)
    outside = float(0.0)
    if x != fx or y != fy:
        outside = wp.length(wp.vec2(x - fx, y - fy)) / field.inv_step
    i = int(fx)
    j = int(fy)
    ax = fx - float(i)
    ay = fy - float(j)

    turns = angle_of(motion[1], motion[0]) * (0.5 / PI)
    fa = wp.where(turns < 0.0, turns + 1.0, turns) * float(field.azimuths)
    a0 = wp.clamp(int(fa), 0, field.azimuths - 1)
    a1 = a0 + 1
    if a1 == field.azimuths:
        a1 = 0
    aa = fa - float(a0)
    across = wp.sqrt(motion[0] * motion[0] + motion[1] * motion[1])
    last = float(field.elevations - 1)
    fe = wp.clamp((angle_of(field.yaw_length * motion[2], across) * (1.0 / PI) + 0.5) * last, 0.0, last - 1.0e-3)
    e0 = int(fe)
    ae = fe - float(e0)

    low = field.azimuths * e0
    high = low + field.azimuths
    below = wp.lerp(at_direction(field, low + a0, i, j, ax, ay), at_direction(field, low + a1, i, j, ax, ay), aa)
    above = wp.lerp(at_direction(field, high + a0, i, j, ax, ay), at_direction(field, high + a1, i, j, ax, ay), aa)
    return wp.lerp(below, above, ae) + outside
