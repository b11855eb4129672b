"""Automatic choice of the rollout engine: the most successful one that keeps up with the control period.

Known figures of an engine are attributes of its entry in :data:`oimppi_warp.registries.ENGINES`: ``known_success`` and
``slower_than`` (see :class:`RobotDynamics`). An engine without a figure for the method is never chosen: it has to be
requested by name.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from oimppi_warp.errors import ConfigError
from oimppi_warp.registries import ENGINES

_TIMED = 3
"""Number of plans to time, if none takes longer than the control period."""


class Rehearsable(Protocol):
    """The part of a planner that is needed to time it."""

    def warm_up(self) -> None:
        """Compiles and loads every kernel, so that the first plan is as fast as the others."""
        ...

    def rehearse(self) -> None:
        """Plans once from the task's start and discards the plan."""
        ...


P = TypeVar("P", bound=Rehearsable)


@dataclass(frozen=True)
class EngineChoice(Generic[P]):
    """An engine and the reason for its choice.

    Attributes:
        engine: Its name.
        reason: The reason, in one line.
        planner: A planner with this engine, warmed up.
    """

    engine: str
    reason: str
    planner: P


def choose_engine(
    method: str, period: float, make: Callable[[str], P], *, report: Callable[[str], None] = lambda _: None
) -> EngineChoice[P]:
    """Chooses the engine to plan with.

    Engines are tried in the order of their known success; among equals, those that are slower than fewer others come
    first. An engine that is known to be slower than one that was too slow is not tried. The first that keeps up is
    chosen or, if none does, the fastest of those tried.

    Args:
        method: Name of the method that will use it.
        period: Time that a plan may take [s].
        make: Function that makes a planner with an engine.
        report: Called with what is being done, in a few words, before it is done.

    Raises:
        ConfigError: No engine has a figure for any method.
    """
    known = {name: figures for name, engine in ENGINES.loadable() if (figures := getattr(engine, "known_success", {}))}
    success = {name: figures[method] for name, figures in known.items() if method in figures}
    if not success:  # a method from outside the package: each engine is rated by its best known figure
        success = {name: max(figures.values()) for name, figures in known.items()}
    slower = {name: getattr(ENGINES[name], "slower_than", frozenset()) for name in success}
    if not success:
        raise ConfigError(
            f"--engine auto: no engine has a known success rate\n  allowed: {', '.join(ENGINES)}\n  to do:   name one"
        )
    found: dict[str, float] = {}
    left_out: list[str] = []
    planners: dict[str, P] = {}
    for name in sorted(success, key=lambda name: (-success[name], len(slower[name]))):
        if slower[name] & found.keys():
            left_out.append(name)
            continue
        report(f"--engine auto: loading the engine {name}")
        planners[name] = make(name)
        found[name] = plan_seconds(planners[name], period, lambda doing, name=name: report(f"{doing} of {name}"))
        if found[name] <= period:
            others = "".join(f"; with {other}, {_ms(found[other])}" for other in found if other != name)
            return EngineChoice(
                name, f"a plan takes {_ms(found[name])} of the {_ms(period)} available{others}", planners[name]
            )
    fastest = min(found, key=lambda name: found[name])
    reason = f"no engine keeps up; with this one, a plan takes {_ms(found[fastest])} of the {_ms(period)} available"
    if left_out:
        reason += f", and {', '.join(left_out)} {'is' if len(left_out) == 1 else 'are'} known to be slower"
    return EngineChoice(fastest, reason, planners[fastest])


def plan_seconds(planner: Rehearsable, period: float, report: Callable[[str], None] = lambda _: None) -> float:
    """Times a plan [s]: the median of a few, or the first that takes longer than ``period``.

    The planner is warmed up first, with one plan; this is not timed.

    Args:
        planner: The planner.
        period: Time that a plan may take [s].
        report: Called with what is being done, in a few words, before it is done.
    """
    report("--engine auto: warming up with a plan")
    planner.warm_up()
    found: list[float] = []
    while len(found) < _TIMED:
        report(f"--engine auto: timing plan {len(found) + 1} of {_TIMED}")
        began = time.perf_counter()
        planner.rehearse()
        found.append(time.perf_counter() - began)
        if found[-1] > period:
            return found[-1]
    return statistics.median(found)


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.0f} ms"
