"""Intervals and paired tests against published and hand-computed values."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from support.sample_results import make_one, make_set

from oimppi_warp.bench.comparison import compare_labels, compare_methods, compare_sets, mcnemar, signed_rank
from oimppi_warp.bench.statistics import summarize_results, wilson
from oimppi_warp.errors import ConfigError

# R. G. Newcombe, Statistics in Medicine 17 (1998), Table I, method 3.
NEWCOMBE = [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)]


@pytest.mark.parametrize(("count", "total", "low", "high"), NEWCOMBE)
def test_wilsons_interval_is_the_published_one(count: int, total: int, low: float, high: float):
    rate = wilson(count, total)
    assert (rate.low, rate.high) == pytest.approx((low, high), abs=5e-5)
    assert rate.share == count / total


def test_ten_of_ten_leave_the_interval_open_to_72_percent():
    assert (wilson(10, 10).low, wilson(10, 10).high) == pytest.approx((10 / (10 + 1.959964**2), 1.0))
    assert wilson(0, 10).low == 0.0
    assert (wilson(0, 0).low, wilson(0, 0).high) == (0.0, 1.0)


@pytest.mark.parametrize(
    ("b", "c", "p"),
    [
        (0, 0, 1.0),
        (1, 8, 2 * (1 + 9) / 2**9),
        (0, 5, 2 / 2**5),
        (3, 3, 1.0),
    ],
)
def test_mcnemars_test_is_a_fair_coin_for_the_pairs_that_differ(b: int, c: int, p: float):
    assert mcnemar(b, c) == pytest.approx(p)
    assert mcnemar(c, b) == pytest.approx(p)


def test_wilcoxons_test_counts_the_signs_of_the_ranks():
    first = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    # All five differences are positive: the most extreme of 2^5 assignments of signs, on either side.
    assert signed_rank(first, first + [0.1, 0.2, 0.3, 0.4, 0.5]) == pytest.approx(2 / 2**5)
    # Ranks 1 (negative), 2, 3, 4, 5: W = 1 or less is reached by 2 of 32 assignments on each side.
    assert signed_rank(first, first + [-0.1, 0.2, 0.3, 0.4, 0.5]) == pytest.approx(4 / 2**5)
    assert signed_rank(first, first) == 1.0
    assert math.isnan(signed_rank(first[:0], first[:0]))


def test_a_trial_that_raised_counts_as_a_failure_and_in_nothing_else():
    results = [make_one(number=0), make_one(number=1, success=False), make_one(number=2, error="Boom: it broke\n")]
    stats = summarize_results(results)
    assert (stats.success.count, stats.success.total, stats.raised) == (1, 3, 1)
    assert stats.steps == results[0].success_steps
    assert stats.time == pytest.approx(0.05 * results[0].success_steps)
    assert stats.error == pytest.approx(np.mean([r.value("mean_position_error_m") for r in results[:2]]))
    assert stats.error_until_success == pytest.approx(results[0].error_until_success_m)
    assert stats.error_until_success > results[0].value("mean_position_error_m")  # the object stays at its goal later
    assert stats.clearance == pytest.approx(min(r.value("min_clearance_m") for r in results[:2]))
    assert (stats.clear.count, stats.clear.total) == (1, 1)


def test_statistics_of_nothing_are_nan():
    stats = summarize_results([])
    assert math.isnan(stats.success.share)
    assert math.isnan(stats.plan_ms)
    assert math.isnan(stats.clearance)


def test_two_sets_are_compared_start_by_start():
    first = make_set([make_one(number=n, success=n < 2) for n in range(8)], suite="a")
    second = make_set([make_one(number=n, success=n > 0, steps=120) for n in range(10)], suite="b")
    overall, only = compare_sets(first, second)
    assert (overall.name, only.name) == ("all", "task01, CLOI")
    assert overall.pairs == 8  # two starts are in the second only
    assert overall.successes == (2, 7)
    assert [a.number for a, _ in overall.only_first] == [0]
    assert [b.number for _, b in overall.only_second] == [2, 3, 4, 5, 6, 7]
    assert overall.p == pytest.approx(2 * (1 + 7) / 2**7)
    time = overall.numbers[0]
    assert time.count == 1  # start 1 is the only one that succeeds on both sides
    assert time.difference == pytest.approx(time.second - time.first)
    assert time.first == pytest.approx(first.results[1].value("success_time_s"))


def test_methods_are_compared_on_the_same_starts():
    results = [make_one(method="soi", number=n) for n in range(4)]
    results += [make_one(method="mppi", number=n, success=False) for n in range(4)]
    (found,) = compare_methods(make_set(results))
    assert (found.name, found.pairs, found.successes) == ("SOI and MPPI", 4, (4, 0))
    assert found.p == pytest.approx(2 / 2**4)


def test_entries_of_one_scene_are_compared_with_the_first_and_count_once_among_methods():
    results = [make_one(method=method, number=n, label="a") for method in ("soi", "mppi") for n in range(4)]
    results += [make_one(method="soi", number=n, success=n == 0, label="b") for n in range(4)]
    made = replace(make_set([]), results=results)
    (found,) = compare_labels(made)
    assert (found.name, found.pairs, found.successes) == ("task01-a and task01-b, SOI", 4, (4, 1))
    (methods,) = compare_methods(made)
    assert methods.pairs == 4


def test_sets_with_nothing_in_common_are_refused():
    first = make_set([make_one(number=0)], suite="a")
    second = make_set([replace(make_one(number=0), start=(9.0, 9.0, 9.0))], suite="b")
    with pytest.raises(ConfigError, match="no trials in common"):
        compare_sets(first, second)
