"""Results of a suite, small enough to commit: each trial's metrics, the command that repeats it, and the object's path.

A :class:`ResultSet` is one JSON file from which tables, comparisons and the whole report are made, without records or
scenes. NaN is stored as ``null``.
"""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from oimppi_warp.bench.causes import RAISED, Cause, likely_cause
from oimppi_warp.bench.suite import Published
from oimppi_warp.bench.trial import Trial
from oimppi_warp.config.run_spec import RunSpec
from oimppi_warp.plants.factory import starts_itself
from oimppi_warp.record.log import EpisodeLog, LogError, flatten, holds_record, to_json, write_atomically
from oimppi_warp.record.metrics import first_success, summarize

FORMAT = 1
"""Version of the file format; readers refuse other versions."""

FILE = "results.json"
_ALLOWED = f"a folder written by oimppi bench, or its {FILE}"

PATH_POINTS = 60
"""Number of points kept of the object's path in an episode."""

PLAN_BINS = np.geomspace(0.5, 5000.0, 61)
"""Bin edges of the plan time histogram [ms]; values outside the range count in the first or the last bin."""


@dataclass(frozen=True)
class Result:
    """The result of one trial.

    Attributes:
        key: Hash of everything that affects the result, see :class:`Trial`.
        task, number, start, run: As in the trial. In JSON the fields of ``run`` are inlined.
        preset: Preset of the trial's settings.
        command: Command that repeats the trial.
        code, machine: See :mod:`oimppi_warp.bench.provenance`.
        wall_s: Wall time of the trial.
        metrics: See :class:`oimppi_warp.record.metrics.Metrics`; empty if the trial raised.
        success_steps: Control steps until success; NaN without success.
        error_until_success_m: Position error averaged over time until success (without success: to the end), which is
            the paper's epsilon_d, as its episodes end there.
        tight_counts, exact_counts: Whether the episode continued to the tight, and to the exact, tolerance, so that
            missing it is meaningful.
        time, pose, position_error: The object's path at even intervals of time: [n] [s], [n, 3] (x, y [m], yaw [rad]),
            [n] [m].
        plan_counts: Number of plans by plan time, in the bins of :data:`PLAN_BINS`.
        cause, evidence: Likely cause of a failure, and its evidence; empty after a success.
        error: The traceback, if the trial raised.
    """

    key: str
    task: str
    number: int
    start: tuple[float, float, float]
    run: RunSpec
    preset: str
    command: str
    code: str
    machine: str
    wall_s: float
    metrics: dict[str, Any] = field(default_factory=dict)
    success_steps: float = math.nan
    error_until_success_m: float = math.nan
    tight_counts: bool = True
    exact_counts: bool = False
    time: list[float] = field(default_factory=list)
    pose: list[list[float]] = field(default_factory=list)
    position_error: list[float] = field(default_factory=list)
    plan_counts: list[int] = field(default_factory=list)
    cause: str = ""
    evidence: str = ""
    error: str = ""

    @property
    def scene(self) -> str:
        """Returns the short name of the scene, without the entry's label."""
        return Path(shlex.split(self.command)[2]).stem

    @property
    def success(self) -> bool:
        """Returns whether the object was held within the tolerance."""
        return bool(self.metrics.get("success", False))

    @property
    def success_tight(self) -> bool:
        """Returns whether the object was held within the tight tolerance."""
        return bool(self.metrics.get("success_tight", False))

    @property
    def success_exact(self) -> bool:
        """Returns whether the object was held within the exact tolerance."""
        return bool(self.metrics.get("success_exact", False))

    def value(self, name: str) -> float:
        """Returns a number by its name in the metrics or in this class; NaN if it is missing."""
        found = self.metrics.get(name, getattr(self, name, None))
        return math.nan if found is None else float(found)


@dataclass(frozen=True)
class ResultSet:
    """The results of a suite.

    Attributes:
        suite, title: Name and title of the suite.
        planned: Number of trials in the suite; more than the results if the run is unfinished.
        versions: Versions of Python and of the packages used.
        entries: The suite's entries as they were run.
        places: Data for top-view pictures by task, see :mod:`oimppi_warp.bench.footprints`.
        results: One result per trial.
        note: Remark of the suite for the report.
        published: Results that others published for the same tasks.
    """

    suite: str
    title: str
    planned: int
    versions: dict[str, str]
    entries: list[dict[str, Any]]
    places: dict[str, Any]
    results: list[Result]
    note: str = ""
    published: tuple[Published, ...] = ()

    @property
    def tasks(self) -> list[str]:
        """Returns the task names in the order of the suite."""
        return list(dict.fromkeys(result.task for result in self.results))

    @property
    def methods(self) -> list[str]:
        """Returns the method names in the order of the suite."""
        return list(dict.fromkeys(result.run.method for result in self.results))

    def of(self, task: str | None = None, method: str | None = None) -> list[Result]:
        """Returns the results of one task and one method, in the order of the suite; ``None`` selects all."""
        return [r for r in self.results if task in (None, r.task) and method in (None, r.run.method)]

    def groups(self) -> Iterator[tuple[str, str, list[Result]]]:
        """Yields task, method and results for each combination that has results."""
        for task in self.tasks:
            for method in self.methods:
                if found := self.of(task, method):
                    yield task, method, found

    @property
    def codes(self) -> list[str]:
        """Returns the hashes of the code that produced the results; more than one deserves a warning."""
        return sorted({result.code for result in self.results})

    def save(self, path: Path) -> None:
        """Writes the results to a file, completely or not at all."""
        facts = {item.name: getattr(self, item.name) for item in fields(self) if item.name != "results"}
        head = {"format": FORMAT} | to_json(facts)
        rows = ",\n".join("  " + json.dumps(result_row(result), allow_nan=False) for result in self.results)
        text = json.dumps(head, indent=1, allow_nan=False).removesuffix("\n}")
        write_atomically(path, f'{text},\n "results": [\n{rows}\n ]\n}}\n'.encode())


def load_results(path: str | Path) -> ResultSet:
    """Loads the results of a suite from a file.

    Args:
        path: The file, or the folder that holds it.

    Raises:
        LogError: There are no results, or their format version is not supported.
    """
    path = Path(path)
    file = path / FILE if path.is_dir() else path
    if not path.exists():
        raise LogError(f"{path}: there is no such file or folder\n  allowed: {_ALLOWED}")
    if holds_record(path):
        raise LogError(f"{path}: the record of one run, not the results of a suite\n  allowed: {_ALLOWED}")
    try:
        facts = json.loads(file.read_text(encoding="utf-8"))
        if facts.pop("format") != FORMAT:
            raise ValueError(f"its format version is not {FORMAT}")
        facts["results"] = [result_from(row) for row in facts["results"]]
        facts["published"] = tuple(_published_from(row) for row in facts.get("published", ()))
        return ResultSet(**facts)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        reason = f"{file.name}: {error.strerror}" if isinstance(error, OSError) else error
        raise LogError(f"{path}: cannot be read as the results of a suite ({reason})\n  allowed: {_ALLOWED}") from None


def _published_from(row: dict[str, Any]) -> Published:
    known = {name: value for name, value in row.items() if value is not None}  # NaN is stored as null
    return Published(**known)


def result_from(row: dict[str, Any]) -> Result:
    """Creates a result from its JSON, the inverse of :func:`result_row`."""
    row = _options_of_command(row["command"]) | row  # rows of earlier versions lack the device and the threads
    options = {item.name: row.pop(item.name) for item in fields(RunSpec) if item.name in row}
    for name in ("knock", "plant_options"):
        if options.get(name) is not None:
            options[name] = tuple(options[name])
    row["run"] = RunSpec(**options)
    row["start"] = tuple(row["start"])
    for name in ("success_steps", "error_until_success_m"):
        row[name] = math.nan if row[name] is None else row[name]
    return Result(**row)


def result_row(result: Result) -> dict[str, Any]:
    """Converts a result to JSON types, with the options of its run inlined."""
    return to_json(flatten(result))


def _options_of_command(command: str) -> dict[str, Any]:
    """Returns device and threads from a trial's command."""
    arguments = shlex.split(command)
    options: dict[str, Any] = dict(pairwise(arguments))
    threads = options.get("--threads")
    return {"device": options.get("--device", "auto"), "threads": None if threads is None else int(threads)}


def make_result(
    trial: Trial, log: EpisodeLog | None, *, error: str, wall_s: float, code: str, machine: str, reach: float
) -> Result:
    """Creates the stored result of a trial.

    Args:
        trial: The trial.
        log: Its record; ``None`` if it raised.
        error: The traceback, if it raised.
        wall_s: Wall time of the trial [s].
        code, machine: Provenance of the result.
        reach: Reach of the arm [m].
    """
    common: dict[str, Any] = {
        name: getattr(trial, name) for name in ("key", "task", "number", "start", "run", "command")
    }
    common |= {"preset": trial.settings.preset, "code": code, "machine": machine, "wall_s": round(wall_s, 2)}
    if log is None:
        said = [line for line in error.splitlines() if line and not line[0].isspace()]  # the last is the exception's
        return Result(**common, cause=RAISED, evidence=said[-1], error=error)
    metrics = summarize(log).row()
    if starts_itself(trial.run.plant):
        common["start"] = tuple(metrics["start"])
    cause = Cause("", "") if metrics["success"] else likely_cause(log, reach=reach)
    arrived, judged = first_success(log), bool(log.header.get("scores"))
    until = len(log) if arrived is None else arrived + 1
    rows = np.unique(np.linspace(0, len(log) - 1, min(PATH_POINTS, len(log))).round().astype(int))
    plans = np.clip(log["plan_ms"][np.isfinite(log["plan_ms"])], PLAN_BINS[0], PLAN_BINS[-1] * (1 - 1e-9))
    del metrics["versions"]
    return Result(
        **common,
        metrics=metrics,
        success_steps=math.nan if arrived is None else arrived + 1,
        error_until_success_m=float(np.mean(log["position_error"][:until])) if until else math.nan,
        tight_counts=trial.config.episode.tight and not judged,
        exact_counts=trial.config.episode.exact and not judged,
        time=log["time"][rows].round(3).tolist(),
        pose=log["object_pose"][rows].round(4).tolist(),
        position_error=log["position_error"][rows].round(4).tolist(),
        plan_counts=np.histogram(plans, PLAN_BINS)[0].tolist(),
        cause=cause.name,
        evidence=cause.evidence,
    )
