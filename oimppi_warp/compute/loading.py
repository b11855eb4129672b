"""Loading of modules of kernels: without optimization, in the background, or compiled by another process."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path

import warp as wp

from oimppi_warp.compute.build_process import BuildProcess, Modules
from oimppi_warp.compute.device import core_count, start_warp

_OWN = "oimppi_warp."
"""Beginning of the names of this package's modules."""
_HASH = 7 * "[0-9a-f]"
"""Pattern of the end of a module's folder in Warp's cache."""


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
def loading(modules: Sequence[wp.Module], *, elsewhere: Modules = tuple) -> Iterator[None]:
    """Loads modules of kernels for the CPU in the background, in this order, until the block ends.

    Whoever needs one of them within the block calls :func:`await_loaded` first; otherwise it is compiled twice. Those
    that have not begun by the end of the block are left out. Such blocks can be nested.

    Args:
        modules: The modules.
        elsewhere: Returns further modules, which are loaded after these. If Warp's cache has no version of any of
            them, another process compiles them meanwhile.
    """
    start_warp()
    last = elsewhere()
    with ThreadPoolExecutor(1, thread_name_prefix="oimppi-kernels") as background:
        new = [module for module in (*modules, *last) if module not in _under_way]
        # A second process gains nothing on one core, and costs the time of its imports.
        begin = core_count() > 1 and not {*last}.isdisjoint(new) and not any(_is_cached(module) for module in last)
        process = BuildProcess(elsewhere) if begin else None

        def load(module: wp.Module) -> None:
            if process is None or module not in last or process.wait():
                wp.force_load("cpu", [module])

        own = {module: background.submit(load, module) for module in new}
        _under_way.update(own)
        try:
            yield
        finally:
            for module, future in own.items():
                future.cancel()
                _under_way.pop(module, None)
            if process is not None:
                process.stop()


def _is_cached(module: wp.Module) -> bool:
    """Returns whether Warp's cache contains some version of a module."""
    folder = wp.config.kernel_cache_dir
    return folder is not None and any(Path(folder).glob(f"wp_{escape(module.name)}_{_HASH}"))


def await_loaded(modules: Iterable[wp.Module]) -> None:
    """Waits for those of the modules that are being loaded by :func:`loading`; raises the errors of their compiler."""
    for module in modules:
        if (future := _under_way.get(module)) is not None:
            with suppress(CancelledError):  # a block in another thread has ended before it began
                future.result()
