"""Runs one trial in a worker process and returns its log, or the traceback if it raised."""

from __future__ import annotations

import os
import signal
import threading
import time
import traceback
import warnings
from contextlib import suppress
from dataclasses import dataclass
from functools import cache

from oimppi_warp.bench.provenance import code_content, machine, without_paths
from oimppi_warp.bench.trial import Trial, make_episode
from oimppi_warp.record.log import EpisodeLog
from oimppi_warp.signals import check_interrupted


@dataclass(frozen=True)
class Outcome:
    """The outcome of a trial in a worker.

    Attributes:
        trial: The trial.
        log: Its record; ``None`` if it raised.
        error: The traceback, if it raised.
        wall_s: Wall time of the trial [s].
        code, machine: Provenance of the result.
    """

    trial: Trial
    log: EpisodeLog | None
    error: str
    wall_s: float
    code: str
    machine: str


def run_trial(trial: Trial, leader: int) -> Outcome:
    """Runs a trial and returns its log, or the traceback of an exception.

    Args:
        trial: The trial.
        leader: Process ID of the process that started the suite and handles Ctrl-C; all others ignore Ctrl-C.

    Raises:
        KeyboardInterrupt: Ctrl-C was pressed in the leading process.
    """
    if os.getpid() != leader:
        with suppress(ValueError):  # not allowed in a thread of a cluster's worker
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        if os.getppid() == leader:
            _end_with_leader()
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    code = code_content()  # before the planner is imported
    began = time.perf_counter()
    log, error = None, ""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            log = make_episode(trial).run()
    except Exception:
        check_interrupted()  # then it is what an extension such as USD made of Ctrl-C
        error = without_paths(traceback.format_exc())
    if log is not None and log.header["ended"] == "interrupted":
        raise KeyboardInterrupt
    return Outcome(trial, log, error, time.perf_counter() - began, code, machine())


@cache
def _end_with_leader() -> None:
    """Makes this process exit when its parent process does, even if the parent is killed."""
    leader = os.getppid()

    def watch() -> None:
        while os.getppid() == leader:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
