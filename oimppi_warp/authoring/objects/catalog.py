"""The objects of the shipped scenes, by name."""

from __future__ import annotations

from oimppi_warp.authoring.letters.letters import GREEN, letter
from oimppi_warp.authoring.objects.flat_object import Box, Disc, FlatObject
from oimppi_warp.authoring.objects.outlines import WOOD
from oimppi_warp.authoring.prims import Color

RED: Color = (0.62, 0.09, 0.08)

T_BLOCK = FlatObject(
    "t_block",
    "TBlock",
    "T block: bar 0.20 x 0.05 x 0.05 m, stem 0.05 x 0.10 x 0.05 m; the frame is at the bar's centre",
    (Box((0.0, 0.0), (0.20, 0.05)), Box((0.0, -0.075), (0.05, 0.10))),
    0.05,
    0.5,
    0.4,
    (0.16, 0.36, 0.62),
)
LAB_T = FlatObject(
    "lab_t",
    "LabT",
    "The laboratory's small T: bar 0.089 x 0.0198 m, stem 0.0198 x 0.0794 m, 0.060 m high; frame at the bar's centre",
    (Box((0.0, 0.0), (0.089, 0.0198)), Box((0.0, -0.0496), (0.0198, 0.0794))),
    0.060,
    0.1,
    0.3,
    WOOD,
)
SOUP_CAN = FlatObject(
    "soup_can",
    "SoupCan",
    "Tomato soup can, the size and weight of YCB object 005",
    (Disc(0.033),),
    0.101,
    0.349,
    0.4,
    RED,
)
LETTER_I = letter("I", mass=0.1)
LETTER_R = letter("R", mass=0.2)
LETTER_O = letter("O", mass=0.2)
LETTER_S = letter("S", mass=0.2, color=GREEN)

OBJECTS = (T_BLOCK, LAB_T, SOUP_CAN, LETTER_I, LETTER_R, LETTER_O, LETTER_S)
