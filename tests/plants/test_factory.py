"""A run's plant is made by name, with its options converted to the types of the function that makes it."""

from __future__ import annotations

import sys

import pytest
from support.small_tasks import shipped

from oimppi_warp.bench.suite import load_suite
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


FILE = """
from beside import GAIN

class Alone:
    def __init__(self, scene, gain: float = GAIN):
        self.scene, self.gain = scene, gain

def all_of_it(scene, config, *, seed):
    return scene.name, config.preset, seed
"""


def test_a_plant_comes_straight_from_a_file(tmp_path, monkeypatch):
    (tmp_path / "my_plant.py").write_text(FILE)
    (tmp_path / "beside.py").write_text("GAIN = 2.5")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    scene = shipped("task01")
    alone = make_plant(scene, best(), RunSpec(plant="my_plant.py:Alone"))
    assert alone.scene is scene and alone.gain == 2.5
    spec = RunSpec().changed(plant="my_plant.py:Alone", plant_options=("gain=4",))
    changed = make_plant(scene, best(), spec)
    assert type(changed) is type(alone) and changed.gain == 4.0  # the file was run once
    assert make_plant(scene, best(), RunSpec(plant="my_plant.py:all_of_it", seed=7)) == ("task01", "best", 7)
    assert not any("my_plant" in name for name in PLANTS) and not PLANTS.is_local("my_plant.py:Alone")
    with pytest.raises(ConfigError, match=r"no Alnoe\n  allowed: Alone, all_of_it\n  to do:   did you mean Alone"):
        make_plant(scene, best(), RunSpec(plant="my_plant.py:Alnoe"))
    (tmp_path / "broken.py").write_text("import no_such_module")
    with pytest.raises(ConfigError, match=r"broken\.py cannot be loaded: ModuleNotFoundError: No module named"):
        make_plant(scene, best(), RunSpec(plant="broken.py:Plant"))
    with pytest.raises(ConfigError, match=r"there is no file my_plnt\.py\n  to do:   did you mean my_plant\.py"):
        RunSpec().changed(plant="my_plnt.py:Alone")


def test_a_suite_takes_a_plant_from_a_file_beside_it(tmp_path):
    (tmp_path / "mine.py").write_text("def plant(scene):\n    return scene.name\n")
    (tmp_path / "suite.toml").write_text('tasks = ["task01"]\nmethods = ["mppi"]\nplant = "mine.py:plant"\n')
    (entry,) = load_suite(tmp_path / "suite.toml").entries
    assert make_plant(shipped("task01"), best(), entry.run) == "task01"
    (tmp_path / "mine.py").unlink()
    with pytest.raises(ConfigError, match=r'plant = [\s\S]*allowed: "ideal" or .* or FILE\.py:NAME'):
        load_suite(tmp_path / "suite.toml")


def test_an_option_without_a_value_is_refused_at_once():
    with pytest.raises(ConfigError, match="gain is not an assignment"):
        RunSpec().changed(plant_options=("gain",))
