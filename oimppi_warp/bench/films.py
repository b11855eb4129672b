"""Films of a suite's trials from their records: the fastest success of each task and method, and every failure."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from oimppi_warp.bench.results import Result
from oimppi_warp.bench.runner import SuiteRun
from oimppi_warp.bench.trial import Trial

FOLDER = "films"
"""Folder of the films, in that of the suite."""


def write_films(run: SuiteRun) -> list[Path]:
    """Writes the films of a suite that was run, as animated GIFs; those that exist are kept.

    Args:
        run: The suite, whose trials have records.

    Returns:
        The files.
    """
    from oimppi_warp.plots.film import film
    from oimppi_warp.record.log import EpisodeLog
    from oimppi_warp.usd import load_scene

    files = []
    (run.folder / FOLDER).mkdir(exist_ok=True)
    for trial, result in _chosen(run):
        outcome = "fastest" if result.success else "failed"
        file = run.folder / FOLDER / f"{outcome}-{trial.name}.gif"
        if not file.is_file():
            log = EpisodeLog.load(run.record_of(trial))
            if len(log):
                film(log, load_scene(trial.scene), file)
        files.append(file)
    return files


def _chosen(run: SuiteRun) -> Iterator[tuple[Trial, Result]]:
    """Yields the trials to film, with their results."""
    groups: dict[tuple[str, str], list[tuple[Trial, Result]]] = {}
    for trial in run.trials:
        if (result := run.finished.get(trial.key)) is not None and not result.error:
            groups.setdefault((trial.task, trial.run.method), []).append((trial, result))
    for group in groups.values():
        good = [each for each in group if each[1].success]
        if good:
            yield min(good, key=lambda each: each[1].success_steps)
        yield from (each for each in group if not each[1].success)
