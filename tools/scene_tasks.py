"""The shipped tasks.

The dimensions of task01 to task05 are those of the paper's simulation scenes, with the origin at the arm's base; those
of the lab scenes follow its hardware tasks.
"""

from __future__ import annotations

import math

from oimppi_warp.authoring.objects.catalog import LETTER_I, LETTER_O, LETTER_R, LETTER_S, SOUP_CAN, T_BLOCK
from oimppi_warp.authoring.task import Block, StaticObject, Task

YELLOW, CREAM, NAVY = (0.75, 0.55, 0.08), (0.72, 0.66, 0.5), (0.08, 0.12, 0.3)
NO_YAW = math.inf

# Tool down on the object's side of the laboratory's obstacle, tip at (0.260, 0.120, 0.050).
LAB_START = (0.4324, -0.3799, -0.2578, 0.0, 0.6377, 0.0)

_T = (T_BLOCK, (0.30, -0.45, 0.0), (0.50, 0.30, math.pi))
_CUBE = Block("Cube", (0.50, 0.05), (0.10, 0.10, 0.10))
_LAB = (SOUP_CAN, (0.381, 0.343, 0.0), (0.381, -0.305, 0.0))
_LAB_TOLERANCES = ((0.1, NO_YAW), (0.05, NO_YAW), LAB_START)


def _shelves(gap: float) -> tuple[Block, Block]:
    x = gap / 2 + 0.10
    size = (0.20, 0.25, 0.20)
    return Block("Left", (round(0.50 - x, 3), 0.05), size), Block("Right", (round(0.50 + x, 3), 0.05), size)


TASKS = (
    Task("task01", "Push the T across an open table and turn it round", *_T),
    Task("task02", "Push the T around a cube and turn it round", *_T, (_CUBE,)),
    Task("task03", "Push the T through or around two boxes with a gap of 0.20 m", *_T, _shelves(0.20)),
    Task("task03_wide", "Push the T through or around two boxes with a gap of 0.30 m", *_T, _shelves(0.30)),
    Task(
        "task04",
        "Push the T through clutter",
        *_T,
        (
            _CUBE,
            Block("SugarBox", (0.50, -0.20), (0.175, 0.095, 0.06), CREAM),
            Block("SpamCan", (0.167, 0.273), (0.10, 0.06, 0.083), NAVY),
            Block("MustardBottle", (0.79, 0.08), (0.095, 0.06, 0.19), YELLOW),
        ),
    ),
    Task(
        "task05",
        "Push the S to its place in the word IROS",
        LETTER_S,
        (0.30, -0.40, 0.0),
        (0.50, 0.15, -math.pi / 2),
        tuple(
            StaticObject(f"Letter{letter}", obj, (0.50, y, -math.pi / 2))
            for letter, obj, y in (("I", LETTER_I, 0.60), ("R", LETTER_R, 0.45), ("O", LETTER_O, 0.30))
        ),
    ),
    Task("arm7_01", "Push the T across an open table with an arm of seven joints", *_T, robot="arm7"),
    Task("point01", "Push the T across an open table with a point robot", *_T, robot="point"),
    Task("lab01", "Push the soup can across the table, as in the laboratory", *_LAB, (), *_LAB_TOLERANCES),
    Task(
        "lab02",
        "Push the soup can around a box, as in the laboratory",
        *_LAB,
        (Block("Box", (0.381, 0.02), (0.108, 0.089, 0.10)),),
        *_LAB_TOLERANCES,
    ),
)
