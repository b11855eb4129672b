"""Modules of kernels: the optimization they are compiled with, and loading them in the background."""

from __future__ import annotations

import pytest
import warp as wp

from oimppi_warp.compute.device import known_modules, loading, quick_compilation
from oimppi_warp.kernels.fields import cost_to_go


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


def test_modules_are_loaded_by_the_end_of_the_block():
    module = wp.get_module(cost_to_go.__name__)
    module.unload()
    with loading(cost_to_go.__name__):
        pass
    assert module.execs


def test_an_error_in_the_block_is_the_one_that_is_raised(monkeypatch):
    def fail(*arguments: object) -> None:
        raise RuntimeError("the compiler")

    monkeypatch.setattr(wp, "force_load", fail)
    with pytest.raises(ValueError, match="the block"), loading(cost_to_go.__name__):
        raise ValueError("the block")
    with pytest.raises(RuntimeError, match="the compiler"), loading(cost_to_go.__name__):
        pass
