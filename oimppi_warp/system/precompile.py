"""Ahead-of-time compilation of every kernel that a run needs, for this machine's CPU or for a GPU elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NamedTuple

import warp as wp

from oimppi_warp.compute.device import EMULATED_GPU, start_warp
from oimppi_warp.compute.loading import known_modules
from oimppi_warp.config.presets import best
from oimppi_warp.config.settings import Config
from oimppi_warp.planning.factory import make_planner
from oimppi_warp.registries import METHODS
from oimppi_warp.scene import Scene


class Variant(NamedTuple):
    """A module as it is compiled for a launch.

    Attributes:
        module: The module.
        block: Number of threads per block.
        overloads: For each generic kernel of the module, its name and the signatures known at the time: Warp compiles
            the module again whenever one is added.
    """

    module: wp.Module
    block: int
    overloads: tuple[tuple[str, tuple[str, ...]], ...] = ()


_USUAL_BLOCK = 256
"""Default number of threads per block of a launch; on the CPU it is one."""
_ON_HOST = "oimppi_warp.kernels.fields.distance"
"""Module of distance fields, which are computed on the CPU whatever the device."""


def needed_on_cuda(scene: Scene, engines: Iterable[str], settings: Callable[[str], Config] = best) -> list[Variant]:
    """Lists the modules that planning on a GPU needs, found by planning on an emulated one.

    MuJoCo Warp chooses its kernels by the model and by the number of worlds, so each plan has as many samples as on the
    GPU, but few steps. Its choice does not depend on the device, apart from the number of threads, as long as the model
    is small enough for dense matrices (60 degrees of freedom); neither do our kernels. For task02 this was verified
    on an H200: no module had to be compiled for it.

    Args:
        scene: The task.
        engines: Names of the engines to be used there.
        settings: All settings of a method, by its name.
    """
    with record_modules() as found:
        for engine in engines:
            for method in METHODS:
                config = settings(method)
                knots = config.robot.optimizer.knots  # the noise has kernels of its own for each number of them
                short = replace(config.robot.optimizer, horizon=knots + 2, iterations=1)
                config = replace(config, robot=replace(config.robot, optimizer=short, substeps=1))
                make_planner(scene, config, method=method, engine=engine, device=EMULATED_GPU).warm_up()
    return [variant for variant in found if variant.module.name != _ON_HOST]


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
    for variant in variants:
        on_module(variant.module)
        with as_launched(variant):
            files += len(wp.compile_aot_module(variant.module, arch=arch))
    return files


@contextmanager
def as_launched(variant: Variant) -> Iterator[None]:
    """Puts a module into the state in which it was when the variant was recorded."""
    module = variant.module
    block, kept = module.options["block_dim"], {name: module.kernels[name].overloads for name, _ in variant.overloads}
    module.options["block_dim"] = variant.block
    for name, signatures in variant.overloads:
        module.kernels[name].overloads = {signature: kept[name][signature] for signature in signatures}
    module.mark_modified()
    try:
        yield
    finally:
        module.options["block_dim"] = block
        for name, overloads in kept.items():
            module.kernels[name].overloads = overloads
        module.mark_modified()


@contextmanager
def record_modules() -> Iterator[list[Variant]]:
    """Records the modules that Warp loads for the CPU in its context, with the block sizes that a GPU would use.

    The list is filled at the end. Loaded modules are first unloaded, so that exactly those that the recorded code needs
    are loaded again (from the kernel cache). With ``enable_cpu_blocks`` the CPU uses the block sizes of the launches. A
    launch of zero threads loads nothing, here as on a GPU: for example, the tendon kernels of a model without tendons.
    """
    start_warp()
    variants: list[Variant] = []
    usual = wp.config.enable_cpu_blocks, wp.get_suggested_block_size, wp.Module.load
    asked: dict[Variant, None] = {}
    generic: dict[Variant, None] = {}

    def suggest(kernel: wp.Kernel, device: wp.DeviceLike = None) -> tuple[int, int]:
        asked[Variant(kernel.module, _USUAL_BLOCK)] = None  # a GPU loads the kernel to answer
        return usual[1](kernel, device)

    def load(self: wp.Module, device: Any, block_dim: int | None = None, *files: Any, **options: Any) -> Any:
        kernels = self.kernels.items()
        overloads = tuple((name, tuple(kernel.overloads)) for name, kernel in kernels if kernel.is_generic)
        if overloads:
            generic[Variant(self, _on_gpu(block_dim or self.options["block_dim"]), overloads)] = None
        return usual[2](self, device, block_dim, *files, **options)

    for module in known_modules().values():
        module.unload()
    wp.config.enable_cpu_blocks, wp.get_suggested_block_size, wp.Module.load = True, suggest, load
    try:
        yield variants
    finally:
        wp.config.enable_cpu_blocks, wp.get_suggested_block_size, wp.Module.load = usual
    found = {
        Variant(module, _on_gpu(block)): None
        for module in known_modules().values()
        for context, block in module.execs
        if context is None  # modules for the CPU
    }
    several = {(variant.module, variant.block) for variant in generic}
    variants += {each: None for each in found if (each.module, each.block) not in several} | generic | asked


def _on_gpu(block: int) -> int:
    """Returns the number of threads per block on a GPU of a launch that has ``block`` of them on the CPU."""
    return block if block > 1 else _USUAL_BLOCK
