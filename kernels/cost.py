"""The terms of the stage costs (equations 15 to 19 of the paper), the single source for every engine.

Poses are planar (x, y, yaw) of the object's friction centre.
"""

import warp as wp

from oimppi_warp.kernels.geometry import wrap_angle

wp.set_module_options({"enable_backward": False})

TERMS = ("goal", "contact", "reference", "approach", "align", "tilt", "height", "clearance", "above", "reach", "press",
         "control", "collision", "topple", "guide")  # fmt: skip
"""Names of the robot level's cost terms, in the order of :class:`CostTerms`."""

FREE = wp.constant(1.0)
"""Clearance of an object that is not being pushed, for costs [m]."""

OVER = wp.constant(0.01)
"""Height above the object's top from which a tip that is guided over it costs nothing [m]."""

CostTerms = wp.types.vector(length=len(TERMS), dtype=float)
"""Weighted cost terms of the robot level."""


@wp.struct
class RobotWeights:
    """Weights of the robot level; see ``oimppi_warp.config.RobotCost`` for each.

    ``edge_lower`` and ``edge_upper`` are the corners of the rectangle within which the object's centre keeps all of it
    on the table [m]; ``topple_speed`` is the speed from which coming close to an object that may tip costs [m/s], and
    ``size`` the largest distance of its outline from its centre [m].
    """

    w_d: float
    w_theta: float
    w_f: float
    f_0: float
    w_to_go: float
    w_reference: float
    w_ee: float
    r_0: float
    w_align: float
    gamma_0: float
    align_fade: float
    w_tilt: float
    w_height: float
    height: float
    w_clearance: float
    clearance: float
    w_above: float
    w_reach: float
    reach_lower: float
    reach_upper: float
    w_edge: float
    edge_lower: wp.vec2
    edge_upper: wp.vec2
    w_press: float
    w_margin: float
    margin: float
    w_lift: float
    w_control: float
    w_collision: float
    w_overhang: float
    w_rush: float
    topple_speed: float
    topple_near: float
    size: float


@wp.struct
class ObjectWeights:
    """Weights of the object level; see ``oimppi_warp.config.ObjectCost`` for each."""

    w_d: float
    w_theta: float
    w_f: float
    f_0: float
    w_to_go: float
    w_margin: float
    margin: float
    w_reach: float
    reach_lower: float
    reach_upper: float


@wp.func
def squared(x: float) -> float:
    """``x`` times itself."""
    return x * x


@wp.func
def pose_distance_squared(a: wp.vec3, b: wp.vec3, w_theta: float) -> float:
    """Squared distance of two planar poses (equation 16) [m^2]; for planar poses its arc cosine is the yaw error."""
    return squared(a[0] - b[0]) + squared(a[1] - b[1]) + w_theta * squared(wrap_angle(a[2] - b[2]))


@wp.func
def contact_cost(force: float, f_0: float) -> float:
    """Hinge on the contact force of object and environment (second term of equation 15) [N^2]."""
    return squared(wp.max(force - f_0, 0.0))


@wp.func
def approach_cost(tip: wp.vec3, center: wp.vec3, r_0: float) -> float:
    """Squared distance of tool and object beyond ``r_0`` (first term of equation 17) [m^2]."""
    return wp.max(wp.length_sq(tip - center) - r_0 * r_0, 0.0)


@wp.func
def align_cost(tip: wp.vec2, center: wp.vec2, target: wp.vec2, gamma_0: float, fade: float) -> float:
    """How far the tool is from being behind the object on its way to ``target`` (equation 18).

    Closer than ``fade`` to the target the direction loses its meaning, and the cost its weight; 0 turns that off.
    """
    push = center - tip
    way = target - center
    length = wp.length(way)
    cosine = wp.dot(push, way) / wp.max(wp.length(push) * length, 1.0e-6)
    share = float(1.0)
    if fade > 0.0:
        share = wp.min(length / fade, 1.0)
    return share * wp.max(gamma_0 - cosine, 0.0)


@wp.func
def tilt_cost(up: wp.vec3) -> float:
    """Tilt of the tool from vertical (equation 19), the root of squared roll and pitch [rad].

    ``up`` is the world's z axis in the tip's frame, the third row of its rotation. The tip's z axis points out of the
    tool, so the paper's upright frame is the tip's turned by pi about x, which changes the sign of R32 and R33.
    """
    roll = wp.atan2(-up[1], -up[2])
    pitch = wp.atan2(-up[0], wp.sqrt(up[1] * up[1] + up[2] * up[2]))
    return wp.sqrt(roll * roll + pitch * pitch)


@wp.func
def shortfall(value: float, wanted: float) -> float:
    """Square of what ``value`` lacks to ``wanted``."""
    return squared(wp.max(wanted - value, 0.0))


@wp.func
def out_of_reach(pose: wp.vec3, lower: float, upper: float) -> float:
    """Distance of the object's centre to the ring around the base in which the arm can push well [m]."""
    distance = wp.sqrt(pose[0] * pose[0] + pose[1] * pose[1])
    return wp.max(lower - distance, 0.0) + wp.max(distance - upper, 0.0)


@wp.func
def over_edge(pose: wp.vec3, lower: wp.vec2, upper: wp.vec2) -> float:
    """How far the object's centre is outside of the rectangle in which all of it is on the table [m]."""
    along = wp.max(lower[0] - pose[0], 0.0) + wp.max(pose[0] - upper[0], 0.0)
    across = wp.max(lower[1] - pose[1], 0.0) + wp.max(pose[1] - upper[1], 0.0)
    return along + across


@wp.func
def topple_cost(w: RobotWeights, tip: wp.vec3, lean: wp.vec2, velocity: wp.vec2, center: wp.vec2, top: float) -> float:
    """What may tip an object over instead of pushing it along: touching its rim first, and coming at it fast.

    A stick that leans over the object touches it at its upper rim; ``lean . n`` times the height left to the rim is by
    how much the rim is nearer to it than the tip is.
    """
    to = center - wp.vec2(tip[0], tip[1])
    distance = wp.max(wp.length(to), 1.0e-6)
    share = 1.0 - (distance - w.size) / w.topple_near
    cost = float(0.0)
    if share > 0.0 and tip[2] < top:
        overhang = wp.max(wp.dot(lean, to), 0.0) / distance * (top - tip[2])
        rush = wp.max(wp.dot(velocity, to) / distance - w.topple_speed, 0.0)
        cost = wp.min(share, 1.0) * (w.w_overhang * squared(overhang) + w.w_rush * squared(rush))
    return cost


@wp.func
def object_cost(w: ObjectWeights, pose: wp.vec3, goal: wp.vec3, force: float, clearance: float, to_go: float) -> float:
    """Stage cost of the object level (equation 15 and our additions)."""
    return (
        w.w_d * pose_distance_squared(pose, goal, w.w_theta)
        + w.w_f * contact_cost(force, w.f_0)
        + w.w_margin * shortfall(clearance, w.margin)
        + w.w_to_go * to_go
        + w.w_reach * out_of_reach(pose, w.reach_lower, w.reach_upper)
    )


@wp.func
def robot_cost(
    w: RobotWeights,
    tip: wp.vec3,
    up: wp.vec3,
    lean: wp.vec2,
    velocity: wp.vec2,
    pose: wp.vec3,
    top: float,
    goal: wp.vec3,
    reference: wp.vec3,
    target: wp.vec3,
    to_go: float,
    force: float,
    room: float,
    above: float,
    pressed: float,
    gap: float,
    rise: float,
    speed_squared: float,
    collision: float,
    guide: wp.vec4,
) -> CostTerms:
    """Stage cost of the robot level (equations 15 to 19 and our additions), term by term and weighted.

    Args:
        w: Weights.
        tip: Tool tip [m].
        up: The world's z axis in the tip's frame.
        lean: How far the stick leans, see ``Placed``.
        velocity: Of the tip, in x and y [m/s].
        pose: The object's pose.
        top: Height of the object's top above the table [m].
        goal: The object's goal.
        reference: Where the object plan has the object at this step.
        target: Where the object plan has it some steps ahead, for the alignment.
        to_go: Cost-to-go of the pose [m].
        force: Contact force of object and environment, lambda_2 [N].
        room: Clearance of arm and tool to obstacles and table, phi_3 [m].
        above: 1 where the tip is above the object, else 0.
        pressed: Depth by which the tool presses into an object that cannot yield [m].
        gap: Clearance phi_2 of the pose that the tool pushes the object to; large while it does not [m].
        rise: Speed at which the tip rises while it pushes [m/s].
        speed_squared: Squared norm of the joint velocities [rad^2/s^2].
        collision: Contact force of robot and environment, lambda_3 [N].
        guide: Where the tip is called to while the object is let go, and the weight of that [1/m^2]; a weight of zero
            is none. Where the tip is and how high are the guide's matter then, not those of ``approach``, ``align`` and
            ``height``.
    """
    terms = CostTerms()
    terms[0] = w.w_d * pose_distance_squared(pose, goal, w.w_theta) + w.w_to_go * to_go
    terms[1] = w.w_f * contact_cost(force, w.f_0) + w.w_margin * shortfall(gap, w.margin)
    terms[2] = w.w_reference * pose_distance_squared(pose, reference, w.w_theta)
    terms[3] = w.w_ee * approach_cost(tip, wp.vec3(pose[0], pose[1], 0.5 * top), w.r_0)
    terms[4] = w.w_align * align_cost(
        wp.vec2(tip[0], tip[1]), wp.vec2(pose[0], pose[1]), wp.vec2(target[0], target[1]), w.gamma_0, w.align_fade
    )
    terms[5] = w.w_tilt * tilt_cost(up)
    if guide[3] > 0.0:
        terms[14] = guide[3] * wp.length_sq(tip - wp.vec3(guide[0], guide[1], guide[2]))
        terms[3] = 0.0
        terms[4] = 0.0
    else:
        terms[6] = w.w_height * squared(tip[2] - w.height)
    terms[7] = w.w_clearance * shortfall(room, w.clearance)
    terms[8] = w.w_above * above
    reach = w.w_reach * out_of_reach(pose, w.reach_lower, w.reach_upper)
    terms[9] = reach + w.w_edge * over_edge(pose, w.edge_lower, w.edge_upper)
    terms[10] = w.w_press * squared(pressed) + w.w_lift * squared(rise)
    terms[11] = w.w_control * speed_squared
    terms[12] = w.w_collision * wp.max(collision - w.f_0, 0.0)
    if w.w_overhang > 0.0 or w.w_rush > 0.0:
        terms[13] = topple_cost(w, tip, lean, velocity, wp.vec2(pose[0], pose[1]), top)
    return terms
