"""Runs the trials of a suite in parallel, storing each finished one, so that an interrupted suite can be resumed.

Worker processes run the trials, and this process writes the files. Each trial has a folder with its record and, written
last, ``trial.json``, which marks the trial as finished: it is not run again. ``results.json`` is compiled from these
files.
"""

from __future__ import annotations

import json
import os
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from oimppi_warp.bench import Backend
from oimppi_warp.bench.results import FILE, Result, ResultSet, make_result, result_from, result_row
from oimppi_warp.bench.suite import Suite
from oimppi_warp.bench.trial import Trial, make_trials
from oimppi_warp.bench.worker import Outcome, run_trial
from oimppi_warp.errors import OimppiError, missing_package
from oimppi_warp.planning.resolve import entries_used
from oimppi_warp.plants.factory import make_plant, starts_itself
from oimppi_warp.record.log import to_json, versions, write_atomically
from oimppi_warp.runtime.request import prepare_scene

SAVE_EVERY = 10.0
"""Minimum interval between updates of ``results.json`` while trials run [s]."""

_TRIAL = "trial.json"


class BenchError(OimppiError):
    """Raised when a suite cannot be run here."""


@dataclass
class SuiteRun:
    """A run of a suite in a folder.

    Args:
        suite: The suite to run.
        folder: Destination, created if necessary.
        retry: Whether to discard the results of trials that raised, so that they run again.

    Attributes:
        trials: Every trial of the suite.
        finished: Results so far, by the trial's key.

    Raises:
        OimppiError: The suite names a scene that cannot be read.
    """

    suite: Suite
    folder: Path
    retry: bool = False
    trials: list[Trial] = field(init=False)
    finished: dict[str, Result] = field(init=False, default_factory=dict)
    places: dict[str, Any] = field(init=False)

    def __post_init__(self) -> None:
        from oimppi_warp.bench.footprints import scene_footprints

        self.trials, scenes = make_trials(self.suite)
        self.places = {name: scene_footprints(scene) for name, scene in scenes.items()}
        self._read_stored()
        if self.retry:
            self.finished = {key: result for key, result in self.finished.items() if not result.error}

    @property
    def pending(self) -> list[Trial]:
        """Returns the unfinished trials, those in real time last."""
        return sorted((t for t in self.trials if t.key not in self.finished), key=lambda trial: trial.real_time)

    def execute(
        self,
        *,
        jobs: int | None = None,
        backend: Backend = "loky",
        cluster: str = "",
        on_result: Callable[[Result], None] | None = None,
    ) -> ResultSet:
        """Runs the unfinished trials and writes the results.

        Args:
            jobs: Number of concurrent trials; ``None``: one per core, and one at a time for trials in real time. With
                ``1`` (and loky) trials run in this process, one after the other.
            backend: Back end that runs the trials.
            cluster: Address of a running cluster; without one, dask starts a local one.
            on_result: Called after each trial.

        Raises:
            BenchError: The back end is not available, a trial needs something that other processes lack, or a worker
                process dies repeatedly.
            ConfigError: A plant with a world of its own cannot be made, for example because a package is missing.
            KeyboardInterrupt: Ctrl-C was pressed; finished trials are stored.
        """
        if backend != "loky" and any(trial.real_time for trial in self.pending):
            raise BenchError("real-time trials need exclusive use of the machine\n  to do:   use --backend loky")
        if jobs != 1 or backend != "loky":
            _check_known_elsewhere(self.pending)
        if not cluster:
            _check_worlds(self.pending)
        self.folder.mkdir(parents=True, exist_ok=True)
        saved = 0.0
        try:
            with cluster_backend(backend, cluster, jobs):
                for real_time in (False, True):
                    batch = [trial for trial in self.pending if trial.real_time is real_time]
                    for outcome in _outcomes(batch, jobs=jobs or (1 if real_time else -1), backend=backend):
                        result = self.store(outcome)
                        if on_result is not None:
                            on_result(result)
                        if time.monotonic() - saved > SAVE_EVERY:
                            self.results().save(self.folder / FILE)
                            saved = time.monotonic()
        finally:
            self._read_stored()  # Ctrl-C may have been pressed just after a trial was written
            found = self.results()
            found.save(self.folder / FILE)
        return found

    def store(self, outcome: Outcome) -> Result:
        """Writes the outcome of a trial (the file that marks it as finished comes last), and returns its result."""
        trial = outcome.trial
        result = make_result(
            trial,
            outcome.log,
            error=outcome.error,
            wall_s=outcome.wall_s,
            code=outcome.code,
            machine=outcome.machine,
            reach=self.places[trial.task]["reach"],
        )
        folder = self.record_of(trial)
        folder.mkdir(parents=True, exist_ok=True)
        if outcome.log is not None:
            outcome.log.save(folder)
        facts = {"trial": trial.row(), "result": result_row(result), "versions": versions()}
        write_atomically(folder / _TRIAL, (json.dumps(to_json(facts), indent=1, allow_nan=False) + "\n").encode())
        self.finished[trial.key] = result
        return result

    def results(self) -> ResultSet:
        """Returns the results so far, in the order of the suite."""
        return ResultSet(
            suite=self.suite.name,
            title=self.suite.title,
            planned=len(self.trials),
            versions=versions(),
            entries=[entry.row() for entry in self.suite.entries],
            places=self.places,
            results=[self.finished[trial.key] for trial in self.trials if trial.key in self.finished],
            note=self.suite.note,
            published=self.suite.published,
        )

    def record_of(self, trial: Trial) -> Path:
        """Returns the folder of a trial's record."""
        return self.folder / "trials" / trial.name

    def _read_stored(self) -> None:
        for trial in self.trials:
            if trial.key not in self.finished and (result := self._stored(trial)) is not None:
                self.finished[trial.key] = result

    def _stored(self, trial: Trial) -> Result | None:
        """Returns the result of a finished trial; ``None`` if its file is missing or unreadable."""
        try:
            result = result_from(json.loads((self.record_of(trial) / _TRIAL).read_text(encoding="utf-8"))["result"])
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return result if result.key == trial.key else None


def prepare(trials: Iterable[Trial]) -> None:
    """Compiles the kernels that the trials need, once instead of in every worker; does nothing if they are cached."""
    from oimppi_warp.bench.trial import make_episode
    from oimppi_warp.compute.device import kernels_are_cached

    if not kernels_are_cached():
        for trial in {(trial.run.method, trial.run.engine): trial for trial in trials}.values():
            make_episode(trial)


@contextmanager
def cluster_backend(backend: Backend, cluster: str, jobs: int | None) -> Iterator[None]:
    """Connects to a dask cluster, or starts a local one, and makes it joblib's back end inside the context.

    Raises:
        ConfigError: dask is not installed.
        BenchError: The cluster cannot be reached.
    """
    import joblib

    with ExitStack() as stack:
        try:
            if backend == "dask":
                import distributed

                options: dict[str, Any] = (
                    {"address": cluster}
                    if cluster
                    else {
                        "n_workers": jobs or joblib.cpu_count(),
                        "threads_per_worker": 1,
                        "dashboard_address": None,
                    }
                )
                stack.enter_context(distributed.Client(**options))
        except ImportError as error:
            raise missing_package(f"--backend {backend}", str(error.name), "cluster") from None
        except (OSError, ConnectionError, RuntimeError) as error:
            raise BenchError(f"--cluster {cluster}: cannot connect to a cluster ({error})") from None
        yield


def _check_known_elsewhere(trials: Iterable[Trial]) -> None:
    """Raises BenchError for trials that only this process can run, because they need plugins registered in it only."""
    for trial in trials:
        for registry, name in entries_used(trial.run, trial.config):
            if registry.is_local(name):
                raise BenchError(
                    f"the {registry.kind} {name} was registered in this process only; worker processes do not have it\n"
                    f"  to do:   use --jobs 1 (with --backend loky), or declare it in an installed package as an entry "
                    f"point of the group {registry.group}"
                )


def _check_worlds(trials: Iterable[Trial]) -> None:
    """Makes one plant of each kind with a world of its own, so that a missing package is reported before all trials."""
    placed = [trial for trial in trials if starts_itself(trial.run.plant)]
    for trial in {(trial.run.plant, trial.run.plant_options, trial.scene): trial for trial in placed}.values():
        make_plant(prepare_scene(trial.scene, start=trial.start), trial.config, trial.run)


def _outcomes(trials: list[Trial], *, jobs: int, backend: Backend) -> Iterator[Outcome]:
    """Runs trials and yields their outcomes as they finish.

    Raises:
        BenchError: A worker died twice without any trial finishing in between.
    """
    from joblib import Parallel, delayed, parallel_config
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    todo = {trial.key: trial for trial in trials}
    died = False
    while todo:
        before = len(todo)
        try:
            with parallel_config(backend=backend, n_jobs=jobs), warnings.catch_warnings():
                warnings.filterwarnings("ignore", message=".*tasks which were still being processed")  # after Ctrl-C
                calls = (delayed(run_trial)(trial, os.getpid()) for trial in list(todo.values()))
                one: Any = 1  # one trial at a time
                parallel: Any = Parallel(return_as="generator_unordered", batch_size=one, pre_dispatch="2*n_jobs")
                for outcome in parallel(calls):
                    del todo[outcome.trial.key]
                    yield outcome
        except TerminatedWorkerError as error:
            if died and len(todo) == before:
                reason = str(error).split("\n")[0]
                raise BenchError(
                    f"a worker process died twice in a row ({reason})\n"
                    "  to do:   use fewer workers (--jobs 1), in case memory ran out; finished trials are kept"
                ) from None
            died = len(todo) == before
