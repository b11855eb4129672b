"""The commands ``oimppi bench``, ``oimppi report`` and ``oimppi compare``."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction, arg

from oimppi_warp.bench import Backend
from oimppi_warp.cli.printing import print_rows
from oimppi_warp.errors import ConfigError

if TYPE_CHECKING:
    from rich.console import Console

    from oimppi_warp.bench.report.tables import Table
    from oimppi_warp.bench.results import Result, ResultSet
    from oimppi_warp.bench.runner import SuiteRun

Assignments = Annotated[
    UseAppendAction[tuple[tuple[str, ...], ...]],
    arg(name="set", metavar="NAME=VALUE", help_behavior_hint="(repeatable)"),
]
AsInSuite = "(default: the suite's)"

_TELL = 20.0
"""Interval of lines about the progress where there is no terminal [s]."""


@dataclass(frozen=True)
class Bench:
    """Run a benchmark suite and write a report of its results.

    To resume a suite that was stopped, run the same command again. Exit status: 0 all trials were run, 1 some trials
    raised an error, 2 bad input, 130 stopped with Ctrl-C.
    """

    suite: Annotated[Positional[str], arg(metavar="[SUITE]", help_behavior_hint="(default: list all suites)")] = ""
    """Name of a shipped suite, or a suite's TOML file."""

    out: Annotated[Path | None, arg(metavar="FOLDER", help_behavior_hint="(default: runs/SUITE)")] = None
    """Folder for records, results and report."""

    trials: Annotated[int | None, arg(metavar="N", help_behavior_hint=AsInSuite)] = None
    """Number of trials per task and method."""

    first: Annotated[int | None, arg(metavar="N", help_behavior_hint=AsInSuite)] = None
    """Number of the first trial. Trials 0 to 9 of shipped scenes have listed starts; others are drawn with the seed."""

    seed: Annotated[int | None, arg(metavar="N", help_behavior_hint=AsInSuite)] = None
    """Seed from which the seeds of all trials are derived: 0 to 4294967295."""

    tasks: Annotated[tuple[str, ...], arg(metavar="TASK", help_behavior_hint="(default: all)")] = ()
    """Tasks of the suite to run: one or more names."""

    methods: Annotated[tuple[str, ...], arg(metavar="METHOD", help_behavior_hint="(default: all)")] = ()
    """Methods of the suite to run: one or more names."""

    assignments: Assignments = ()
    """Change settings of all trials, after the suite's own changes; docs/settings.md lists the names."""

    max_sim_seconds: Annotated[float | None, arg(metavar="S", help_behavior_hint=AsInSuite)] = None
    """Time limit of an episode in simulated seconds."""

    tolerance: Annotated[str | None, arg(metavar="M,RAD", help_behavior_hint=AsInSuite)] = None
    """Tolerance for success: position in metres and yaw in radians, e.g. 0.005,0.02."""

    jobs: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: one per core; 1 in real time)")] = None
    """Number of trials to run in parallel, each in a separate process; with 1, trials run in this process."""

    backend: Backend = "loky"
    """Execution of the trials: in processes on this machine (loky), or on a Dask cluster (dask)."""

    cluster: Annotated[str, arg(metavar="ADDRESS", help_behavior_hint="(default: a local cluster)")] = ""
    """Address of a running Dask cluster, for --backend dask."""

    retry: FlagCreatePairsOff[bool] = False
    """Run the trials that raised an error again."""

    no_report: FlagCreatePairsOff[bool] = False
    """Write the results without a report."""

    films: FlagCreatePairsOff[bool] = False
    """Write films from above, as GIFs: of the fastest success for each task and method, and of every failure."""

    def execute(self) -> int:
        """Runs the suite and returns the exit status."""
        if not self.suite:
            return _list_suites()
        from oimppi_warp.bench.runner import SuiteRun, prepare
        from oimppi_warp.bench.suite import check_value, load_suite
        from oimppi_warp.runtime.request import parse_tolerance

        suite = load_suite(self.suite).only(tasks=self.tasks, methods=self.methods)
        changes = {name: getattr(self, name) for name in ("trials", "first", "seed", "max_sim_seconds")}
        for key, value in changes.items():
            if value is not None:
                check_value(key, value, "--")
        if self.jobs is not None and self.jobs < 1:
            raise ConfigError(f"--jobs {self.jobs} cannot be used\n  allowed: 1 or more")
        if self.cluster and self.backend == "loky":
            raise ConfigError(
                f"--cluster {self.cluster}: the backend loky runs without a cluster\n  to do:   add --backend dask"
            )
        assignments = tuple(assignment for group in self.assignments for assignment in group)
        suite = suite.changed(**changes, tolerance=parse_tolerance(self.tolerance)).assigned(assignments)

        from rich.console import Console

        console = Console(stderr=True, highlight=False)
        folder = self.out or Path("runs") / suite.name
        with console.status("reading the scenes"):
            run = SuiteRun(suite, folder, retry=self.retry)
        kept, pending = len(run.finished), run.pending
        if kept:
            console.print(f"{kept} of {len(run.trials)} trials are already finished", soft_wrap=True)
        if pending:
            with console.status("loading kernels; the first time, they are compiled in about 20 seconds"):
                prepare(pending)
        stopped = False
        with _progress(run, console) as on_result:
            try:
                run.execute(jobs=self.jobs, backend=self.backend, cluster=self.cluster, on_result=on_result)
            except KeyboardInterrupt:
                stopped = True
        results = run.results()
        if results.results and not self.no_report:
            with console.status("writing the report"):
                from oimppi_warp.bench.report.write import write_report

                page, _ = write_report(results, folder)
            console.print(f"report: {page}", soft_wrap=True)
        if results.results and self.films:
            from oimppi_warp.bench.films import write_films

            with console.status("drawing films"):
                write_films(run)
        _summary(results, folder)
        if stopped:
            console.print("stopped; run the same command again to resume", soft_wrap=True)
            return 130
        return 1 if any(result.error for result in results.results) else 0


@dataclass(frozen=True)
class Report:
    """Write a report of a suite's results, as one HTML page and as Markdown."""

    results: Annotated[Positional[Path], arg(metavar="RESULTS")]
    """Folder written by `oimppi bench`, or its results.json."""

    out: Annotated[Path | None, arg(metavar="FOLDER", help_behavior_hint="(default: next to the results)")] = None
    """Folder for the report."""

    def execute(self) -> int:
        """Writes the report and returns the exit status."""
        from oimppi_warp.bench.results import load_results

        results = load_results(self.results)
        if not results.results:
            raise ConfigError(f"{self.results}: no trial has finished\n  to do:   run `oimppi bench {results.suite}`")
        from oimppi_warp.bench.report.write import write_report

        folder = self.out or (self.results if self.results.is_dir() else self.results.parent)
        for file in write_report(results, folder):
            print(file)
        return 0


@dataclass(frozen=True)
class Compare:
    """Compare two sets of results by pairing their trials with the same task, method and start."""

    first: Annotated[Positional[Path], arg(metavar="A")]
    """First set: a folder written by `oimppi bench`, or its results.json."""

    second: Annotated[Positional[Path], arg(metavar="B")]
    """Second set: a folder or a results.json, as for A."""

    out: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: terminal only)")] = None
    """File to which the comparison is also written, as Markdown."""

    def execute(self) -> int:
        """Prints the comparison and returns the exit status."""
        from oimppi_warp.bench.comparison import compare_sets
        from oimppi_warp.bench.report.markdown import write_comparison
        from oimppi_warp.bench.report.tables import comparison_table, differing_pairs
        from oimppi_warp.bench.results import load_results
        from oimppi_warp.record.log import write_atomically

        found = compare_sets(load_results(self.first), load_results(self.second))
        table = comparison_table(found, title=f"A: {self.first}, B: {self.second}", sides=("A", "B"))
        pairs = differing_pairs(found[0])
        if self.out is not None:
            self.out.absolute().parent.mkdir(parents=True, exist_ok=True)
            write_atomically(self.out, write_comparison(table, pairs).encode())
        _print_table(table)
        _print_table(pairs)
        return 0


def _list_suites() -> int:
    """Prints the shipped suites, one per line, and returns the exit status."""
    from oimppi_warp.bench.suite import shipped_suites

    rows = {}
    for suite in shipped_suites():
        trials = sum(len(entry.tasks) * len(entry.methods) * entry.trials for entry in suite.entries)
        rows[suite.name] = f"{trials:4d} trials   {suite.title}"
    print_rows(rows, name_style="bold")
    return 0


@contextmanager
def _progress(run: SuiteRun, console: Console) -> Iterator[Callable[[Result], None]]:
    """Shows the progress over the trials with success rates; yields the function to call with each new result.

    On a terminal it is a bar, otherwise a line from time to time.
    """
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    began, here = time.monotonic(), 0
    told = began

    def state() -> str:
        results = list(run.finished.values())
        rates = []
        for method in dict.fromkeys(trial.run.method for trial in run.trials):
            found = [result.success for result in results if result.run.method == method]
            if found:
                rates.append(f"{method.upper()} {100 * sum(found) / len(found):.0f} %")
        pace = f"{(time.monotonic() - began) / here:.1f} s per trial" if here else ""
        return ", ".join([*rates, pace] if pace else rates)

    columns = (BarColumn(), TextColumn("{task.completed:.0f} of {task.total:.0f}  {task.fields[state]}"))
    with Progress(*columns, TimeRemainingColumn(), console=console, refresh_per_second=5, transient=True) as progress:
        bar = progress.add_task("", total=len(run.trials), completed=len(run.finished), state=state())

        def on_result(result: Result) -> None:
            nonlocal here, told
            here += 1
            progress.update(bar, completed=len(run.finished), state=state())
            if not console.is_terminal and time.monotonic() - told > _TELL:
                told = time.monotonic()
                console.print(f"{len(run.finished)} of {len(run.trials)} trials; {state()}", soft_wrap=True)
            if result.error:
                progress.console.print(f"{result.command}\n  raised {result.evidence}", soft_wrap=True, markup=False)

        yield on_result


def _summary(results: ResultSet, folder: Path) -> None:
    """Prints a table of the results, the number of trials, and the causes of failures with their counts."""
    from rich.console import Console

    from oimppi_warp.bench.report.tables import brief_table, score_table

    scores = score_table(results)
    brief = brief_table(results)
    _print_table(scores if scores.rows else brief)
    if note := results.note if scores.rows else brief.note:
        Console(highlight=False).print(note, soft_wrap=True, style="dim")
    missing = results.planned - len(results.results)
    failed = [result for result in results.results if not result.success]
    console = Console(highlight=False)
    left = f"; {missing} of {results.planned} trials have not been run" if missing else ""
    console.print(f"{len(results.results)} trials, {len(failed)} failed{left}; results in {folder}", soft_wrap=True)
    for name in sorted({result.cause for result in failed}):
        console.print(f"  {sum(result.cause == name for result in failed):3d}  {name}")


def _print_table(table: Table) -> None:
    """Prints a table, or nothing if it has no rows; if the output is not a terminal, lines are not wrapped."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table as Grid

    if not table.rows:
        return
    grid = Grid(title=escape(table.title), title_justify="left", box=None, header_style="dim", padding=(0, 2, 0, 0))
    for index, name in enumerate(table.header):
        grid.add_column(escape(name), justify="left" if index < 2 else "right", overflow="fold")
    for row in table.rows:
        grid.add_row(*map(escape, row))
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=1000)
    console.print(grid)
