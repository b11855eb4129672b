"""A fictitious seven-joint arm with a stick; shoulder, elbow and wrist have no lateral offsets.

Its joint axes are alternately along the limb and perpendicular to it; fully extended, the arm is upright. It is not a
real product.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from scene_skin import DARK, METAL, SHELL, Part, Rings, drum, write_parts

from oimppi_warp.authoring.robots import arm_usd
from oimppi_warp.authoring.robots.arm import NOT_TURNED, Arm, ArmJoint, ArmLink, Stick, capsule_between
from oimppi_warp.scene import Collider

_HALF = math.sqrt(0.5)
ACROSS, ALONG = (-_HALF, 0.0, 0.0, _HALF), (_HALF, 0.0, 0.0, _HALF)  # rotate along to across the limb, and back

JOINTS = [
    # position in the parent's frame, rotation, symmetric position limit, effort limit
    ((0.0, 0.0, 0.16), NOT_TURNED, 2.9, 80.0),
    ((0.0, 0.0, 0.14), ACROSS, 2.0, 80.0),
    ((0.0, -0.20, 0.0), ALONG, 2.9, 40.0),
    ((0.0, 0.0, 0.19), ACROSS, 2.4, 40.0),
    ((0.0, -0.20, 0.0), ALONG, 2.9, 40.0),
    ((0.0, 0.0, 0.17), ACROSS, 2.1, 20.0),
    ((0.0, -0.06, 0.0), ALONG, 3.05, 20.0),
]
VELOCITY_LIMIT = 2.5  # rad/s
FLANGE = 0.04  # distance from the last joint, along its axis
STICK = Stick(length=0.17, position=(0.0, 0.0, FLANGE))

# Tool down, tip at (0.300, -0.200, 0.050).
START = (-0.588, 0.4878, 0.0, 2.1526, 0.0, 0.5011, 0.0)

LINKS = [
    # mass, and capsules (ax ay az bx by bz radius): first the limb, then the drum of the joint; base first
    (3.0, [(0.0, 0.0, 0.06, 0.0, 0.0, 0.10, 0.075)]),
    (2.6, [(0.0, 0.0, 0.02, 0.0, 0.0, 0.13, 0.065), (0.0, -0.05, 0.14, 0.0, 0.05, 0.14, 0.062)]),
    (2.4, [(0.0, -0.03, 0.0, 0.0, -0.18, 0.0, 0.052), (0.0, 0.0, -0.05, 0.0, 0.0, 0.05, 0.062)]),
    (1.9, [(0.0, 0.0, 0.02, 0.0, 0.0, 0.17, 0.048), (0.0, -0.04, 0.19, 0.0, 0.04, 0.19, 0.052)]),
    (1.7, [(0.0, -0.03, 0.0, 0.0, -0.18, 0.0, 0.043), (0.0, 0.0, -0.04, 0.0, 0.0, 0.04, 0.052)]),
    (1.2, [(0.0, 0.0, 0.02, 0.0, 0.0, 0.15, 0.040), (0.0, -0.035, 0.17, 0.0, 0.035, 0.17, 0.042)]),
    (0.9, [(0.0, -0.02, 0.0, 0.0, -0.05, 0.0, 0.036), (0.0, 0.0, -0.035, 0.0, 0.0, 0.035, 0.042)]),
    (0.3, [(0.0, 0.0, 0.005, 0.0, 0.0, 0.015, 0.030)]),
]
FOOT_RADIUS, FOOT_HEIGHT = 0.09, 0.06

_FOOT = Collider(
    "foot", "cylinder", np.array([0.0, 0.0, FOOT_HEIGHT / 2, 0.0, 0.0, 0.0, 1.0]), (FOOT_RADIUS, FOOT_HEIGHT / 2)
)


def _link(index: int, *more: Collider) -> ArmLink:
    """Returns a link whose mass is distributed evenly over its first capsule, treated as a cylinder."""
    mass, capsules = LINKS[index]
    *ends, radius = capsules[0]
    a, b = np.array(ends[:3]), np.array(ends[3:])
    length = float(np.linalg.norm(b - a)) + radius
    axis = (b - a) / np.linalg.norm(b - a)
    across, along = mass * (3.0 * radius**2 + length**2) / 12.0, mass * radius**2 / 2.0
    inertia = across * np.eye(3) + (along - across) * np.outer(axis, axis)
    shapes = tuple(
        capsule_between(f"collider{number}", each[:3], each[3:6], each[6]) for number, each in enumerate(capsules)
    )
    return ArmLink(mass, (a + b) / 2, inertia, (*shapes, *more))


ARM7 = Arm(
    name="Arm7",
    doc="An arm of seven joints with a stick for pushing. Written by tools/make_scenes.py; do not edit by hand.",
    base=_link(0, _FOOT),
    joints=tuple(
        ArmJoint(position, turn, -limit, limit, effort, VELOCITY_LIMIT) for position, turn, limit, effort in JOINTS
    ),
    links=tuple(_link(index) for index in range(1, 8)),
    stick=STICK,
    start=START,
)


def write(folder: Path) -> None:
    """Write the robot's files."""
    parts: dict[str, list[Part]] = {f"link{index}": _parts(index) for index in range(1, 8)}
    parts["base"] = [
        ("plate", drum((0, 0, 0), (0, 0, 0.012), FOOT_RADIUS, fillet=0.002), METAL),
        ("column", drum((0, 0, 0.012), (0, 0, 0.152), 0.078, 0.066), SHELL),
        ("collar", drum((0, 0, 0.150), (0, 0, 0.162), 0.062, fillet=0.001), DARK),
    ]
    write_parts(folder / "arm7_skin.usda", "Arm7", "the arm of seven joints", parts, STICK.length, STICK.radius).Save()
    arm_usd.write(ARM7, folder / "arm7.usda", skin="arm7_skin.usda")


def _parts(index: int) -> list[Part]:
    """Returns a sleeve for the limb, and a drum with dark caps at both ends for the joint."""
    limb, *joints = LINKS[index][1]
    parts = [("sleeve", _around(limb, 0.6, limb[6]), SHELL)]
    for joint in joints:
        parts += [("drum", _around(joint, 0.5, joint[6]), SHELL), ("caps", _around(joint, 0.62, 0.8 * joint[6]), DARK)]
    return parts


def _around(capsule: tuple[float, ...], beyond: float, radius: float) -> Rings:
    """Returns a rounded cylinder that extends beyond the ends of a capsule's axis by a fraction of its radius."""
    a, b = np.array(capsule[:3]), np.array(capsule[3:6])
    further = beyond * capsule[6] * (b - a) / np.linalg.norm(b - a)
    return drum(a - further, b + further, radius, fillet=0.3 * radius)
