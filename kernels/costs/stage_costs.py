"""The stage costs of both levels, the paper's l_o, l_r and l_c with our additions: the single source for every engine.

A term of the robot level is one function of the weights and the stage, added by :func:`term` under its name. Its
weights are fields of ``RobotCost`` (``config/settings.py``). Poses are planar (x, y, yaw) of the object's friction
centre.
"""

from functools import lru_cache

import warp as wp

from oimppi_warp.config.settings import ObjectCost
from oimppi_warp.kernels.costs.terms import ExtraTerms, RobotWeights, Stage, compose, weights_struct
from oimppi_warp.kernels.geometry import wrap_angle

wp.set_module_options({"enable_backward": False})

ObjectWeights = weights_struct("ObjectWeights", ObjectCost)
"""Weights of the object level; see ``oimppi_warp.config.settings.ObjectCost`` for each."""


@wp.func
def squared(x: float) -> float:
    """Returns the square of ``x``."""
    return x * x


@wp.func
def pose_distance_squared(a: wp.vec3, b: wp.vec3, w_theta: float) -> float:
    """Returns the squared distance of two poses [m^2]: ``d^2(a, b) = |p_a - p_b|^2 + w_theta angle^2`` (equation 16).

    For planar poses, the paper's ``angle = acos((trace(R_a^T R_b) - 1) / 2)`` is the magnitude of the yaw error.
    """
    return squared(a[0] - b[0]) + squared(a[1] - b[1]) + w_theta * squared(wrap_angle(a[2] - b[2]))


@wp.func
def contact_cost(force: float, f_0: float) -> float:
    """Returns the hinge cost of the object's contact force: ``max(lambda_2 - f_0, 0)^2`` (equation 15) [N^2]."""
    return squared(wp.max(force - f_0, 0.0))


@wp.func
def psi_align(tip: wp.vec2, center: wp.vec2, target: wp.vec2, gamma_0: float) -> float:
    """Returns the misalignment of the tool, which should be behind the object as seen in the direction of its motion.

    ``psi_align = max(gamma_0 - cos angle(p_o - p_ee, p_o* - p_o), 0)`` (equation 18), with the tip p_ee, the object's
    centre p_o and the target p_o* that the object should move to.
    """
    push = center - tip
    way = target - center
    cosine = wp.dot(push, way) / wp.max(wp.length(push) * wp.length(way), 1.0e-6)
    return wp.max(gamma_0 - cosine, 0.0)


@wp.func
def psi_tilt(up: wp.vec3) -> float:
    """Returns the tilt of the tool from vertical: ``psi_tilt = sqrt(roll^2 + pitch^2)`` (equation 19) [rad].

    ``roll = atan(R32 / R33)`` and ``pitch = atan(-R31 / sqrt(R32^2 + R33^2))``; ``up`` is the third row of the tip's
    rotation. The tip's z axis points out of the tool, so the paper's upright frame is the tip's turned by pi about x,
    which changes the sign of R32 and R33.
    """
    roll = wp.atan2(-up[1], -up[2])
    pitch = wp.atan2(-up[0], wp.sqrt(up[1] * up[1] + up[2] * up[2]))
    return wp.sqrt(roll * roll + pitch * pitch)


@wp.func
def shortfall(value: float, wanted: float) -> float:
    """Returns the squared amount by which ``value`` falls short of ``wanted``."""
    return squared(wp.max(wanted - value, 0.0))


@wp.func
def outside_ring(pose: wp.vec3, ring: wp.vec2, goal: wp.vec3) -> float:
    """Returns the distance of the object's centre to the ring around the base in which the arm pushes well [m].

    The ring is widened to the goal, so that an object may end where it should.
    """
    distance = wp.length(wp.vec2(pose[0], pose[1]))
    there = wp.length(wp.vec2(goal[0], goal[1]))
    return wp.max(wp.min(ring[0], there) - distance, 0.0) + wp.max(distance - wp.max(ring[1], there), 0.0)


@wp.func
def object_cost(w: ObjectWeights, pose: wp.vec3, goal: wp.vec3, force: float, clearance: float, to_go: float) -> float:
    """Returns the object level's stage cost: ``l_o = w_d d^2(x_o, g) + w_f max(lambda_2 - f_0, 0)^2`` (equation 15).

    ``d^2`` is that of equation 16. We add terms of the clearance phi_2, of the cost-to-go and of the ring in
    which the arm pushes well.
    """
    return (
        w.w_d * pose_distance_squared(pose, goal, w.w_theta)
        + w.w_f * contact_cost(force, w.f_0)
        + w.w_margin * shortfall(clearance, w.margin)
        + w.w_to_go * to_go
        + w.w_push_ring * outside_ring(pose, w.push_ring, goal)
    )


_TERMS: dict[str, wp.Function] = {}


def term(name: str):
    """Returns a decorator that makes ``(w: RobotWeights, s: Stage) -> float`` a cost term of the robot level."""

    def add(function):
        _TERMS[name] = wp.func(function)
        return _TERMS[name]

    return add


# Terms of the paper


@term("goal")
def goal_term(w: RobotWeights, s: Stage) -> float:
    """Returns the cost of the object's distance to its goal: ``w_d d^2(x_o, g)``, the first term of l_o (equation 15).

    We add ``w_to_go V(x_o)``, with the cost-to-go V.
    """
    return w.w_d * pose_distance_squared(s.pose, s.goal, w.w_theta) + w.w_to_go * s.to_go


@term("contact")
def contact_term(w: RobotWeights, s: Stage) -> float:
    """Returns the cost of contact with obstacles: ``w_f max(lambda_2 - f_0, 0)^2``, second term of l_o (equation 15).

    We add ``w_margin max(margin - phi_2, 0)^2``.
    """
    return w.w_f * contact_cost(s.force, w.f_0) + w.w_margin * shortfall(s.gap, w.margin)


@term("reference")
def reference_term(w: RobotWeights, s: Stage) -> float:
    """Returns the cost of the distance to the plan: ``w_reference l_c``, ``l_c = d^2(x_o, x_o*)`` (equation 14)."""
    return w.w_reference * pose_distance_squared(s.pose, s.reference, w.w_theta)


@term("approach")
def approach_term(w: RobotWeights, s: Stage) -> float:
    """Returns the cost of a distant tool: ``w_ee max(|p_ee - p_o|^2 - r_0^2, 0)``, first term of l_r (equation 17).

    ``p_o`` is at half the object's height. The cost is zero while repositioning.
    """
    cost = float(0.0)
    if s.waypoint[3] <= 0.0:
        center = wp.vec3(s.pose[0], s.pose[1], 0.5 * s.top)
        cost = w.w_ee * wp.max(wp.length_sq(s.tip - center) - w.r_0 * w.r_0, 0.0)
    return cost


@term("align")
def align_term(w: RobotWeights, s: Stage) -> float:
    """Returns the misalignment cost: ``w_align psi_align`` (equation 18), the second term of l_r (equation 17).

    It penalizes a tool that is not behind the object, seen in the direction of the object's motion.

    Closer than ``align_fade`` to the target, where the direction becomes meaningless, the cost fades out; 0 turns
    fading off. The cost is zero while repositioning.
    """
    cost = float(0.0)
    if s.waypoint[3] <= 0.0 and w.w_align > 0.0:
        center = wp.vec2(s.pose[0], s.pose[1])
        target = wp.vec2(s.target[0], s.target[1])
        share = float(1.0)
        if w.align_fade > 0.0:
            share = wp.min(wp.length(target - center) / w.align_fade, 1.0)
        cost = w.w_align * (share * psi_align(wp.vec2(s.tip[0], s.tip[1]), center, target, w.gamma_0))
    return cost


@term("tilt")
def tilt_term(w: RobotWeights, s: Stage) -> float:
    """Returns the cost of the tool's tilt: ``w_tilt psi_tilt`` (equation 19), the third term of l_r (equation 17)."""
    cost = float(0.0)
    if s.up[0] != 0.0 or s.up[1] != 0.0 or s.up[2] >= 0.0:  # that of an upright tool is zero
        cost = w.w_tilt * psi_tilt(s.up)
    return cost


# Terms that are not in the paper


@term("track")
def track_term(w: RobotWeights, s: Stage) -> float:
    """Returns the cost of the distance to the plan, not squared: ``w_track d(x_o, x_o*)``, with d^2 of equation 16.

    Its slope does not vanish at the plan, so that millimetres still outweigh the temperature.
    """
    return w.w_track * wp.sqrt(pose_distance_squared(s.pose, s.reference, w.w_theta))


@term("stance")
def stance_term(w: RobotWeights, s: Stage) -> float:
    """Returns the cost of a tool that is not in place for a push towards the target: ``w_stance`` per metre of way.

    The way is that of the stance field (``kernels/fields/stance.py``); closer than ``stance_fade`` to the target the
    cost fades out. The cost is zero while repositioning.
    """
    cost = float(0.0)
    if s.waypoint[3] <= 0.0 and w.w_stance > 0.0:
        left = wp.sqrt(pose_distance_squared(s.pose, s.target, w.w_theta))
        cost = w.w_stance * wp.min(left / wp.max(w.stance_fade, 1.0e-6), 1.0) * s.stance
    return cost


@term("height")
def height_term(w: RobotWeights, s: Stage) -> float:
    """Returns the cost of the tip's height error: ``w_height (z_ee - height)^2``; zero while repositioning."""
    cost = float(0.0)
    if s.waypoint[3] <= 0.0:
        cost = w.w_height * squared(s.tip[2] - w.height)
    return cost


@term("arm_clearance")
def arm_clearance_term(w: RobotWeights, s: Stage) -> float:
    """Returns the cost of an arm close to obstacles or table: ``w_arm_clearance max(arm_clearance - phi_3, 0)^2``."""
    return w.w_arm_clearance * shortfall(s.arm_clearance, w.arm_clearance)


@term("above")
def above_term(w: RobotWeights, s: Stage) -> float:
    """Returns the cost of a tip above the object: ``w_above`` per step."""
    return w.w_above * s.above


@term("push_ring")
def push_ring_term(w: RobotWeights, s: Stage) -> float:
    """Returns the cost of an object off the push ring or at the table's edge: ``w_push_ring d_ring + w_edge d_edge``.

    ``d_ring`` is the distance of the object's centre to the ring, ``d_edge`` that to the rectangle in which the whole
    object is on the table [m].
    """
    along = wp.max(w.edge_lower[0] - s.pose[0], 0.0) + wp.max(s.pose[0] - w.edge_upper[0], 0.0)
    across = wp.max(w.edge_lower[1] - s.pose[1], 0.0) + wp.max(s.pose[1] - w.edge_upper[1], 0.0)
    return w.w_push_ring * outside_ring(s.pose, w.push_ring, s.goal) + w.w_edge * (along + across)


@term("press")
def press_term(w: RobotWeights, s: Stage) -> float:
    """Returns the cost of pressing into the object and of rising while pushing: ``w_press depth^2 + w_lift rise^2``."""
    return w.w_press * squared(s.pressed) + w.w_lift * squared(s.rise)


@term("control")
def control_term(w: RobotWeights, s: Stage) -> float:
    """Returns the cost of control effort: ``w_control |u|^2``, with the control u."""
    return w.w_control * s.speed_squared


@term("collision")
def collision_term(w: RobotWeights, s: Stage) -> float:
    """Returns the cost of forces of the robot on obstacles and table: ``w_collision max(lambda_3 - f_0, 0)``."""
    return w.w_collision * wp.max(s.collision - w.f_0, 0.0)


@term("topple")
def topple_term(w: RobotWeights, s: Stage) -> float:
    """Returns the cost of motions that may tip the object over.

    This is ``w_overhang overhang^2 + w_rush max(v - topple_speed, 0)^2``, close to the object only, with the speed v of
    the tip towards the object. A stick that leans over the object touches it at its upper rim; the overhang is how
    much nearer to the object the stick is there than at its tip: ``lean . n`` times the height from tip to rim, with
    the direction n to the object.
    """
    cost = float(0.0)
    if w.w_overhang > 0.0 or w.w_rush > 0.0:
        to = wp.vec2(s.pose[0], s.pose[1]) - wp.vec2(s.tip[0], s.tip[1])
        distance = wp.max(wp.length(to), 1.0e-6)
        share = 1.0 - (distance - w.size) / w.topple_near
        if share > 0.0 and s.tip[2] < s.top:
            overhang = wp.max(wp.dot(s.lean, to), 0.0) / distance * (s.top - s.tip[2])
            rush = wp.max(wp.dot(s.velocity, to) / distance - w.topple_speed, 0.0)
            cost = wp.min(share, 1.0) * (w.w_overhang * squared(overhang) + w.w_rush * squared(rush))
    return cost


@term("waypoint")
def waypoint_term(w: RobotWeights, s: Stage) -> float:
    """Returns the cost of repositioning: the waypoint's weight times the squared distance of the tip to it."""
    cost = float(0.0)
    if s.waypoint[3] > 0.0:
        cost = s.waypoint[3] * wp.length_sq(s.tip - wp.vec3(s.waypoint[0], s.waypoint[1], s.waypoint[2]))
    return cost


TERMS: tuple[str, ...] = tuple(_TERMS)
"""Names of the built-in cost terms of the robot level, in the order in which they are added up."""


def terms_vector(extra: int = 0) -> type:
    """Returns the vector type of the weighted cost terms: the built-in ones, then ``extra`` from other packages."""
    return wp.types.vector(length=len(TERMS) + extra, dtype=float)


@lru_cache
def make_robot_cost(extra: ExtraTerms) -> wp.Function:
    """Returns the stage cost ``(w: RobotWeights, s: Stage)`` of the robot level: a vector of all weighted terms.

    Its sum is ``l_o + l_r + l_c`` of equation 14, and our additions: l_o is ``goal`` and ``contact``, l_c is
    ``reference``, and ``l_r = w_ee max(|p_ee - p_o|^2 - r_0^2, 0) + w_align psi_align + w_tilt psi_tilt`` (equation 17)
    is ``approach``, ``align`` and ``tilt``.

    Args:
        extra: Cost terms from outside the package, whose weights are ``w.extra``.
    """
    return compose(tuple(_TERMS.values()), extra)
