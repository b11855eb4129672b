"""Letters, words and other flat shapes as convex pieces."""

from __future__ import annotations

import string

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib import font_manager

from oimppi_warp.authoring import extrusion, letter, word
from oimppi_warp.authoring.letters.alphabet import CAP_HEIGHT, outline_of
from oimppi_warp.authoring.objects.flat_object import Box, FlatObject
from oimppi_warp.authoring.objects.polygons import convex_pieces
from oimppi_warp.errors import ConfigError

FONT = "DejaVu Sans"  # comes with matplotlib


def polygons(obj: FlatObject) -> list[shapely.Polygon]:
    corners = [piece.polygon() if isinstance(piece, Box) else piece for piece in obj.pieces]
    return [shapely.Polygon(each) for each in corners]


def whole(pieces: list[shapely.Polygon]) -> shapely.Geometry:
    """The pieces as one, gaps of rounding closed."""
    return shapely.union_all([piece.buffer(2e-5, join_style="mitre") for piece in pieces])


def assert_cut(pieces: list[shapely.Polygon], shape: shapely.Geometry) -> None:
    """They are convex, counter-clockwise, do not overlap, and make up the shape."""
    for piece in pieces:
        assert piece.exterior.is_ccw
        assert piece.convex_hull.area == pytest.approx(piece.area, rel=1e-3)
    assert sum(piece.area for piece in pieces) == pytest.approx(shape.area, rel=2e-3)
    assert shapely.symmetric_difference(shapely.union_all(pieces), shape).area < 0.01 * shape.area


@pytest.mark.parametrize("character", string.ascii_uppercase)
def test_every_capital_letter_is_one_body_of_few_convex_pieces(character):
    obj = letter(character)
    pieces = polygons(obj)
    assert_cut(pieces, outline_of(character))
    assert whole(pieces).geom_type == "Polygon"
    assert len(pieces) <= 8
    x0, y0, x1, y1 = outline_of(character).bounds
    assert y1 - y0 == pytest.approx(CAP_HEIGHT)
    assert x1 - x0 < 0.13
    assert 0.05 < obj.mass < 0.4


def test_letters_have_the_holes_and_ends_that_make_them_letters():
    holes = {c: len(shapely.get_rings(outline_of(c))) - 1 for c in string.ascii_uppercase}
    assert {c for c, n in holes.items() if n == 1} == set("ADOPRQ")
    assert {c for c, n in holes.items() if n == 2} == {"B"}
    shapes = [shapely.normalize(outline_of(c)) for c in string.ascii_uppercase]
    assert len({shape.wkt for shape in shapes}) == 26


def test_a_letter_of_half_the_size_weighs_a_quarter():
    large, small = letter("S", mass=None), letter("S", size=CAP_HEIGHT / 2)
    assert small.mass == pytest.approx(large.mass / 4, abs=0.01)
    assert_cut(polygons(small), shapely.affinity.scale(outline_of("S"), 0.5, 0.5, origin=(0, 0)))


@pytest.mark.parametrize("text", ["WARP", "push it", "Q", "AVA"])
def test_a_word_is_one_body_on_a_bar(text):
    obj = word(text)
    shape = whole(polygons(obj))
    assert shape.geom_type == "Polygon"
    x0, y0, x1, y1 = shape.bounds
    assert x1 - x0 <= 0.3001
    assert (x0 + x1, y0 + y1) == pytest.approx((0, 0), abs=1e-4)


def test_a_word_reads_from_left_to_right():
    obj = word("LT")
    shape = whole(polygons(obj))
    x0, y0, x1, y1 = shape.bounds
    top = shapely.intersection(shape, shapely.box(x0, y1 - 0.01, x1, y1))
    left, right = (
        shapely.intersection(top, box).area for box in (shapely.box(x0, y0, 0, y1), shapely.box(0, y0, x1, y1))
    )
    assert right > 2 * left  # the L has a stem up there, the T its bar


@pytest.mark.parametrize("character", ["S", "g", "B", "&", "ä"])
def test_any_character_of_an_installed_font_can_be_had(character):
    obj = letter(character, font=FONT)
    pieces = polygons(obj)
    assert_cut(pieces, shapely.union_all(pieces))
    assert obj.name.isidentifier()
    assert letter(character, font=font_manager.findfont(FONT)).pieces[0] == pytest.approx(obj.pieces[0])


def test_a_letter_of_a_font_is_as_high_as_ours():
    shape = whole(polygons(letter("H", font=FONT)))
    assert np.ptp(shape.bounds[1::2]) == pytest.approx(CAP_HEIGHT, abs=1e-3)


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: letter("1"), "not in the built-in alphabet"),
        (lambda: letter("AB"), "text:AB"),
        (lambda: letter("A", size=0.01), "too small for the stick"),
        (lambda: letter("A", height=2.0), "out of range"),
        (lambda: letter("S", height=5.0), "out of range"),
        (lambda: letter("A", mass=0.0), "--mass 0"),
        (lambda: word(" "), "no letters were given"),
        (lambda: word("PNEUMONOULTRAMICROSCOPIC"), "too long"),
        (lambda: letter("A", font="No Such Font"), "no such font is installed"),
        (lambda: letter("\u4e00", font=FONT), "has no such character"),
        (lambda: letter(" ", font=FONT), "blank"),
    ],
)
def test_letters_that_cannot_be_made_are_refused(make, reason):
    with pytest.raises(ConfigError, match="allowed:") as error:
        make()
    assert reason in str(error.value)


SQUARES = st.lists(
    st.tuples(st.integers(0, 7), st.integers(0, 7), st.integers(1, 4), st.integers(1, 4), st.integers(0, 1)),
    min_size=1,
    max_size=6,
)


@settings(max_examples=60, deadline=None)
@given(SQUARES)
def test_any_flat_shape_is_cut_into_convex_pieces(squares):
    """Boxes, some of them cut off at a corner, in any arrangement: holes, touching corners, several parts."""
    parts = []
    for x, y, w, h, cut in squares:
        corners = [(x, y), (x + w, y), (x + w, y + h), (x, y + h)]
        parts.append(shapely.Polygon(corners[: 4 - cut]))
    shape = shapely.transform(shapely.union_all(parts), lambda xy: 0.01 * xy)
    pieces = [shapely.Polygon(piece) for piece in convex_pieces(shape)]
    assert_cut(pieces, shape)
    assert len(pieces) <= len(shapely.get_coordinates(shape))


def test_a_shape_of_ones_own_becomes_an_object():
    ring = shapely.Point(0, 0).buffer(0.05).difference(shapely.Point(0, 0).buffer(0.03))
    obj = extrusion("ring", "Ring", "A ring", ring, 0.04, mass=0.3)
    assert obj.mass == 0.3
    assert_cut(polygons(obj), ring)
    _, inertia = obj.center_and_inertia()
    assert inertia[2, 2] == pytest.approx(0.3 * (0.05**2 + 0.03**2) / 2, rel=0.01)
