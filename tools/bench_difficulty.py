"""Measures success against difficulty, with and without an object level.

Four planners run four series of tasks, each of which changes one number: the gap between the boxes of task03, the
number of cubes on the way of task01, the robot level's horizon and the number of samples on task02. All have the
settings of the preset ``best``, apart from that number and from what plain MPPI is given as its goal. Run the command
again to resume::

    python tools/bench_difficulty.py --out runs/difficulty
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import matplotlib as mpl
import tyro

mpl.use("Agg")

from matplotlib import pyplot as plt

from oimppi_warp.authoring.objects.catalog import T_BLOCK
from oimppi_warp.authoring.project import write_task
from oimppi_warp.authoring.task import Block, Task
from oimppi_warp.bench.results import Result
from oimppi_warp.bench.runner import SuiteRun
from oimppi_warp.bench.statistics import wilson
from oimppi_warp.bench.suite import Entry, Suite

PLANNERS: dict[str, tuple[str, tuple[str, ...]]] = {
    "MPPI, distance to the goal": ("mppi", ("cost.w_to_go=0", "cost.w_track=100")),
    "MPPI, cost-to-go": ("mppi", ()),
    "SOI": ("soi", ()),
    "CLOI": ("cloi", ()),
}
"""Method and settings of each planner. The first tracks the goal as if it were the plan."""
GAPS = (0.34, 0.30, 0.27, 0.24, 0.22, 0.20, 0.19)
"""Gap between the boxes of task03 [m]."""
CUBES = ((0.50, 0.05), (0.26, -0.05), (0.72, 0.02), (0.52, -0.24), (0.30, 0.24), (0.70, 0.26))
"""Centres of the cubes [m], in the order in which they are added."""
HORIZONS = (5, 10, 15, 20, 25)
"""Horizon of the robot level."""
SAMPLES = (64, 128, 256, 512, 1200)
"""K of both levels."""
FIRST = 2000
"""Number of the first trial; nothing was tuned on these starts."""


@dataclass(frozen=True)
class Difficulty:
    """Measure success against difficulty, with and without an object level."""

    out: Path = Path("runs/difficulty")
    """Folder for scenes, trials, results and figure."""

    trials: int = 10
    """Number of trials of each planner at each point."""

    jobs: int = 2
    """Number of concurrent trials."""


@dataclass(frozen=True)
class Point:
    """A task and settings of one difficulty; ``value`` is the number that differs within the series."""

    series: str
    value: float
    task: str
    assignments: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """Returns a name for the point."""
        return f"{self.series}-{self.value:g}".replace(".", "_")


@dataclass(frozen=True)
class Row:
    """Number of trials of a planner at a point, and of those that succeed at the paper's and the exact tolerance."""

    series: str
    value: float
    planner: str
    trials: int
    success: int
    success_exact: int


def points(scenes: Path) -> Iterator[Point]:
    """Writes the scenes that are not shipped, and yields all points."""
    for gap in GAPS:
        x, size = 0.5 * gap + 0.10, (0.20, 0.25, 0.20)
        boxes = (Block("Left", (round(0.5 - x, 4), 0.05), size), Block("Right", (round(0.5 + x, 4), 0.05), size))
        yield Point("gap", gap, scene(scenes, f"gap_{1000 * gap:.0f}mm", boxes))
    for count in range(len(CUBES) + 1):
        cubes = tuple(Block(f"Cube{i}", at, (0.06, 0.06, 0.10)) for i, at in enumerate(CUBES[:count]))
        yield Point("cubes", count, scene(scenes, f"cubes_{count}", cubes))
    for horizon in HORIZONS:
        knots = min(6, horizon - 1)
        yield Point(
            "horizon", horizon, "task02", (f"robot.optimizer.knots={knots}", f"robot.optimizer.horizon={horizon}")
        )
    for samples in SAMPLES:
        yield Point(
            "samples", samples, "task02", (f"robot.optimizer.samples={samples}", f"object.optimizer.samples={samples}")
        )


def scene(folder: Path, name: str, obstacles: tuple[Block, ...]) -> str:
    """Writes a scene with the T, its start and its goal of task01 to task04; returns the file's path."""
    start, goal = (0.30, -0.45, 0.0), (0.50, 0.30, math.pi)
    write_task(Task(name, f"Difficulty: {name}", T_BLOCK, start, goal, obstacles), folder, force=True)
    return str((folder / f"{name}.usda").resolve())


def suite_of(found: list[Point], trials: int) -> Suite:
    """Returns the suite of all planners at all points."""
    entries = tuple(
        Entry(tasks=(point.task,), methods=(method,), trials=trials, first=FIRST).changed(
            {"label": f"{point.label}-{number}", "set": (*point.assignments, *own), "max_sim_seconds": 40.0}
        )
        for point in found
        for number, (method, own) in enumerate(PLANNERS.values())
    )
    return Suite("difficulty", "Success against difficulty", Path("difficulty.toml"), entries)


def rows(found: list[Point], results: list[Result]) -> list[Row]:
    """Returns the row of each point and planner."""
    made = []
    for point in found:
        for number, planner in enumerate(PLANNERS):
            own = [r for r in results if r.task.endswith(f"-{point.label}-{number}")]
            succeeded = [sum(bool(r.metrics.get(name)) for r in own) for name in ("success", "success_exact")]
            made.append(Row(point.series, point.value, planner, len(own), *succeeded))
    return made


def draw(table: list[Row], file: Path) -> None:
    """Draws the success rates of each series, with Wilson's intervals."""
    titles = {
        "gap": "gap between two boxes [m]",
        "cubes": "cubes on the way",
        "horizon": "horizon $H_r$ (task02)",
        "samples": "samples $K$ (task02)",
    }
    figure, axes = plt.subplots(1, len(titles), figsize=(15, 3.4), sharey=True, layout="constrained")
    for (series, title), axis in zip(titles.items(), axes, strict=True):
        for shift, planner in enumerate(PLANNERS):
            own = [row for row in table if row.series == series and row.planner == planner and row.trials]
            values = [row.value for row in own]
            found = [wilson(row.success, row.trials) for row in own]
            rates = [rate.share for rate in found]
            axis.plot(values, rates, marker="o", ms=4, label=planner, zorder=3 + shift)
            axis.fill_between(values, [rate.low for rate in found], [rate.high for rate in found], alpha=0.08)
        axis.set(xlabel=title, ylim=(-0.03, 1.03))
        if series == "gap":
            axis.invert_xaxis()
        if series == "samples":
            axis.set_xscale("log", base=2)
    axes[0].set_ylabel("success, paper's tolerance")
    axes[-1].legend(fontsize=8)
    figure.savefig(file, dpi=120)


def main(options: Difficulty) -> None:
    """Runs what is left to run, and writes table and figure."""
    found = list(points(options.out / "scenes"))
    run = SuiteRun(suite_of(found, options.trials), options.out)
    print(f"{len(run.trials)} trials, {len(run.pending)} left to run", flush=True)
    table = rows(found, run.execute(jobs=options.jobs).results)
    (options.out / "difficulty.json").write_text(json.dumps([asdict(row) for row in table], indent=1) + "\n")
    draw(table, options.out / "difficulty.png")
    for row in table:
        print(*asdict(row).values())


if __name__ == "__main__":
    main(tyro.cli(Difficulty, description=__doc__))
