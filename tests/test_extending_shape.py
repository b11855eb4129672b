"""A shape from elsewhere: registered in a few lines, it is an object, an obstacle, in help, and then gone again."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
import shapely

from oimppi_warp.authoring import Block, FlatObject, Parameter, Shape, extrusion
from oimppi_warp.authoring.named_shapes import objects
from oimppi_warp.cli.main import main
from oimppi_warp.errors import ConfigError
from oimppi_warp.registries import SHAPES
from oimppi_warp.usd import load_scene


def angle(length: float, width: float, *, height: float = 0.05, **weight: float) -> FlatObject:
    """An L of two legs of one length."""
    legs = shapely.union(shapely.box(0.0, 0.0, length, width), shapely.box(0.0, 0.0, width, length))
    return extrusion("angle", "Angle", "An angle", legs, height, **weight)


def fence(name: str, pose: tuple[float, float, float], length: float, width: float) -> Block:
    """What stands for it as an obstacle in one test: a plain box."""
    return Block(name, pose[:2], (length, width, 0.08), yaw=pose[2])


@pytest.fixture
def shape() -> Iterator[str]:
    SHAPES.register(
        "steel-angle",
        Shape(
            about="an angle of two legs",
            make=angle,
            example="0.12x0.04",
            parameters=(Parameter("leg"), Parameter("width")),
            options=("height",),
            noun="angles",
        ),
    )
    yield "steel-angle"
    SHAPES.unregister("steel-angle")


def test_a_registered_shape_is_pushed_and_stands_in_the_way(shape, tmp_path):
    options = ["--mass", "0.3", "--height", "0.03", "--obstacle", f"{shape}:0.15x0.03@0.4,-0.1,0.3"]
    assert main(["scene", "new", "mine", "--out", str(tmp_path), "--object", f"{shape}:0.12x0.04", *options]) == 0
    scene = load_scene(tmp_path / "mine.usda")
    assert (scene.object.mass, scene.object.rest_height) == (0.3, 0.015)
    corners = np.vstack([piece.vertices for piece in scene.object.colliders if piece.vertices is not None])
    assert np.ptp(corners, axis=0) == pytest.approx((0.12, 0.12, 0.03))
    (obstacle,) = scene.obstacles
    assert obstacle.path == "/World/Obstacles/SteelAngle"
    assert main(["scene", "check", str(tmp_path / "mine.usda")]) == 0


def test_a_registered_shape_may_be_an_obstacle_of_its_own_kind(tmp_path):
    numbers = (Parameter("length"), Parameter("width"))
    SHAPES.register(
        "fence", Shape(about="a fence", make=angle, example="0.3x0.02", parameters=numbers, make_obstacle=fence)
    )
    try:
        options = ["--obstacle", "fence:0.3x0.02@0.5,-0.1,0.5"]
        assert main(["scene", "new", "mine", "--out", str(tmp_path), *options]) == 0
        ((collider,),) = [obstacle.colliders for obstacle in load_scene(tmp_path / "mine.usda").obstacles]
        assert (collider.kind, collider.size) == ("box", pytest.approx((0.15, 0.01, 0.04)))
        assert 2 * math.atan2(collider.transform[5], collider.transform[6]) == pytest.approx(0.5)
    finally:
        SHAPES.unregister("fence")


def test_a_registered_shape_is_in_help_and_in_messages(shape, tmp_path, capsys):
    assert f"{shape}:0.12x0.04 (leg x width)" in objects()
    assert main(["scene", "new", "mine", "--out", str(tmp_path), "--object", "steel-angel:1"]) == 2
    assert "did you mean steel-angle:0.12x0.04?" in capsys.readouterr().err
    assert main(["scene", "new", "mine", "--out", str(tmp_path), "--object", "t-block", "--height", "0.03"]) == 2
    assert "only with letters, words or angles" in capsys.readouterr().err


def test_a_shape_that_was_removed_is_no_longer_known(shape, tmp_path, capsys):
    SHAPES.unregister(shape)
    assert main(["scene", "new", "mine", "--out", str(tmp_path), "--object", f"{shape}:0.12x0.04"]) == 2
    assert "there is no such object" in capsys.readouterr().err
    assert shape not in objects()


def test_a_shipped_name_cannot_be_taken():
    with pytest.raises(ConfigError, match="shape 'box' is already registered"):
        SHAPES.register("box", Shape(about="another box", make=angle))
