"""Ahead-of-time compilation of every kernel that a run needs, for this machine's CPU or for a GPU elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import warp as wp
from warp._src.context import user_modules

from oimppi_warp.compute.device import EMULATED_GPU, start_warp
from oimppi_warp.config.presets import best
from oimppi_warp.config.settings import Config
from oimppi_warp.planning.factory import make_planner
from oimppi_warp.registries import METHODS
from oimppi_warp.scene import Scene

Variant = tuple[wp.Module, int]
"""A module and the number of threads per block that it is compiled for."""

_USUAL_BLOCK = 256
"""Default number of threads per block of a launch; on the CPU it is one."""
_ON_HOST = "oimppi_warp.kernels.fields.distance"
"""Module of distance fields, which are computed on the CPU whatever the device."""


def needed_on_cuda(scene: Scene, engines: Iterable[str], settings: Callable[[str], Config] = best) -> list[Variant]:
    """Lists the modules that planning on a GPU needs, found by planning on an emulated one.

    MuJoCo Warp chooses its kernels by the model and by the number of worlds, so each plan has as many samples as on the
    GPU, but few steps. Its choice does not depend on the device, apart from the number of threads, as long as the model
    is small enough for dense matrices (60 degrees of freedom); neither do our kernels. This has not been verified on a
    GPU.

    Args:
        scene: The task.
        engines: Names of the engines to be used there.
        settings: All settings of a method, by its name.
    """
    with record_modules() as found:
        for engine in engines:
            for method in METHODS:
                config = settings(method)
                short = replace(config.robot.optimizer, horizon=2, knots=0, iterations=1)
                config = replace(config, robot=replace(config.robot, optimizer=short, substeps=1))
                make_planner(scene, config, method=method, engine=engine, device=EMULATED_GPU).warm_up()
    return [(module, block) for module, block in found if module.name != _ON_HOST]


def compile_for(variants: list[Variant], arch: int, on_module: Callable[[wp.Module], None]) -> int:
    """Compiles modules for an architecture into Warp's kernel cache, where a run on such a GPU finds them.

    Args:
        variants: Modules to compile.
        arch: Architecture, such as 90 for sm_90; no such GPU is needed.
        on_module: Callback before each module.

    Returns:
        Number of files.
    """
    files = 0
    for module, block in variants:
        on_module(module)
        usual = module.options["block_dim"]
        module.options["block_dim"] = block
        try:
            files += len(wp.compile_aot_module(module, arch=arch))
        finally:
            module.options["block_dim"] = usual
    return files


@contextmanager
def record_modules() -> Iterator[list[Variant]]:
    """Records the modules that Warp loads for the CPU in its context, with the block sizes that a GPU would use.

    The list is filled at the end. Loaded modules are first unloaded, so that exactly those that the recorded code needs
    are loaded again (from the kernel cache). With ``enable_cpu_blocks`` the CPU uses the block sizes of the launches. A
    launch of zero threads loads nothing, here as on a GPU: for example, the tendon kernels of a model without tendons.
    """
    start_warp()
    variants: list[Variant] = []
    usual = wp.config.enable_cpu_blocks, wp.get_suggested_block_size
    asked: dict[Variant, None] = {}

    def suggest(kernel: wp.Kernel, device: wp.DeviceLike = None) -> tuple[int, int]:
        asked[kernel.module, _USUAL_BLOCK] = None  # a GPU loads the kernel to answer
        return usual[1](kernel, device)

    for module in _modules():
        module.unload()
    wp.config.enable_cpu_blocks, wp.get_suggested_block_size = True, suggest
    try:
        yield variants
    finally:
        wp.config.enable_cpu_blocks, wp.get_suggested_block_size = usual
    found = {
        (module, block if block > 1 else _USUAL_BLOCK): None
        for module in _modules()
        for context, block in module.execs
        if context is None  # modules for the CPU
    }
    variants += found | asked


def _modules() -> list[wp.Module]:
    """Returns every module known to Warp, including kernels made at run time.

    Warp has no public list of them. The tests fail if either of these names is removed.
    """
    return list(user_modules.values())
