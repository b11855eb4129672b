"""Modules of kernels that another process is asked to compile."""

from __future__ import annotations

import warp as wp

from oimppi_warp.kernels.optimizers.update import weigh_samples


def small() -> list[wp.Module]:
    """A module that compiles quickly."""
    return [weigh_samples.module]


def slow() -> list[wp.Module]:
    """Modules that are never found."""
    import time

    time.sleep(60.0)
    return []


def failing() -> list[wp.Module]:
    """Raises an error in another process, but not in that of the tests."""
    import __main__

    if (__main__.__spec__ and __main__.__spec__.name) == "oimppi_warp.compute.build_process":
        raise RuntimeError("the other process")
    return small()
