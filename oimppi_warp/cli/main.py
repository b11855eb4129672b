"""The command ``oimppi``: each command is a dataclass with ``execute``, its options are the fields.

Exit status: 0 the object is at its goal, 1 it is not, 2 bad input (one message on stderr, nothing written), 130 Ctrl-C
(the record is complete up to the last control step). Heavy imports happen inside ``execute``, after the options are
known to be good, so that help and mistakes answer at once.
"""

from __future__ import annotations

import atexit
import gc
import math
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import arg, subcommand

from oimppi_warp.cli.bench import Bench, Compare, Report
from oimppi_warp.cli.check import Check
from oimppi_warp.cli.options import TaskOptions
from oimppi_warp.cli.robot import AddRobot
from oimppi_warp.cli.scene import Import, New
from oimppi_warp.cli.system import Doctor, Warmup
from oimppi_warp.cli.view import Export, View
from oimppi_warp.errors import ConfigError, OimppiError

if TYPE_CHECKING:
    from rich.console import Console

    from oimppi_warp.record.log import EpisodeLog
    from oimppi_warp.record.metrics import Metrics
    from oimppi_warp.scene import Scene


_PACES = {"lockstep": "lock step", "realtime": "real time"}


@dataclass(frozen=True)
class Run(TaskOptions):
    """Plan and push until the object is at its goal.

    Exit status: 0 at the goal, 1 not there, 2 bad input, 130 stopped by Ctrl-C.
    """

    record: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")] = None
    """Keep the log and plots in this folder."""

    json: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")] = None
    """Write the metrics to this file."""

    def execute(self) -> int:
        """Run the episode; returns the exit status."""
        _check_outputs(self.record, self.json)
        setup, console = self.prepare()

        from oimppi_warp.record.log import write_atomically
        from oimppi_warp.record.metrics import summarize

        with console.status("loading kernels"):
            episode = setup.episode()
        if episode.planner.engine_reason:
            console.print(f"engine {episode.planner.engine}: {episode.planner.engine_reason}", soft_wrap=True)
        with _progress(setup.config.episode.max_sim_seconds, console) as on_step:
            log = episode.run(on_step=on_step)
        metrics = summarize(log)
        for step, reason in log.header.get("problems", []):
            console.print(f"step {step}: the arm was stopped, {reason}", soft_wrap=True)
        if self.json is not None:
            self.json.absolute().parent.mkdir(parents=True, exist_ok=True)
            write_atomically(self.json, metrics.json().encode())
        if self.record is not None:
            log.save(self.record)
            with console.status("drawing"):
                from oimppi_warp.plots.episode import draw

                draw(log, setup.scene, self.record)
        _print_summary(metrics, setup.scene, self.record)
        if metrics.ended == "interrupted":
            return 130
        return 0 if metrics.success else 1


@dataclass(frozen=True)
class Scenes:
    """List the shipped scenes, one line each."""

    def execute(self) -> int:
        """Print them; returns the exit status."""
        from rich.console import Console
        from rich.table import Table

        from oimppi_warp.usd import shipped_scenes

        table = Table.grid(padding=(0, 3))
        for scene in shipped_scenes():
            table.add_row(f"[bold]{scene.name}", scene.title)
        Console(highlight=False).print(table)
        return 0


SceneCommand = (
    Annotated[New, subcommand("new", prefix_name=False)]
    | Annotated[Import, subcommand("import", prefix_name=False)]
    | Annotated[AddRobot, subcommand("robot", prefix_name=False)]
    | Annotated[Check, subcommand("check", prefix_name=False)]
)
"""The commands below ``oimppi scene``."""

Command = (
    Annotated[Run, subcommand("run", prefix_name=False)]
    | Annotated[Bench, subcommand("bench", prefix_name=False)]
    | Annotated[Report, subcommand("report", prefix_name=False)]
    | Annotated[Compare, subcommand("compare", prefix_name=False)]
    | Annotated[View, subcommand("view", prefix_name=False)]
    | Annotated[Export, subcommand("export", prefix_name=False)]
    | Annotated[
        SceneCommand,
        subcommand(
            "scene", prefix_name=False, description="Write tasks, objects and robots of your own, and check them."
        ),
    ]
    | Annotated[Scenes, subcommand("scenes", prefix_name=False)]
    | Annotated[Warmup, subcommand("warmup", prefix_name=False)]
    | Annotated[Doctor, subcommand("doctor", prefix_name=False)]
)
"""Every command; another one is one more dataclass in this union."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse and execute; returns the exit status."""
    gc.set_threshold(100_000, 50, 1000)  # Newton and MuJoCo Warp make half a million objects that live to the end:
    atexit.register(gc.freeze)  # going through them again and again, and once more at exit, doubles the start's time
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")  # threads of NumPy's BLAS slow the planner's kernels down
    about = "Object-informed MPPI: an arm pushes an object to its goal."
    command = tyro.cli(Command, prog="oimppi", description=about, args=arguments)
    try:
        return command.execute()
    except OimppiError as error:
        print(f"oimppi: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"oimppi: a result could not be written: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("oimppi: stopped before the first step", file=sys.stderr)
        return 130


def _check_outputs(record: Path | None, json: Path | None) -> None:
    """Raise ConfigError where a result could not be written at the end."""
    if json is not None and json.is_dir():
        raise ConfigError(f"--json {json}: that is a folder\n  allowed: the name of a file")
    for option, folder in (("--json", json and json.absolute().parent), ("--record", record and record.absolute())):
        if folder is not None:
            parent = next(place for place in (folder, *folder.parents) if place.exists())
            if not parent.is_dir() or not os.access(parent, os.W_OK):
                raise ConfigError(f"{option}: {parent} is no folder that can be written to")


@contextmanager
def _progress(seconds: float, console: Console) -> Iterator[Callable[[EpisodeLog], None]]:
    """A bar over simulated time with the errors to the goal; yields what to call after each step."""
    from rich.progress import BarColumn, Progress, TextColumn

    text = TextColumn("{task.completed:.1f} of {task.total:g} s  {task.fields[state]}")
    with Progress(BarColumn(), text, console=console, refresh_per_second=5, transient=True) as progress:
        bar = progress.add_task("", total=seconds, state="planning")

        def on_step(log: EpisodeLog) -> None:
            to_go = f"{log['position_error'][-1]:.3f} m and {log['yaw_error'][-1]:.2f} rad to go"
            if math.isfinite(took := log["plan_ms"][-1]):
                to_go += f"  {took:.0f} ms a plan"
            progress.update(bar, completed=float(log["time"][-1]), state=to_go)

        yield on_step


def _print_summary(metrics: Metrics, scene: Scene, record: Path | None) -> None:
    """What came out, for a person."""
    from rich.console import Console
    from rich.table import Table

    from oimppi_warp.geometry.fields import FURTHEST

    result, total = "[bold red]did not reach its goal[/]", "with planning"
    if metrics.success:
        tight = "also within the tight tolerance" if metrics.success_tight else "not within the tight tolerance"
        result, total = f"[bold green]reached its goal[/], {tight}", "to the goal with planning (the paper's T)"
    yaw = f", {metrics.yaw_error_rad:.3f} rad" if math.isfinite(scene.tolerance.yaw) else " (any yaw will do)"
    clearance = f"{1000 * metrics.min_clearance_m:.1f} mm at the least"
    if metrics.min_clearance_m > FURTHEST - 1e-6:
        clearance = f"more than {1000 * FURTHEST:.0f} mm"  # it is not measured any further
    run = metrics.run
    rows = {
        "task": f"{metrics.scene}, {run.method.upper()}, preset {metrics.preset}, seed {run.seed}, "
        f"{run.plant} plant in {_PACES[run.mode]}, "
        f"{run.engine} on {run.device}",
        "result": f"{result} ({metrics.ended})",
        "errors": f"{metrics.position_error_m:.3f} m{yaw} at the end; {metrics.mean_position_error_m:.3f} m on average",
        "time": f"{metrics.sim_time_s:.2f} s simulated in {metrics.steps} steps; "
        f"{metrics.total_time_s:.1f} s {total}, of it "
        f"{metrics.preplan_time_s:.2f} s before the first step",
        "plans": f"median {metrics.plan_ms_median:.1f} ms, p95 {metrics.plan_ms_p95:.1f} ms, "
        f"{metrics.control_hz:.0f} Hz; {metrics.mean_effective_samples:.1f} effective samples",
        "clearance": clearance,
        "forces": f"tool {metrics.max_contact_tool_object_n:.1f} N, object on obstacles "
        f"{metrics.max_contact_object_obstacle_n:.1f} N, robot on obstacles or table "
        f"{metrics.max_contact_robot_obstacle_n:.1f} N at the most",
    }
    if metrics.detections > 0:
        rows["perception"] = (
            f"{metrics.detections} detections, {metrics.rejected_detections} rejected, "
            f"{metrics.recoveries} recoveries; {1000 * metrics.mean_estimate_error_m:.0f} mm off on average, "
            f"{1000 * metrics.max_estimate_error_m:.0f} mm at the most"
        )
    if run.mode == "realtime":
        rows["deadlines"] = (
            f"{metrics.missed_deadlines} of {metrics.steps} missed, {metrics.stops} stops; "
            f"at the most {metrics.max_lag_ms:.0f} ms behind the clock"
        )
    if record is not None:
        rows["record"] = str(record)
    table = Table.grid(padding=(0, 2))
    for name, text in rows.items():
        table.add_row(f"[dim]{name}", text)
    Console(highlight=False, width=None if sys.stdout.isatty() else 160).print(table)
