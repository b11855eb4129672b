"""Sheets to print: the tag of an object with the outline to cut along, and the board for calibration, true to scale."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import shapely

from oimppi_warp.errors import ConfigError
from oimppi_warp.perception.board import Board
from oimppi_warp.perception.opencv import load_opencv
from oimppi_warp.perception.tags import FAMILIES, Tag, TagLayout, dictionary, top_outline
from oimppi_warp.scene import PushedObject

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Paper = Literal["a4", "letter"]
PAPERS: dict[Paper, tuple[float, float]] = {"a4": (297.0, 210.0), "letter": (279.4, 215.9)}
"""Width and height of the papers, landscape [mm]."""
_INCH = 25.4
_EDGE = 10.0
"""Width of the margin that printers leave empty [mm]."""
_FOOT, _HEAD = 22.0, 14.0
"""Heights for the ruler and for the title [mm]."""
_RULER = 100
"""Length of the ruler [mm]."""
_PIXELS = 20
"""Pixels per module in the file."""


def object_page(pushed: PushedObject, layout: TagLayout, title: str, *, paper: Paper = "a4") -> Figure:
    """Returns a page with the tags of an object, and the outline of its top to cut along.

    Args:
        pushed: The object.
        layout: Its tags.
        title: Name of the object.
        paper: Size of the paper.

    Raises:
        ConfigError: The object is larger than the paper.
    """
    width, height = PAPERS[paper]
    top = top_outline(pushed)
    parts = [shapely.box(*_bounds(tag)) for tag in layout.tags]
    low_x, low_y, high_x, high_y = (1e3 * value for value in shapely.union_all([top, *parts]).bounds)
    if high_x - low_x > width - 2.0 * _EDGE or high_y - low_y > height - _FOOT - _HEAD:
        raise ConfigError(
            f"the top of the object, {high_x - low_x:.0f} mm by {high_y - low_y:.0f} mm, does not fit on the paper\n"
            "  to do:   print a tag from the sheet of a smaller object, measure where it is on the object, and write "
            "that to a file for --tags (docs/perception.md)"
        )
    axes = _page(paper, f"{title}: {layout.family} " + ", ".join(f"{tag.id}" for tag in layout.tags))
    origin = np.array([width - low_x - high_x, height + _FOOT - _HEAD - low_y - high_y]) / 2.0
    for part in shapely.get_parts(top):
        for ring in (part.exterior, *part.interiors):
            x, y = (1e3 * np.asarray(ring.coords)[:, :2] + origin).T
            axes.plot(x, y, color="0.6", linewidth=0.4)
    for tag in layout.tags:
        _draw_tag(axes, layout.family, tag, origin)
    reach = 1e3 * max(tag.position[0] + tag.size / 2.0 for tag in layout.tags)
    x, y = origin[0] + max(high_x, reach) + 8.0, origin[1] + 1e3 * layout.tags[0].position[1]
    axes.annotate("", (x, y), (x - 7.0, y), arrowprops={"arrowstyle": "->"})
    axes.text(x + 1.0, y, "x", fontsize=8, va="center")
    _note(
        axes, "Cut along the grey line and glue it on the top: without gaps, flat, the arrow along the object's x axis."
    )
    return _figure(axes)


def board_page(board: Board, *, paper: Paper = "a4") -> Figure:
    """Returns a page with the board for calibration.

    Args:
        board: The board.
        paper: Size of the paper.

    Raises:
        ConfigError: The board is larger than the paper.
    """
    width, height = PAPERS[paper]
    across, up = (1e3 * length for length in board.size)
    if across > width - 2.0 * _EDGE or up > height - _FOOT - _HEAD:
        raise ConfigError(
            f"the board, {across:.0f} mm by {up:.0f} mm, does not fit on the paper\n"
            f"  allowed: {width - 2.0 * _EDGE:.0f} mm by {height - _FOOT - _HEAD:.0f} mm"
        )
    axes = _page(paper, f"Board of {board.columns} x {board.rows} squares of {1e3 * board.square:g} mm")
    left, bottom = (width - across) / 2.0, _FOOT + (height - _FOOT - _HEAD - up) / 2.0
    extent = (left, left + across, bottom, bottom + up)
    axes.imshow(board.image(_PIXELS * 8), cmap="gray", vmin=0, vmax=255, extent=extent, interpolation="none")
    for name, x, y in (("x", 1.0, 0.0), ("y", 0.0, 1.0)):
        start = left - 2.5 * y, bottom - 2.5 * x
        axes.annotate("", (start[0] + 9.0 * x, start[1] + 9.0 * y), start, arrowprops={"arrowstyle": "->"})
        axes.text(start[0] + 11.0 * x, start[1] + 11.0 * y, name, fontsize=8, va="center", ha="center")
    _note(axes, "Glue it on something stiff and flat. The board's origin is its bottom left corner, at the arrows.")
    return _figure(axes)


def save_pages(pages: Sequence[Figure], file: Path) -> None:
    """Writes pages to a PDF."""
    from matplotlib.backends.backend_pdf import PdfPages

    file.parent.mkdir(parents=True, exist_ok=True)
    with PdfPages(file) as document:
        for page in pages:
            document.savefig(page)


def _bounds(tag: Tag) -> tuple[float, float, float, float]:
    """Returns the smallest and the largest x and y of a tag in the object's frame [m]."""
    (low_x, low_y), (high_x, high_y) = tag.corners[:, :2].min(axis=0), tag.corners[:, :2].max(axis=0)
    return low_x, low_y, high_x, high_y


def _draw_tag(axes: Axes, family: str, tag: Tag, origin: np.ndarray) -> None:
    """Draws a tag at its place in the object's frame, whose origin is at a point of the page [mm]."""
    from matplotlib.transforms import Affine2D

    modules = FAMILIES[family][1]
    known = dictionary(family)
    if tag.id >= len(known.bytesList):
        raise ConfigError(f"tag {tag.id} does not exist in {family}\n  allowed: 0 to {len(known.bytesList) - 1}")
    image = load_opencv().aruco.generateImageMarker(known, tag.id, _PIXELS * modules)
    half = 500.0 * tag.size
    place = Affine2D().rotate(tag.yaw).translate(*(origin + 1e3 * np.array(tag.position[:2])))
    axes.imshow(
        image,
        cmap="gray",
        vmin=0,
        vmax=255,
        extent=(-half, half, -half, half),
        interpolation="none",
        transform=place + axes.transData,
        clip_on=False,
    )


def _page(paper: Paper, title: str) -> Axes:
    """Returns the axes of an empty page in millimetres, with its title and a ruler."""
    from matplotlib.figure import Figure

    width, height = PAPERS[paper]
    figure = Figure(figsize=(width / _INCH, height / _INCH))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.axis("off")
    axes.autoscale(False)
    axes.set(xlim=(0.0, width), ylim=(0.0, height))
    axes.text(_EDGE, height - _EDGE, title, fontsize=9, va="top")
    left, base = width - _EDGE - _RULER - 5.0, _EDGE
    axes.plot([left, left + _RULER], [base, base], color="black", linewidth=0.5)
    for at in range(0, _RULER + 1, 10):
        axes.plot([left + at, left + at], [base, base + (4.0 if at % 50 == 0 else 2.0)], color="black", linewidth=0.5)
    axes.text(left, base + 5.0, f"{_RULER} mm: print at 100 %, and measure", fontsize=7)
    return axes


def _note(axes: Axes, text: str) -> None:
    """Writes a note at the foot of a page."""
    axes.text(_EDGE, _EDGE, text, fontsize=7)


def _figure(axes: Axes) -> Figure:
    """Returns the page of some axes, their scale restored."""
    from matplotlib.figure import Figure

    figure = axes.figure
    assert isinstance(figure, Figure)
    width, height = figure.get_size_inches() * _INCH
    axes.set(xlim=(0.0, width), ylim=(0.0, height), aspect="auto")  # imshow changes them
    return figure
