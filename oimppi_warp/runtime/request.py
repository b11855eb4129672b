"""Parsing of run requests: a preset with changes becomes a config, a scene with a start becomes a task.

The commands ``run`` and ``bench`` share this module, so that a benchmark trial is identical to the ``run`` command that
is reported for it. All other options of a run are in :class:`oimppi_warp.config.run_spec.RunSpec`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from oimppi_warp.config.overrides import set_option, validate
from oimppi_warp.config.presets import PRESETS
from oimppi_warp.config.settings import Config
from oimppi_warp.errors import ConfigError
from oimppi_warp.registries import METHODS
from oimppi_warp.scene import Scene

if TYPE_CHECKING:
    from oimppi_warp.scene import PlanarPose

RANDOMIZED_DRAWS = 4
"""Number of random draws per sample that ``--randomize`` sets."""

LARGEST_TOLERANCE = (0.5, math.pi)
"""Largest tolerance, of the position [m] and of the yaw [rad]."""

TOLERANCE_LIMITS = f"above 0, up to {LARGEST_TOLERANCE[0]:g} and {LARGEST_TOLERANCE[1]:.2f}"
"""Description of the limits of a tolerance."""

TOLERANCE = f"position,yaw in metres and radians, {TOLERANCE_LIMITS}, e.g. 0.005,0.02"
"""Description of a tolerance on the command line."""

POSE = "x,y,yaw in metres and radians, e.g. 0.3,-0.45,3.14"
"""Description of a planar pose on the command line."""


@dataclass(frozen=True)
class SettingsRequest:
    """The requested settings: a preset and changes to it.

    Attributes:
        preset: Name of the preset.
        assignments: Changes of settings as ``NAME=VALUE``, applied in order.
        max_sim_seconds: Time limit of an episode [simulated s], if it differs from the preset's.
        tolerance: Tolerance for success, position [m] and yaw [rad], if it differs from the scene's.
    """

    preset: str = "best"
    assignments: tuple[str, ...] = ()
    max_sim_seconds: float | None = None
    tolerance: tuple[float, float] | None = None

    def config(self, method: str, *, randomize: bool = False) -> Config:
        """Returns the validated settings for a method.

        Args:
            method: Name of the method that plans.
            randomize: Whether to evaluate each sample under :data:`RANDOMIZED_DRAWS` random draws, unless an assignment
                sets another number.

        Raises:
            ConfigError: The preset or a setting does not exist, or a value is not allowed.
        """
        if self.preset not in PRESETS:
            raise ConfigError(f"preset {self.preset!r} does not exist\n  allowed: {', '.join(PRESETS)}")
        known = method if method in METHODS else "cloi"  # results may be of a method that is not installed here
        config = PRESETS[self.preset](known)
        if randomize:
            config = set_option(config, f"robot.uncertainty.draws={RANDOMIZED_DRAWS}")
        for assignment in self.assignments:
            config = set_option(config, assignment)
        if self.max_sim_seconds is not None:
            config = replace(config, episode=replace(config.episode, max_sim_seconds=self.max_sim_seconds))
        if self.tolerance is not None:
            config = replace(config, episode=replace(config.episode, tolerance=self.tolerance))
        return validate(config)


def prepare_scene(
    scene: str | Path | Scene, *, start: PlanarPose | int | None = None, goal: PlanarPose | None = None, seed: int = 0
) -> Scene:
    """Loads a scene with the requested start and goal, and checks it.

    Args:
        scene: A USD file, the name of a shipped scene, or a scene that has been loaded.
        start: A planar pose [m, m, rad], the index (from 0) of a start listed in the scene, or ``None`` to draw a start
            with the seed.
        goal: A planar pose [m, m, rad], or ``None`` for the scene's goal.
        seed: Seed of the start, if it is drawn.

    Raises:
        SceneError: The task cannot be done.
        ConfigError: The scene has no start with this index.
    """
    from oimppi_warp.geometry.feasibility import check_task, sample_start
    from oimppi_warp.usd import load_scene

    loaded = scene if isinstance(scene, Scene) else load_scene(scene)
    if goal is not None:
        loaded = loaded.with_goal(goal)
    if start is None:
        start = sample_start(loaded, seed)
    elif isinstance(start, int):
        start = _listed_start(loaded, start)
    loaded = loaded.with_start(start)
    check_task(loaded)
    return loaded


def parse_pose(option: str, text: str, *, given: str = "", allowed: str = POSE) -> PlanarPose:
    """Parses a planar pose from "x,y,yaw", in metres and radians.

    Args:
        option: Name of the option that the text was given for.
        text: The text.
        given: The option and its value as typed, for the error; empty: ``option`` and ``text``.
        allowed: Description of the allowed values, for the error.

    Raises:
        ConfigError: The text is not a pose; the message shows ``given`` and ``allowed``.
    """
    try:
        x, y, yaw = (float(part) for part in text.split(","))
    except ValueError:
        x = y = yaw = math.nan
    if not all(map(math.isfinite, (x, y, yaw))):
        raise ConfigError(f"{given or f'{option} {text}'}: not a pose\n  allowed: {allowed}")
    return x, y, yaw


def is_tolerance(position: float, yaw: float) -> bool:
    """Returns whether a position [m] and a yaw [rad] can be a tolerance; metres that were meant as cm or mm cannot."""
    return 0.0 < position <= LARGEST_TOLERANCE[0] and 0.0 < yaw <= LARGEST_TOLERANCE[1] + 0.01


def parse_tolerance(text: str | None) -> tuple[float, float] | None:
    """Parses the value of ``--tolerance``, "position,yaw" in metres and radians; ``None`` is kept.

    Raises:
        ConfigError: The text is not a tolerance.
    """
    if text is None:
        return None
    try:
        position, yaw = (float(part) for part in text.split(","))
    except ValueError:
        position = yaw = math.nan
    if not is_tolerance(position, yaw):
        raise ConfigError(f"--tolerance {text}: not a tolerance\n  allowed: {TOLERANCE}")
    return position, yaw


def parse_start(text: str | None) -> PlanarPose | int | None:
    """Parses the value of ``--start``: the index of a start listed in the scene, or a planar pose; ``None`` is kept.

    Raises:
        ConfigError: The text is neither.
    """
    if text is None:
        return None
    if text.strip().isdecimal():
        return int(text)
    return parse_pose("--start", text, allowed=f"the index (from 0) of a start listed in the scene, or {POSE}")


def _listed_start(scene: Scene, index: int) -> PlanarPose:
    """Returns one of the scene's starts by its number."""
    count = len(scene.starts)
    if index >= count:
        raise ConfigError(f"--start {index}: {scene.name} has {count} starts\n  allowed: 0 to {count - 1}, or x,y,yaw")
    x, y, yaw = map(float, scene.starts[index])
    return x, y, yaw
