"""Kernels that can be compiled before the planner that uses them is made."""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import partial
from typing import Any

import warp as wp

from oimppi_warp.compute.device import pick_device
from oimppi_warp.compute.loading import known_modules, loading
from oimppi_warp.config.run_spec import RunSpec
from oimppi_warp.config.settings import Config, Sampling
from oimppi_warp.kernels.detour import take_detour
from oimppi_warp.kernels.fields import cost_to_go, distance, stance
from oimppi_warp.kernels.optimizers.sampling import make_sample_controls
from oimppi_warp.kernels.optimizers.update import make_shift_nominal, make_update_nominal, weigh_samples
from oimppi_warp.kernels.rollouts.object import object_rollout
from oimppi_warp.kernels.rollouts.quasistatic import make_upright_rollout
from oimppi_warp.kernels.tracking import make_track_object
from oimppi_warp.kernels.upright import make_upright_clearance
from oimppi_warp.kernels.upright_step import allowed_velocity
from oimppi_warp.planning.engines.cost_terms import weighted_terms
from oimppi_warp.scene import Scene


def loading_early(scene: Scene, config: Config, spec: RunSpec) -> AbstractContextManager[None]:
    """Loads, in the background until the block ends, the kernels of an episode that is made within it.

    Kernels that are known only once there is a planner are left out; they are compiled when it is warmed up.

    Args:
        scene: The task.
        config: All settings.
        spec: The options of the run; ``device``, ``method`` and ``engine`` are used.

    Raises:
        DeviceError: There is no such device.
    """
    flagged = partial(kernels_with_own_flags, config, spec)
    left_out = {*flagged()}
    modules = [*setup_kernels(scene, config), *step_kernels(config, spec)]
    return loading([module for module in modules if module not in left_out], by_other_process=flagged)


def setup_kernels(scene: Scene, config: Config) -> list[wp.Module]:
    """Returns the modules of the kernels that run on the CPU while planner and estimator are made."""
    fields = [known_modules()[module.__name__] for module in (distance, stance, cost_to_go)]
    kernels = [make_track_object(scene.robot.chain)]
    if config.robot.controls == "tool":
        kernels.append(make_upright_clearance(scene.robot.chain))
    return [*fields, *(kernel.module for kernel in kernels)]


def step_kernels(config: Config, spec: RunSpec) -> list[wp.Module]:
    """Returns the modules of the kernels of a control step on the CPU."""
    if pick_device(spec.device) != "cpu":
        return []
    kernels: list[Any] = [take_detour]
    if spec.method != "mppi":
        kernels += [*_of_optimizer(config.object.optimizer, 3), object_rollout]
    if config.robot.controls == "tool" and spec.engine in ("auto", "quasistatic"):
        kernels += [*_of_optimizer(config.robot.optimizer, 3), allowed_velocity]
        added = tuple((term.name, term.function) for term in weighted_terms(config.cost))
        # It comes last, since it takes longest, and Warp compiles nothing else meanwhile if its flags set LLVM's.
        kernels.append(make_upright_rollout(added))
    return list(dict.fromkeys(kernel.module for kernel in kernels))


def kernels_with_own_flags(config: Config, spec: RunSpec) -> list[wp.Module]:
    """Returns those of :func:`step_kernels` that have compiler flags of their own.

    They share no precompiled header with the others, so that it costs little to have another process compile them. They
    take about half of the time that all kernels of the package do.
    """
    return [module for module in step_kernels(config, spec) if module.options["cpu_compiler_flags"]]


def _of_optimizer(settings: Sampling, size: int) -> list[Any]:
    """Returns the kernels of an optimizer of controls with ``size`` entries."""
    if settings.kind != "mppi":
        return []
    sample = make_sample_controls(size, settings.knots)
    return [sample, weigh_samples, make_update_nominal(size), make_shift_nominal(size)]
