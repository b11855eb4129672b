"""Forward kinematics of a serial arm of revolute joints about their local z axes."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class Arm:
    """A serial arm with its tool, and spheres that stand for its shape.

    Attributes:
        rotation: Joint frame in the previous link's frame, at position zero, [dof].
        position: The same, its origin [m], [dof].
        lower, upper: Joint position limits [rad], [dof].
        speed: Joint velocity limits [rad/s], [dof].
        tip_position: Tool tip in the last link's frame [m].
        tip_rotation: The tip's frame in the last link's frame; its z axis points out of the tool.
        sphere: Spheres along the links: centre in the link's frame [m] and radius [m], sorted by link.
        first_sphere: Index of each link's first sphere, [dof + 1].
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


@wp.func
def turn_about_z(r: wp.mat33, angle: float) -> wp.mat33:
    """``r`` followed by a turn about its own z axis."""
    c = wp.cos(angle)
    s = wp.sin(angle)
    return wp.mat33(
        c * r[0, 0] + s * r[0, 1], c * r[0, 1] - s * r[0, 0], r[0, 2],
        c * r[1, 0] + s * r[1, 1], c * r[1, 1] - s * r[1, 0], r[1, 2],
        c * r[2, 0] + s * r[2, 1], c * r[2, 1] - s * r[2, 0], r[2, 2],
    )  # fmt: skip
