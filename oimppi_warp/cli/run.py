"""The commands ``oimppi run`` and ``oimppi demo``."""

from __future__ import annotations

import math
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import FlagCreatePairsOff, arg

from oimppi_warp.cli.options import TaskOptions
from oimppi_warp.cli.summary import print_summary
from oimppi_warp.errors import ConfigError
from oimppi_warp.signals import uninterrupted

if TYPE_CHECKING:
    from rich.console import Console
    from rich.status import Status

    from oimppi_warp.record.log import EpisodeLog


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
        from oimppi_warp.registries import PLANTS

        with console.status("loading kernels") as status:
            episode = setup.episode(report=_reporter(console, status))
        if episode.planner.engine_reason:
            console.print(f"engine {episode.planner.engine}: {episode.planner.engine_reason}", soft_wrap=True)
        record = self.record if self.record is None or self.force else unused_folder(self.record)
        if record != self.record:
            console.print(f"{self.record} holds a record; this one is written to {record}", soft_wrap=True)
        if record is None and isinstance(episode.plant, RealPlant):  # there is a record of every run
            name = PLANTS.place(setup.spec.plant) or ("", setup.spec.plant)
            record = Path("runs") / f"{name[1]}-{time.strftime('%Y-%m-%d-%H-%M-%S')}"
        with _progress(episode.config.episode.max_sim_seconds, console) as on_step:
            try:
                log = episode.run(on_step=on_step)
            finally:
                if record is not None:
                    with uninterrupted():
                        episode.log.save(record)
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
            with console.status("drawing plots"):
                from oimppi_warp.plots.episode import draw

                draw(log, setup.scene, record)
        print_summary(log, metrics, record)
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
            program = _program()
            print("\n".join(f"  {program} {words:{width}}  {what}" for words, what in tips.items()))
            print("If you started this with `pipx run` or `uvx`, replace only the word `demo`.")
        return status


def _program() -> str:
    """Returns how this command can be started again from the same folder."""
    if shutil.which("oimppi"):
        return "oimppi"
    return sys.argv[0] if Path(sys.argv[0]).name == "oimppi" else "python -m oimppi_warp"


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
