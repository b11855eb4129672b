"""Options of a run: method, engine, device, seed, plant, mode and disturbances."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, Literal

from tyro.conf import arg

from oimppi_warp.errors import ConfigError
from oimppi_warp.registries import ENGINES, METHODS, PLANTS

Mode = Literal["lockstep", "realtime"]
MODES: tuple[Mode, ...] = ("lockstep", "realtime")

LARGEST_SEED = 2**32 - 1
"""Largest seed; seeds are 32-bit numbers."""


def listed(*names: str) -> str:
    """Returns names as the help of the command line lists choices."""
    return f"{{{','.join(names)}}}"


MethodName = Annotated[str, arg(metavar=listed(*METHODS))]
"""Name of a method."""


@dataclass(frozen=True)
class RunSpec:
    """Options of a run, apart from its scene and settings. Trials, records and metrics contain them unchanged."""

    method: MethodName = "cloi"
    """Method: plain MPPI (mppi), or MPPI that follows an object plan made once (soi) or at every step (cloi).
    An object plan is a sequence of object poses from the current pose to the goal, planned without the arm."""

    engine: Annotated[str, arg(metavar=listed("auto", *ENGINES))] = "auto"
    """Rollout engine: the paper's quasi-static model (quasistatic) or full physics (newton).
    auto selects the engine with the highest known success rate among those that keep up with the control period.
    If none keeps up on this machine, the fastest engine is selected."""

    device: Annotated[str, arg(metavar="NAME")] = "auto"
    """Device of the planner: cpu, cuda:0, cuda:1, ...; auto selects the first GPU, or the CPU if there is no GPU."""

    threads: Annotated[
        int | None, arg(metavar="N", help_behavior_hint="(default: all cores; in real time, all but one)")
    ] = None
    """Number of CPU threads of the planner."""

    seed: Annotated[int, arg(metavar="N")] = 0
    """Seed of the planner's noise and, unless --start is given, of the start pose: 0 to 4294967295."""

    plant: Annotated[str, arg(metavar=listed(*PLANTS, "FILE.py:NAME"))] = "ideal"
    """Plant to control: an ideal simulation (ideal), or a simulated laboratory (lab), configured by the settings lab.*.
    In lab, the object is detected once a second, with delay, noise, occasional outliers and occlusion by the arm.
    Commands are delayed and joint accelerations are limited. pusht is the benchmark Push-T, for the scene pusht.
    xarm is a real xArm6 at the address --robot-address, and ros2 an arm on ROS 2 topics, both in real time.
    FILE.py:NAME is a plant of your own, a class or function in a Python file (docs/own_plant.md)."""

    plant_options: Annotated[tuple[str, ...], arg(metavar="NAME=VALUE", help_behavior_hint="(default: none)")] = ()
    """Options of the plant: the keyword arguments of the function that makes it."""

    mode: Mode = "lockstep"
    """Timing: the plant waits for each plan (lockstep) or runs in parallel with the planner in real time (realtime)."""

    friction: Annotated[
        float | None, arg(metavar="MU", help_behavior_hint="(default: the scene's, which the planner knows)")
    ] = None
    """Friction coefficient between object and table in the plant; the planner keeps the scene's."""

    knock: Annotated[tuple[float, float, float] | None, arg(metavar="T N S", help_behavior_hint="(default: none)")] = (
        None
    )
    """Knock on the object in the plant: time [s], force [N] and duration [s].
    The force acts sideways: to the left of the direction from the object to its goal."""

    def changed(self, **options: Any) -> RunSpec:
        """Returns a copy with some options changed, after validation.

        Args:
            **options: New values by the names of the fields.

        Raises:
            ConfigError: An option does not exist, a name is unknown, or a number is out of bounds.
        """
        known = [field.name for field in fields(self)]
        for name in options:
            if name not in known:
                raise ConfigError(f"{name}: a run has no such option\n  allowed: {', '.join(known)}")
        return replace(self, **options).checked()

    def checked(self) -> RunSpec:
        """Validates the options and returns them unchanged. A device is not checked before the run is set up.

        Raises:
            ConfigError: A name is unknown, or a number is out of bounds.
        """
        METHODS.check(self.method)
        ENGINES.check(self.engine, "auto")
        PLANTS.check(self.plant)
        for option in self.plant_options:
            if "=" not in option:
                raise ConfigError(f"plant_options: {option} is not an assignment\n  allowed: NAME=VALUE")
        if self.mode not in MODES:
            raise ConfigError(f"mode {self.mode!r} does not exist\n  allowed: {', '.join(MODES)}")
        if self.threads is not None and self.threads < 1:
            raise ConfigError(f"threads = {self.threads} cannot be used\n  allowed: 1 or more")
        if not 0 <= self.seed <= LARGEST_SEED:
            raise ConfigError(f"seed = {self.seed} cannot be used\n  allowed: 0 to {LARGEST_SEED}")
        if self.friction is not None and not 0.0 < self.friction <= 10.0:
            raise ConfigError(f"friction = {self.friction:g} cannot be used\n  allowed: above 0, up to 10")
        if self.knock is not None and not (min(self.knock) >= 0.0 and max(self.knock) <= 1e4):
            given = ", ".join(f"{number:g}" for number in self.knock)
            raise ConfigError(
                f"knock = {given} cannot be used\n  allowed: time [s], force [N] and duration [s], each 0 to 10000"
            )
        return self
