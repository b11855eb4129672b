"""Modules of kernels that another process is asked to compile."""

from __future__ import annotations

import time

import warp as wp

from oimppi_warp.kernels.optimizers.cem import select_elites
from oimppi_warp.kernels.optimizers.update import weigh_samples


def small() -> list[wp.Module]:
    """A module that compiles quickly."""
    return [weigh_samples.module]


def two() -> list[wp.Module]:
    """Two modules."""
    return [*small(), select_elites.module]


def slow() -> list[wp.Module]:
    """The same module, after a minute in another process."""
    if _elsewhere():
        time.sleep(60.0)
    return small()


def failing() -> list[wp.Module]:
    """The same module, but an error in another process."""
    if _elsewhere():
        raise RuntimeError("the other process")
    return small()


def different() -> list[wp.Module]:
    """Another module in another process."""
    return [select_elites.module] if _elsewhere() else small()


def _elsewhere() -> bool:
    """Returns whether this code runs in a build process, instead of the process of the tests."""
    import __main__

    return __main__.__spec__ is not None and __main__.__spec__.name == "oimppi_warp.compute.build_process"
