"""The sheets: what is printed has the stated size, and is found by the detector."""

from __future__ import annotations

import io

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure
from support import small_tasks

from oimppi_warp.errors import ConfigError
from oimppi_warp.perception.board import Board, BoardFinder
from oimppi_warp.perception.sheet import PAPERS, board_page, object_page, save_pages
from oimppi_warp.perception.tags import Tag, TagLayout, dictionary, layout_of

DPI = 254
"""Resolution of a print, ten pixels per millimetre."""


def printed(page: Figure) -> np.ndarray:
    """A page as a printer would print it, in grey."""
    data = io.BytesIO()
    page.savefig(data, dpi=DPI, format="png")
    return cv2.imdecode(np.frombuffer(data.getvalue(), np.uint8), cv2.IMREAD_GRAYSCALE)


def corners_of(image: np.ndarray, family: str) -> dict[int, np.ndarray]:
    """The corners of all tags in an image [mm], x to the right and y up."""
    found, ids, _ = cv2.aruco.ArucoDetector(dictionary(family)).detectMarkers(image)
    return {
        int(number): (each[0] + 0.5) / 10.0 * [1, -1] + [0, image.shape[0] / 10.0]
        for number, each in zip(np.ravel(ids), found, strict=True)
    }


@pytest.mark.parametrize("family", ["apriltag36h11", "aruco5x5"])
def test_the_printed_tag_is_found_and_has_its_size(family: str):
    can = small_tasks.shipped("lab01").object
    layout = layout_of(can, family=family)
    image = printed(object_page(can, layout, "lab01"))
    assert image.shape == (2100, 2970)
    (corners,) = corners_of(image, family).values()
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    np.testing.assert_allclose(sides, 1e3 * layout.tags[0].size, atol=0.25)
    assert corners[0, 1] > corners[3, 1] and corners[1, 0] > corners[0, 0]  # its top is up, its right to the right


def test_several_tags_are_printed_where_they_are_on_the_object():
    block = small_tasks.shipped("task01").object
    tags = (Tag(2, 0.03, (-0.07, 0.0, 0.025), 0.0), Tag(7, 0.03, (0.0, -0.09, 0.025), np.pi / 2))
    found = corners_of(printed(object_page(block, TagLayout("apriltag36h11", tags), "task01")), "apriltag36h11")
    assert found.keys() == {2, 7}
    apart = found[7].mean(axis=0) - found[2].mean(axis=0)
    np.testing.assert_allclose(apart, (70.0, -90.0), atol=0.2)
    # The edge from the first to the second corner is the tag's x, which a quarter turn points along the object's y.
    edge = found[7][1] - found[7][0]
    assert edge[1] == pytest.approx(30.0, abs=0.3) and edge[0] == pytest.approx(0.0, abs=0.3)


@pytest.mark.parametrize("paper", PAPERS)
def test_the_printed_board_is_found_and_has_its_size(paper):
    board = Board()
    image = printed(board_page(board, paper=paper))
    view = BoardFinder(board).find(image)
    assert view is not None and len(view.pixels) == (board.columns - 1) * (board.rows - 1)
    millimetres = view.pixels / 10.0 * [1, -1]
    off = millimetres - 1e3 * view.points[:, :2]
    np.testing.assert_allclose(off - off.mean(axis=0), 0.0, atol=0.1)


def test_the_ruler_is_ten_centimetres_long():
    image = printed(board_page(Board()))
    base = image[-(10 * 10) - 3 : -(10 * 10) + 3].min(axis=0)  # at 10 mm from the lower edge
    dark = np.flatnonzero(base[1500:] < 128) + 1500
    assert np.ptp(dark) == pytest.approx(1000, abs=5)


def test_the_pdf_has_both_pages_at_the_size_of_the_paper(tmp_path):
    can = small_tasks.shipped("lab01").object
    save_pages([object_page(can, layout_of(can), "lab01"), board_page(Board())], tmp_path / "new" / "sheet.pdf")
    data = (tmp_path / "new" / "sheet.pdf").read_bytes()
    # A4 is 841.9 by 595.3 points.
    assert data.count(b"/MediaBox [ 0 0 841.8897637795 595.2755905512 ]") == 2


def test_what_does_not_fit_on_the_paper_is_refused():
    with pytest.raises(ConfigError, match="does not fit on the paper"):
        board_page(Board(columns=12))
    large = small_tasks.shipped("task01").object.scaled(2.0)
    with pytest.raises(ConfigError, match="does not fit on the paper"):
        object_page(large, layout_of(large), "large")


def test_a_tag_that_its_family_does_not_have_is_refused():
    can = small_tasks.shipped("lab01").object
    with pytest.raises(ConfigError, match="tag 999 does not exist in apriltag36h11\n  allowed: 0 to 586"):
        object_page(can, TagLayout("apriltag36h11", (Tag(999, 0.03, (0.0, 0.0, 0.05)),)), "can")
