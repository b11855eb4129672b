"""Benchmarks: suites of trials, run in parallel and resumable, and the statistics and reports made from them.

The modules are layered; every import goes down::

    commands -> runner, page, markdown -> tables, figures -> causes, statistics, comparison, paper -> results -> suite
"""

from __future__ import annotations

from typing import Literal

Backend = Literal["loky", "dask"]
"""Back end that runs trials in parallel: processes on this machine, or a cluster."""
