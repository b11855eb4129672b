"""Construction of the planner for a run."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from oimppi_warp.compute.step import Compute, making_planner
from oimppi_warp.config.overrides import validate
from oimppi_warp.config.run_spec import RunSpec
from oimppi_warp.config.settings import Config
from oimppi_warp.planning.engine_choice import choose_engine
from oimppi_warp.planning.planner import Planner
from oimppi_warp.planning.resolve import resolve
from oimppi_warp.registries import METHODS
from oimppi_warp.scene import Scene


def make_planner(
    scene: Scene,
    config: Config,
    spec: RunSpec | None = None,
    *,
    control_period: float | None = None,
    report: Callable[[str], None] = lambda _: None,
    **options: Any,
) -> Planner:
    """Makes a planner for a scene.

    Args:
        scene: The task.
        config: All settings.
        spec: Method, engine, device, threads and seed. With the engine ``"auto"``, a few plans are timed.
        control_period: The plant's control period, if it is fixed [s]; else that of ``config`` is used.
        report: Called with what is being done while engines are timed.
        **options: Fields of ``spec`` to change, for example ``method="soi"``.

    Raises:
        ConfigError: The method or the engine does not exist, or a setting cannot be used.
        DeviceError: There is no such device.
    """
    spec = (spec or RunSpec()).changed(**options)
    config = resolve(validate(config), scene, control_period=control_period).config
    method = METHODS.get_checked(spec.method)

    def make(engine: str) -> Planner:
        compute = Compute(spec.device, threads=spec.threads)
        return method(scene, config, engine=engine, compute=compute, seed=spec.seed)

    with making_planner:
        if spec.engine != "auto":
            return make(spec.engine)
        choice = choose_engine(spec.method, config.control_period, make, report=report)
    choice.planner.engine_reason = choice.reason
    return choice.planner
