"""The capital letters A to Z as strokes of a broad pen: 22 mm wide, 103 mm high, outer corners of bends cut off."""

from __future__ import annotations

from functools import cache

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from oimppi_warp.authoring.objects.flat_object import Box, Point, stroke

STROKE_WIDTH, CAP_HEIGHT = 0.022, 0.103
"""Width of the pen and height of the letters [m]."""

Line = tuple[list[Point], float]
"""The pen's path [m], and how much is cut off the outer corners of its bends [m]."""

_UP, _DOWN = CAP_HEIGHT / 2, -CAP_HEIGHT / 2
# Pen positions along the upper and the lower edge.
_T, _B = CAP_HEIGHT / 2 - STROKE_WIDTH / 2, STROKE_WIDTH / 2 - CAP_HEIGHT / 2
_L, _R = STROKE_WIDTH / 2 - 0.042, 0.042 - STROKE_WIDTH / 2  # along the left and the right edge

_STEM: Line = ([(_L, _UP), (_L, _DOWN)], 0.0)
_OTHER_STEM: Line = ([(_R, _UP), (_R, _DOWN)], 0.0)


def _bar(y: float, left: float, right: float) -> Line:
    return [(left, y), (right, y)], 0.0


def _slant(a: Point, b: Point) -> Line:
    """Returns a slanted line extended beyond both ends; the letter's box trims it level."""
    along = np.subtract(b, a) / np.linalg.norm(np.subtract(b, a)) * STROKE_WIDTH
    (ax, ay), (bx, by) = np.subtract(a, along), np.add(b, along)
    return [(float(ax), float(ay)), (float(bx), float(by))], 0.0


# Half the width of the letter's box [m], and its lines.
_LINES: dict[str, tuple[float, list[Line]]] = {
    "A": (
        0.047,
        [_slant((-0.034, _DOWN), (-0.004, _UP)), _slant((0.034, _DOWN), (0.004, _UP)), _bar(-0.018, -0.02, 0.02)],
    ),
    "B": (
        0.042,
        [
            ([(_L, _T), (0.026, _T), (0.026, 0.0), (_L, 0.0)], 0.010),
            ([(_L, 0.0), (_R, 0.0), (_R, _B), (_L, _B)], 0.012),
            _STEM,
        ],
    ),
    "C": (0.042, [([(0.040, _T), (_L, _T), (_L, _B), (0.040, _B)], 0.018)]),
    "D": (0.042, [([(_L, _B), (_R, _B), (_R, _T), (_L, _T)], 0.022), _STEM]),
    "E": (0.042, [_STEM, _bar(_T, _L, 0.036), _bar(0.0, _L, 0.028), _bar(_B, _L, 0.036)]),
    "F": (0.042, [_STEM, _bar(_T, _L, 0.036), _bar(-0.004, _L, 0.028)]),
    "G": (0.042, [([(0.040, _T), (_L, _T), (_L, _B), (_R, _B), (_R, -0.004), (0.002, -0.004)], 0.016)]),
    "H": (0.042, [_STEM, _OTHER_STEM, _bar(0.0, _L, _R)]),
    "J": (0.042, [([(0.024, _UP), (0.024, _B), (_L, _B), (_L, -0.014)], 0.016)]),
    "K": (0.044, [_STEM, _slant((-0.012, -0.004), (0.028, _UP)), ([(-0.006, 0.006), (0.038, -0.066)], 0.0)]),
    "L": (0.042, [_STEM, _bar(_B, _L, 0.036)]),
    "M": (
        0.051,
        [
            ([(-0.040, _UP), (-0.040, _DOWN)], 0.0),
            ([(0.040, _UP), (0.040, _DOWN)], 0.0),
            ([(-0.052, 0.060), (0.0, -0.012)], 0.0),
            ([(0.052, 0.060), (0.0, -0.012)], 0.0),
        ],
    ),
    "N": (0.042, [_STEM, _OTHER_STEM, ([(-0.034, 0.046), (0.034, -0.046)], 0.0)]),
    "P": (0.042, [_STEM, ([(_L, -0.006), (_R, -0.006), (_R, _T), (_L, _T)], 0.016)]),
    "Q": (0.042, [([(0.002, -0.016), (0.050, -0.058)], 0.0)]),  # the tail of an O
    "T": (0.044, [_bar(_T, -0.044, 0.044), ([(0.0, _T), (0.0, _DOWN)], 0.0)]),
    "U": (0.042, [([(_L, _UP), (_L, _B), (_R, _B), (_R, _UP)], 0.020)]),
    "V": (0.047, [_slant((-0.034, _UP), (-0.004, _DOWN)), _slant((0.034, _UP), (0.004, _DOWN))]),
    "W": (
        0.064,
        [
            _slant((-0.052, _UP), (-0.028, _DOWN)),
            _slant((-0.004, _UP), (-0.024, _DOWN)),
            _slant((0.004, _UP), (0.024, _DOWN)),
            _slant((0.052, _UP), (0.028, _DOWN)),
        ],
    ),
    "X": (0.047, [_slant((-0.033, _UP), (0.033, _DOWN)), _slant((0.033, _UP), (-0.033, _DOWN))]),
    "Y": (
        0.047,
        [
            ([(-0.047, 0.071), (0.0, -0.004)], 0.0),
            ([(0.047, 0.071), (0.0, -0.004)], 0.0),
            ([(0.0, 0.002), (0.0, _DOWN)], 0.0),
        ],
    ),
    "Z": (0.042, [_bar(_T, -0.040, 0.042), _bar(_B, -0.042, 0.040), ([(-0.030, _B), (0.030, _T)], 0.0)]),
}

_BELLY = -0.008  # height of the middle of the R's lower bar

SIMPLE: dict[str, tuple[Box | np.ndarray, ...]] = {
    "I": (Box((0.0, 0.0), (0.03, CAP_HEIGHT)),),
    "O": tuple(stroke([(_R, _T), (_L, _T), (_L, _B), (_R, _B)], STROKE_WIDTH, 0.018, closed=True)),
    "R": (
        Box((_L, 0.0), (STROKE_WIDTH, CAP_HEIGHT)),
        *stroke(
            [(_L + STROKE_WIDTH / 2, _BELLY), (_R, _BELLY), (_R, _T), (_L + STROKE_WIDTH / 2, _T)], STROKE_WIDTH, 0.012
        ),
        np.array(
            [(0.018, _DOWN), (0.044, _DOWN), (0.018, _BELLY - STROKE_WIDTH / 2), (-0.008, _BELLY - STROKE_WIDTH / 2)]
        ),
    ),
    "S": tuple(stroke([(_R, _T), (_L, _T), (_L, 0), (_R, 0), (_R, _B), (_L, _B)], STROKE_WIDTH, 0.012)),
}
"""Letters whose strokes are already convex pieces that do not overlap."""


@cache
def outline_of(letter: str) -> BaseGeometry:
    """Returns the outline of a capital letter about the middle of its box [m]."""
    if letter in SIMPLE:
        corners = [piece.polygon() if isinstance(piece, Box) else piece for piece in SIMPLE[letter]]
        return shapely.union_all([shapely.Polygon(each) for each in corners], grid_size=1e-6)
    half, lines = _LINES[letter]
    strokes = [piece for points, chamfer in lines for piece in stroke(points, STROKE_WIDTH, chamfer)]
    pieces: list[BaseGeometry] = [shapely.Polygon(piece) for piece in strokes]
    if letter == "Q":
        pieces.append(outline_of("O"))
    return shapely.intersection(shapely.union_all(pieces), shapely.box(-half, _DOWN, half, _UP))
