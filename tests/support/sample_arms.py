"""Arms of the sizes of well-known ones, each written as URDF and as MJCF; their shapes and masses are made up.

Lengths and limits are from data sheets; angles are rounded as people round them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

Vector = tuple[float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Shape:
    """A collision shape: sphere (radius), cylinder or capsule (radius, length of the straight part), or box (sides)."""

    kind: str
    size: tuple[float, ...]
    at: Vector = ZERO
    rpy: Vector = ZERO


@dataclass(frozen=True)
class Part:
    """A link, and the joint that holds it: a fixed one without an axis, and none for the base."""

    name: str
    parent: str = ""
    at: Vector = ZERO
    rpy: Vector = ZERO
    axis: Vector | None = None
    limits: tuple[float, float] = (-3.0, 3.0)
    slides: bool = False
    mass: float = 1.0
    shapes: tuple[Shape, ...] = ()

    @property
    def joint(self) -> str:
        """Name of the joint."""
        return f"{self.name}_joint"


@dataclass(frozen=True)
class SampleArm:
    """An arm: its parts from the base on, and the options of ``oimppi scene robot`` that it needs."""

    name: str
    parts: tuple[Part, ...]
    options: tuple[str, ...] = ()
    effort: float = 40.0
    velocity: float = 2.2


def _text(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:g}" for value in values)


# URDF


def urdf(arm: SampleArm) -> str:
    """The arm as a URDF. A capsule is a cylinder and two spheres, as in the usual descriptions."""
    return f'<robot name="{arm.name}">{"".join(_urdf_part(arm, part) for part in arm.parts)}</robot>'


def _urdf_part(arm: SampleArm, part: Part) -> str:
    inertia = 'ixx="{0}" iyy="{0}" izz="{0}" ixy="0" ixz="0" iyz="0"'.format(f"{0.004 * part.mass:g}")
    inertial = f'<inertial><mass value="{part.mass:g}"/><inertia {inertia}/></inertial>' if part.mass else ""
    made = f'<link name="{part.name}">{inertial}{"".join(map(_urdf_shape, part.shapes))}</link>'
    if not part.parent:
        return made
    kind = "fixed" if part.axis is None else "prismatic" if part.slides else "revolute"
    ends = f'<parent link="{part.parent}"/><child link="{part.name}"/>'
    origin = f'<origin xyz="{_text(part.at)}" rpy="{_text(part.rpy)}"/>'
    moves = ""
    if part.axis is not None:
        lower, upper = part.limits
        limit = f'lower="{lower:g}" upper="{upper:g}" effort="{arm.effort:g}" velocity="{arm.velocity:g}"'
        moves = f'<axis xyz="{_text(part.axis)}"/><limit {limit}/>'
    return f'{made}<joint name="{part.joint}" type="{kind}">{ends}{origin}{moves}</joint>'


def _urdf_shape(shape: Shape) -> str:
    def element(geometry: str, at: Vector) -> str:
        origin = f'<origin xyz="{_text(at)}" rpy="{_text(shape.rpy)}"/>'
        return f"<collision>{origin}<geometry>{geometry}</geometry></collision>"

    if shape.kind == "sphere":
        return element(f'<sphere radius="{shape.size[0]:g}"/>', shape.at)
    if shape.kind == "box":
        return element(f'<box size="{_text(shape.size)}"/>', shape.at)
    radius, length = shape.size
    made = element(f'<cylinder radius="{radius:g}" length="{length:g}"/>', shape.at)
    if shape.kind == "capsule":
        along = _third_axis(shape.rpy)
        for side in (-0.5, 0.5):
            end = (
                shape.at[0] + side * length * along[0],
                shape.at[1] + side * length * along[1],
                shape.at[2] + side * length * along[2],
            )
            made += element(f'<sphere radius="{radius:g}"/>', end)
    return made


def _third_axis(rpy: Vector) -> Vector:
    """The z axis of a frame with these angles."""
    (sr, sp, sy), (cr, cp, cy) = map(math.sin, rpy), map(math.cos, rpy)
    return (cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr)


# MJCF


def mjcf(arm: SampleArm) -> str:
    """The arm as an MJCF file: nested bodies, a default class for the shapes, and an actuator for each joint."""
    moving = [part for part in arm.parts if part.axis is not None]
    force = f"{-arm.effort:g} {arm.effort:g}"
    actuators = "".join(f'<position joint="{part.joint}" kp="100" forcerange="{force}"/>' for part in moving)
    bodies = "".join(_body(arm, part) for part in arm.parts if not part.parent)
    return (
        f'<mujoco model="{arm.name}"><compiler angle="radian" eulerseq="XYZ"/>'
        '<default><default class="solid"><geom group="3" density="0"/></default></default>'
        f'<worldbody><light pos="0 0 2"/><geom type="plane" size="2 2 0.1"/>{bodies}</worldbody>'
        f"<actuator>{actuators}</actuator></mujoco>"
    )


def _body(arm: SampleArm, part: Part) -> str:
    place = f'pos="{_text(part.at)}" euler="{_text(part.rpy)}"'
    inertia = _text((0.004 * part.mass,) * 3)
    made = f'<inertial pos="0 0 0" mass="{part.mass:g}" diaginertia="{inertia}"/>' if part.mass else ""
    if part.axis is not None:
        kind, limits = "slide" if part.slides else "hinge", _text(part.limits)
        made += f'<joint name="{part.joint}" type="{kind}" axis="{_text(part.axis)}" range="{limits}"/>'
    for shape in part.shapes:
        whole = 0 if shape.kind == "box" else 1  # a radius is not halved
        size = _text((*shape.size[:whole], *(value / 2 for value in shape.size[whole:])))
        frame = f'pos="{_text(shape.at)}" euler="{_text(shape.rpy)}"'
        made += f'<geom class="solid" type="{shape.kind}" size="{size}" {frame}/>'
    made += "".join(_body(arm, child) for child in arm.parts if child.parent == part.name)
    return f'<body name="{part.name}" {place}>{made}</body>'


# The arms


def ur5_like() -> SampleArm:
    """Six joints, 0.85 m: its first link is a turret whose shape ends 5 mm above the table."""
    turn = (-6.28, 6.28)

    def tube(radius: float, length: float, at: Vector, rpy: Vector = ZERO) -> tuple[Shape, ...]:
        return (Shape("cylinder", (radius, length), at, rpy),)

    lying = (1.5708, 0.0, 0.0)
    return SampleArm(
        "ur5_like",
        (
            Part("base", mass=4.0, shapes=tube(0.075, 0.04, (0, 0, 0.02))),
            Part(
                "shoulder", "base", (0, 0, 0.0892), axis=(0, 0, 1), limits=turn, mass=3.7,
                shapes=tube(0.075, 0.168, ZERO),
            ),
            Part(
                "upper", "shoulder", (0, 0.1358, 0), (0, 1.5708, 0), (0, 1, 0), turn, mass=8.4,
                shapes=tube(0.055, 0.425, (0, 0, 0.2125)),
            ),
            Part(
                "fore", "upper", (0, -0.1197, 0.425), axis=(0, 1, 0), limits=(-3.14, 3.14), mass=2.3,
                shapes=tube(0.045, 0.392, (0, 0, 0.196)),
            ),
            Part(
                "wrist1", "fore", (0, 0, 0.3922), (0, 1.5708, 0), (0, 1, 0), turn, mass=1.2,
                shapes=tube(0.04, 0.08, (0, 0.05, 0), lying),
            ),
            Part(
                "wrist2", "wrist1", (0, 0.093, 0), axis=(0, 0, 1), limits=turn, mass=1.2,
                shapes=tube(0.04, 0.08, (0, 0, 0.04)),
            ),
            Part(
                "wrist3", "wrist2", (0, 0, 0.0946), axis=(0, 1, 0), limits=turn, mass=0.2,
                shapes=tube(0.035, 0.05, (0, 0.03, 0), lying),
            ),
            Part("tool0", "wrist3", (0, 0.0823, 0), (-1.5708, 0, 0), mass=0.0),
        ),
    )  # fmt: skip


def panda_like() -> SampleArm:
    """Seven joints, 0.85 m, with coarse capsules for self-collision, of which the first reaches into the table."""
    wide = (-2.8973, 2.8973)

    def capsule(radius: float, length: float, at: Vector = ZERO, rpy: Vector = ZERO) -> Shape:
        return Shape("capsule", (radius + 0.03, length), at, rpy)

    x = (0.0, 1.5708, 0.0)
    return SampleArm(
        "panda_like",
        (
            Part("link0", mass=3.0, shapes=(capsule(0.06, 0.03, (-0.075, 0, 0.06), x),)),
            Part(
                "link1", "link0", (0, 0, 0.333), axis=(0, 0, 1), limits=wide, mass=3.0,
                shapes=(capsule(0.06, 0.283, (0, 0, -0.1915)),),
            ),
            Part(
                "link2", "link1", ZERO, (-1.5708, 0, 0), (0, 0, 1), (-1.7628, 1.7628), mass=3.0,
                shapes=(capsule(0.06, 0.12),),
            ),
            Part(
                "link3", "link2", (0, -0.316, 0), (1.5708, 0, 0), (0, 0, 1), wide, mass=3.0,
                shapes=(capsule(0.06, 0.15, (0, 0, -0.145)),),
            ),
            Part(
                "link4", "link3", (0.0825, 0, 0), (1.5708, 0, 0), (0, 0, 1), (-3.0718, -0.0698), mass=3.0,
                shapes=(capsule(0.06, 0.12),),
            ),
            Part(
                "link5", "link4", (-0.0825, 0.384, 0), (-1.5708, 0, 0), (0, 0, 1), wide, mass=3.0,
                shapes=(capsule(0.06, 0.1, (0, 0, -0.26)), capsule(0.025, 0.14, (0, 0.08, -0.13))),
            ),
            Part(
                "link6", "link5", ZERO, (1.5708, 0, 0), (0, 0, 1), (-0.0175, 3.7525), mass=1.5,
                shapes=(capsule(0.05, 0.08, (0, 0, -0.03)),),
            ),
            Part(
                "link7", "link6", (0.088, 0, 0), (1.5708, 0, 0), (0, 0, 1), wide, mass=0.7,
                shapes=(capsule(0.04, 0.14, (0, 0, 0.01)),),
            ),
            Part("link8", "link7", (0, 0, 0.107), mass=0.0),
        ),
        effort=80.0,
    )  # fmt: skip


def widowx_like() -> SampleArm:
    """Six joints, 0.65 m, a gripper, and names with slashes."""

    def rod(x: float, radius: float = 0.025) -> tuple[Shape, ...]:
        return (Shape("capsule", (radius, max(x - 2 * radius, 0.01)), (x / 2, 0, 0), (0, 1.57, 0)),)

    finger = (Shape("box", (0.03, 0.01, 0.02), (0.02, 0, 0)),)
    parts = (
        Part("base_link", mass=0.7, shapes=(Shape("cylinder", (0.06, 0.07), (0, 0, 0.035)),)),
        Part(
            "shoulder_link", "base_link", (0, 0, 0.072), axis=(0, 0, 1), limits=(-3.14, 3.14), mass=0.8,
            shapes=(Shape("cylinder", (0.05, 0.06), (0, 0, 0.01)),),
        ),
        Part(
            "upper_arm_link", "shoulder_link", (0, 0, 0.03865), axis=(0, 1, 0), limits=(-1.88, 1.99), mass=0.8,
            shapes=(Shape("capsule", (0.025, 0.2), (0.02, 0, 0.125)),),
        ),
        Part(
            "upper_forearm_link", "upper_arm_link", (0.04975, 0, 0.25), axis=(0, 1, 0), limits=(-2.15, 1.6), mass=0.6,
            shapes=rod(0.17),
        ),
        Part(
            "lower_forearm_link", "upper_forearm_link", (0.175, 0, 0), axis=(1, 0, 0), limits=(-3.14, 3.14), mass=0.3,
            shapes=rod(0.07),
        ),
        Part(
            "wrist_link", "lower_forearm_link", (0.075, 0, 0), axis=(0, 1, 0), limits=(-1.74, 2.14), mass=0.2,
            shapes=rod(0.06, 0.02),
        ),
        Part(
            "gripper_link", "wrist_link", (0.065, 0, 0), axis=(1, 0, 0), limits=(-3.14, 3.14), mass=0.15,
            shapes=rod(0.04, 0.018),
        ),
        Part("ee_arm_link", "gripper_link", (0.043, 0, 0), mass=0.0),
        Part(
            "left_finger_link", "ee_arm_link", axis=(0, 1, 0), limits=(0.015, 0.037), slides=True, mass=0.02,
            shapes=finger,
        ),
        Part(
            "right_finger_link", "ee_arm_link", axis=(0, -1, 0), limits=(0.015, 0.037), slides=True, mass=0.02,
            shapes=finger,
        ),
    )  # fmt: skip
    named = tuple(
        Part(
            f"wx/{part.name}", part.parent and f"wx/{part.parent}", part.at, part.rpy, part.axis, part.limits,
            part.slides, part.mass, part.shapes,
        )
        for part in parts
    )  # fmt: skip
    return SampleArm("widowx_like", named, ("--flange", "wx/ee_arm_link", "--tool-axis=x"), effort=12.0)


def so101_like() -> SampleArm:
    """Five joints, 0.3 m, whose first axis is beside the base's origin, and a jaw."""
    flat, down = (1.57, 0.0, 0.0), (0.0, 1.57, 0.0)
    return SampleArm(
        "so101_like",
        (
            Part("base", mass=0.15, shapes=(Shape("box", (0.09, 0.08, 0.05), (0, 0, 0.025)),)),
            Part(
                "shoulder", "base", (0.0388, 0, 0.0624), (3.14, 0, 3.14), (0, 0, 1), (-1.92, 1.92), mass=0.1,
                shapes=(Shape("box", (0.05, 0.05, 0.06), (0, 0, -0.02)),),
            ),
            Part(
                "upper_arm", "shoulder", (-0.0304, 0, -0.0542), (-1.57, 0, 0), (0, 0, 1), (-1.75, 1.75), mass=0.1,
                shapes=(Shape("box", (0.03, 0.1, 0.03), (-0.014, 0.055, 0)),),
            ),
            Part(
                "lower_arm", "upper_arm", (-0.028, 0.1126, 0), (0, 0, -1.57), (0, 0, 1), (-1.69, 1.69), mass=0.1,
                shapes=(Shape("box", (0.03, 0.12, 0.03), (0, -0.067, 0)),),
            ),
            Part(
                "wrist", "lower_arm", (-0.0052, -0.1349, 0), ZERO, (0, 0, 1), (-1.66, 1.66), mass=0.08,
                shapes=(Shape("box", (0.03, 0.05, 0.03), (0, -0.025, 0)),),
            ),
            Part(
                "gripper", "wrist", (0, -0.0611, 0), flat, (0, 0, 1), (-2.74, 2.84), mass=0.08,
                shapes=(Shape("box", (0.04, 0.03, 0.04), (0, 0, 0.02)),),
            ),
            Part("jaw", "gripper", (0.02, 0, 0.03), down, (0, 0, 1), (-0.17, 1.75), mass=0.02),
        ),
        ("--flange", "gripper", "--tool-length", "0.12"),
        effort=10.0,
        velocity=10.0,
    )  # fmt: skip


def lite6_like() -> SampleArm:
    """Six joints, 0.44 m."""
    turn, half, whole = (-6.28, 6.28), 1.5708, 3.1416
    return SampleArm(
        "lite6_like",
        (
            Part("link_base", mass=1.6, shapes=(Shape("cylinder", (0.06, 0.16), (0, 0, 0.08)),)),
            Part(
                "link1", "link_base", (0, 0, 0.2435), axis=(0, 0, 1), limits=turn, mass=1.4,
                shapes=(Shape("capsule", (0.055, 0.06), (0, 0, -0.03)),),
            ),
            Part(
                "link2", "link1", ZERO, (half, -half, whole), (0, 0, 1), (-2.618, 2.618), mass=1.0,
                shapes=(Shape("capsule", (0.045, 0.2), (0.1, 0, 0.06), (0, half, 0)),),
            ),
            Part(
                "link3", "link2", (0.2002, 0, 0), (-whole, 0, half), (0, 0, 1), (-0.061, 5.236), mass=0.9,
                shapes=(Shape("capsule", (0.045, 0.06), (0.05, 0, 0), (0, half, 0)),),
            ),
            Part(
                "link4", "link3", (0.087, -0.2276, 0), (half, 0, 0), (0, 0, 1), turn, mass=0.9,
                shapes=(Shape("capsule", (0.035, 0.12), (0, 0, -0.1)),),
            ),
            Part(
                "link5", "link4", ZERO, (half, 0, 0), (0, 0, 1), (-2.16, 2.16), mass=0.7,
                shapes=(Shape("sphere", (0.035,)),),
            ),
            Part(
                "link6", "link5", (0, 0.0625, 0), (-half, 0, 0), (0, 0, 1), turn, mass=0.1,
                shapes=(Shape("cylinder", (0.03, 0.02), (0, 0, -0.01)),),
            ),
        ),
    )  # fmt: skip


ARMS: dict[str, Callable[[], SampleArm]] = {
    "ur5_like": ur5_like,
    "panda_like": panda_like,
    "widowx_like": widowx_like,
    "so101_like": so101_like,
    "lite6_like": lite6_like,
}
FORMATS: dict[str, Callable[[SampleArm], str]] = {"urdf": urdf, "xml": mjcf}


def write_arm(folder: Path, name: str, form: str) -> tuple[Path, list[str]]:
    """Write an arm of :data:`ARMS` in one of :data:`FORMATS`; returns its file and the options that it needs."""
    arm = ARMS[name]()
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{name}.{form}"
    file.write_text(FORMATS[form](arm))
    return file, list(arm.options)
