"""An arm that holds its tool upright: its placement, reduced to fields over the position of the tip.

With the tool upright, the tip's position determines the joint positions (``geometry/postures.py``). Clearance and speed
of the arm are therefore fields over the tip's position, and a rollout whose controls are velocities of the tip needs no
forward kinematics.
"""

from functools import lru_cache

import warp as wp

from oimppi_warp.kernels.geometry import PoseField, SpaceField, space_field
from oimppi_warp.kernels.kinematics import Arm, ArmPlacement, Environment, make_place_arm

wp.set_module_options({"enable_backward": False})

BRAKING = wp.constant(0.5)
"""Share of the change of the tip's velocity that is counted on for braking; the rest is left for turning."""

AT_ONCE = wp.constant(10.0)
"""Change of the tip's velocity per control step that counts as unlimited [m/s]."""


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
def fastest(upright: UprightArm, tip: wp.vec3) -> float:
    """Returns the largest horizontal speed of the tip at a position [m/s]."""
    return space_field(upright.speed, within_top(upright.speed, tip))


@wp.func
def braking_at(upright: UprightArm, speed: float) -> float:
    """Returns by how much a control step can slow down the tip where its largest speed is ``speed`` [m/s]."""
    return wp.min(BRAKING * upright.agility * speed, AT_ONCE)


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
