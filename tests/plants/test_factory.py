"""A run's plant is made by name, with its options converted to the types of the function that makes it."""

from __future__ import annotations

import pytest
from support.small_tasks import shipped

from oimppi_warp.config.presets import best
from oimppi_warp.config.run_spec import RunSpec
from oimppi_warp.errors import ConfigError
from oimppi_warp.plants.factory import make_plant, plant_options, starts_itself
from oimppi_warp.plants.plant import SimulatedPlant, ideal_plant
from oimppi_warp.registries import PLANTS


def made_with(scene, config, *, seed, gain: float = 1.0, count: int = 2, name: str = "", flag: bool = False, port=None):
    return gain, count, name, flag, port


class Drawn:
    own_world = True

    def __init__(self, scene, config, *, seed: int, limit: float | None = None) -> None:
        self.limit = limit


def options(*assignments: str, make=made_with) -> dict:
    return plant_options(make, "mine", assignments)


def test_options_have_the_types_of_the_arguments():
    found = options("gain=0.5", "count=3", "name=a=b", "flag=true", "port=/dev/ttyUSB0")
    assert found == {"gain": 0.5, "count": 3, "name": "a=b", "flag": True, "port": "/dev/ttyUSB0"}
    assert options("flag=no") == {"flag": False}
    assert options("limit=2", make=Drawn) == {"limit": 2.0}
    assert options() == {}


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("gian=1", "no such option\n  allowed: gain, count, name, flag, port\n  to do:   did you mean gain"),
        ("seed=1", "no such option"),
        ("gain=fast", "gain=fast: not a value of this option\n  allowed: float"),
        ("count=1.5", "allowed: int"),
        ("flag=maybe", "allowed: bool"),
    ],
)
def test_an_option_that_cannot_be_used_is_said(assignment, message):
    with pytest.raises(ConfigError, match=message):
        options(assignment)


def test_a_plant_without_options_says_so():
    with pytest.raises(ConfigError, match="the plant ideal has no such option\n  allowed: none"):
        plant_options(ideal_plant, "ideal", ["gain=1"])


def test_a_run_makes_its_plant(monkeypatch):
    scene = shipped("task01")
    assert isinstance(make_plant(scene, best(), RunSpec()), SimulatedPlant)
    PLANTS.register("drawn", Drawn)
    try:
        plant = make_plant(scene, best(), RunSpec(plant="drawn", plant_options=("limit=3",)))
        assert isinstance(plant, Drawn) and plant.limit == 3.0
        assert starts_itself("drawn") and not starts_itself("ideal") and not starts_itself("lab")
        with pytest.raises(ConfigError, match="the plant drawn has a friction of its own"):
            make_plant(scene, best(), RunSpec(plant="drawn", friction=0.3))
    finally:
        PLANTS.unregister("drawn")


def test_an_option_without_a_value_is_refused_at_once():
    with pytest.raises(ConfigError, match="gain is not an assignment"):
        RunSpec().changed(plant_options=("gain",))
