"""The xArm6 with its pushing stick, as a USD articulation.

Sources: UFACTORY's published description (`xarm_ros2`) for the chain, limits and inertials; the collision capsules are
least-squares fits to the vendor's surfaces (mean error 2-6 mm). Metres, radians, kilograms; joint axes are local +z.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import scene_skin

from oimppi_warp.authoring.robots import arm_usd
from oimppi_warp.authoring.robots.arm import Arm, ArmJoint, ArmLink, Stick, capsule_between
from oimppi_warp.scene import Collider

HALF_PI = math.pi / 2

JOINTS = [
    # xyz in the parent's frame, roll, lower and upper limit, effort limit
    ((0.0, 0.0, 0.267), 0.0, -2 * math.pi, 2 * math.pi, 50.0),
    ((0.0, 0.0, 0.0), -HALF_PI, -2.059, 2.0944, 50.0),
    ((0.0535, -0.2845, 0.0), 0.0, -3.927, 0.19198, 32.0),
    ((0.0775, 0.3425, 0.0), -HALF_PI, -2 * math.pi, 2 * math.pi, 32.0),
    ((0.0, 0.0, 0.0), HALF_PI, -1.69297, math.pi, 32.0),
    ((0.076, 0.097, 0.0), -HALF_PI, -2 * math.pi, 2 * math.pi, 20.0),
]

INERTIALS = [
    # mass, centre of mass, (ixx, iyy, izz, ixy, ixz, iyz) in the link's frame; base first
    (2.7, (0, 0, 0.09103), (0.00494875, 0.00494174, 0.002219, -3.5e-6, 1.25e-5, 1.67e-6)),
    (2.3814, (0.00022, 0.02951, -0.0124), (0.0058562, 0.0050316, 0.003536652, -1.79e-5, 3.55e-6, -0.000888336)),
    (2.2675, (0.03881, -0.22783, 0.03496), (0.028315776, 0.0058, 0.0273447, 0.005, 0.00066546, -0.0045741)),
    (1.875, (0.07041, 0.11631, 0.0107), (0.0063483, 0.00379758, 0.00595768, -0.0015397, 0.00096858, 0.00186567)),
    (1.3192, (-0.00018, 0.01798, -0.02291), (0.004896, 0.00445694, 0.00134332, -6.925e-6, -1.418e-5, -0.00023186)),
    (1.33854, (0.0651, 0.03096, 0.00315), (0.00146378, 0.00184192, 0.002333524, -0.000450624, 2.84306e-4, 1.30866e-4)),
    (0.17, (0, -0.00677, -0.01098), (9.3e-5, 5.87e-5, 0.000132, 0, 0, -3.6e-6)),
]

CAPSULES = [
    # ax ay az bx by bz radius in the link's frame; base first
    [(0.0007, 0.0004, 0.0204, -0.0001, -0.0003, 0.125, 0.0482)],
    [
        (-0.0006, -0.0024, -0.0859, 0.0004, -0.0148, 0.0023, 0.0454),
        (0.0001, -0.0115, -0.0013, -0.0003, 0.0431, 0.0001, 0.0485),
    ],
    [
        (0.0019, 0.013, 0.0911, -0.0125, -0.1103, 0.0869, 0.034),
        (0.0024, -0.1099, 0.0767, -0.0006, -0.1075, 0.0017, 0.0454),
        (-0.0012, -0.1222, 0.0102, 0.0025, -0.2359, -0.0135, 0.0411),
        (0.0433, -0.2844, -0.0325, 0.0552, -0.2849, 0.038, 0.0419),
    ],
    [
        (-0.0052, -0.0102, 0.0823, 0.039, 0.0494, 0.0935, 0.0308),
        (0.0781, 0.0836, 0.0118, 0.0773, 0.0824, 0.0684, 0.0423),
        (0.0779, 0.0837, -0.0001, 0.0775, 0.1411, 0.0004, 0.0425),
    ],
    [
        (0.0018, 0.0062, -0.1481, -0.0018, -0.0025, -0.1516, 0.0401),
        (0.0012, 0.0452, -0.1094, 0.0, 0.0704, -0.062, 0.026),
        (-0.0002, 0.0543, -0.0021, -0.0003, 0.0294, 0.0003, 0.0382),
    ],
    [
        (-0.0029, -0.0008, 0.0219, 0.0035, 0.0019, 0.0207, 0.0377),
        (0.0607, 0.0213, 0.0094, 0.0381, -0.0071, 0.0219, 0.0264),
        (0.0759, -0.0058, 0.0002, 0.0758, 0.0448, -0.0001, 0.0381),
    ],
    [(-0.0028, 0.0081, -0.0175, 0.0028, -0.0101, -0.0169, 0.0299)],
]

VELOCITY_LIMIT = 3.14  # rad/s
STICK = Stick(length=0.175)
BASE_RADIUS, BASE_HEIGHT = 0.09, 0.06  # the base with its connector, which objects on the table must avoid

# Tool down, tip at (0.300, -0.200, 0.050).
START = (-0.588, -0.11, -0.51, 0.0, 0.62, 0.0)

_FOOT = Collider(
    "foot", "cylinder", np.array([0.0, 0.0, BASE_HEIGHT / 2, 0.0, 0.0, 0.0, 1.0]), (BASE_RADIUS, BASE_HEIGHT / 2)
)


def _link(index: int, *more: Collider) -> ArmLink:
    mass, center, (ixx, iyy, izz, ixy, ixz, iyz) = INERTIALS[index]
    inertia = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
    capsules = tuple(
        capsule_between(f"collider{number}", (ax, ay, az), (bx, by, bz), radius)
        for number, (ax, ay, az, bx, by, bz, radius) in enumerate(CAPSULES[index])
    )
    return ArmLink(mass, center, inertia, (*capsules, *more))


XARM6 = Arm(
    name="XArm6",
    doc="UFACTORY xArm6 with a stick for pushing. Written by tools/make_scenes.py; do not edit by hand.",
    base=_link(0, _FOOT),
    joints=tuple(
        ArmJoint(xyz, (math.sin(roll / 2), 0.0, 0.0, math.cos(roll / 2)), lower, upper, effort, VELOCITY_LIMIT)
        for xyz, roll, lower, upper, effort in JOINTS
    ),
    links=tuple(_link(index) for index in range(1, 7)),
    stick=STICK,
    start=START,
)


def write(folder: Path) -> None:
    """Write the robot's files."""
    scene_skin.write(folder / "xarm6_skin.usda", STICK.length, STICK.radius)
    arm_usd.write(XARM6, folder / "xarm6.usda", skin="xarm6_skin.usda")
