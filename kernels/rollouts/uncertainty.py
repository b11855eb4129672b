"""Rollouts in several draws of the world, and how their costs are combined into one."""

import warp as wp

from oimppi_warp.kernels.optimizers.update import LOST

wp.set_module_options({"enable_backward": False})


@wp.struct
class Draw:
    """One draw of the uncertain world parameters; see ``oimppi_warp.planning.engines.uncertainty.Draws``.

    Attributes:
        force: Factor on the object's friction force mu m g.
        tool_friction: Factor on the Coulomb coefficient of tool and object.
        pose: Error of the object's perceived planar pose [m, m, rad].
        tool: Offset of the tip in its own frame, across the tool [m].
    """

    force: float
    tool_friction: float
    pose: wp.vec3
    tool: wp.vec2


@wp.kernel
def combine_costs(
    # in:
    first: int,
    rolled: wp.array[float],
    draws: int,
    worst: int,
    # out:
    costs: wp.array[float],
):
    """Computes each sample's cost: the mean of the ``worst`` costliest of its ``draws`` rollouts.

    With ``worst = draws`` that is the mean over all rollouts, with ``worst = 1`` the largest cost, and in between the
    conditional value at risk (CVaR). A sample with a rollout whose cost is not finite is lost. Shapes: ``rolled``
    [sample * draws], ``costs`` [sample].
    """
    k = first + wp.tid()
    begin = k * draws
    lost = bool(False)
    for i in range(draws):
        c = rolled[begin + i]
        if not wp.isfinite(c) or c >= LOST:
            lost = True
    cost = float(wp.inf)
    if not lost:
        # The worst are taken in descending order; among equal costs, the earlier first.
        cost = float(0.0)
        bound = float(wp.inf)
        taken = int(-1)
        for _ in range(worst):
            best = float(-wp.inf)
            which = int(-1)
            for i in range(draws):
                c = rolled[begin + i]
                if (c < bound or (c == bound and i > taken)) and c > best:
                    best = c
                    which = i
            bound = best
            taken = which
            cost += best
        cost = cost / float(worst)
    costs[k] = cost
