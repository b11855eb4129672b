"""A run's plant is made by name, with its options converted to the types of the function that makes it."""

from __future__ import annotations

import re
import sys

import pytest
from support.small_tasks import shipped

from oimppi_warp.bench.suite import load_suite
from oimppi_warp.bench.trial import make_trials
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
    assert re.fullmatch("my_plant_[0-9a-f]{12}", type(alone).__module__)
    assert make_plant(scene, best(), RunSpec(plant="my_plant.py:all_of_it", seed=7)) == ("task01", "best", 7)
    assert not any("my_plant" in name for name in PLANTS) and not PLANTS.is_local("my_plant.py:Alone")
    with pytest.raises(ConfigError, match=r"no Alnoe\n  allowed: Alone, all_of_it\n  to do:   did you mean Alone"):
        make_plant(scene, best(), RunSpec(plant="my_plant.py:Alnoe"))
    (tmp_path / "broken.py").write_text("import no_such_module")
    with pytest.raises(ConfigError, match=r"broken\.py:Plant': the file cannot be loaded: ModuleNotFoundError"):
        make_plant(scene, best(), RunSpec(plant="broken.py:Plant"))
    with pytest.raises(ConfigError, match=r"there is no file my_plnt\.py\n  to do:   did you mean my_plant\.py"):
        RunSpec().changed(plant="my_plnt.py:Alone")


SIGNATURES = {
    "def f(scene): return scene, None, None": (True, False, False),
    "def f(scene, config): return scene, config, None": (True, True, False),
    "def f(scene, seed=0): return scene, None, seed": (True, False, True),
    "def f(scene, radius=0.1, config=None): return scene, config, None": (True, True, False),
    "def f(config, scene): return scene, config, None": (True, True, False),
    "def f(*, scene, config, seed): return scene, config, seed": (True, True, True),
    "def f(task, settings, *, seed): return task, settings, seed": (True, True, True),
    "def f(task, settings, **rest): return task, settings, rest['seed']": (True, True, True),
    "def f(*given, **rest): return *given, rest['seed']": (True, True, True),
    "def f(task, /): return task, None, None": (True, False, False),
    "def f(): return None, None, None": (False, False, False),
}


@pytest.mark.parametrize("code", SIGNATURES)
def test_a_plant_gets_what_it_takes_of_scene_config_and_seed(code):
    names: dict = {}
    exec(code, names)
    scene, config = shipped("task01"), best()
    PLANTS.register("f", names["f"])
    try:
        made = make_plant(scene, config, RunSpec(plant="f", seed=7))
    finally:
        PLANTS.unregister("f")
    assert made == tuple(
        given if has else None for given, has in zip((scene, config, 7), SIGNATURES[code], strict=True)
    )


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("f = 3", "f is neither a function nor a class"),
        ("def f(scene, radius: float): pass", "cannot be made: missing a required argument: 'radius'\n  allowed: the"),
        ("import sys; sys.exit(3)", "the file cannot be loaded: SystemExit: 3\n  to do:   run"),
        ("def f(:", "the file cannot be loaded: SyntaxError"),
    ],
)
def test_a_file_or_a_function_that_makes_no_plant_says_why(code, said, tmp_path):
    (tmp_path / "wrong.py").write_text(code)
    with pytest.raises(ConfigError, match=said):
        make_plant(shipped("task01"), best(), RunSpec(plant=f"{tmp_path / 'wrong.py'}:f"))


def test_options_need_no_types_that_only_type_checkers_import():
    def mine(scene: "Unknown", gain="1"):  # noqa: F821, UP037  # pyright: ignore[reportUndefinedVariable]
        return gain

    assert options("gain=2", make=mine) == {"gain": "2"}


def test_a_suite_takes_a_plant_from_a_file_beside_it(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.chdir(tmp_path)
    monkeypatch.chdir("..")
    (tmp_path / "mine.py").write_text("def plant(scene):\n    return scene.name\n")
    (tmp_path / "suite.toml").write_text('tasks = ["task01"]\nmethods = ["mppi"]\nplant = "mine.py:plant"\n')
    (entry,) = load_suite(tmp_path / "suite.toml").entries
    assert entry.run.plant == f"{tmp_path.name}/mine.py:plant"  # the same in every checkout
    assert make_plant(shipped("task01"), best(), entry.run) == "task01"
    before = make_trials(load_suite(tmp_path / "suite.toml"))[0][0].key
    (tmp_path / "mine.py").write_text("def plant(scene):\n    return 2\n")
    assert make_trials(load_suite(tmp_path / "suite.toml"))[0][0].key != before  # it is run again
    (tmp_path / "mine.py").rename(tmp_path / "mein.py")
    with pytest.raises(
        ConfigError, match=r"suite\.toml: plant .*: there is no file .*\n.*did you mean .*mein\.py:plant"
    ):
        load_suite(tmp_path / "suite.toml")


def test_an_option_without_a_value_is_refused_at_once():
    with pytest.raises(ConfigError, match="gain is not an assignment"):
        RunSpec().changed(plant_options=("gain",))
