"""Says in words why all samples of a plan were lost: the input or the cost term that made their costs not finite."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from oimppi_warp.compute.step import using_gpu
from oimppi_warp.kernels.costs import stage_costs
from oimppi_warp.kernels.optimizers.update import LOST

if TYPE_CHECKING:
    from oimppi_warp.planning.engines.dynamics import RobotDynamics
    from oimppi_warp.planning.engines.tip_controls import TipControls
    from oimppi_warp.planning.planner import Planner

_EXAMINED = 16
"""Number of samples whose cost terms are examined."""


def why_lost(planner: Planner, rollouts: RobotDynamics | TipControls) -> str:
    """Returns the reason why no sample of the latest plan has a finite cost, in one line.

    The inputs are checked first, in the order in which they are used, and then the terms of some of the samples.

    Args:
        planner: The planner, right after it planned.
        rollouts: The dynamics of its samples.
    """
    samples = planner.optimizer.settings.samples
    with using_gpu:
        cause = _input_cause(planner) or _term_cause(planner, rollouts)
    return f"all {samples} samples were lost: {cause}"


def _input_cause(planner: Planner) -> str:
    """Returns which input of the robot level has a number that is not finite; empty if none has."""
    dynamics, optimizer = planner.dynamics, planner.optimizer
    inputs = {
        "the goal": planner.goal,
        "the reference, the object's planned motion": dynamics.reference.host,
        "the waypoint of the tip": dynamics.waypoint.host,
        "the covariance of the noise": optimizer.noise.host,
        "the sampled controls": optimizer.controls.numpy(),
    }
    for name, values in inputs.items():
        numbers = np.asarray(values, dtype=float)
        if not np.isfinite(numbers).all():
            first = [round(value, 4) for value in numbers.reshape(-1)[:3].tolist()]
            return f"{name} is not finite ({', '.join(map(str, first))}{', ...' if numbers.size > 3 else ''})"
    return ""


def _term_cause(planner: Planner, rollouts: RobotDynamics | TipControls) -> str:
    """Returns which cost term of the samples is too large or not finite, with its weights."""
    names = planner.dynamics.terms
    chosen = np.arange(min(_EXAMINED, planner.optimizer.settings.samples))
    _, terms = rollouts.paths(planner.optimizer.controls, chosen)
    terms = np.asarray(terms, dtype=float)
    broken = ~np.isfinite(terms) | (np.abs(terms) >= float(LOST))
    if broken.any():
        # Terms that follow from a NaN state are all NaN: the first is as good as any, and infinities come before them.
        counts = broken.sum(axis=0) + np.isinf(terms).sum(axis=0)
        worst = int(counts.argmax())
        value = terms[broken[:, worst], worst][0]
        others = [names[i] for i in np.flatnonzero(broken.any(axis=0)) if i != worst]
        also = f"; so are {', '.join(others)}" if others else ""
        return f"the cost term {names[worst]!r} is {value:.3g}{_weights(planner, names[worst])}{also}"
    total = terms.sum(axis=1)
    if (np.abs(total) >= float(LOST)).any():
        worst = int(np.abs(terms).max(axis=0).argmax())
        return f"the costs are too large, {names[worst]!r} most of all{_weights(planner, names[worst])}"
    if planner.dynamics.task.draws.per_sample > 1:
        return "their costs are finite in the nominal world, but not under the random draws of friction, mass and pose"
    return f"the physics of the engine {planner.engine!r} diverged, although every input and every cost term is finite"


def _weights(planner: Planner, term: str) -> str:
    """Returns the settings that a cost term depends on, as an addition to a sentence."""
    cost = planner.config.cost
    function = getattr(stage_costs, f"{term}_term", None)
    if function is None:
        return f" (cost.extra.{term} = {cost.extra[term]:g})" if term in cost.extra else ""
    used = [name for name in function.func.__code__.co_names if name.startswith("w_") and getattr(cost, name, 0.0)]
    return f" ({', '.join(f'cost.{name} = {getattr(cost, name):g}' for name in used)})" if used else ""
