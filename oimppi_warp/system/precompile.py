"""Ahead-of-time compilation of every kernel that a run needs, for this machine's CPU or for a GPU elsewhere."""

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
"""A module and the number of threads per block that it is compiled for."""

_USUAL_BLOCK = 256
"""Default number of threads per block of a launch; on the CPU it is one."""


def needed_on_cuda(scene: Scene, config: Config, engines: Iterable[str]) -> list[Variant]:
    """Lists the modules that planning on a GPU needs, found by planning on the CPU with few samples.

    MuJoCo Warp chooses its kernels by the model. Its choice does not depend on the device, apart from the number of
    threads, as long as the model is small enough for dense matrices (60 degrees of freedom); neither do our kernels.
    This has not been verified on a GPU.

    Args:
        scene: The task.
        config: All settings.
        engines: Names of the engines to be used there.
    """
    small = replace(config.robot.optimizer, samples=2, horizon=2, knots=0, iterations=1)
    level = replace(config.robot, optimizer=small, substeps=1)
    few = replace(config, robot=level)
    with record_modules() as found:
        wp.load_module(distance, device="cpu")  # fields cached on this machine may not be cached on the other
        for engine in engines:
            # On the CPU the Newton engine has another implementation, so the remaining kernels are found with the
            # quasi-static engine.
            around = "quasistatic" if engine == "newton" else engine
            for method in METHODS:
                make_planner(scene, few, method=method, engine=around, device="cpu", threads=1).warm_up()
            if engine == "newton":
                _plan_with_worlds(scene, few)
    return found


def _plan_with_worlds(scene: Scene, config: Config) -> None:
    """Runs one step of the Newton engine that a GPU would use, with batched worlds, on the CPU."""
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
        if context is None  # modules for the CPU
    }
    variants += found


def _modules() -> list[wp.Module]:
    """Returns every module known to Warp, including kernels made at run time.

    Warp has no public list of them. The tests fail if either of these names is removed.
    """
    return list(user_modules.values())
