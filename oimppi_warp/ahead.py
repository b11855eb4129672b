"""Compiling ahead of time: every kernel that a run needs, for this machine's CPU or for a GPU that is elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from oimppi_warp.clearance import build_geometry
from oimppi_warp.compute import Compute
from oimppi_warp.config import Config
from oimppi_warp.dynamics.base import RolloutTask
from oimppi_warp.dynamics.newton_worlds import NewtonWorlds
from oimppi_warp.methods import METHODS, make_planner
from oimppi_warp.mppi import Mppi
from oimppi_warp.observation import Observation, planar_transform
from oimppi_warp.scene import Scene

Variant = tuple[wp.Module, int]
"""A module as it is compiled: with the number of threads in a block."""


def needed_on_cuda(scene: Scene, config: Config, engine: str) -> list[Variant]:
    """What planning on a GPU launches, found by planning small on the CPU.

    MuJoCo Warp chooses its kernels by the model. Where it asks for the device as well, it does so for the number of
    threads, not for another kernel, as long as the model is small enough for dense matrices (60 degrees of freedom);
    ours asks for none. Whether a GPU needs nothing else has not been tried.

    Args:
        scene: The task.
        config: All settings.
        engine: ``"quasistatic"`` or ``"newton"``.
    """
    small = replace(config.robot.mppi, samples=2, horizon=2, knots=0, iterations=1)
    level = replace(config.robot, mppi=small, substeps=1)
    with _recorded() as found:
        for method in METHODS:
            planner = make_planner(
                scene, replace(config, robot=level), method=method, engine="quasistatic", device="cpu", threads=1
            )
            planner.warm_up()
        if engine == "newton":
            geometry = build_geometry(scene, "cpu")
            compute = Compute("cpu", threads=1)
            worlds = NewtonWorlds(
                RolloutTask(
                    scene=scene,
                    geometry=geometry,
                    level=level,
                    cost=config.cost,
                    dt=config.control_period,
                    compute=compute,
                )
            )
            mppi = Mppi(worlds, small, seed=0)
            start = np.array(scene.start)
            transform = planar_transform(scene.start, scene.object.rest_height)
            joints = scene.robot.start
            worlds.set_state(Observation(0.0, joints, np.zeros_like(joints), start, transform), start)
            compute.step([*mppi.improve, worlds.trace(mppi.nominal, mppi.costs), mppi.shift])()
    return list(found)


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
def _recorded() -> Iterator[list[Variant]]:
    """Notes what is launched, with the block size that a GPU would be given."""
    found: dict[Variant, None] = {}
    launches = {"launch": wp.launch, "launch_tiled": wp.launch_tiled}

    def noting(launch: Callable[..., Any]) -> Callable[..., Any]:
        def run(kernel: Any, *args: Any, **kwargs: Any) -> Any:
            found[kernel.module, kwargs.get("block_dim", 256)] = None
            return launch(kernel, *args, **kwargs)

        return run

    variants: list[Variant] = []
    try:
        for name, launch in launches.items():
            setattr(wp, name, noting(launch))
        yield variants
    finally:
        for name, launch in launches.items():
            setattr(wp, name, launch)
        variants += found
