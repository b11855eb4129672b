"""Options that every command has which plans: which task, who plans, with what settings."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction, arg

from oimppi_warp.config import Config, Method, Mode, PlantKind
from oimppi_warp.errors import ConfigError
from oimppi_warp.task import make_config, make_task, parse_pose, parse_start

if TYPE_CHECKING:
    from rich.console import Console

    from oimppi_warp.episode import Setup

Values = arg(name="set", metavar="NAME=VALUE", help_behavior_hint="(repeatable)")


@dataclass(frozen=True)
class TaskOptions:
    """A task and who plans it."""

    scene: Annotated[Positional[str], arg(metavar="SCENE")]
    """A USD file, or the name of a shipped scene (`oimppi scenes` lists them)."""

    method: Method = "cloi"
    """Plain MPPI, the object planned once ahead (SOI), or again at every step (CLOI)."""

    engine: Literal["auto", "quasistatic", "newton"] = "auto"
    """What simulates the planner's samples: the paper's quasi-static model, or full physics; auto takes the best one
    that keeps up with the control period on this machine."""

    device: str = "auto"
    """Where the planner computes: cpu, cuda:0, ..., or auto."""

    threads: Annotated[
        int | None, arg(metavar="N", help_behavior_hint="(default: every core; in real time all but one)")
    ] = None
    """Threads of the planner on the CPU."""

    seed: Annotated[int, arg(metavar="N")] = 0
    """Seed of the planner's noise and, unless --start is given, of the start."""

    start: Annotated[str | None, arg(metavar="I|X,Y,YAW", help_behavior_hint="")] = None
    """Which of the scene's starts (from 0), or a pose: metres and radians (half a turn is 3.1416)."""

    goal: Annotated[str | None, arg(metavar="X,Y,YAW", help_behavior_hint="")] = None
    """Another goal than the scene's: metres and radians."""

    preset: Literal["auto", "best", "paper", "lab"] = "auto"
    """Settings to begin with; auto takes lab with --plant lab, else best."""

    assignments: Annotated[UseAppendAction[tuple[tuple[str, ...], ...]], Values] = ()
    """Change settings, e.g. --set cost.w_align=2 robot.mppi.samples=512."""

    plant: PlantKind = "ideal"
    """The simulated world as it is, or as a laboratory has it: the object seen once a second, with noise, late,
    sometimes wrongly and not behind the arm; commands late and acceleration limited (`lab` has the settings)."""

    mode: Mode = "lockstep"
    """Whether the world waits for each plan, or planner and world run side by side on the wall clock."""

    randomize: FlagCreatePairsOff[bool] = False
    """Try every sample in four draws of friction, mass, perceived pose and tool; a plan takes four times as long
    (`robot.uncertainty` has the settings)."""

    max_sim_seconds: Annotated[float | None, arg(metavar="S", help_behavior_hint="")] = None
    """Time limit in simulated seconds, if another than the preset's."""

    def settings(self) -> Config:
        """The preset with the options applied, validated.

        Raises:
            ConfigError: An option is wrong.
        """
        if self.seed < 0:
            raise ConfigError(f"--seed {self.seed}: cannot be used\n  allowed: 0 or more")
        if self.threads is not None and self.threads < 1:
            raise ConfigError(f"--threads {self.threads}: cannot be used\n  allowed: 1 or more")
        preset = ("lab" if self.plant == "lab" else "best") if self.preset == "auto" else self.preset
        return make_config(
            preset,
            self.method,
            assignments=[assignment for group in self.assignments for assignment in group],
            max_sim_seconds=self.max_sim_seconds,
            randomize=self.randomize,
        )

    def prepare(self) -> tuple[Setup, Console]:
        """All that makes the episode, the scene read and checked and the device there; and the console for notices.

        Raises:
            ConfigError: An option is wrong; this is known before anything heavy is imported.
            SceneError: The scene cannot be run so.
            DeviceError: There is no such device.
        """
        config = self.settings()
        start, goal = parse_start(self.start), None if self.goal is None else parse_pose("--goal", self.goal)

        console = notices()
        from oimppi_warp import device

        where = device.pick_device(self.device)
        with console.status("reading the scene"):
            scene = make_task(self.scene, start=start, goal=goal, seed=self.seed)
            if (doubts := _doubts(self.scene)) > 0:
                warnings = f"{doubts} warning{'s' if doubts > 1 else ''}"
                console.print(
                    f"{self.scene}: {warnings}, which `oimppi scene check {self.scene}` tells", soft_wrap=True
                )
        if not device.kernels_are_cached():
            console.print(
                "First run on this machine: compiling kernels, which takes about half a minute and is done once.",
                soft_wrap=True,
            )
        with console.status("loading kernels"):
            from oimppi_warp.episode import Setup

        setup = Setup(
            scene=scene,
            config=config,
            method=self.method,
            engine=self.engine,
            device=where,
            threads=self.threads,
            seed=self.seed,
            plant=self.plant,
            mode=self.mode,
        )
        return setup, console


def notices() -> Console:
    """The console for what is said beside a result, with a line there for each kernel that Warp compiles."""
    from rich.console import Console

    from oimppi_warp.device import tell_compilation

    console = Console(stderr=True, highlight=False)
    tell_compilation(partial(console.print, soft_wrap=True))
    return console


def _doubts(scene: str) -> int:
    """How many things in a file of one's own may not be meant as they stand, a misspelt attribute for one."""
    if not Path(scene).is_file():
        return 0
    from oimppi_warp.usd import inspect_scene
    from oimppi_warp.usd.doubts import stage_doubts

    stage = inspect_scene(scene).stage
    return 0 if stage is None else len(list(stage_doubts(stage)))
