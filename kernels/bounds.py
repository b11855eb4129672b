"""Bounds on the motion of a tip: the arm keeps clear of obstacles, and so does the object that it pushes.

A motion that would break a bound is projected, so that the tip slides along what it must keep off (``phi_2 >= 0`` and
``phi_3 >= 0`` of equation 4, with margins), and everything is approached no faster than the arm can brake.
"""

import warp as wp

from oimppi_warp.kernels.contact import Contact, push_along
from oimppi_warp.kernels.costs.terms import NOT_PUSHED
from oimppi_warp.kernels.geometry import SpaceField, planar_field, pose_field, rotate, space_slope
from oimppi_warp.kernels.kinematics import ArmPlacement
from oimppi_warp.kernels.pushing import ObjectModel, phi_1
from oimppi_warp.kernels.upright import UprightArm, placed_with, within_top

wp.set_module_options({"enable_backward": False})

APPROACH = wp.constant(0.5)
"""Largest share of a clearance, in excess of the margin, that one control step may take away."""

BESIDE = wp.constant(2.0e-3)
"""Gap that a tip which is too high to push keeps to the object, and a tip above the object to its top [m]."""

SKIM = wp.constant(0.01)
"""Height above the object's top up to which a tip keeps off its sides, as it may come down further [m]."""

TOUCHING = wp.constant(5.0e-4)
"""Gap between tool and object up to which they touch: the tool's speed is not limited, so that it can push [m]."""

CLOSE = wp.constant(0.05)
"""Clearance of an object beyond which a control step does not take it to its margin [m]."""

SLOWING = wp.constant(8.0)
"""Speed that a tip may push with, per clearance of the object in excess of its margin [1/s]."""

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

PROBE = wp.constant(5.0e-4)
"""Displacement of the tip that the slope of the object's clearance is computed with [m]."""


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
    projections = int(0)
    while left < least - short and projections < PROJECTIONS:
        beside = moved + wp.vec3(PROBE, 0.0, 0.0)
        along_x = pushed_clearance(upright, body, pose, start, beside, radius, contact_steps) - left
        beside = moved + wp.vec3(0.0, PROBE, 0.0)
        along_y = pushed_clearance(upright, body, pose, start, beside, radius, contact_steps) - left
        slope = wp.vec2(along_x, along_y) / PROBE
        step = (least - left) / wp.max(wp.length_sq(slope), LEAST_SLOPE * LEAST_SLOPE)
        moved = within(start, moved + wp.vec3(step * slope[0], step * slope[1], 0.0), longest)
        left = pushed_clearance(upright, body, pose, start, moved, radius, contact_steps)
        projections += 1
    if left < least - short:
        # Slowly, down to contact, or not at all.
        scale = float(1.0)
        moved = within(start, tip, longest)
        left = straight
        halvings = int(0)
        while left < wp.min(before, 0.0) and halvings < HALVINGS:
            scale = 0.5 * scale
            moved = within(start, tip, scale * longest)
            left = pushed_clearance(upright, body, pose, start, moved, radius, contact_steps)
            halvings += 1
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
