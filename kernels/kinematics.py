"""Forward kinematics of a serial arm whose joints turn about or slide along their local z axes, and its clearance.

A chain is written as one letter per joint: R for one that turns, P for one that slides. Kernels are generated for a
chain, so that no thread has to check a joint's type.
"""

from functools import lru_cache

import warp as wp

from oimppi_warp.kernels.geometry import SpaceField, space_field

wp.set_module_options({"enable_backward": False})


@wp.struct
class Arm:
    """A serial arm with its tool, and spheres that approximate its shape.

    Attributes:
        rotation: Joint frame in the previous link's frame, at position zero, [dof].
        position: Origin of that frame [m], [dof].
        lower, upper: Joint position limits [rad; m for a sliding joint], [dof].
        speed: Joint velocity limits [rad/s; m/s], [dof].
        tip_position: Tool tip in the last link's frame [m].
        tip_rotation: The tip's frame in the last link's frame; its z axis points out of the tool.
        sphere: Spheres along the links: centre in the link's frame [m] and radius [m], sorted by link.
        first_sphere: Index of each link's first sphere, [dof + 1].
        hull: A sphere that encloses all spheres of each link, [dof].
        turret: Number of first links that no joint raises or lowers; their distance to the table does not count.
    """

    rotation: wp.array[wp.mat33]
    position: wp.array[wp.vec3]
    lower: wp.array[float]
    upper: wp.array[float]
    speed: wp.array[float]
    tip_position: wp.vec3
    tip_rotation: wp.mat33
    sphere: wp.array[wp.vec4]
    first_sphere: wp.array[int]
    hull: wp.array[wp.vec4]
    turret: int


@wp.struct
class Environment:
    """Obstacles and table, which the arm must keep clear of.

    Attributes:
        obstacles: Distance to the obstacles [m].
        top: Height above which no obstacle is near [m].
        near: Clearance above which a lower bound is sufficient [m].
        tool_radius: Radius of the tool [m].
        table: Height of the table's top [m].
    """

    obstacles: SpaceField
    top: float
    near: float
    tool_radius: float
    table: float


@wp.struct
class ArmPlacement:
    """Placement of an arm at given joint positions.

    Attributes:
        tip: The tool's tip [m].
        up: The world's z axis in the tip's frame.
        lean: Horizontal offset of the stick's axis from the tip per metre of height, in x and y.
        arm_clearance: Clearance of arm and tool to obstacles and table, phi_3 [m]; beyond ``Environment.near`` a
            lower bound.
    """

    tip: wp.vec3
    up: wp.vec3
    lean: wp.vec2
    arm_clearance: float


@wp.func
def turn_about_z(r: wp.mat33, c: float, s: float) -> wp.mat33:
    """Returns ``r`` rotated about its own z axis by the angle with cosine ``c`` and sine ``s``."""
    return wp.mat33(
        c * r[0, 0] + s * r[0, 1], c * r[0, 1] - s * r[0, 0], r[0, 2],
        c * r[1, 0] + s * r[1, 1], c * r[1, 1] - s * r[1, 0], r[1, 2],
        c * r[2, 0] + s * r[2, 1], c * r[2, 1] - s * r[2, 0], r[2, 2],
    )  # fmt: skip


@wp.func
def lowest_clearance(environment: Environment, p: wp.vec3, r: wp.mat33, ball: wp.vec4, still: bool) -> float:
    """Returns the clearance of a sphere (centre, radius) in the frame ``p``, ``r`` to table and obstacles [m].

    That of a link that stays at its height, ``still``, is only to obstacles, and at most a metre.
    """
    height = p[2] + r[2, 0] * ball[0] + r[2, 1] * ball[1] + r[2, 2] * ball[2] - ball[3]
    clearance = wp.where(still, 1.0, height - environment.table)
    if height < environment.top:
        at = p + r * wp.vec3(ball[0], ball[1], ball[2])
        clearance = wp.min(clearance, space_field(environment.obstacles, at) - ball[3])
    return clearance


@lru_cache
def make_place_arm(chain: str) -> wp.Function:
    """Returns the function that places an arm with a chain of joints, such as ``"RRRRRR"``."""
    dof = len(chain)
    vec = wp.types.vector(length=dof, dtype=float)
    # One bit per joint: a constant that the unrolled loop tests, so that the compiler drops the dead branch. (With
    # wp.static in the loop, a module's hash would depend on what was compiled before it.)
    slides = sum(1 << j for j, kind in enumerate(chain) if kind == "P")

    @wp.func(module=f"oimppi_warp.kernels.kinematics_{chain}")
    def place_arm(arm: Arm, environment: Environment, tip: wp.vec3, q: vec) -> ArmPlacement:
        """Computes tip, tilt and clearance of the arm; the clearance is ``phi_3(x_r) >= 0`` of equation 4.

        Args:
            arm: The arm.
            environment: Obstacles and table.
            tip: The tip in the last link's frame [m].
            q: Joint positions [rad].
        """
        clearance = float(1.0)
        r = wp.identity(n=3, dtype=float)
        p = wp.vec3()
        for j in range(dof):
            p = p + r * arm.position[j]
            if (slides >> j) & 1 != 0:
                r = r * arm.rotation[j]
                p = p + q[j] * wp.vec3(r[0, 2], r[1, 2], r[2, 2])
            else:
                r = turn_about_z(r * arm.rotation[j], wp.cos(q[j]), wp.sin(q[j]))
            # If a link's hull is far from everything, its spheres need not be checked.
            whole = lowest_clearance(environment, p, r, arm.hull[j], j < arm.turret)
            if whole > environment.near:
                clearance = wp.min(clearance, whole)
            else:
                for s in range(arm.first_sphere[j], arm.first_sphere[j + 1]):
                    clearance = wp.min(clearance, lowest_clearance(environment, p, r, arm.sphere[s], j < arm.turret))
        placed = ArmPlacement()
        placed.tip = p + r * tip
        placed.up = wp.transpose(arm.tip_rotation) * wp.vec3(r[2, 0], r[2, 1], r[2, 2])
        stick = r * wp.vec3(-arm.tip_rotation[0, 2], -arm.tip_rotation[1, 2], -arm.tip_rotation[2, 2])
        placed.lean = wp.vec2(stick[0], stick[1]) / wp.max(stick[2], 0.1)
        placed.arm_clearance = wp.min(clearance, placed.tip[2] - environment.table)
        return placed

    return place_arm
