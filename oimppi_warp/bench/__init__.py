"""Benchmarks: suites of trials, run in parallel and resumed, and what is computed and drawn from them.

One stair here as well; every import goes down::

    commands -> runner, page, markdown -> tables, figures -> causes, statistics, comparison, paper -> results -> suite
"""
