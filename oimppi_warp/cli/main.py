"""The command ``oimppi``. Each subcommand is a dataclass: its fields are the options, and ``execute`` runs it.

Exit status of ``oimppi run``: 0 if the goal was reached, 1 if the goal was not reached, 2 for bad input (one message on
stderr, nothing written), 130 for Ctrl-C (the record is complete up to the last control step). Heavy imports happen
inside ``execute``, after the options have been checked, so that help and error messages appear at once.
"""

from __future__ import annotations

import atexit
import gc
import math
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import FlagCreatePairsOff, arg, subcommand

from oimppi_warp.cli.bag import ImportBag
from oimppi_warp.cli.bench import Bench, Compare, Report
from oimppi_warp.cli.check import Check
from oimppi_warp.cli.demos import Demos
from oimppi_warp.cli.hardware import LabEmulator
from oimppi_warp.cli.options import REAL, TaskOptions
from oimppi_warp.cli.perceive import PerceiveCommand
from oimppi_warp.cli.robot import AddRobot
from oimppi_warp.cli.ros2 import Ros2Check, Ros2Plant
from oimppi_warp.cli.scene import Import, New
from oimppi_warp.cli.system import Doctor, Warmup
from oimppi_warp.cli.view import Export, View
from oimppi_warp.errors import ConfigError, OimppiError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.status import Status

    from oimppi_warp.record.log import EpisodeLog
    from oimppi_warp.record.metrics import Metrics
    from oimppi_warp.scene import Scene


_PACES = {"lockstep": "lock step", "realtime": "real time"}

_LONG = 3.0
"""Time after which a run that is not in a terminal says what is being done before it starts [s]."""


@dataclass(frozen=True)
class Run(TaskOptions):
    """Plan and push until the object reaches its goal.

    Exit status: 0 goal reached, 1 goal not reached, 2 bad input, 130 stopped with Ctrl-C.
    """

    record: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")] = None
    """Folder to which the log and plots of the run are written."""

    force: FlagCreatePairsOff[bool] = False
    """Overwrite the record that the folder holds; otherwise a numbered folder beside it is used."""

    json: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")] = None
    """File to which the metrics of the run are written, as JSON."""

    def execute(self) -> int:
        """Runs the episode and returns the exit status."""
        _check_outputs(self.record, self.json)
        setup, console = self.prepare()

        from oimppi_warp.plants.plant import RealPlant
        from oimppi_warp.record.log import unused_folder, write_atomically
        from oimppi_warp.record.metrics import summarize

        with console.status("loading kernels") as status:
            episode = setup.episode(report=_reporter(console, status))
        if episode.planner.engine_reason:
            console.print(f"engine {episode.planner.engine}: {episode.planner.engine_reason}", soft_wrap=True)
        record = self.record if self.record is None or self.force else unused_folder(self.record)
        if record != self.record:
            console.print(f"{self.record} holds a record; this one is written to {record}", soft_wrap=True)
        if record is None and isinstance(episode.plant, RealPlant):  # there is a record of every run
            record = Path("runs") / time.strftime(f"{setup.spec.plant}-%Y-%m-%d-%H-%M-%S")
        with _progress(episode.config.episode.max_sim_seconds, console) as on_step:
            try:
                log = episode.run(on_step=on_step)
            except Exception:
                if record is not None:
                    episode.log.save(record)
                raise
        metrics = summarize(log)
        for step, reason in log.header.get("problems", []):
            console.print(f"step {step}: the arm was stopped: {reason}", soft_wrap=True)
        if metrics.filtered_commands:
            reasons = sorted(log.header["filtered"].items(), key=lambda item: -item[1])
            console.print(
                f"the safety filter changed {metrics.filtered_commands} of {metrics.steps} commands, "
                f"most often for: {reasons[0][0]}",
                soft_wrap=True,
            )
        if self.json is not None:
            self.json.absolute().parent.mkdir(parents=True, exist_ok=True)
            write_atomically(self.json, metrics.json().encode())
        if record is not None:
            log.save(record)
            with console.status("drawing plots"):
                from oimppi_warp.plots.episode import draw

                draw(log, setup.scene, record)
        _print_summary(metrics, setup.scene, record)
        if metrics.ended == "interrupted":
            return 130
        return 0 if metrics.success else 1


@dataclass(frozen=True)
class Demo:
    """Push the T block around a cube to its goal, and print what to try next.

    This is `oimppi run task02 --start 1 --record oimppi-demo`. Exit status: that of `oimppi run`.
    """

    record: Annotated[Path, arg(metavar="DIR")] = Path("oimppi-demo")
    """Folder to which the log and plots are written. If it holds a record, a numbered folder beside it is used."""

    force: FlagCreatePairsOff[bool] = False
    """Overwrite the record that the folder holds."""

    def execute(self) -> int:
        """Runs the episode, prints what to try next and returns the exit status."""
        from oimppi_warp.record.log import unused_folder

        _check_outputs(self.record, None)
        record = self.record if self.force else unused_folder(self.record)
        status = Run("task02", start="1", record=record, force=self.force).execute()
        if status in (0, 1):
            tips = {
                f"view --replay {record}": "replay it in the browser",
                f"export {record} --to html": "write it as one page, to keep or to send",
                "view task02 --start 1": "watch the planner live, and change the task meanwhile",
                "scene new my_task --object letter:S": "write a task of your own",
            }
            width = max(map(len, tips))
            print(f"\n{record / 'way.png'} shows the path of the T from above. What to try next:")
            print("\n".join(f"  oimppi {words:{width}}  {what}" for words, what in tips.items()))
            print("If you started this with `pipx run` or `uvx`, replace only the word `demo`.")
        return status


@dataclass(frozen=True)
class Scenes:
    """List the shipped scenes, one per line."""

    def execute(self) -> int:
        """Prints the scenes and returns the exit status."""
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
"""The subcommands of ``oimppi scene``."""

Ros2Command = (
    Annotated[Ros2Plant, subcommand("plant", prefix_name=False)]
    | Annotated[Ros2Check, subcommand("check", prefix_name=False)]
)
"""The subcommands of ``oimppi ros2``."""

Command = (
    Annotated[Demo, subcommand("demo", prefix_name=False)]
    | Annotated[Run, subcommand("run", prefix_name=False)]
    | Annotated[Bench, subcommand("bench", prefix_name=False)]
    | Annotated[Report, subcommand("report", prefix_name=False)]
    | Annotated[Compare, subcommand("compare", prefix_name=False)]
    | Annotated[Demos, subcommand("demos", prefix_name=False)]
    | Annotated[View, subcommand("view", prefix_name=False)]
    | Annotated[Export, subcommand("export", prefix_name=False)]
    | Annotated[ImportBag, subcommand("import-bag", prefix_name=False)]
    | Annotated[
        SceneCommand,
        subcommand(
            "scene", prefix_name=False, description="Create scenes, objects and robots of your own, and check scenes."
        ),
    ]
    | Annotated[Scenes, subcommand("scenes", prefix_name=False)]
    | Annotated[Warmup, subcommand("warmup", prefix_name=False)]
    | Annotated[Doctor, subcommand("doctor", prefix_name=False)]
    | Annotated[LabEmulator, subcommand("lab-emulator", prefix_name=False)]
    | Annotated[
        Ros2Command,
        subcommand("ros2", prefix_name=False, description="Simulate a lab on ROS 2 topics, and check a real one."),
    ]
    | Annotated[
        PerceiveCommand,
        subcommand("perceive", prefix_name=False, description="Find the object with a camera, by tags on it."),
    ]
)
"""All commands; to add one, add its dataclass to this union."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Parses the command line, runs the command and returns the exit status.

    Args:
        arguments: The command line without the program's name; default: that of this process.

    Raises:
        SystemExit: Help was requested (status 0), or the command line cannot be parsed (status 2).
    """
    gc.set_threshold(100_000, 50, 1000)  # Newton and MuJoCo Warp create half a million long-lived objects; scanning
    atexit.register(gc.freeze)  # them repeatedly, and once more at exit, would double the start-up time
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")  # NumPy's BLAS threads slow down the planner's kernels
    about = "Object-informed MPPI: an arm pushes an object to its goal."
    command = tyro.cli(Command, prog="oimppi", description=about, args=arguments)
    try:
        return command.execute()
    except OimppiError as error:
        print(f"oimppi: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"oimppi: input or output failed: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("oimppi: interrupted before the first step", file=sys.stderr)
        return 130


def _reporter(console: Console, status: Status) -> Callable[[str], None]:
    """Returns a function that shows what is being done: beside the spinner or, without one, if it takes long."""
    began = time.monotonic()

    def report(doing: str) -> None:
        status.update(doing)
        if not console.is_terminal and time.monotonic() - began > _LONG:
            console.print(doing, soft_wrap=True)

    return report


def _check_outputs(record: Path | None, json: Path | None) -> None:
    """Raises ConfigError if the record or the metrics could not be written at the end of the run."""
    if json is not None and json.is_dir():
        raise ConfigError(f"--json {json}: the path is that of a folder\n  allowed: the path of a file")
    for option, folder in (("--json", json and json.absolute().parent), ("--record", record and record.absolute())):
        if folder is not None:
            parent = next(place for place in (folder, *folder.parents) if place.exists())
            if not parent.is_dir() or not os.access(parent, os.W_OK):
                raise ConfigError(f"{option}: {parent} is not a writable folder\n  to do:   choose another path")


@contextmanager
def _progress(seconds: float, console: Console) -> Iterator[Callable[[EpisodeLog], None]]:
    """Shows a progress bar of an episode; yields the function to call with the log after each control step.

    The bar advances with simulated time. Beside it are the object's distance [m] and yaw error [rad] from the goal, and
    the wall time of the latest plan [ms].

    Args:
        seconds: Time limit of the episode [simulated s].
        console: Console on which the bar is drawn.
    """
    from rich.progress import BarColumn, Progress, TextColumn

    text = TextColumn("{task.completed:.1f} of {task.total:g} s  {task.fields[state]}")
    with Progress(BarColumn(), text, console=console, refresh_per_second=5, transient=True) as progress:
        bar = progress.add_task("", total=seconds, state="planning")

        def on_step(log: EpisodeLog) -> None:
            state = f"{log['position_error'][-1]:.3f} m and {log['yaw_error'][-1]:.2f} rad from the goal"
            if math.isfinite(took := log["plan_ms"][-1]):
                state += f"  {took:.0f} ms per plan"
            progress.update(bar, completed=float(log["time"][-1]), state=state)

        yield on_step


def _print_summary(metrics: Metrics, scene: Scene, record: Path | None) -> None:
    """Prints a summary of the episode.

    Args:
        metrics: The episode's metrics.
        scene: The task.
        record: Folder of the record; ``None`` if none was written.
    """
    from rich.console import Console
    from rich.table import Table

    from oimppi_warp.geometry.fields import FURTHEST

    result, total = "[bold red]goal not reached[/]", "including planning"
    if metrics.success:
        tight = "also within the tight tolerance" if metrics.success_tight else "not within the tight tolerance"
        if metrics.success_exact:
            tight = "also within 5 mm and 0.02 rad" if math.isfinite(scene.tolerance.yaw) else "also within 5 mm"
        result, total = f"[bold green]goal reached[/], {tight}", "to the goal including planning (the paper's T)"
    yaw = f", {metrics.yaw_error_rad:.3f} rad" if math.isfinite(scene.tolerance.yaw) else " (every yaw is allowed)"
    clearance = f"at least {1000 * metrics.min_clearance_m:.1f} mm"
    if metrics.min_clearance_m > FURTHEST - 1e-6:
        clearance = f"more than {1000 * FURTHEST:.0f} mm"  # larger clearances are not measured
    run = metrics.run
    rows = {
        "task": f"{metrics.scene}, {run.method.upper()}, preset {metrics.preset}, seed {run.seed}, "
        f"{run.plant} plant in {_PACES[run.mode]}, "
        f"{run.engine} on {run.device}",
        "result": f"{result} ({metrics.ended})",
        "errors": f"{metrics.position_error_m:.3f} m{yaw} at the end; {metrics.mean_position_error_m:.3f} m on average",
        "time": f"{metrics.sim_time_s:.2f} s{'' if run.plant in REAL else ' simulated'} in {metrics.steps} steps; "
        f"{metrics.total_time_s:.1f} s {total}, of which "
        f"{metrics.preplan_time_s:.2f} s before the first step",
        "plans": f"median {metrics.plan_ms_median:.1f} ms, p95 {metrics.plan_ms_p95:.1f} ms, "
        f"{metrics.control_hz:.0f} Hz; {metrics.mean_effective_samples:.1f} effective samples on average",
        "clearance": clearance,
    }
    if metrics.best_scores:
        rows["scores"] = ", ".join(f"{name} {value:.3f}" for name, value in metrics.best_scores.items()) + " at best"
    if math.isfinite(metrics.max_contact_tool_object_n):
        rows["forces"] = (
            f"at most {metrics.max_contact_tool_object_n:.1f} N between tool and object, "
            f"{metrics.max_contact_object_obstacle_n:.1f} N between object and obstacles, "
            f"{metrics.max_contact_robot_obstacle_n:.1f} N between robot and obstacles or table"
        )
    if metrics.detections > 0:
        rows["perception"] = (
            f"{metrics.detections} detections, {metrics.rejected_detections} rejected, {metrics.recoveries} recoveries"
        )
        if metrics.max_estimate_error_m > 0.0:  # the true pose of a real object is not known
            rows["perception"] += (
                f"; error {1000 * metrics.mean_estimate_error_m:.0f} mm on average, "
                f"at most {1000 * metrics.max_estimate_error_m:.0f} mm"
            )
    if run.mode == "realtime":
        rows["deadlines"] = (
            f"{metrics.missed_deadlines} of {metrics.steps} missed, {metrics.stops} stops; "
            f"at most {metrics.max_lag_ms:.0f} ms behind the clock; "
            f"99 % of the commands within {metrics.command_jitter_ms:.1f} ms of their time"
        )
    if record is not None:
        rows["record"] = str(record)
    table = Table.grid(padding=(0, 2))
    for name, text in rows.items():
        table.add_row(f"[dim]{name}", text)
    Console(highlight=False, width=None if sys.stdout.isatty() else 160).print(table)
