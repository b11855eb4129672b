"""Contact of a moving arm with its surroundings: with obstacles and table, and with the object, which it pushes."""

import warp as wp

from oimppi_warp.kernels.costs.terms import NOT_PUSHED
from oimppi_warp.kernels.kinematics import ArmPlacement
from oimppi_warp.kernels.pushing import ObjectModel, over_object, phi_1, push, settle

wp.set_module_options({"enable_backward": False})

PENETRATION_TOLERANCE = wp.constant(5.0e-4)
"""Penetration depth beyond which the arm is stopped [m]."""


@wp.struct
class Contact:
    """Outcome of a motion of the tool beside, into or above the object.

    Attributes:
        stopped: Whether the arm is stopped by an obstacle, by the table or on top of the object: the motion does not
            take place.
        pose: Pose of the object's friction centre after the motion.
        pushed: Pose to which the tool pushes it, before obstacles push it back.
        force: Contact force between object and environment, lambda_2 [N].
        gap: Clearance phi_2 of the pose to which the tool pushes the object; ``NOT_PUSHED`` if it does not push [m].
        pressed: Depth to which the tool presses into an object that cannot yield [m].
        rise: Speed at which the tip rises while it pushes [m/s].
        above: Whether the tip is above the object.
    """

    stopped: bool
    pose: wp.vec3
    pushed: wp.vec3
    force: float
    gap: float
    pressed: float
    rise: float
    above: bool


@wp.func
def untouched(pose: wp.vec3) -> Contact:
    """Returns the outcome of a motion that does not touch the object, which is at a pose."""
    out = Contact()
    out.pose = pose
    out.pushed = pose
    out.gap = NOT_PUSHED
    return out


@wp.func
def push_along(
    body: ObjectModel, pose: wp.vec3, start: wp.vec3, end: wp.vec3, radius: float, contact_steps: int
) -> wp.vec3:
    """Returns the object's pose after the tool has moved from ``start`` to ``end``, without obstacles."""
    moved = pose
    last = wp.vec2(start[0], start[1])
    way = wp.vec2(end[0], end[1]) - last
    away = wp.length(last - wp.vec2(pose[0], pose[1])) - wp.length(way)
    if away < body.size + radius:  # else it does not come near
        move = way / float(contact_steps)
        for _ in range(contact_steps):
            moved = push(body, moved, last, last + move, radius)
            last = last + move
    return moved


@wp.func
def touch(
    body: ObjectModel, pose: wp.vec3, old: ArmPlacement, new: ArmPlacement, radius: float, dt: float, contact_steps: int
) -> Contact:
    """Returns the outcome of the arm's motion from one placement to another, for object and arm.

    The arm is stopped: a step that would move it further into an obstacle or the table, or the tool down onto the
    object, is not taken. The object moves by :func:`push` and :func:`settle` (equation 2). ``radius`` is the tool's.
    """
    out = untouched(pose)
    tip = new.tip
    out.stopped = new.arm_clearance < -PENETRATION_TOLERANCE and new.arm_clearance < old.arm_clearance
    if tip[2] >= body.top or old.tip[2] >= body.top:
        if over_object(body, pose, tip, radius):
            out.above = True
            if tip[2] < body.top:
                out.stopped = True
    if not out.stopped:
        moved = pose
        if tip[2] < body.top and old.tip[2] < body.top:
            moved = push_along(body, pose, old.tip, tip, radius, contact_steps)
        if moved[0] != pose[0] or moved[1] != pose[1] or moved[2] != pose[2]:
            settled = settle(body, moved, dt)
            out.pose = settled.pose
            out.pushed = moved
            out.force = settled.force
            out.gap = settled.clearance
            out.rise = wp.max(tip[2] - old.tip[2], 0.0) / dt
            if out.force > 0.0:
                # The obstacle pushed the object back: any remaining overlap of tool and object is a jam.
                out.pressed = wp.max(radius - phi_1(body, out.pose, wp.vec2(tip[0], tip[1])), 0.0)
    return out
