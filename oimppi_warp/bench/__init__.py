"""Benchmarks: suites of trials, run in parallel and resumed, and what is computed and drawn from them.

One stair here as well; every import goes down::

    commands -> runner, page, markdown -> tables, figures -> causes, statistics, comparison, paper -> results -> suite
"""

from __future__ import annotations

from typing import Literal

Backend = Literal["loky", "dask"]
"""Back end that runs trials in parallel: processes of this machine, or a cluster."""
