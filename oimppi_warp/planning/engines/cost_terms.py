"""Cost terms of the robot level from outside the package.

A term is a Warp function of the stage, the result of one control step of a rollout. If it is registered and its weight
is not zero, it is compiled into the kernels of every engine whose costs the package computes::

    import warp as wp

    from oimppi_warp.planning.engines.cost_terms import CostTerm
    from oimppi_warp.kernels.costs.terms import Stage
    from oimppi_warp.registries import COST_TERMS


    @wp.func
    def high(s: Stage) -> float:
        return wp.max(s.tip[2] - 0.05, 0.0)


    COST_TERMS.register("high", CostTerm(high, about="height of the tip above 5 cm [1/m]"))

Its weight is the setting ``cost.extra.high``. The file must not have ``from __future__ import annotations``: Warp reads
the annotations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from oimppi_warp.config.settings import RobotCost
from oimppi_warp.errors import ConfigError
from oimppi_warp.registries import COST_TERMS

if TYPE_CHECKING:
    import warp as wp


@dataclass(frozen=True)
class CostTerm:
    """A cost term of the robot level.

    Attributes:
        function: A ``wp.func`` that takes a ``kernels.costs.terms.Stage`` and returns the unweighted cost.
        weight: Its weight if the settings give none; 0 turns it off.
        about: One-line description of the cost, with the weight's unit.
    """

    function: wp.Function
    weight: float = 0.0
    about: str = ""

    def __post_init__(self) -> None:
        if not 0.0 <= self.weight < math.inf:
            raise ConfigError(
                f"CostTerm: weight is {self.weight:g}\n  allowed: a finite number, zero or more\n"
                "  to do:   to reward something, let the function return a negative cost"
            )


@dataclass(frozen=True)
class WeightedTerm:
    """A cost term with a nonzero weight.

    Attributes:
        name: Its name.
        function: Function of the stage, unweighted.
        weight: Its weight, not zero.
    """

    name: str
    function: wp.Function
    weight: float


def weighted_terms(cost: RobotCost) -> tuple[WeightedTerm, ...]:
    """Returns the registered terms whose weights are not zero, in the order of registration.

    Args:
        cost: Weights of the robot level; those in ``extra`` override the terms' own.

    Raises:
        ConfigError: A weight has no term, or a term cannot be used.
    """
    for name, weight in cost.extra.items():
        if weight != 0.0:
            COST_TERMS.check(name)
    found = []
    for name, term in COST_TERMS.loadable():
        weight = cost.extra.get(name, term.weight)
        if weight != 0.0:
            _check(name, term.function)
            found.append(WeightedTerm(name, term.function, weight))
    return tuple(found)


def _check(name: str, function: wp.Function) -> None:
    """Raises ConfigError if a term cannot be compiled into the stage cost."""
    from oimppi_warp.kernels.costs.stage_costs import TERMS
    from oimppi_warp.kernels.costs.terms import Stage

    if not name.isidentifier() or name in TERMS:
        raise ConfigError(
            f"cost term {name!r}: the name cannot be used\n"
            f"  allowed: letters, digits and underscores, none of {', '.join(TERMS)}"
        )
    takes = list(getattr(function, "input_types", {}).values())
    if takes != [Stage]:
        found = ", ".join(getattr(kind, "key", str(kind)) for kind in takes) or "no wp.func, or one without arguments"
        raise ConfigError(
            f"cost term {name!r}: its function cannot be used\n  found:   {found}\n"
            "  allowed: a wp.func with one argument, annotated oimppi_warp.kernels.costs.terms.Stage"
        )
