"""Remakes the paper's figures of its experiments from our results: the object's ways, and snapshots of single trials.

The paper's Figure 5 has the object's ways in all trials of a task and method, numbered by start and coloured by time;
Figure 4 has snapshots of a successful and of a failed trial of each method. Snapshots need records, so their trials are
run again, by the commands in the result file::

    python tools/paper_figures.py docs/results/paper-sim.json --snapshots task02
"""

from __future__ import annotations

import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
import tyro

mpl.use("Agg")

from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from oimppi_warp.bench.report.figures import FAILED, draw_footprints, shown_region
from oimppi_warp.bench.report.tables import shown_methods
from oimppi_warp.bench.results import Result, ResultSet, load_results
from oimppi_warp.plots.film import draw_state, state_of
from oimppi_warp.plots.style import GOAL, INK, STYLE, rendered
from oimppi_warp.record.log import EpisodeLog, write_atomically
from oimppi_warp.runtime.request import prepare_scene

TIME = mpl.colormaps["turbo"]
"""Colours of time, from blue to red as in the paper."""
SNAPSHOTS = 6
"""Snapshots of a trial, at even intervals."""


@dataclass(frozen=True)
class PaperFigures:
    """Remake the paper's figures of its experiments from a result file."""

    results: tyro.conf.Positional[Path]
    """Result file of a suite, such as docs/results/paper-sim.json."""

    out: Path = Path("docs/images")
    """Folder for the pictures."""

    snapshots: str = ""
    """Task of which to run a successful and a failed trial of each method again, for their snapshots."""


def ways(results: ResultSet) -> Figure:
    """Draws the object's ways, with a row for each method and a column for each task."""
    methods, tasks = shown_methods(results), results.tasks
    figure = Figure(figsize=(2.3 * len(tasks) + 0.6, 2.75 * len(methods)), layout="constrained")
    panels = figure.subplots(len(methods), len(tasks), squeeze=False)
    norm = Normalize(0.0, max(run.time[-1] for run in results.results if run.time))
    for task, column in zip(tasks, panels.T, strict=True):
        low, high = shown_region(results.places[task], results.of(task))
        for method, axes in zip(methods, column, strict=True):
            runs = results.of(task, method)
            draw_footprints(axes, results.places[task])
            for run in runs:
                _draw_way(axes, run, norm)
            axes.set(aspect="equal", anchor="N", xlim=(low[0], high[0]), ylim=(low[1], high[1]), xticks=[], yticks=[])
            axes.set_title(f"{task}, {method.upper()}: {sum(run.success for run in runs)} of {len(runs)}", fontsize=8)
    bar = figure.colorbar(ScalarMappable(norm, TIME), ax=panels, fraction=0.015, pad=0.01)
    bar.set_label("time [s]")
    return figure


def _draw_way(axes: Axes, run: Result, norm: Normalize) -> None:
    """Draws the way of an object coloured by time, its start with the trial's number, and its end."""
    if not run.pose:
        return
    way = np.vstack([run.start, *run.pose])[:, :2]
    segments = list(np.stack([way[:-1], way[1:]], axis=1))
    axes.add_collection(LineCollection(segments, array=np.array(run.time), cmap=TIME, norm=norm, lw=1.2, zorder=5))
    x, y = way[0]
    axes.plot(x, y, marker="o", ls="none", ms=7, mfc="white", mec="#15803d", mew=0.9, zorder=6)
    axes.text(x, y, str(run.number), fontsize=5, ha="center", va="center", color=INK, zorder=7)
    if run.success:
        axes.plot(*way[-1], marker="o", ms=4, mec=GOAL, mfc="none", ls="none", zorder=7)
    else:
        axes.plot(*way[-1], marker="x", ms=4, mec=FAILED, ls="none", zorder=7)


def snapshots(results: ResultSet, task: str) -> Figure:
    """Draws snapshots of the first successful and the first failed trial of each method, with a row for each trial."""
    found = list(_trials(results, task))
    figure = Figure(figsize=(1.7 * SNAPSHOTS, 1.95 * len(found)), layout="constrained")
    panels = figure.subplots(len(found), SNAPSHOTS, squeeze=False)
    with tempfile.TemporaryDirectory() as folder:
        for number, (run, row) in enumerate(zip(found, panels, strict=True)):
            log = _recorded(run, Path(folder) / str(number))
            scene = prepare_scene(run.task, start=run.start)
            for axes, step in zip(row, np.linspace(0, len(log) - 1, SNAPSHOTS).astype(int), strict=True):
                draw_state(axes, scene, **state_of(log, int(step)))
                axes.set(xticks=[], yticks=[])
                axes.set_title(f"{log['time'][step]:.1f} s", fontsize=7)
            row[0].set_ylabel(f"{run.run.method.upper()}, trial {run.number}\n{log.header['ended']}", fontsize=7)
    return figure


def _trials(results: ResultSet, task: str) -> Iterator[Result]:
    """Yields the first successful trial of each method, then the first failed one of each."""
    for success in (True, False):
        for method in shown_methods(results):
            yield from [run for run in results.of(task, method) if run.success is success][:1]


def _recorded(run: Result, folder: Path) -> EpisodeLog:
    """Runs a trial again, and returns its log."""
    print(f"$ {run.command}", flush=True)
    words = [sys.executable, "-m", "oimppi_warp", *shlex.split(run.command)[1:], "--record", str(folder)]
    subprocess.run(words, stdout=subprocess.DEVNULL)  # a failed trial's exit status is not zero
    log = EpisodeLog.load(folder)
    if (log.header["ended"] == "success") is not run.success and len(log) != run.metrics["steps"]:
        print(f"  ended otherwise than in the results: {log.header['ended']}", flush=True)
    return log


def main(options: PaperFigures) -> None:
    """Draws the figures that were asked for."""
    results = load_results(options.results)
    name = options.results.stem.replace("-", "_")
    with mpl.rc_context(STYLE):
        write_atomically(options.out / f"{name}_ways.png", rendered(ways(results), dpi=110))
        if options.snapshots:
            picture = rendered(snapshots(results, options.snapshots), dpi=110)
            write_atomically(options.out / f"{name}_snapshots.png", picture)


if __name__ == "__main__":
    main(tyro.cli(PaperFigures, description=__doc__))
