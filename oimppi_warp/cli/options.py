"""Options shared by the commands ``run`` and ``view``: the task, the planner and its settings."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction, arg

from oimppi_warp.config.run_spec import RunSpec
from oimppi_warp.config.settings import Config
from oimppi_warp.errors import ConfigError
from oimppi_warp.runtime.request import SettingsRequest, parse_pose, parse_start, parse_tolerance, prepare_scene

if TYPE_CHECKING:
    from rich.console import Console

    from oimppi_warp.runtime.setup import Setup
    from oimppi_warp.scene import PlanarPose, Scene

Values = arg(name="set", metavar="NAME=VALUE", help_behavior_hint="(repeatable)")


REAL = ("xarm", "ros2")
"""Plants that are real arms."""
_TELL = 2.0
"""Interval of notices that something is still being done [s]."""
_ADDRESSES = ("robot_address", "pose_address")
"""Options of the plant xarm alone."""


@dataclass(frozen=True)
class HardwareOptions:
    """Options of a real arm, with --plant xarm or ros2; docs/hardware.md says what to do before it moves."""

    robot_address: Annotated[str | None, arg(metavar="HOST", help_behavior_hint="")] = None
    """IPv4 address or name of the xArm's controller, HOST or HOST:PORT; that of `oimppi lab-emulator` is 127.0.0.2."""

    pose_address: Annotated[
        str | None, arg(metavar="HOST:PORT", help_behavior_hint="(default: that of the robot, port 17501)")
    ] = None
    """Address of the server that sends the object's poses."""

    pose_timeout: Annotated[float | None, arg(metavar="S", help_behavior_hint="(default: 2.5)")] = None
    """The arm stops when the object's pose is older than this, in seconds."""

    speed: Annotated[float | None, arg(metavar="SHARE", help_behavior_hint="(default: 1; first 0.1)")] = None
    """Share of the usual speed, from 0.01 to 1. The first run at a new address is limited to 0.1."""

    yes: FlagCreatePairsOff[bool] = False
    """Move the arm to its start posture, and push, without asking."""

    resume: FlagCreatePairsOff[bool] = False
    """After a stop for a reason that passes by itself, such as an object that is hidden, go on without asking."""

    dry_run: FlagCreatePairsOff[bool] = False
    """Do everything but move: connect, check, plan and record."""

    def assignments(self, plant: str) -> tuple[str, ...]:
        """Returns the options that were given, as options of the plant, ``NAME=VALUE``.

        Raises:
            ConfigError: The plant is no real arm.
        """
        given = {name: value for name, value in vars(self).items() if value is not None and value is not False}
        if given and plant not in REAL:
            option = next(iter(given)).replace("_", "-")
            raise ConfigError(f"--{option}: the plant {plant} is no real arm\n  to do:   --plant {' or '.join(REAL)}")
        if plant != "xarm" and (given.keys() & _ADDRESSES):
            option = next(name for name in _ADDRESSES if name in given).replace("_", "-")
            raise ConfigError(f"--{option}: the plant {plant} has no address\n  to do:   --plant-options domain=N")
        return tuple(f"{name}={value}" for name, value in given.items())


@dataclass(frozen=True)
class TaskOptions:
    """The task, the options of the run, and the settings."""

    scene: Annotated[Positional[str], arg(metavar="SCENE")]
    """A USD file, or the name of a shipped scene (`oimppi scenes` lists them)."""

    run: Annotated[RunSpec, arg(name="")] = field(default_factory=RunSpec)
    """Options of the run."""

    hardware: Annotated[HardwareOptions, arg(name="")] = field(default_factory=lambda: HardwareOptions())
    """Options of a real arm."""

    start: Annotated[str | None, arg(metavar="I|X,Y,YAW", help_behavior_hint="(default: drawn with --seed)")] = None
    """Start pose of the object in metres and radians, or the index I (from 0) of a start listed in the scene."""

    goal: Annotated[str | None, arg(metavar="X,Y,YAW", help_behavior_hint="(default: the scene's)")] = None
    """Goal pose of the object, as X,Y,YAW in metres and radians."""

    preset: Literal["auto", "best", "paper", "paper-printed", "lab"] = "auto"
    """Settings to start from. best: our best. paper: the paper's, and values found by search where it prints none.
    paper-printed: the paper's, and those of its baseline where it prints none. lab: for the simulated laboratory.
    auto selects lab with --plant lab, xarm and ros2, otherwise best."""

    assignments: Annotated[UseAppendAction[tuple[tuple[str, ...], ...]], Values] = ()
    """Change settings, e.g. --set cost.w_align=2 robot.optimizer.samples=512; docs/settings.md lists the names."""

    randomize: FlagCreatePairsOff[bool] = False
    """Evaluate every sample under four random draws of friction, mass, perceived pose and tool offset.
    Planning takes about four times as long; the settings are under robot.uncertainty."""

    max_sim_seconds: Annotated[float | None, arg(metavar="S", help_behavior_hint="(default: the preset's)")] = None
    """Time limit of the episode in simulated seconds."""

    tolerance: Annotated[str | None, arg(metavar="M,RAD", help_behavior_hint="(default: the scene's)")] = None
    """Tolerance for success: position in metres and yaw in radians, e.g. 0.005,0.02."""

    def settings(self) -> Config:
        """Returns the preset with the options applied, validated.

        Raises:
            ConfigError: An option or a setting does not exist, or has a value that is not allowed.
        """
        self.run.checked()
        preset = ("lab" if self.run.plant in ("lab", *REAL) else "best") if self.preset == "auto" else self.preset
        assignments = tuple(assignment for group in self.assignments for assignment in group)
        request = SettingsRequest(preset, assignments, self.max_sim_seconds, parse_tolerance(self.tolerance))
        return request.config(self.run.method, randomize=self.randomize)

    def read(self) -> Scene:
        """Returns the scene as it is in its file, after checking the options and settings that do not depend on it.

        Raises:
            ConfigError: An option or a setting does not exist, or has a value that is not allowed. The error is raised
                before anything heavy is imported.
            SceneError: The scene cannot be read.
        """
        self.settings()
        self.hardware.assignments(self.run.plant)
        self._places()
        from oimppi_warp.usd import load_scene

        return load_scene(self.scene)

    def prepare(self, scene: Scene | None = None) -> tuple[Setup, Console]:
        """Returns the setup of the episode, with scene and device checked, and the console for notices.

        Args:
            scene: The scene, if it has been read.

        Raises:
            ConfigError: An option or a setting does not exist, or has a value that is not allowed. The error is raised
                before anything heavy is imported, except for the number of a start that the scene does not have.
            SceneError: The scene cannot be read, or the task cannot be done with this start and goal.
            DeviceError: The device does not exist.
        """
        config = self.settings()
        options = (*self.run.plant_options, *self.hardware.assignments(self.run.plant))
        start, goal = self._places()

        console = notices()
        from oimppi_warp.compute import device
        from oimppi_warp.plants.factory import starts_itself

        where = device.pick_device(self.run.device)
        if self.run.device == "auto" and (unused := device.unused_gpu()):
            console.print(f"planning on the CPU: {unused}", soft_wrap=True)
        with console.status("reading the scene"):
            if start is not None and starts_itself(self.run.plant):
                raise ConfigError(
                    f"--start {self.start}: the plant {self.run.plant} places arm and object itself\n"
                    "  to do:   choose a start with --seed"
                )
            task = prepare_scene(scene or self.scene, start=start, goal=goal, seed=self.run.seed)
            if (count := _warning_count(self.scene)) > 0:
                warnings = f"{count} warning{'s' if count > 1 else ''}"
                console.print(f"{self.scene}: {warnings}, listed by `oimppi scene check {self.scene}`", soft_wrap=True)
        if not device.kernels_are_cached():
            console.print(
                "First run on this machine: the planner's kernels are compiled, in about 20 seconds on two idle cores.",
                soft_wrap=True,
            )
        from oimppi_warp.runtime.setup import Setup

        return Setup(task, config, replace(self.run, device=where, plant_options=options)), console

    def _places(self) -> tuple[PlanarPose | int | None, PlanarPose | None]:
        """Returns start and goal as given."""
        return parse_start(self.start), None if self.goal is None else parse_pose("--goal", self.goal)


def notices() -> Console:
    """Returns a console on stderr for notices; from now on, each module that Warp compiles is reported there."""
    from rich.console import Console

    from oimppi_warp.compute.device import tell_compilation

    console = Console(stderr=True, highlight=False)
    tell_compilation(partial(console.print, soft_wrap=True))
    return console


@contextmanager
def busy(console: Console, doing: str) -> Iterator[None]:
    """Tells that something is being done: with a spinner on a terminal, otherwise with a line every two seconds.

    Args:
        console: Console for notices.
        doing: What is being done, such as ``loading kernels``.
    """
    if console.is_terminal:
        with console.status(doing):
            yield
        return
    began, done = time.monotonic(), threading.Event()

    def tell() -> None:
        while not done.wait(_TELL):
            console.print(f"{doing}: {time.monotonic() - began:.0f} s", soft_wrap=True)

    teller = threading.Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield
    finally:
        done.set()
        teller.join()


def _warning_count(scene: str) -> int:
    """Returns the number of warnings about a user's scene file, such as misspelt attributes; 0 for shipped scenes."""
    if not Path(scene).is_file():
        return 0
    from oimppi_warp.usd import inspect_scene
    from oimppi_warp.usd.lint import lint_stage

    stage = inspect_scene(scene).stage
    return 0 if stage is None else len(list(lint_stage(stage)))
