"""Cost terms as somebody outside the package would write them.

No ``from __future__ import annotations`` here: Warp reads the annotations.
"""

import warp as wp

from oimppi_warp.kernels.costs.terms import Stage

SAFE = 0.05
"""Height of the tip above which it costs [m]."""
LINE = 0.12
"""The tip's y on the line that it should keep to [m]."""


@wp.func
def high(s: Stage) -> float:
    """Squared height of the tip above ``SAFE`` [m^2]."""
    above = wp.max(s.tip[2] - SAFE, 0.0)
    return above * above


@wp.func
def off_line(s: Stage) -> float:
    """Distance of the tip to the line y = ``LINE`` [m]."""
    return wp.abs(s.tip[1] - LINE)


@wp.func
def broken(s: Stage) -> float:
    """Not a number wherever the tip is."""
    return wp.sqrt(-1.0 - s.tip[2] * s.tip[2])


@wp.func
def two_arguments(s: Stage, more: float) -> float:
    """Not a cost term."""
    return s.tip[2] + more
