"""Quasi-static planar pushing on the ellipsoidal limit surface (the paper's Example 1, with friction)."""

import warp as wp

from oimppi_warp.kernels.geometry import (
    PlanarField,
    PoseCell,
    PoseField,
    field_in_cell,
    planar_field,
    pose_cell,
    rotate,
)

wp.set_module_options({"enable_backward": False})


@wp.struct
class ObjectModel:
    """The pushed object on the table.

    Attributes:
        force: Friction force mu m g [N].
        radius: Friction torque over friction force [m].
        tool_friction: Coulomb coefficient of tool and object.
        top: Height of the object's top [m].
        size: Largest distance of the outline from the friction centre [m].
        clearance: phi_2 over poses [m].
        body: Signed distance to the object's outline [m].
        slack: Clearance that the object keeps to obstacles, in the model [m].
        center: The friction centre in the object's own frame [m].
    """

    force: float
    radius: float
    tool_friction: float
    top: float
    size: float
    clearance: PoseField
    body: PlanarField
    slack: float
    center: wp.vec2


@wp.struct
class Settled:
    """Result of settling an object against the obstacles.

    Attributes:
        pose: Pose of the friction centre.
        force: Contact force lambda_2 that pushed it there [N].
        clearance: phi_2 before it was pushed out [m].
        cell: Where the pose is in the grid of phi_2.
    """

    pose: wp.vec3
    force: float
    clearance: float
    cell: PoseCell


LEAST_YIELD = wp.constant(0.05)
"""Motion of the contact point along the normal, per unit force, below which a cone's edge is not used. Such a force
would hardly move the contact inwards, or would even pull it back, and removing the remaining depth would take a huge
force."""

CORRECTIONS = wp.constant(2)
"""Largest number of projections out of obstacles."""

LONGEST_CORRECTION = wp.constant(0.02)
"""Largest correction of phi_2 in one projection [m]; beyond it the linearization does not hold."""

LEAST_GRADIENT = wp.constant(0.1)
"""Least ``g^T D g`` in units of ``1 / (mu m g)``; bounds the step at kinks of phi_2, where the gradient vanishes."""


@wp.func
def mobility(model: ObjectModel) -> wp.vec3:
    """Returns the diagonal of the mobility ``D``, in units of ``1 / (mu m g)``: ``(1, 1, 1 / radius^2)``.

    A wrench ``w`` about the friction centre moves the object with the twist ``x_o' = D w``,
    ``D = diag(mu m g, mu m g, c r mu m g)^-1`` (equation 5). The paper's ``c r`` is ``radius^2`` here, with the limit
    surface's radius: friction torque over friction force [m].
    """
    return wp.vec3(1.0, 1.0, 1.0 / (model.radius * model.radius))


@wp.func
def phi_1(model: ObjectModel, pose: wp.vec3, point: wp.vec2) -> float:
    """Returns the gap between a point of the robot and the object [m]: ``phi_1 = d_B(R^T (x_r - p_o))``.

    This is equation 7, with the object's signed distance field ``d_B``, its pose ``(p_o, theta)``, the rotation ``R``
    by theta, and the point ``x_r``. It is negative inside the object. A round tool's gap is smaller by its radius.
    """
    local = rotate(wp.cos(pose[2]), -wp.sin(pose[2]), point - wp.vec2(pose[0], pose[1]))
    return planar_field(model.body, local)[0]


@wp.func
def over_object(model: ObjectModel, pose: wp.vec3, tip: wp.vec3, tool_radius: float) -> bool:
    """Returns whether the tool is over the object, seen from above."""
    return phi_1(model, pose, wp.vec2(tip[0], tip[1])) < tool_radius


@wp.func
def push(model: ObjectModel, pose: wp.vec3, start: wp.vec2, end: wp.vec2, tool_radius: float) -> wp.vec3:
    """Returns the object's pose after a round tool has moved from ``start`` to ``end``.

    The object yields along the limit surface by exactly as much as the tool would otherwise penetrate it. The contact
    sticks while the force stays in the friction cone and otherwise slides along the cone's edge.

    In the paper's symbols: the object moves by ``x_o <- x_o + D w_o dt`` (equation 2, with ``h_o = dt D``) under the
    tool's part of the wrench, ``w_o = grad phi_1 lambda_1`` (equation 3) with friction added, where
    ``0 <= lambda_1 _|_ phi_1 >= 0`` (equation 4): no force without contact, and no overlap after it. phi_1 is that of
    equation 7, less the tool's radius and looked up with its gradient; lambda_1 itself is not computed.
    """
    moved = pose
    c = wp.cos(pose[2])
    s = wp.sin(pose[2])
    local = rotate(c, -s, end - wp.vec2(pose[0], pose[1]))
    reach = wp.float32(model.body.values.shape[0] + model.body.values.shape[1]) / model.body.inv_step
    if wp.length_sq(local) < reach * reach:
        field = planar_field(model.body, local)
        depth = tool_radius - field[0]
        if depth > 0.0:
            outward = wp.normalize(wp.vec2(field[1], field[2]))
            n = -outward
            t = wp.vec2(-n[1], n[0])
            contact = local - field[0] * outward
            travel = rotate(c, -s, end - start)
            # Only the part of the motion that is spent in contact drags the object sideways.
            approach = wp.dot(travel, n)
            share = wp.clamp(depth / wp.max(approach, 1.0e-6), 0.0, 1.0)
            want = depth * n + share * wp.dot(travel, t) * t

            # Motion of the contact point under a force f: A f with A = J D J^T, J the contact's Jacobian.
            b = mobility(model)[2]
            a00 = 1.0 + contact[1] * contact[1] * b
            a01 = -contact[0] * contact[1] * b
            a11 = 1.0 + contact[0] * contact[0] * b
            inv_det = 1.0 / (a00 * a11 - a01 * a01)
            f = wp.vec2((a11 * want[0] - a01 * want[1]) * inv_det, (a00 * want[1] - a01 * want[0]) * inv_det)
            if wp.abs(wp.dot(f, t)) > model.tool_friction * wp.dot(f, n):
                edge = n + wp.sign(wp.dot(f, t)) * model.tool_friction * t
                yielded = wp.vec2(a00 * edge[0] + a01 * edge[1], a01 * edge[0] + a11 * edge[1])
                along = wp.dot(n, yielded)
                if along < LEAST_YIELD:  # push along the normal instead
                    edge = n
                    along = a00 * n[0] * n[0] + 2.0 * a01 * n[0] * n[1] + a11 * n[1] * n[1]
                f = (depth / along) * edge
            shift = rotate(c, s, f)
            moved = wp.vec3(
                pose[0] + shift[0], pose[1] + shift[1], pose[2] + b * (contact[0] * f[1] - contact[1] * f[0])
            )
    return moved


@wp.func
def settle(model: ObjectModel, pose: wp.vec3, dt: float) -> Settled:
    """Moves an object that entered an obstacle back to its surface, by the shortest motion in terms of ``D``.

    This is ``0 <= lambda_2 _|_ phi_2 >= 0`` (equation 4) by projection. The obstacles' part of the wrench is
    ``w_o = grad phi_2 lambda_2`` (equation 3), which moves the object by ``dt D w_o`` (equation 6); so the force that
    moves it by phi_2 within ``dt`` is ``lambda_2 = -phi_2 / (dt g^T D g)``, ``g`` the gradient of phi_2.
    """
    out = Settled()
    out.pose = pose
    out.force = 0.0
    out.cell = pose_cell(model.clearance, pose)
    field = field_in_cell(model.clearance, out.cell)
    out.clearance = field[0]
    d = mobility(model)
    corrections = int(0)
    while field[0] < model.slack and corrections < CORRECTIONS:
        gradient = field[1] * field[1] + field[2] * field[2] + d[2] * field[3] * field[3]
        step = wp.min(model.slack - field[0], LONGEST_CORRECTION) / wp.max(gradient, LEAST_GRADIENT)
        out.pose = out.pose + step * wp.vec3(field[1], field[2], d[2] * field[3])
        out.force = out.force + model.force * step / dt
        out.cell = pose_cell(model.clearance, out.pose)
        field = field_in_cell(model.clearance, out.cell)
        corrections += 1
    return out
