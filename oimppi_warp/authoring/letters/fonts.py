"""Outlines of characters from an installed font."""

from __future__ import annotations

import difflib
from functools import cache
from pathlib import Path

import numpy as np
import shapely
from matplotlib import font_manager
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath
from shapely.geometry.base import BaseGeometry

from oimppi_warp.errors import ConfigError

COARSE = 0.0012
"""Maximum deviation of an outline from the font's curve [m]; fewer corners give fewer convex pieces."""

_POINTS = 100.0


def glyph_outline(character: str, font: str, cap: float) -> BaseGeometry:
    """Returns the outline of a character, with its baseline at y = 0 [m].

    Args:
        character: One character.
        font: Name of an installed font, or path of a font file.
        cap: Height of the font's capital H [m].

    Raises:
        ConfigError: The font does not exist, or has no such character.
    """
    properties = _properties(font)
    if character.isspace() or not character.isprintable():
        raise ConfigError(f"{character!r} is blank in the font {font}\n  allowed: visible characters")
    scale = cap / TextPath((0.0, 0.0), "H", _POINTS, prop=properties).get_extents().height
    if ord(character) not in font_manager.get_font(font_manager.findfont(properties)).get_charmap():
        raise ConfigError(f"{character!r}: the font {font} has no such character\n  allowed: characters in the font")
    rings = TextPath((0.0, 0.0), character, _POINTS, prop=properties).to_polygons(closed_only=True)
    outline = _filled([shapely.Polygon(scale * ring) for ring in map(np.asarray, rings) if len(ring) > 3])
    return shapely.simplify(outline, COARSE)


def _filled(rings: list[shapely.Polygon]) -> BaseGeometry:
    """Returns the area within contours: those oriented as the largest one are filled, the others are holes."""
    ways = [ring.exterior.is_ccw for ring in rings]
    outer = ways[max(range(len(rings)), key=lambda i: rings[i].area)]
    whole = [shapely.make_valid(ring) for ring in rings]
    filled = shapely.union_all([ring for ring, way in zip(whole, ways, strict=True) if way == outer])
    return shapely.difference(
        filled, shapely.union_all([r for r, way in zip(whole, ways, strict=True) if way != outer])
    )


@cache
def _properties(font: str) -> FontProperties:
    """Returns the properties by which matplotlib finds a font."""
    if Path(font).is_file():
        return FontProperties(fname=font)
    properties = FontProperties(family=font)
    try:
        font_manager.findfont(properties, fallback_to_default=False)
    except ValueError:
        names = sorted({entry.name for entry in font_manager.fontManager.ttflist})
        near = difflib.get_close_matches(font, names, n=3, cutoff=0.4) or names[:5]
        raise ConfigError(
            f"--font {font}: no such font is installed\n  allowed: a font file, or one of the "
            f"{len(names)} installed fonts, such as {', '.join(near)}"
        ) from None
    return properties
