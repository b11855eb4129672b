"""Modules of kernels: the optimization they are compiled with, and loading them in the background."""

from __future__ import annotations

import threading
import time

import pytest
import warp as wp

from oimppi_warp.compute.loading import await_loaded, known_modules, loading, quick_compilation
from oimppi_warp.config.presets import best
from oimppi_warp.config.run_spec import RunSpec
from oimppi_warp.kernels.fields import cost_to_go, distance
from oimppi_warp.planning.early_kernels import setup_kernels, step_kernels
from oimppi_warp.planning.factory import make_planner
from oimppi_warp.registries import METHODS
from oimppi_warp.runtime.estimator import Estimator
from oimppi_warp.usd import load_scene


def levels() -> dict[str, int | None]:
    """The optimization level of each module that is known, ``None`` for the default."""
    return {name: module.options["optimization_level"] for name, module in known_modules().items()}


def test_only_kernels_of_other_packages_are_compiled_without_optimization():
    import newton.solvers  # noqa: F401

    before = levels()
    with quick_compilation():
        during = levels()
    others = {name for name in before if not name.startswith("oimppi_warp.")}
    assert any(name.startswith("newton.") for name in others)
    assert all(during[name] == 0 for name in others if before[name] is None)
    assert all(during[name] == before[name] for name in before if name not in others)
    assert levels() == before


def test_backward_passes_are_left_out_of_named_modules_only():
    import newton.solvers  # noqa: F401

    name = "newton._src.solvers.mujoco.kernels"  # which a first run needs
    backward = {it: module.options["enable_backward"] for it, module in known_modules().items()}
    with quick_compilation(without_gradients=[name]):
        during = {it: module.options["enable_backward"] for it, module in known_modules().items()}
    assert backward[name]
    assert during == {**backward, name: False}
    assert backward == {it: module.options["enable_backward"] for it, module in known_modules().items()}


MODULE = wp.get_module(cost_to_go.__name__)


def test_a_module_is_loaded_once_it_has_been_waited_for():
    MODULE.unload()
    with loading([MODULE]):
        await_loaded([MODULE])
        assert MODULE.execs
    await_loaded([MODULE])  # nothing is under way any more


def test_what_an_outer_block_loads_is_not_loaded_again(monkeypatch):
    loaded = []
    monkeypatch.setattr(wp, "force_load", lambda _device, modules: loaded.extend(modules))
    other = wp.get_module(distance.__name__)
    with loading([MODULE]):
        with loading([MODULE, other]):
            await_loaded([MODULE, other])
        await_loaded([MODULE])
    assert loaded.count(MODULE) == loaded.count(other) == 1


def test_who_waits_for_a_module_goes_on_when_the_block_of_another_thread_ends(monkeypatch):
    free = threading.Event()
    monkeypatch.setattr(wp, "force_load", lambda _device, modules: free.wait(10.0))
    other, went_on = wp.get_module(distance.__name__), threading.Event()

    def wait() -> None:
        await_loaded([MODULE])
        went_on.set()

    with loading([other, MODULE]):
        waiting = threading.Thread(target=wait, daemon=True)
        waiting.start()
        time.sleep(0.2)
        assert not went_on.is_set()
        threading.Timer(0.2, free.set).start()
    waiting.join(10.0)
    assert went_on.is_set()


def test_modules_that_have_not_begun_by_the_end_of_the_block_are_left_out(monkeypatch):
    loaded, free = [], threading.Event()

    def load(_device: str, modules: list[wp.Module]) -> None:
        loaded.extend(modules)
        free.wait(10.0)

    monkeypatch.setattr(wp, "force_load", load)
    other = wp.get_module(distance.__name__)
    with pytest.raises(ValueError, match="the block"), loading([MODULE, other]):
        threading.Timer(0.3, free.set).start()
        while not loaded:
            time.sleep(0.01)
        raise ValueError("the block")
    assert loaded == [MODULE]


def test_an_error_of_the_compiler_is_raised_where_the_module_is_needed(monkeypatch):
    def fail(*arguments: object) -> None:
        raise RuntimeError("the compiler")

    monkeypatch.setattr(wp, "force_load", fail)
    with loading([MODULE]):
        pass
    with loading([MODULE]), pytest.raises(RuntimeError, match="the compiler"):
        await_loaded([MODULE])


@pytest.mark.parametrize("method", METHODS)
def test_a_run_with_the_default_settings_compiles_nothing_that_was_not_begun_early(method):
    scene, config, spec = load_scene("task02"), best(method), RunSpec(method=method, device="cpu", engine="quasistatic")
    early = {*setup_kernels(scene, config), *step_kernels(config, spec)}
    for module in known_modules().values():
        module.unload()
    make_planner(scene, config, spec).warm_up()
    Estimator(scene, config)
    loaded = {module for module in known_modules().values() if module.execs}
    own = {module for module in loaded if module.name.startswith("oimppi_warp.kernels.")}
    assert len(own) > 5
    assert [module.name for module in own - early] == []
