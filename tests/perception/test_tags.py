"""Where the tags on an object are: the default place and size, and the file."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import shapely
from support import small_tasks

from oimppi_warp.errors import ConfigError
from oimppi_warp.perception.tags import FAMILIES, Tag, TagLayout, dictionary, layout_of, load_layout, top_outline


def test_the_tag_of_the_can_is_in_its_middle_on_its_top_as_large_as_fits():
    can = small_tasks.shipped("lab01").object
    (tag,) = layout_of(can).tags
    assert tag.position == (0.0, 0.0, pytest.approx(0.0505)) and tag.yaw == 0.0
    # With its white border of one module, a tag of 8 modules has a diagonal of sqrt(2) 10/8 of its side.
    assert tag.size == pytest.approx(0.066 / (np.sqrt(2.0) * 10 / 8), abs=0.001) and tag.size * 1e3 % 1 < 1e-6


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("name", ["lab01", "task01", "pusht"])
def test_a_tag_and_its_border_are_on_the_object(name: str, family: str):
    pushed = small_tasks.shipped(name).object
    (tag,) = layout_of(pushed, family=family).tags
    modules = FAMILIES[family][1]
    bordered = replace(tag, size=tag.size * (modules + 2) / modules)
    top = top_outline(pushed)
    assert top.buffer(5e-4).contains(shapely.Polygon(bordered.corners[:, :2]))


def test_a_top_that_is_too_narrow_asks_for_a_card_and_gets_one():
    letter = small_tasks.shipped("task05").object
    with pytest.raises(ConfigError, match="put a larger tag on a card"):
        layout_of(letter)
    (tag,) = layout_of(letter, size=0.04).tags
    assert tag.size == 0.04


def test_families_and_sizes_that_do_not_exist_are_refused():
    can = small_tasks.shipped("lab01").object
    with pytest.raises(ConfigError, match=r"allowed: apriltag36h11, "):
        layout_of(can, family="qr")
    with pytest.raises(ConfigError, match="allowed: above 0, below 1 m"):
        layout_of(can, size=-0.1)


def test_no_tag_of_an_object_is_a_marker_of_the_board():
    board = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    for family, (_, modules) in FAMILIES.items():
        known = dictionary(family)
        assert known.markerSize == modules - 2 != board.markerSize


def test_tags_are_the_same_after_writing_and_reading(tmp_path):
    layout = TagLayout("aruco5x5", (Tag(3, 0.0412, (0.01, -0.02, 0.05), 0.3), Tag(0, 0.02, (0.0, 0.0, 0.025))))
    layout.save(tmp_path / "deep" / "tags.toml")
    assert load_layout(tmp_path / "deep" / "tags.toml") == layout


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("family = [", "cannot be read"),
        ("", "no description of tags"),
        ('family = "qr"\n[[tag]]\nid = 0\nsize = 0.04\nposition = [0, 0, 0]', "'qr' does not exist"),
        ('family = "aruco5x5"\ntag = []', "at least one tag"),
        ('family = "aruco5x5"\n[[tag]]\nid = 0\nsize = 0.04\nposition = [0, 0]', "no description"),
        ('family = "aruco5x5"\n[[tag]]\nid = 0\nsize = -1\nposition = [0, 0, 0]', "no description"),
        ('family = "aruco5x5"\n[[tag]]\nid = 0\nsize = 0.04\nposition = [0, 0, 0]\nyav = 1', "no description"),
        ('family = "aruco5x5"\n' + 2 * "[[tag]]\nid = 0\nsize = 0.04\nposition = [0, 0, 0]\n", "no number twice"),
    ],
)
def test_a_broken_file_of_tags_is_refused_with_its_name(tmp_path, text: str, wrong: str):
    file = tmp_path / "tags.toml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=wrong) as refused:
        load_layout(file)
    assert str(file) in str(refused.value)


def test_a_missing_file_of_tags_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="oimppi perceive sheet writes one"):
        load_layout(tmp_path / "none.toml")
