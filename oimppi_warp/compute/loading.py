"""Loading of modules of kernels: without optimization, or in the background."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress

import warp as wp

from oimppi_warp.compute.device import start_warp

_OWN = "oimppi_warp."
"""Beginning of the names of this package's modules."""


def known_modules() -> dict[str, wp.Module]:
    """Returns every module known to Warp by its name, including those of kernels made at run time."""
    from warp._src.context import user_modules  # Warp lists them nowhere else

    return dict(user_modules)


@contextmanager
def quick_compilation() -> Iterator[None]:
    """Compiles without optimization those kernels of other packages that are loaded meanwhile.

    It takes less than half of the time, and suits kernels that run once. The packages must have been imported. Modules
    that were loaded so stay as they are for the rest of the process.
    """
    others = [
        module
        for name, module in known_modules().items()
        if not name.startswith(_OWN) and module.options["optimization_level"] is None
    ]
    for module in others:
        module.options["optimization_level"] = 0
    try:
        yield
    finally:
        for module in others:
            module.options["optimization_level"] = None


_under_way: dict[wp.Module, Future[None]] = {}
"""Modules that are loaded in the background, or wait for it."""


@contextmanager
def loading(modules: Sequence[wp.Module]) -> Iterator[None]:
    """Loads modules of kernels for the CPU in the background, in this order, until the block ends.

    Whoever needs one of them within the block calls :func:`await_loaded` first; otherwise it is compiled twice. Those
    that have not begun by the end of the block are left out. Such blocks can be nested.
    """
    start_warp()
    with ThreadPoolExecutor(1, thread_name_prefix="oimppi-kernels") as background:
        new = [module for module in modules if module not in _under_way]
        own = {module: background.submit(wp.force_load, "cpu", [module]) for module in new}
        _under_way.update(own)
        try:
            yield
        finally:
            for module, future in own.items():
                future.cancel()
                _under_way.pop(module, None)


def await_loaded(modules: Iterable[wp.Module]) -> None:
    """Waits for those of the modules that are being loaded by :func:`loading`; raises the errors of their compiler."""
    for module in modules:
        if (future := _under_way.get(module)) is not None:
            with suppress(CancelledError):  # a block in another thread has ended before it began
                future.result()
