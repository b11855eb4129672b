"""The options of a run: method, engine, device, seed, plant and mode."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import arg

from oimppi_warp.errors import ConfigError
from oimppi_warp.registries import ENGINES, METHODS, PLANTS

Mode = Literal["lockstep", "realtime"]
MODES: tuple[Mode, ...] = ("lockstep", "realtime")

LARGEST_SEED = 2**32 - 1
"""Seeds are 32-bit numbers."""


if TYPE_CHECKING:
    MethodName = EngineName = PlantName = str
else:  # the command line and its help list the choices
    MethodName, EngineName, PlantName = METHODS.choice(), ENGINES.choice("auto"), PLANTS.choice()


@dataclass(frozen=True)
class RunSpec:
    """The options of a run, besides its scene and its settings. Trials, records and metrics carry it as it is."""

    method: MethodName = "cloi"
    """Who plans: mppi is plain MPPI, soi plans the object's whole way once ahead, cloi plans it again at every step."""

    engine: EngineName = "auto"
    """What rolls the samples out: the paper's quasi-static model or full physics (newton); auto takes the most
    successful engine that keeps up with the control period on this machine."""

    device: str = "auto"
    """Where the planner computes: cpu, cuda:0, ..., or auto for the first GPU, or else the CPU."""

    threads: Annotated[
        int | None, arg(metavar="N", help_behavior_hint="(default: every core; in real time all but one)")
    ] = None
    """Threads of the planner on the CPU."""

    seed: Annotated[int, arg(metavar="N")] = 0
    """Seed of the planner's noise and, unless a start is given, of the start: 0 to 4294967295."""

    plant: PlantName = "ideal"
    """What is moved: the simulation without imperfection (ideal), or as a laboratory sees and moves it (lab), set by
    lab.*: the object once a second, delayed, with noise, occasional outliers and occlusion by the arm; commands
    delayed, accelerations limited."""

    mode: Mode = "lockstep"
    """Whether the plant waits for each plan, or both run side by side on the wall clock."""

    def changed(self, **options: Any) -> RunSpec:
        """Returns a copy with some options changed, checked.

        Raises:
            ConfigError: There is no such option, or it cannot have that value.
        """
        known = [field.name for field in fields(self)]
        for name in options:
            if name not in known:
                raise ConfigError(f"{name}: no such option of a run\n  allowed: {', '.join(known)}")
        return replace(self, **options).checked()

    def checked(self) -> RunSpec:
        """Validates the options and returns them.

        Raises:
            ConfigError: A name is unknown, or a number out of bounds.
        """
        METHODS.check(self.method)
        ENGINES.check(self.engine, "auto")
        PLANTS.check(self.plant)
        if self.mode not in MODES:
            raise ConfigError(f"mode {self.mode!r} does not exist\n  allowed: {', '.join(MODES)}")
        if self.threads is not None and self.threads < 1:
            raise ConfigError(f"--threads {self.threads}: cannot be used\n  allowed: 1 or more")
        if not 0 <= self.seed <= LARGEST_SEED:
            raise ConfigError(f"--seed {self.seed}: cannot be used\n  allowed: 0 to {LARGEST_SEED}")
        return self
