"""Loading of modules of kernels: without optimization, in the background, or compiled by another process."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from glob import escape
from pathlib import Path
from typing import Any

import warp as wp

from oimppi_warp.compute.build_process import BuildProcess, ModuleSource
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
def quick_compilation(*, without_gradients: Collection[str] = ()) -> Iterator[None]:
    """Compiles without optimization those kernels of other packages that are loaded meanwhile.

    It takes less than half of the time, and suits kernels that run once. The packages must have been imported. Modules
    that were loaded so stay as they are for the rest of the process.

    Args:
        without_gradients: Names of modules whose kernels nobody differentiates: their backward passes, which are more
            than half of the work, are not compiled.
    """
    known = known_modules()
    quick: dict[str, dict[str, Any]] = {
        name: {"optimization_level": 0}
        for name, module in known.items()
        if not name.startswith(_OWN) and module.options["optimization_level"] is None
    }
    for name in known.keys() & without_gradients:
        quick.setdefault(name, {})["enable_backward"] = False
    before = {name: {option: known[name].options[option] for option in options} for name, options in quick.items()}
    for name, options in quick.items():
        known[name].options.update(options)
    try:
        yield
    finally:
        for name, options in before.items():
            known[name].options.update(options)


_under_way: dict[wp.Module, Future[None]] = {}
"""Modules that are loaded in the background, or wait for it."""


@contextmanager
def loading(modules: Sequence[wp.Module], *, by_other_process: ModuleSource = tuple) -> Iterator[None]:
    """Loads modules of kernels for the CPU in the background, in this order, until the block ends.

    Whoever needs one of them within the block calls :func:`await_loaded` first; otherwise it is compiled twice. Those
    that are not being loaded by the end of the block are left out. Such blocks can be nested.

    Args:
        modules: The modules.
        by_other_process: Returns further modules, which are loaded after these. In a first run, when Warp's cache has
            no version of some of them, another process compiles them meanwhile; if there is only one core, it would
            gain nothing. After an update, when there are earlier versions, they are compiled here.
    """
    start_warp()
    last = by_other_process()
    with ExitStack() as stack:
        background = stack.enter_context(ThreadPoolExecutor(1, thread_name_prefix="oimppi-kernels"))
        new = [module for module in (*modules, *last) if module not in _under_way]
        own: dict[wp.Module, Future[None]] = {}
        stack.callback(_leave_out, own)
        worthwhile = core_count() > 1 and wp.config.cache_kernels
        if worthwhile and any(module in new and not _is_cached(module) for module in last):
            process = BuildProcess(by_other_process)
            stack.callback(process.stop)
        else:
            process = None

        def load(module: wp.Module) -> None:
            if process is None or module not in last or process.wait():
                wp.force_load("cpu", [module])

        for module in new:
            own[module] = _under_way[module] = background.submit(load, module)
        yield


def _leave_out(loads: dict[wp.Module, Future[None]]) -> None:
    """Cancels those loads that have not begun, and forgets all."""
    for module, future in loads.items():
        future.cancel()
        _under_way.pop(module, None)


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
