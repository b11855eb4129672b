"""Named shapes: what the registry says of them is what help, messages and the manual say, and what is made."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from oimppi_warp.authoring import StaticObject
from oimppi_warp.authoring import named_shapes as shapes_module
from oimppi_warp.authoring.object_spec import ShapeOptions, check_used, parse_object, parse_obstacles
from oimppi_warp.authoring.objects.outlines import regular_prism
from oimppi_warp.cli.main import main
from oimppi_warp.errors import ConfigError
from oimppi_warp.geometry.feasibility import object_outline
from oimppi_warp.registries import SHAPES
from oimppi_warp.usd import load_scene

WORDS = {name: f"{name}:{shape.example}" if shape.example else name for name, shape in SHAPES.items()}
MADE = [word for name, word in WORDS.items() if not SHAPES[name].files]
"""Words that need no file."""


def help_of(*command: str, capsys: pytest.CaptureFixture[str]) -> str:
    """Help as one line without its frame."""
    with pytest.raises(SystemExit):
        main([*command, "--help"])
    return " ".join(re.sub("[│╭╮╰╯─]", " ", capsys.readouterr().out).split())


@pytest.mark.parametrize("word", MADE)
def test_the_example_of_every_shape_makes_an_object_and_an_obstacle(word):
    obj = parse_object(word, ShapeOptions(mass=0.25, friction=0.35))
    assert (obj.friction, obj.rest_height > 0.0) == (0.35, True)
    (obstacle,) = parse_obstacles([f"{word}@0.5,0.1,0.3"])
    assert re.fullmatch(r"[A-Z][A-Za-z0-9]*", obstacle.name)
    kind = word.partition(":")[0]
    assert isinstance(obstacle, StaticObject) == (SHAPES[kind].make_obstacle is None)


def test_help_names_every_shape(capsys):
    told = help_of("scene", "new", capsys=capsys)
    for name, shape in SHAPES.items():
        assert shape.usage(name) in told


def test_help_says_which_shapes_take_an_option(capsys):
    told = help_of("scene", "new", capsys=capsys)
    assert "from the table to its top [m]. (with letter, text; default: 0.05)" in told
    assert "(with mesh; default: m)" in told


def test_the_manual_has_the_table_of_shapes():
    manual = Path(__file__).resolve().parents[2] / "docs" / "authoring.md"
    assert shapes_module.table() in manual.read_text()


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("boxx:0.1x0.1x0.1", "did you mean box:0.1x0.06x0.05?"),
        ("letter", "did you mean letter:S?"),
        ("box:120x60x50", "give it in metres: 0.12 if 120 mm were meant"),
        ("lab_tt", "did you mean lab-t?"),
        ("box:0.1x0.1", "needs 3 lengths above zero\n  allowed: box:0.1x0.06x0.05 (length x width x height), "
         "in metres"),
        ("prism:6x0.05", "needs 3 numbers above zero\n  allowed: prism:6x0.05x0.04 (sides x radius x height), "
         "radius in m, height in m"),
        ("prism:2x0.05x0.04", "2 is not a valid number of sides\n  allowed: an integer from 3 to 24"),
        ("prism:4.5x0.05x0.04", "4.5 is not a valid number of sides"),
        ("prism:6x0.5x0.04", "out of range"),
        ("wedge:0.1", "allowed: t-block, lab-t"),
    ],
)  # fmt: skip
def test_a_spec_that_makes_nothing_is_refused_with_what_would(word, said):
    with pytest.raises(ConfigError) as error:
        parse_object(word)
    assert said in str(error.value)


def test_an_option_that_no_shape_of_the_task_takes_is_refused():
    check_used(ShapeOptions(height=0.03, mass=1.0, friction=0.2), ("letter:S", "box:0.1x0.1x0.1@0.5,0"))
    check_used(ShapeOptions(scale="mm"), ("t-block", "somewhere/part.STL@0.5,0"))
    with pytest.raises(ConfigError, match=r"--font Sans .*\n.*only with letters or words"):
        check_used(ShapeOptions(font="Sans"), ("prism:6x0.05x0.04", "t-block@0.5,0"))
    with pytest.raises(ConfigError, match=r"--lay as-is .*\n.*only with a mesh"):
        check_used(ShapeOptions(lay="as-is"), ("letter:S",))


@pytest.mark.parametrize("sides", [3, 4, 5, 6, 12, 24])
def test_a_prism_weighs_and_turns_as_the_polygon_below_it(sides):
    """Area ``n r^2 sin(2 pi / n) / 2``; polar moment ``m r^2 (1/2 - sin^2(pi / n) / 3)``."""
    radius, height = 0.06, 0.05
    obj = regular_prism(sides, radius, height)
    (polygon,) = obj.pieces
    assert isinstance(polygon, np.ndarray)
    assert len(polygon) == sides
    np.testing.assert_allclose(np.linalg.norm(polygon, axis=1), radius, atol=2e-5)
    lowest = polygon[polygon[:, 1] < polygon[:, 1].min() + 2e-5]
    assert len(lowest) == 2, "a side faces -y"
    area = sides * radius**2 * math.sin(math.tau / sides) / 2
    assert obj.mass == pytest.approx(650.0 * area * height, abs=0.006)
    center, inertia = obj.center_and_inertia()
    assert center == pytest.approx((0.0, 0.0, 0.0), abs=1e-5)
    assert inertia[2, 2] == pytest.approx(obj.mass * radius**2 * (0.5 - math.sin(math.pi / sides) ** 2 / 3), rel=2e-3)


def test_a_prism_is_written_checked_and_read_back(tmp_path, capsys):
    options = ["--mass", "0.3", "--goal", "0.5,0.2,1.57", "--obstacle", "prism:3x0.05x0.1@0.4,-0.1,0.5"]
    assert main(["scene", "new", "mine", "--out", str(tmp_path), "--object", "prism:6,0.05,0.04", *options]) == 0
    assert main(["scene", "check", "--strict", str(tmp_path / "mine.usda")]) == 0
    assert "no problems found" in capsys.readouterr().out
    scene = load_scene(tmp_path / "mine.usda")
    assert (scene.object.mass, scene.object.rest_height) == (0.3, 0.02)
    outline = object_outline(scene, (0.0, 0.0, 0.0))
    assert outline.area == pytest.approx(6 * 0.05**2 * math.sin(math.tau / 6) / 2, rel=1e-3)
    assert [obstacle.path for obstacle in scene.obstacles] == ["/World/Obstacles/Prism"]
