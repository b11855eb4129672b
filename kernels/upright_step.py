"""A control step of an arm that holds its tool upright: the servo, the bounds, and the contact with the object."""

import warp as wp

from oimppi_warp.kernels.bounds import (
    BESIDE,
    CLOSE,
    approach,
    closest_approach,
    is_close,
    keep_clear,
    keep_off,
    least_clearance,
    pushing_speed,
    within,
)
from oimppi_warp.kernels.contact import Contact, push_along, touch, untouched
from oimppi_warp.kernels.geometry import planar_field, pose_field, rotate
from oimppi_warp.kernels.kinematics import ArmPlacement
from oimppi_warp.kernels.pushing import ObjectModel, phi_1
from oimppi_warp.kernels.upright import UprightArm, braking_at, clearance_at, fastest, place_upright

wp.set_module_options({"enable_backward": False})

HEIGHT_RATE = wp.constant(6.0)
"""Rate at which the servo reduces the error of the tip's height [1/s]."""

HEIGHT_SPEED = wp.constant(0.15)
"""Largest vertical speed of the servo [m/s]."""

ASIDE = wp.constant(0.01)
"""Gap to the object, seen from above, within which a tip above the object is not lowered [m]."""

FASTER = wp.constant(0.03)
"""Increase per control step of the speed at which the tip pushes, beyond that of the touch [m/s]."""

NEAR = wp.constant(0.01)
"""Gap between tool and object within which the object may be pushed, whatever the model says [m]."""

ROUNDING = wp.constant(1.0e-4)
"""Amount by which the arm's clearance may fall short of the least where the object holds the tip back [m]."""


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
