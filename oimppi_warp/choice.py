"""Which rollout engine to plan with: of those that keep up with the control period, the most successful one."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

KNOWN_SUCCESS: Mapping[tuple[str, str], float] = {
    ("quasistatic", "cloi"): 0.95,
    ("quasistatic", "soi"): 1.0,
    ("quasistatic", "mppi"): 1.0,
    ("newton", "cloi"): 0.9,
    ("newton", "soi"): 0.8,
    ("newton", "mppi"): 0.0,
}
"""Share of task 02's starts that an engine and a method bring to the goal, from ``docs/results.md``; 0 where nobody has
measured it with the present settings. Of equals, the first is the cheaper one."""

_TIMED = 3
"""Plans that are timed."""


@dataclass(frozen=True)
class Choice:
    """An engine and why it was chosen.

    Attributes:
        engine: Its name.
        reason: One line.
    """

    engine: str
    reason: str


def choose(method: str, period: float, plan_seconds: Callable[[str], float]) -> Choice:
    """The engine to plan with.

    Engines are tried in the order of their known success. An engine is made only if all before it are too slow.

    Args:
        method: How it will be used.
        period: What a plan may take [s].
        plan_seconds: Makes an engine and says how long a plan takes with it [s].
    """
    known = {engine: share for (engine, of), share in KNOWN_SUCCESS.items() if of == method}
    found: dict[str, float] = {}
    for engine in sorted(known, key=lambda name: -known[name]):
        found[engine] = plan_seconds(engine)
        if found[engine] <= period:
            slower = "".join(f", with {other} {_ms(found[other])}" for other in found if other != engine)
            return Choice(engine, f"a plan takes {_ms(found[engine])} of {_ms(period)}{slower}")
    fastest = min(found, key=lambda name: found[name])
    return Choice(fastest, f"none keeps up; with this one a plan takes {_ms(found[fastest])} of {_ms(period)}")


def median_seconds(plan: Callable[[], object]) -> float:
    """Median time of some plans, after one that is not counted [s]."""
    plan()
    found = []
    for _ in range(_TIMED):
        began = time.perf_counter()
        plan()
        found.append(time.perf_counter() - began)
    return statistics.median(found)


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.0f} ms"
