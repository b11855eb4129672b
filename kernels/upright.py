"""An arm that holds its tool upright: its placement, reduced to fields over the position of the tip.

With the tool upright, the tip's position determines the joint positions (``geometry/postures.py``). Clearance and speed
of the arm are therefore fields over the tip's position, and a rollout whose controls are velocities of the tip needs no
forward kinematics.
"""

from functools import lru_cache

import warp as wp

from oimppi_warp.kernels.geometry import SpaceField, space_field
from oimppi_warp.kernels.kinematics import Arm, ArmPlacement, Environment, make_place_arm
from oimppi_warp.kernels.pushing import ObjectModel, phi_1

wp.set_module_options({"enable_backward": False})

HEIGHT_RATE = wp.constant(6.0)
"""Rate at which the servo reduces the error of the tip's height [1/s]."""

HEIGHT_SPEED = wp.constant(0.15)
"""Largest vertical speed of the servo [m/s]."""

ASIDE = wp.constant(0.01)
"""Gap to the object, seen from above, within which a tip above the object is not lowered [m]."""


SEAM = wp.constant(1.5)
"""Difference of a joint's positions at neighbouring nodes beyond which they belong to different turns [rad]."""


@wp.struct
class UprightArm:
    """Fields over the position of the tip of an arm that holds its tool upright.

    Attributes:
        clearance: Clearance of arm and tool to obstacles and table, phi_3; negative out of reach [m].
        speed: Largest horizontal speed of the tip in any direction within the joints' velocity limits [m/s].
        height: Height of the tip while pushing [m].
    """

    clearance: SpaceField
    speed: SpaceField
    height: float


@wp.func
def within_top(field: SpaceField, tip: wp.vec3) -> wp.vec3:
    """Returns ``tip``, lowered to the field's highest layer if it is above."""
    top = field.origin[2] + (float(field.values.shape[2] - 1) - 1.0e-3) / field.inv_step
    return wp.vec3(tip[0], tip[1], wp.min(tip[2], top))


@wp.func
def place_upright(upright: UprightArm, tip: wp.vec3) -> ArmPlacement:
    """Returns the placement of the arm with the tip at a position [m]."""
    placed = ArmPlacement()
    placed.tip = tip
    placed.up = wp.vec3(0.0, 0.0, -1.0)
    placed.lean = wp.vec2()
    placed.arm_clearance = space_field(upright.clearance, within_top(upright.clearance, tip))
    return placed


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
    upright: UprightArm, model: ObjectModel, pose: wp.vec3, tip: wp.vec3, u: wp.vec3, lifting: bool, radius: float,
    dt: float,
) -> wp.vec3:  # fmt: skip
    """Returns the tip's position after a control step with the velocity ``u``, as the servo of the arm follows it.

    The horizontal speed is limited to what the joints allow. The vertical velocity is the servo's, unless the tip is
    being lifted over the object; then the servo only keeps it from sinking below its height. ``radius`` is that of the
    tool.
    """
    most = space_field(upright.speed, within_top(upright.speed, tip))
    v = wp.vec2(u[0], u[1])
    v = wp.min(1.0, most / wp.max(wp.length(v), 1.0e-6)) * v
    ahead = wp.vec2(tip[0], tip[1]) + dt * v
    rise = wp.max(u[2], wp.min(HEIGHT_RATE, 1.0 / dt) * (upright.height - tip[2]))
    if not lifting:
        rise = servo_height(upright, model, pose, tip, ahead, radius)
        rise = wp.sign(rise) * wp.min(wp.abs(rise), wp.abs(upright.height - tip[2]) / dt)
    return wp.vec3(ahead[0], ahead[1], tip[2] + dt * rise)


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
        tip = start[0]
        q = start_joints[0]
        origin = upright.speed.origin
        inv_step = upright.speed.inv_step
        lifting = waypoint[0][3] > 0.0
        radius = environment.tool_radius
        # What the joints deviate from the posture by at first is kept: the servo removes it slowly.
        offset = q - posture(postures, origin, inv_step, tip)
        for h in range(controls.shape[1]):
            tip = move_upright(upright, model, start[1], tip, controls[n, h], lifting, radius, dt)
            wanted = posture(postures, origin, inv_step, tip) + offset
            u = vec()
            for j in range(dof):
                u[j] = wp.clamp((wanted[j] - q[j]) / dt, -arm.speed[j], arm.speed[j])
            q = q + dt * u
            joint_controls[n, h] = u

    return joint_controls
