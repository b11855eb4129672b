"""The rollout engines of the robot level by name."""

from __future__ import annotations

from oimppi_warp.clearance import Geometry
from oimppi_warp.compute import Compute
from oimppi_warp.config import RobotCost, RobotLevel
from oimppi_warp.dynamics.base import RobotDynamics
from oimppi_warp.dynamics.quasistatic import QuasistaticDynamics
from oimppi_warp.kernels.geometry import PoseField
from oimppi_warp.scene import Scene
from oimppi_warp.uncertainty import Draws

ENGINES = ("quasistatic", "newton")
"""Names of the engines."""


def make_dynamics(
    engine: str,
    scene: Scene,
    geometry: Geometry,
    level: RobotLevel,
    cost: RobotCost,
    *,
    dt: float,
    compute: Compute,
    draws: Draws,
    to_go: PoseField | None,
) -> RobotDynamics:
    """An engine: ``"quasistatic"``, or ``"newton"``, which is batched worlds on CUDA and C threads on the CPU.

    Args:
        engine: One of :data:`ENGINES`.
        scene: The task.
        geometry: Its shapes.
        level: Settings of the robot level.
        cost: Its weights.
        dt: Control period [s].
        compute: Where to compute.
        draws: Worlds that the rollouts are in.
        to_go: Cost-to-go of the object, where its weight is not zero [m].
    """
    if engine == "quasistatic":
        return QuasistaticDynamics(scene, geometry, level, cost, dt=dt, compute=compute, draws=draws, to_go=to_go)
    if compute.device == "cpu":
        from oimppi_warp.dynamics.newton_threads import NewtonThreads as Newton
    else:
        from oimppi_warp.dynamics.newton_worlds import NewtonWorlds as Newton
    return Newton(scene, geometry, level, cost, dt=dt, compute=compute, draws=draws, to_go=to_go)
