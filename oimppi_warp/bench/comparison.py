"""Compares results in pairs of trials with the same task and start, which are equally hard on both sides."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass

import numpy as np

from oimppi_warp.bench.results import Result, ResultSet
from oimppi_warp.errors import ConfigError

Pair = tuple[Result, Result]

NUMBERS = {
    "success_time_s": ("time to success [s]", True),
    "error_until_success_m": ("error until success [m]", False),
    "plan_ms_median": ("plan time [ms]", False),
}
"""Quantities compared besides success: their name, and whether only pairs that succeed on both sides are used."""


@dataclass(frozen=True)
class Paired:
    """A quantity compared over pairs.

    Attributes:
        name: Name, with its unit.
        count: Number of pairs in which both sides have a value.
        first, second: Median of each side.
        difference: Median of second minus first.
        p: p value of the two-sided Wilcoxon signed-rank test; 1 if no pair differs, NaN without pairs.
    """

    name: str
    count: int
    first: float
    second: float
    difference: float
    p: float


@dataclass(frozen=True)
class Comparison:
    """The comparison of two sets of paired trials.

    Attributes:
        name: Name of the comparison.
        pairs: Number of pairs.
        successes: Number of successes of each side.
        only_first, only_second: The pairs that succeed on only one side.
        p: p value of McNemar's two-sided exact test on these.
        numbers: See :data:`NUMBERS`.
    """

    name: str
    pairs: int
    successes: tuple[int, int]
    only_first: tuple[Pair, ...]
    only_second: tuple[Pair, ...]
    p: float
    numbers: tuple[Paired, ...]


def compare_sets(first: ResultSet, second: ResultSet) -> tuple[Comparison, ...]:
    """Compares two result sets: first all pairs together, then those of each task and method.

    Raises:
        ConfigError: The sets have no combination of task, method and start in common.
    """
    pairs = _matched(first.results, second.results, lambda r: (r.task, r.run.method, r.start))
    if not pairs:
        raise ConfigError(
            f"{first.suite} and {second.suite} have no trials in common\n"
            "  allowed: two result sets that share some combinations of task, method and start"
        )
    groups: dict[tuple[str, str], list[Pair]] = {}
    for pair in pairs:
        groups.setdefault((pair[0].task, pair[0].run.method), []).append(pair)
    parts = [compare(f"{task}, {method.upper()}", found) for (task, method), found in groups.items()]
    return (compare("all", pairs), *parts)


def compare_methods(results: ResultSet) -> tuple[Comparison, ...]:
    """Compares the methods of one set with each other, over all its tasks.

    A scene listed under several labels is counted once, under the first, as its starts are the same under all.
    """
    firsts = {result.scene: result.task for result in reversed(results.results)}
    found = []
    for index, first in enumerate(results.methods):
        for second in results.methods[index + 1 :]:
            one, other = (
                [result for result in results.of(method=method) if result.task == firsts[result.scene]]
                for method in (first, second)
            )
            pairs = _matched(one, other, lambda r: (r.task, r.start, r.run.seed))
            if pairs:
                found.append(compare(f"{first.upper()} and {second.upper()}", pairs))
    return tuple(found)


def compare_labels(results: ResultSet) -> tuple[Comparison, ...]:
    """Compares each labelled entry of one set with the first entry of the same scene and method."""
    groups: dict[tuple[str, str], dict[str, list[Result]]] = {}
    for result in results.results:
        groups.setdefault((result.scene, result.run.method), {}).setdefault(result.task, []).append(result)
    found = []
    for (_, method), entries in groups.items():
        first, *others = entries
        for other in others:
            pairs = _matched(entries[first], entries[other], lambda r: (r.start, r.run.seed))
            found.append(compare(f"{first} and {other}, {method.upper()}", pairs))
    return tuple(found)


def compare(name: str, pairs: Sequence[Pair]) -> Comparison:
    """Compares paired trials.

    Args:
        name: Name of the comparison.
        pairs: Pairs of results with the same task and start.
    """
    only_first = tuple((a, b) for a, b in pairs if a.success and not b.success)
    only_second = tuple((a, b) for a, b in pairs if b.success and not a.success)
    return Comparison(
        name=name,
        pairs=len(pairs),
        successes=(sum(a.success for a, _ in pairs), sum(b.success for _, b in pairs)),
        only_first=only_first,
        only_second=only_second,
        p=mcnemar(len(only_first), len(only_second)),
        numbers=tuple(_paired(pairs, key, *about) for key, about in NUMBERS.items()),
    )


def mcnemar(only_first: int, only_second: int) -> float:
    """Returns the p value of McNemar's exact test (Q. McNemar, Psychometrika 12, 1947).

    Under its null hypothesis, either side is equally likely to be the one that succeeds in a differing pair.

    Args:
        only_first, only_second: Numbers of pairs in which only that side succeeded.
    """
    if only_first + only_second == 0:
        return 1.0
    from scipy.stats import binomtest

    return float(binomtest(only_first, only_first + only_second, 0.5).pvalue)


def signed_rank(first: np.ndarray, second: np.ndarray) -> float:
    """Returns the p value of the two-sided Wilcoxon signed-rank test of paired values, shape [n] each.

    Pairs without a difference are dropped. 1 if no pair differs; NaN without pairs.
    """
    if not len(first):
        return math.nan
    if not np.any(first != second):
        return 1.0
    from scipy.stats import wilcoxon

    _, p = wilcoxon(second, first, zero_method="wilcox")
    return float(p)  # pyright: ignore[reportArgumentType]


def _paired(pairs: Sequence[Pair], key: str, name: str, both_succeed: bool) -> Paired:
    wanted = [(a, b) for a, b in pairs if not both_succeed or (a.success and b.success)]
    values = np.array([(a.value(key), b.value(key)) for a, b in wanted], dtype=float).reshape(-1, 2)
    first, second = values[np.isfinite(values).all(axis=1)].T
    if not len(first):
        return Paired(name, 0, math.nan, math.nan, math.nan, math.nan)
    middle = [float(np.median(values)) for values in (first, second, second - first)]
    return Paired(name, len(first), middle[0], middle[1], middle[2], signed_rank(first, second))


def _matched(first: Sequence[Result], second: Sequence[Result], identity: Callable[[Result], Hashable]) -> list[Pair]:
    """Returns pairs of results with the same identity, in the first sequence's order."""
    others = {identity(result): result for result in second}
    return [(result, others[identity(result)]) for result in first if identity(result) in others]
