"""Builds letters and words as objects; many of them are hollow, forked or bent."""

from __future__ import annotations

import re
import string

import shapely
from shapely import affinity
from shapely.geometry.base import BaseGeometry

from oimppi_warp.authoring.letters.alphabet import CAP_HEIGHT, SIMPLE, outline_of
from oimppi_warp.authoring.objects.flat_object import FlatObject
from oimppi_warp.authoring.objects.outlines import FRICTION, checked_friction, checked_mass, checked_sides, extrusion
from oimppi_warp.authoring.prims import Color
from oimppi_warp.errors import ConfigError

BLUE: Color = (0.1, 0.22, 0.55)
GREEN: Color = (0.12, 0.42, 0.2)

HEIGHT = 0.05
"""Thickness of letters and words [m]."""

LONGEST = 0.30
"""A word without a given size is scaled down until it is no longer than this [m]."""

SMALLEST = 0.03
"""Minimum height of a letter [m]; the stick is 0.016 m wide."""

_GAP, _SPACE = 0.12, 0.45  # between letters and between words, in letter heights
_BAR = 0.18  # thickness of the bar that joins a word, in letter heights


def letter(
    letter: str,
    *,
    size: float = CAP_HEIGHT,
    height: float = HEIGHT,
    mass: float | None = None,
    friction: float = FRICTION,
    font: str | None = None,
    color: Color = BLUE,
) -> FlatObject:
    """Creates a letter that lies on the table.

    Args:
        letter: One of A to Z; with a font, any character of that font.
        size: Height of a capital letter in its plane [m].
        height: Thickness [m].
        mass: Mass [kg]; ``None``: computed from the density of wood.
        friction: Coulomb coefficient with the table.
        font: Name of an installed font, or path of a font file; without it, the built-in alphabet.
        color: Red, green and blue.

    Raises:
        ConfigError: The letter or font does not exist, or a number is out of range.
    """
    if len(letter) != 1:
        raise ConfigError(
            f"letter:{letter}: not a single letter\n  allowed: one letter, as in letter:S; for a word, text:{letter}"
        )
    outline = _letter_outline(letter, size, font)
    character = letter if font else letter.upper()
    name = f"letter_{_file_name_part(character)}"
    doc = f"The letter {character}" + (f" of the font {font}" if font else "")
    if character in SIMPLE and font is None and size == CAP_HEIGHT:  # cut by hand, as in the shipped scenes
        x0, y0, x1, y1 = outline.bounds
        checked_sides(doc, x1 - x0, y1 - y0, height)
        weight = checked_mass(mass, shapely.area(outline) * height)
        return FlatObject(
            name, f"Letter{character}", doc, SIMPLE[character], height, weight, checked_friction(friction), color
        )
    prim = f"Letter{_file_name_part(character).title()}"
    return extrusion(name, prim, doc, outline, height, mass=mass, friction=friction, color=color)


def word(
    text: str,
    *,
    size: float | None = None,
    height: float = HEIGHT,
    mass: float | None = None,
    friction: float = FRICTION,
    font: str | None = None,
    color: Color = BLUE,
) -> FlatObject:
    """Creates a word as one rigid object, its letters joined by a bar below them.

    Args:
        text: Letters and spaces; with a font, any characters of that font.
        size: Height of a capital letter [m]; ``None``: that of the shipped letters, reduced if necessary so that the
            word is no longer than :data:`LONGEST`.
        height: Thickness [m].
        mass: Mass [kg]; ``None``: computed from the density of wood.
        friction: Coulomb coefficient with the table.
        font: Name of an installed font, or path of a font file; without it, the built-in alphabet.
        color: Red, green and blue.

    Raises:
        ConfigError: A letter or the font does not exist, or a number is out of range.
    """
    text = " ".join(text.split())
    if not text:
        raise ConfigError("text: no letters were given\n  allowed: letters and spaces, as in text:WARP")
    outline = _row_of(text, font)
    x0, _, x1, _ = outline.bounds
    if size is None:
        size = min(CAP_HEIGHT, CAP_HEIGHT * LONGEST / (x1 - x0))
        if size < SMALLEST:
            raise ConfigError(
                f"text:{text}: too long, its letters would be {1000 * size:.0f} mm high\n"
                f"  allowed: words whose letters are at least {1000 * SMALLEST:.0f} mm high when the word is "
                f"{LONGEST:g} m long"
            )
    outline = affinity.scale(outline, size / CAP_HEIGHT, size / CAP_HEIGHT, origin=(0.0, 0.0))
    name, doc = f"text_{_file_name_part(text)}", f"The word {text if font else text.upper()}, on a bar"
    prim = "Text" + "".join(part.title() for part in _file_name_part(text).split("_"))
    return extrusion(name, prim, doc, outline, height, mass=mass, friction=friction, color=color)


def _letter_outline(letter: str, size: float, font: str | None) -> BaseGeometry:
    """Returns a letter's outline about the middle of its box [m]."""
    if size < SMALLEST:
        raise ConfigError(f"--size {size:g}: too small for the stick\n  allowed: {SMALLEST:g} m or more")
    outline = _glyph(letter, font)
    x0, y0, x1, y1 = outline.bounds
    outline = affinity.translate(outline, -(x0 + x1) / 2, -(y0 + y1) / 2) if font else outline
    if size == CAP_HEIGHT:
        return outline
    return affinity.scale(outline, size / CAP_HEIGHT, size / CAP_HEIGHT, origin=(0.0, 0.0))


def _glyph(letter: str, font: str | None) -> BaseGeometry:
    """Returns the outline of a letter of height :data:`CAP_HEIGHT`, its foot at ``-CAP_HEIGHT / 2``."""
    if font is not None:
        from oimppi_warp.authoring.letters.fonts import glyph_outline

        return affinity.translate(glyph_outline(letter, font, CAP_HEIGHT), 0.0, -CAP_HEIGHT / 2)
    capital = letter.upper()
    if capital not in string.ascii_uppercase:
        raise ConfigError(
            f"{letter!r}: not in the built-in alphabet\n  allowed: A to Z, or any character of a font given with --font"
        )
    return outline_of(capital)


def _row_of(text: str, font: str | None) -> BaseGeometry:
    """Returns letters of height :data:`CAP_HEIGHT` in a row on a bar, about the middle of their box [m]."""
    parts, pen = [], 0.0
    for character in text:
        if character == " ":
            pen += _SPACE * CAP_HEIGHT
            continue
        glyph = _glyph(character, font)
        parts.append(affinity.translate(glyph, pen - glyph.bounds[0], 0.0))
        pen = parts[-1].bounds[2] + _GAP * CAP_HEIGHT
    letters = shapely.union_all(parts)
    x0, _, x1, _ = letters.bounds
    bar = shapely.box(x0, -CAP_HEIGHT / 2 - _BAR * CAP_HEIGHT, x1, -CAP_HEIGHT / 2)
    whole = shapely.union(letters, bar, grid_size=1e-5)
    x0, y0, x1, y1 = whole.bounds
    return affinity.translate(whole, -(x0 + x1) / 2, -(y0 + y1) / 2)


def _file_name_part(text: str) -> str:
    """Converts text for a file name to lower-case letters, digits and underscores, and the code numbers of others."""
    found = (c if re.fullmatch(r"[a-z0-9]", c) else "_" if c == " " else f"u{ord(c):x}" for c in text.lower())
    return "".join(found)
