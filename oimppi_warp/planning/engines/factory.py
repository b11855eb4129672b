"""The Newton engine, which has one implementation for the CPU and one for CUDA."""

from __future__ import annotations

from collections.abc import Mapping

from oimppi_warp.planning.engines.dynamics import RobotDynamics, RolloutTask
from oimppi_warp.registries import ENGINES


class NewtonEngine:
    """Full physics: batched worlds on CUDA, C threads on the CPU.

    Attributes:
        known_success, slower_than: See :class:`oimppi_warp.planning.engines.dynamics.RobotDynamics`.
    """

    # Share of task 02's starts with the preset ``best`` (``docs/results.md``); plain MPPI has not been measured.
    known_success: Mapping[str, float] = {"cloi": 0.9, "soi": 0.8}
    slower_than: frozenset[str] = frozenset({"quasistatic"})  # by a factor of a hundred (``docs/performance.md``)

    def __call__(self, task: RolloutTask) -> RobotDynamics:
        """Returns the engine for the task's device."""
        if task.compute.on_gpu:
            from oimppi_warp.planning.engines.newton_worlds import NewtonWorlds as Newton
        else:
            from oimppi_warp.planning.engines.newton_threads import NewtonThreads as Newton
        return Newton(task)


newton = NewtonEngine()


def make_dynamics(engine: str, task: RolloutTask) -> RobotDynamics:
    """Makes an engine by its name in :data:`oimppi_warp.registries.ENGINES`.

    Raises:
        ConfigError: There is no such engine.
    """
    return ENGINES.get_checked(engine)(task)
