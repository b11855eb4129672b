"""The objects of the shipped scenes."""

from __future__ import annotations

import numpy as np

from oimppi_warp.authoring.thing import Box, Disc, Thing, stroke

PEN = 0.022
WOOD, BLUE, RED, GREEN = (0.72, 0.45, 0.2), (0.1, 0.22, 0.55), (0.62, 0.09, 0.08), (0.12, 0.42, 0.2)
LETTER = 0.103  # cap height
TOP = LETTER / 2 - PEN / 2
SIDE = 0.042 - PEN / 2

T_BLOCK = Thing(
    "t_block",
    "TBlock",
    "T block: bar 0.20 x 0.05 x 0.05 m, stem 0.05 x 0.10 x 0.05 m; the frame is at the bar's centre",
    (Box((0.0, 0.0), (0.20, 0.05)), Box((0.0, -0.075), (0.05, 0.10))),
    0.05,
    0.5,
    0.4,
    (0.16, 0.36, 0.62),
)
LAB_T = Thing(
    "lab_t",
    "LabT",
    "The laboratory's small T: bar 0.089 x 0.0198 m, stem 0.0198 x 0.0794 m, 0.060 m high; frame at the bar's centre",
    (Box((0.0, 0.0), (0.089, 0.0198)), Box((0.0, -0.0496), (0.0198, 0.0794))),
    0.060,
    0.1,
    0.3,
    WOOD,
)
SOUP_CAN = Thing(
    "soup_can",
    "SoupCan",
    "Tomato soup can, the size and weight of YCB object 005",
    (Disc(0.033),),
    0.101,
    0.349,
    0.4,
    RED,
)
LETTER_I = Thing("letter_i", "LetterI", "The letter I", (Box((0.0, 0.0), (0.03, LETTER)),), 0.05, 0.1, 0.4, BLUE)
LETTER_S = Thing(
    "letter_s",
    "LetterS",
    "The letter S",
    tuple(stroke([(SIDE, TOP), (-SIDE, TOP), (-SIDE, 0), (SIDE, 0), (SIDE, -TOP), (-SIDE, -TOP)], PEN, 0.012)),
    0.05,
    0.2,
    0.4,
    GREEN,
)
LETTER_O = Thing(
    "letter_o",
    "LetterO",
    "The letter O",
    tuple(stroke([(SIDE, TOP), (-SIDE, TOP), (-SIDE, -TOP), (SIDE, -TOP)], PEN, 0.018, closed=True)),
    0.05,
    0.2,
    0.4,
    BLUE,
)
_BELLY = -0.008  # height of the middle of the R's lower bar
_STEM, _RIGHT = -SIDE, SIDE
LETTER_R = Thing(
    "letter_r",
    "LetterR",
    "The letter R",
    (
        Box((_STEM, 0.0), (PEN, LETTER)),
        *stroke([(_STEM + PEN / 2, _BELLY), (_RIGHT, _BELLY), (_RIGHT, TOP), (_STEM + PEN / 2, TOP)], PEN, 0.012),
        np.array([(0.018, -LETTER / 2), (0.044, -LETTER / 2), (0.018, _BELLY - PEN / 2), (-0.008, _BELLY - PEN / 2)]),
    ),
    0.05,
    0.2,
    0.4,
    BLUE,
)
THINGS = (T_BLOCK, LAB_T, SOUP_CAN, LETTER_I, LETTER_R, LETTER_O, LETTER_S)
