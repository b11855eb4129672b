"""An arm that holds its tool upright: its placement, reduced to fields over the position of the tip.

With the tool upright, the tip's position determines the joint positions (``geometry/postures.py``). Clearance and speed
of the arm are therefore fields over the tip's position, and a rollout whose controls are velocities of the tip needs no
forward kinematics.
"""

from functools import lru_cache

import warp as wp

from oimppi_warp.kernels.contact import Contact, push_along, touch, untouched
from oimppi_warp.kernels.costs.terms import NOT_PUSHED
from oimppi_warp.kernels.geometry import (
    PoseField,
    SpaceField,
    planar_field,
    pose_field,
    rotate,
    space_field,
    space_slope,
)
from oimppi_warp.kernels.kinematics import Arm, ArmPlacement, Environment, make_place_arm
from oimppi_warp.kernels.pushing import ObjectModel, phi_1

wp.set_module_options({"enable_backward": False})

HEIGHT_RATE = wp.constant(6.0)
"""Rate at which the servo reduces the error of the tip's height [1/s]."""

HEIGHT_SPEED = wp.constant(0.15)
"""Largest vertical speed of the servo [m/s]."""

ASIDE = wp.constant(0.01)
"""Gap to the object, seen from above, within which a tip above the object is not lowered [m]."""

APPROACH = wp.constant(0.5)
"""Largest share of a clearance, in excess of the margin, that one control step may take away."""

BESIDE = wp.constant(2.0e-3)
"""Gap that a tip which is too high to push keeps to the object, and a tip above the object to its top [m]."""

SKIM = wp.constant(0.01)
"""Height above the object's top up to which a tip keeps off its sides, as it may come down further [m]."""

TOUCHING = wp.constant(5.0e-4)
"""Gap between tool and object up to which they touch: the tool's speed is not limited, so that it can push [m]."""

BRAKING = wp.constant(0.5)
"""Share of the change of the tip's velocity that is counted on for braking; the rest is left for turning."""

AT_ONCE = wp.constant(10.0)
"""Change of the tip's velocity per control step that counts as unlimited [m/s]."""

CLOSE = wp.constant(0.05)
"""Clearance of an object beyond which a control step does not take it to its margin [m]."""

SLOWING = wp.constant(8.0)
"""Speed that a tip may push with, per clearance of the object in excess of its margin [1/s]."""

FASTER = wp.constant(0.03)
"""Increase per control step of the speed at which the tip pushes, beyond that of the touch [m/s]."""

NEAR = wp.constant(0.01)
"""Gap between tool and object within which the object may be pushed, whatever the model says [m]."""

LEAST_SLOPE = wp.constant(0.3)
"""Least slope of the clearance that a correction of the tip is computed with; it is one in front of a wall."""

PROJECTIONS = wp.constant(3)
"""Number of corrections of the tip."""

HALVINGS = wp.constant(3)
"""Number of times that the tip's motion is halved."""

SLIDES = wp.constant(2)
"""Number of corrections of a tip that slides along the object as along a wall."""

SHORT = wp.constant(5.0e-4)
"""Amount by which the object's clearance may fall short of the least after them [m]."""

ROUNDED = wp.constant(5.0e-5)
"""The same, for an object that is closer than the margin already [m]."""

ASIDE_STEP = wp.constant(2.0e-3)
"""Length of a control step of the tip that keeps the object clear, if the tip would move less [m]."""

ROUNDING = wp.constant(1.0e-4)
"""Amount by which the arm's clearance may fall short of the least where the object holds the tip back [m]."""

PROBE = wp.constant(5.0e-4)
"""Displacement of the tip that the slope of the object's clearance is computed with [m]."""

SEAM = wp.constant(1.5)
"""Difference of a joint's positions at neighbouring nodes beyond which they belong to different turns [rad]."""


@wp.struct
class UprightArm:
    """Fields over the position of the tip of an arm that holds its tool upright.

    Attributes:
        clearance: Clearance of arm and tool to obstacles and table, phi_3; negative out of reach [m].
        speed: Largest horizontal speed of the tip in any direction within the joints' velocity limits [m/s].
        agility: Change of the tip's velocity that a control step can make, as a fraction of ``speed``.
        height: Height of the tip while pushing [m].
        highest: Height from which the tip does not touch the object's side, which it would tip over [m].
        arm_margin: Clearance that the arm keeps [m].
        object_clearance: Clearance phi_2 of the object, to obstacles and to the table's edge [m].
        object_margin: Its least value: below, the object is not pushed further [m].
        touch_speed: Largest speed towards the object at which the tool touches it [m/s].
        within_lower, within_upper: Corners of the rectangle in which the object's centre keeps it on the table [m].
    """

    clearance: SpaceField
    speed: SpaceField
    agility: float
    height: float
    highest: float
    arm_margin: float
    object_clearance: PoseField
    object_margin: float
    touch_speed: float
    within_lower: wp.vec2
    within_upper: wp.vec2


@wp.func
def within_top(field: SpaceField, tip: wp.vec3) -> wp.vec3:
    """Returns ``tip``, lowered to the field's highest layer if it is above."""
    top = field.origin[2] + (float(field.values.shape[2] - 1) - 1.0e-3) / field.inv_step
    return wp.vec3(tip[0], tip[1], wp.min(tip[2], top))


@wp.func
def clearance_at(clearance: SpaceField, tip: wp.vec3) -> float:
    """Returns the clearance of the arm with the tip at a position [m]."""
    return space_field(clearance, within_top(clearance, tip))


@wp.func
def placed_with(tip: wp.vec3, clearance: float) -> ArmPlacement:
    """Returns the placement of the arm with the tip at a position, given its clearance there [m]."""
    placed = ArmPlacement()
    placed.tip = tip
    placed.up = wp.vec3(0.0, 0.0, -1.0)
    placed.lean = wp.vec2()
    placed.arm_clearance = clearance
    return placed


@wp.func
def place_upright(upright: UprightArm, tip: wp.vec3) -> ArmPlacement:
    """Returns the placement of the arm with the tip at a position [m]."""
    return placed_with(tip, clearance_at(upright.clearance, tip))


@wp.func
def servo_height(
    upright: UprightArm, model: ObjectModel, pose: wp.vec3, tip: wp.vec3, ahead: wp.vec2, radius: float
) -> float:
    """Returns the vertical velocity with which the servo brings the tip to its height for pushing [m/s].

    A tip above the object is held there: it is lowered beside the object only. ``ahead`` is where the tip moves to,
    ``radius`` that of the tool.
    """
    height = upright.height
    if tip[2] >= model.top and phi_1(model, pose, ahead) < radius + ASIDE:
        height = tip[2]
    return wp.clamp(HEIGHT_RATE * (height - tip[2]), -HEIGHT_SPEED, HEIGHT_SPEED)


@wp.func
def fastest(upright: UprightArm, tip: wp.vec3) -> float:
    """Returns the largest horizontal speed of the tip at a position [m/s]."""
    return space_field(upright.speed, within_top(upright.speed, tip))


@wp.func
def braking_at(upright: UprightArm, speed: float) -> float:
    """Returns by how much a control step can slow down the tip where its largest speed is ``speed`` [m/s]."""
    return wp.min(BRAKING * upright.agility * speed, AT_ONCE)


@wp.func
def closest_approach(distance: float, braking: float, dt: float) -> float:
    """Returns the largest approach of a control step to something at a distance, such that the tip stops before it [m].

    From a speed ``v`` the tip slows down by ``braking`` in each control step: all its steps together are
    ``dt v (v + braking) / (2 braking)`` long.
    """
    left = wp.max(distance, 0.0)
    speed = 0.5 * (wp.sqrt(braking * braking + 8.0 * braking * left / dt) - braking)
    return wp.min(APPROACH * left, dt * speed)


@wp.func
def braking_distance(approach: float, braking: float, dt: float) -> float:
    """Returns the distance within which :func:`closest_approach` is less than an approach of a control step [m]."""
    return wp.max(approach / APPROACH, approach * (approach / dt + braking) / wp.max(2.0 * braking, 1.0e-6))


@wp.func
def move_upright(
    upright: UprightArm, model: ObjectModel, pose: wp.vec3, tip: wp.vec3, u: wp.vec3, most: float, repositioning: bool,
    radius: float, braking: float, dt: float,
) -> wp.vec3:  # fmt: skip
    """Returns the tip's position after a control step with the velocity ``u``, as the servo of the arm follows it.

    The horizontal speed is limited to ``most``, which the joints allow. The vertical velocity is the servo's. While the
    tool is being repositioned it is that of ``u``, and the servo only keeps the tip from sinking below its height, and
    from coming down on the object faster than it can stop. ``radius`` is that of the tool.
    """
    v = wp.vec2(u[0], u[1])
    v = wp.min(1.0, most / wp.max(wp.length(v), 1.0e-6)) * v
    ahead = wp.vec2(tip[0], tip[1]) + dt * v
    rise = wp.max(u[2], wp.min(HEIGHT_RATE, 1.0 / dt) * (upright.height - tip[2]))
    if not repositioning:
        rise = servo_height(upright, model, pose, tip, ahead, radius)
        rise = wp.sign(rise) * wp.min(wp.abs(rise), wp.abs(upright.height - tip[2]) / dt)
    elif rise < 0.0 and tip[2] >= model.top:
        if phi_1(model, pose, ahead) < radius + ASIDE:
            rise = wp.max(rise, -closest_approach(tip[2] - model.top - BESIDE, braking, dt) / dt)
    return wp.vec3(ahead[0], ahead[1], tip[2] + dt * rise)


@wp.func
def least_clearance(before: float, margin: float, braking: float, dt: float) -> float:
    """Returns the least clearance after a control step, given that before it [m].

    The margin is approached at a limited rate; a clearance below the margin does not become smaller.
    """
    return before - closest_approach(before - margin, braking, dt)


@wp.func
def keep_clear(clearance: SpaceField, placed: ArmPlacement, least: float) -> ArmPlacement:
    """Returns the placement beside one whose clearance is less than the least that it may be.

    The projection changes the tip's horizontal position only: ``phi_3 >= 0`` of equation 4 with a margin, along which
    the tip slides.
    """
    tip = placed.tip
    field = space_slope(clearance, within_top(clearance, tip))
    for _ in range(2):
        if field[0] < least:
            slope = wp.vec2(field[1], field[2])
            step = (least - field[0]) / wp.max(wp.length_sq(slope), LEAST_SLOPE * LEAST_SLOPE)
            tip = tip + wp.vec3(step * slope[0], step * slope[1], 0.0)
            field = space_slope(clearance, within_top(clearance, tip))
    return placed_with(tip, field[0])


@wp.func
def within(start: wp.vec3, tip: wp.vec3, longest: float) -> wp.vec3:
    """Returns ``tip``, or on the way to it the position at a horizontal distance ``longest`` from ``start`` [m]."""
    x = tip[0] - start[0]
    y = tip[1] - start[1]
    share = wp.min(1.0, longest / wp.max(wp.length(wp.vec2(x, y)), 1.0e-9))
    return wp.vec3(start[0] + share * x, start[1] + share * y, tip[2])


@wp.func
def is_close(upright: UprightArm, contact: Contact) -> bool:
    """Returns whether the object is pushed close to an obstacle or to the table's edge, without a further look-up."""
    at = contact.pushed
    inside = wp.min(
        wp.min(at[0] - upright.within_lower[0], upright.within_upper[0] - at[0]),
        wp.min(at[1] - upright.within_lower[1], upright.within_upper[1] - at[1]),
    )
    return contact.gap < NOT_PUSHED and wp.min(contact.gap, inside) < CLOSE


@wp.func
def pushing_speed(upright: UprightArm, clearance: float) -> float:
    """Returns the largest speed of a tip that pushes an object with a clearance [m/s].

    At its margin the object is pushed no faster than it is touched: what it does on the way there may differ from the
    prediction, and what it is pushed onto then feels that speed.
    """
    return upright.touch_speed + SLOWING * wp.max(clearance - upright.object_margin, 0.0)


@wp.func
def pushed_clearance(
    upright: UprightArm, body: ObjectModel, pose: wp.vec3, start: wp.vec3, tip: wp.vec3, radius: float,
    contact_steps: int,
) -> float:  # fmt: skip
    """Returns the clearance phi_2 of the pose to which a motion of the tool pushes the object [m]."""
    return pose_field(upright.object_clearance, push_along(body, pose, start, tip, radius, contact_steps))[0]


@wp.func
def slide_along(body: ObjectModel, pose: wp.vec3, start: wp.vec3, tip: wp.vec3, radius: float) -> wp.vec3:
    """Returns where the tip gets on its way to a position, along an object at a pose as along a wall."""
    moved = tip
    c = wp.cos(pose[2])
    s = wp.sin(pose[2])
    for _ in range(SLIDES):
        field = planar_field(body.body, rotate(c, -s, wp.vec2(moved[0] - pose[0], moved[1] - pose[1])))
        outward = wp.max(radius - field[0], 0.0) * rotate(c, s, wp.normalize(wp.vec2(field[1], field[2])))
        moved = moved + wp.vec3(outward[0], outward[1], 0.0)
    return moved


@wp.func
def keep_off(
    upright: UprightArm, body: ObjectModel, pose: wp.vec3, start: wp.vec3, tip: wp.vec3, pushed: wp.vec3, radius: float,
    braking: float, dt: float, contact_steps: int,
) -> wp.vec3:  # fmt: skip
    """Returns where the tip gets on its way to a position without pushing the object onto obstacles or off the table.

    ``pushed`` is the pose to which the tip pushes the object on that way. The tip slides along the object:
    ``phi_2 >= 0`` of equation 4 with a margin, by projection in terms of the tip's position. Where it finds no way, it
    stays at ``start``.
    """
    moved = tip
    longest = wp.max(wp.length(wp.vec2(tip[0] - start[0], tip[1] - start[1])), ASIDE_STEP)
    before = pose_field(upright.object_clearance, pose)[0]
    least = least_clearance(before, upright.object_margin, braking, dt)
    short = ROUNDED
    if before > upright.object_margin:
        short = SHORT
    straight = pose_field(upright.object_clearance, pushed)[0]
    left = straight
    for _ in range(PROJECTIONS):
        if left < least - short:
            beside = moved + wp.vec3(PROBE, 0.0, 0.0)
            along_x = pushed_clearance(upright, body, pose, start, beside, radius, contact_steps) - left
            beside = moved + wp.vec3(0.0, PROBE, 0.0)
            along_y = pushed_clearance(upright, body, pose, start, beside, radius, contact_steps) - left
            slope = wp.vec2(along_x, along_y) / PROBE
            step = (least - left) / wp.max(wp.length_sq(slope), LEAST_SLOPE * LEAST_SLOPE)
            moved = within(start, moved + wp.vec3(step * slope[0], step * slope[1], 0.0), longest)
            left = pushed_clearance(upright, body, pose, start, moved, radius, contact_steps)
    if left < least - short:
        # Slowly, down to contact, or not at all.
        scale = float(1.0)
        moved = within(start, tip, longest)
        left = straight
        for _ in range(HALVINGS):
            if left < wp.min(before, 0.0):
                scale = 0.5 * scale
                moved = within(start, tip, scale * longest)
                left = pushed_clearance(upright, body, pose, start, moved, radius, contact_steps)
        if left < wp.min(before, 0.0):
            moved = slide_along(body, pose, start, within(start, tip, longest), radius)
            if (
                pushed_clearance(upright, body, pose, start, moved, radius, contact_steps)
                < wp.min(before, 0.0) - ROUNDED
            ):
                moved = wp.vec3(start[0], start[1], tip[2])
    return moved


@wp.func
def least_gap(upright: UprightArm, body: ObjectModel, before: float, tip: wp.vec3, braking: float, dt: float) -> float:
    """Returns the least gap of the tool to the object after a control step, given that before it [m].

    A tip at its height for pushing may touch, but no faster than the limit. A tip that is beside the object, but too
    high to push it, keeps a gap until it is down.
    """
    least = -wp.inf
    if before > TOUCHING:
        least = before - wp.max(upright.touch_speed * dt, closest_approach(before, braking, dt))
    if tip[2] > upright.highest:
        least = wp.max(least, wp.min(BESIDE, before))
    return least


@wp.func
def approach(
    upright: UprightArm, body: ObjectModel, pose: wp.vec3, start: wp.vec3, tip: wp.vec3, radius: float, braking: float,
    dt: float,
) -> wp.vec3:  # fmt: skip
    """Returns where a tip gets on its way towards the object, which it may touch from beside, and slowly only."""
    moved = tip
    step = wp.vec2(tip[0] - start[0], tip[1] - start[1])
    c = wp.cos(pose[2])
    s = wp.sin(pose[2])
    field = planar_field(body.body, rotate(c, -s, wp.vec2(tip[0] - pose[0], tip[1] - pose[1])))
    gap = field[0] - radius
    length = wp.length(step)
    if tip[2] < body.top + SKIM and gap + length < braking_distance(length, braking, dt) + BESIDE:
        before = phi_1(body, pose, wp.vec2(start[0], start[1])) - radius
        lack = least_gap(upright, body, before, tip, braking, dt) - gap
        if lack > 0.0 and before > -radius:
            outward = lack * rotate(c, s, wp.normalize(wp.vec2(field[1], field[2])))
            moved = tip + wp.vec3(outward[0], outward[1], 0.0)
    return moved


@wp.struct
class UprightStep:
    """Outcome of a control step of an arm that holds its tool upright.

    Attributes:
        placed: The arm as it comes to rest.
        tried: The arm as it would be without what stopped it.
        contact: The object's motion and contact.
    """

    placed: ArmPlacement
    tried: ArmPlacement
    contact: Contact


@wp.func
def step_upright(
    upright: UprightArm, body: ObjectModel, pose: wp.vec3, placed: ArmPlacement, u: wp.vec3, repositioning: bool,
    radius: float, dt: float, contact_steps: int,
) -> UprightStep:  # fmt: skip
    """Returns the outcome of a control step with the tip velocity ``u``, for arm and object.

    Where arm, or tool and object, meet what cannot yield, the tip slides along it (:func:`keep_clear`), or is held back
    by the object: the tool does not press.
    """
    out = UprightStep()
    most = fastest(upright, placed.tip)
    braking = braking_at(upright, most)
    wanted = move_upright(upright, body, pose, placed.tip, u, most, repositioning, radius, braking, dt)
    least = least_clearance(placed.arm_clearance, upright.arm_margin, braking, dt)
    out.tried = place_upright(upright, wanted)
    if out.tried.arm_clearance < least:
        out.tried = keep_clear(upright.clearance, out.tried, least)
    clear = out.tried.tip
    out.tried.tip = approach(upright, body, pose, placed.tip, clear, radius, braking, dt)
    out.contact = touch(body, pose, placed, out.tried, radius, dt, contact_steps)
    if is_close(upright, out.contact):
        tip = out.tried.tip
        pushed = out.contact.pushed
        if out.contact.gap < CLOSE:
            tip = within(placed.tip, tip, dt * pushing_speed(upright, out.contact.gap))
        if tip[0] != out.tried.tip[0] or tip[1] != out.tried.tip[1]:
            pushed = push_along(body, pose, placed.tip, tip, radius, contact_steps)
        tip = keep_off(upright, body, pose, placed.tip, tip, pushed, radius, braking, dt, contact_steps)
        if tip[0] != out.tried.tip[0] or tip[1] != out.tried.tip[1]:
            out.tried.tip = tip
            out.contact = touch(body, pose, placed, out.tried, radius, dt, contact_steps)
    out.placed = out.tried
    if out.contact.pressed > 0.0:
        at = out.contact.pose
        c = wp.cos(at[2])
        s = wp.sin(at[2])
        tip = out.tried.tip
        field = planar_field(body.body, rotate(c, -s, wp.vec2(tip[0] - at[0], tip[1] - at[1])))
        back = out.contact.pressed * rotate(c, s, wp.normalize(wp.vec2(field[1], field[2])))
        out.placed.tip = tip + wp.vec3(back[0], back[1], 0.0)
    if out.placed.tip[0] != clear[0] or out.placed.tip[1] != clear[1]:
        out.placed.arm_clearance = clearance_at(upright.clearance, out.placed.tip)
        if out.placed.arm_clearance < least - ROUNDING:  # into an obstacle: there is no way, but up or down
            out.placed = place_upright(upright, wp.vec3(placed.tip[0], placed.tip[1], clear[2]))
            if out.placed.arm_clearance < least - ROUNDING:
                out.placed = placed
            out.contact = untouched(pose)
    if out.contact.stopped:
        out.placed = placed
    return out


@wp.func
def change_velocity(rates: wp.array[wp.vec3], most: float, before: wp.vec3, u: wp.vec3) -> wp.vec3:
    """Returns the velocity of the tip, on the way from one to another, to which it can change at once [m/s].

    ``rates`` are the joint velocities per velocity of the tip, ``most`` their largest change [rad/s].
    """
    change = u - before
    share = float(1.0)
    for j in range(rates.shape[0]):
        share = wp.min(share, most / wp.max(wp.abs(wp.dot(rates[j], change)), 1.0e-6))
    return before + share * change


@wp.kernel
def allowed_velocity(
    # in:
    upright: UprightArm,
    model: ObjectModel,
    radius: float,
    start: wp.array[wp.vec3],
    rates: wp.array[wp.vec3],
    most_change: float,
    waypoint: wp.array[wp.vec4],
    command: wp.array[wp.vec3],
    dt: float,
    contact_steps: int,
    # out:
    allowed: wp.array[wp.vec3],
):
    """Computes the velocity with which the tip follows a command for one control step, by :func:`step_upright` [m/s].

    Shapes: ``start`` [3]: the tip's position, the object's pose and the tip's velocity in the control step before;
    ``rates`` [dof]: joint velocities per velocity of the tip [rad/m]; ``waypoint``, ``command`` and
    ``allowed`` [1]. ``most_change`` is the largest change of a joint's velocity [rad/s].
    """
    repositioning = waypoint[0][3] > 0.0
    placed = place_upright(upright, start[0])
    u = command[0]
    c = wp.cos(start[1][2])
    s = wp.sin(start[1][2])
    tip = wp.vec2(start[0][0], start[0][1])
    field = planar_field(model.body, rotate(c, -s, tip - wp.vec2(start[1][0], start[1][1])))
    gap = field[0] - radius
    if gap < NEAR and start[0][2] < model.top:
        # The model may be wrong about where, and whether, the tip pushes: its speed is limited before it is sure to.
        ahead = phi_1(model, start[1], tip + dt * wp.vec2(u[0], u[1])) - radius
        if ahead < gap + BESIDE:
            clearance = pose_field(upright.object_clearance, start[1])[0]
            u = within(wp.vec3(0.0, 0.0, u[2]), u, pushing_speed(upright, clearance))
        outward = rotate(c, s, wp.normalize(wp.vec2(field[1], field[2])))
        before = -wp.dot(wp.vec2(start[2][0], start[2][1]), outward)
        faster = -wp.dot(wp.vec2(u[0], u[1]), outward) - wp.max(upright.touch_speed, before + FASTER)
        back = wp.max(faster, 0.0) * outward
        u = u + wp.vec3(back[0], back[1], 0.0)
    u = change_velocity(rates, most_change, start[2], u)
    step = step_upright(upright, model, start[1], placed, u, repositioning, radius, dt, contact_steps)
    allowed[0] = (step.placed.tip - start[0]) / dt


@lru_cache
def make_upright_clearance(chain: str) -> wp.Kernel:
    """Returns the kernel that computes the clearance of an arm with a chain of joints such as ``"RRRRRR"``."""
    vec = wp.types.vector(length=len(chain), dtype=float)
    place_arm = make_place_arm(chain)

    @wp.kernel(module=f"oimppi_warp.kernels.upright_clearance_{chain}", enable_backward=False)
    def upright_clearance(
        # in:
        arm: Arm,
        environment: Environment,
        joints: wp.array[vec],
        # out:
        clearance: wp.array[float],
    ):
        """Computes the clearance phi_3 of each posture [m]. Shapes: ``joints`` [posture] [rad], ``clearance``."""
        i = wp.tid()
        clearance[i] = place_arm(arm, environment, arm.tip_position, joints[i]).arm_clearance

    return upright_clearance


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
