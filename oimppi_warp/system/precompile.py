"""Compiling ahead of time: every kernel that a run needs, for this machine's CPU or for a GPU that is elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import warp as wp
from warp._src.context import user_modules

from oimppi_warp.compute.device import start_warp
from oimppi_warp.compute.step import Compute
from oimppi_warp.config.settings import Config
from oimppi_warp.geometry.fields import build_geometry
from oimppi_warp.kernels.fields import distance
from oimppi_warp.observation import Observation, planar_transform
from oimppi_warp.planning.engines.dynamics import RolloutTask
from oimppi_warp.planning.engines.newton_worlds import NewtonWorlds
from oimppi_warp.planning.factory import make_planner
from oimppi_warp.planning.optimizers.optimizer import make_optimizer
from oimppi_warp.registries import METHODS
from oimppi_warp.scene import Scene

Variant = tuple[wp.Module, int]
"""A module as it is compiled: with the number of threads in a block."""

_USUAL_BLOCK = 256
"""Threads in a block of a launch that does not say; on the CPU that is one."""


def needed_on_cuda(scene: Scene, config: Config, engines: Iterable[str]) -> list[Variant]:
    """What planning on a GPU launches, found by planning small on the CPU.

    MuJoCo Warp chooses its kernels by the model. Where it asks for the device as well, it does so for the number of
    threads, not for another kernel, as long as the model is small enough for dense matrices (60 degrees of freedom);
    ours asks for none. Whether a GPU needs nothing else has not been tried.

    Args:
        scene: The task.
        config: All settings.
        engines: Names of the engines that are to be used there.
    """
    small = replace(config.robot.optimizer, samples=2, horizon=2, knots=0, iterations=1)
    level = replace(config.robot, optimizer=small, substeps=1)
    few = replace(config, robot=level)
    with record_modules() as found:
        wp.load_module(distance, device="cpu")  # fields that are in the cache here may not be there
        for engine in engines:
            # On the CPU the Newton engine is another one: what surrounds it is launched with the quasi-static engine.
            around = "quasistatic" if engine == "newton" else engine
            for method in METHODS:
                make_planner(scene, few, method=method, engine=around, device="cpu", threads=1).warm_up()
            if engine == "newton":
                _plan_with_worlds(scene, few)
    return found


def _plan_with_worlds(scene: Scene, config: Config) -> None:
    """One step of the Newton engine that a GPU would use: batched worlds, here on the CPU."""
    geometry = build_geometry(scene, "cpu")
    compute = Compute("cpu", threads=1)
    worlds = NewtonWorlds(
        RolloutTask(
            scene=scene,
            geometry=geometry,
            level=config.robot,
            cost=config.cost,
            dt=config.control_period,
            compute=compute,
        )
    )
    mppi = make_optimizer(worlds, config.robot.optimizer, seed=0)
    start = np.array(scene.start)
    transform = planar_transform(scene.start, scene.object.rest_height)
    joints = scene.robot.start
    worlds.set_state(Observation(0.0, joints, np.zeros_like(joints), start, transform), start)
    compute.step([*mppi.improve, worlds.trace(mppi.nominal, mppi.costs), mppi.shift])()


def compile_for(variants: list[Variant], arch: int, on_module: Callable[[wp.Module], None]) -> int:
    """Compiles modules for an architecture into Warp's kernel cache, where a run on such a GPU looks for them.

    Args:
        variants: What to compile.
        arch: Like 90 for sm_90; no such GPU is needed.
        on_module: Called before each module.

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
    """Lists, at its end, what Warp loaded for the CPU in between, with the block sizes that a GPU would be given.

    Warp is made to forget what it has loaded, so that what the rehearsal needs is loaded again (out of the kernel
    cache), and nothing else is. With ``enable_cpu_blocks`` the CPU takes the block sizes that launches ask for. A
    launch of no threads loads nothing, here as on a GPU: kernels for tendons, say, of a model that has none.
    """
    start_warp()
    variants: list[Variant] = []
    usual = wp.config.enable_cpu_blocks
    for module in _modules():
        module.unload()
    wp.config.enable_cpu_blocks = True
    try:
        yield variants
    finally:
        wp.config.enable_cpu_blocks = usual
    found = {
        (module, block if block > 1 else _USUAL_BLOCK): None
        for module in _modules()
        for context, block in module.execs
        if context is None  # the CPU's
    }
    variants += found


def _modules() -> list[wp.Module]:
    """Every module that Warp knows of, the kernels made at run time included.

    Warp lists them nowhere else. The tests fail where either name is no longer there.
    """
    return list(user_modules.values())
