"""The options of a run: who plans, with which engine, on which device, in which world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from oimppi_warp.errors import ConfigError
from oimppi_warp.registries import ENGINES, METHODS, PLANTS

Mode = Literal["lockstep", "realtime"]
MODES: tuple[Mode, ...] = ("lockstep", "realtime")

LARGEST_SEED = 2**32 - 1
"""Seeds are 32-bit numbers."""


@dataclass(frozen=True)
class RunSpec:
    """The options of a run, besides its scene and its settings. Trials, records and metrics carry it as it is.

    Attributes:
        method: Name of a method, see :data:`oimppi_warp.registries.METHODS`.
        engine: Name of a rollout engine, see :data:`oimppi_warp.registries.ENGINES`, or ``"auto"``.
        device: Warp device of the planner, or ``"auto"``: the first GPU, or else the CPU.
        threads: Threads of the planner on the CPU; ``None``: every core, in real time all but one.
        seed: Seed of all noise, a 32-bit number.
        plant: Name of a plant, see :data:`oimppi_warp.registries.PLANTS`.
        mode: Whether the plant waits for each plan, or both run side by side on the wall clock.
    """

    method: str = "cloi"
    engine: str = "auto"
    device: str = "auto"
    threads: int | None = None
    seed: int = 0
    plant: str = "ideal"
    mode: Mode = "lockstep"

    def checked(self) -> RunSpec:
        """The same, if it can be run.

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
