"""Shared parts of all figures: style, colours, and shapes seen from above."""

from __future__ import annotations

import io
from collections.abc import Iterable
from itertools import cycle
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline

INK, FAINT, WALL, GOAL, START = "#26323a", "#b8c2c9", "#5d6a73", "#c2410c", "#3b0f70"
METHOD_COLORS = {"mppi": "#8592a6", "cloi": "#0f766e", "soi": "#d97706"}
"""Colours of the paper's methods, in all figures."""
FURTHER_COLORS = ("#4f46a5", "#a21caf", "#0284c7", "#65a30d", "#92400e", "#be123c")
"""Colours of all other methods, assigned in order."""

STYLE: Any = {
    "font.size": 9,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.titlelocation": "left",
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e9edf0",
    "grid.linewidth": 0.8,
    "legend.frameon": False,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "svg.hashsalt": "oimppi",  # makes files reproducible
}


def method_colors(methods: Iterable[str]) -> dict[str, str]:
    """Returns a colour for each method: fixed for the paper's, in order from :data:`FURTHER_COLORS` for all others."""
    further = cycle(FURTHER_COLORS)
    return {name: METHOD_COLORS.get(name) or next(further) for name in methods}


def rendered(figure: Figure, *, kind: str = "png", dpi: int = 150) -> bytes:
    """Renders a figure, and returns the content of a ``png`` or ``svg`` file."""
    picture = io.BytesIO()
    with matplotlib.rc_context(STYLE):
        figure.savefig(picture, format=kind, dpi=dpi, metadata={"Date": None} if kind == "svg" else None)
    return picture.getvalue()


def add_rings(axes: Axes, rings: Iterable[np.ndarray], **style: Any) -> None:
    """Adds closed rings, shape [n, 2] [m] each, as one patch."""
    paths = [Outline(np.asarray(ring), closed=True) for ring in rings]
    if paths:
        axes.add_patch(PathPatch(Outline.make_compound_path(*paths), **style))
