"""A single trial: everything that affects its result, the command that repeats it, and the code that runs it."""

from __future__ import annotations

import hashlib
import json
import os
import shlex
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from oimppi_warp.bench.suite import Suite
from oimppi_warp.config.overrides import effective_weights
from oimppi_warp.config.run_spec import LARGEST_SEED, RunSpec
from oimppi_warp.config.settings import Config
from oimppi_warp.errors import ConfigError, SceneError
from oimppi_warp.plants.factory import starts_itself
from oimppi_warp.record.log import flatten, to_json
from oimppi_warp.registries import PLANTS
from oimppi_warp.runtime.request import SettingsRequest, prepare_scene

if TYPE_CHECKING:
    from oimppi_warp.runtime.episode import Episode
    from oimppi_warp.scene import PlanarPose, Scene

_SEEDS, _NUMBERS = 100_000, 10_000
"""Seeds are computed arithmetically for suite seeds up to the first and trial numbers below the second."""


@dataclass(frozen=True)
class Trial:
    """One episode to be run.

    Attributes:
        task: Short name of the scene, followed by the entry's label, if any.
        scene: Name of a shipped scene, or a file, from which it is loaded.
        content: Hash of the scene's files, and of the file of a plant ``FILE.py:NAME``.
        number: Number of the trial, from 0; the same number means the same start and the same seed for every method.
        start: Planar start pose of the object: x, y, yaw [m, m, rad]. A plant that starts itself ignores it.
        run: Options of the run, with the trial's own seed.
        settings: Requested settings.
    """

    task: str
    scene: str
    content: str
    number: int
    start: PlanarPose
    run: RunSpec
    settings: SettingsRequest

    @property
    def real_time(self) -> bool:
        """Returns whether the trial runs in real time and needs exclusive use of the machine."""
        return self.run.mode == "realtime"

    @property
    def config(self) -> Config:
        """Returns the settings for the trial's method, complete and validated."""
        return self.settings.config(self.run.method)

    @property
    def key(self) -> str:
        """Returns a hash of everything that affects the result: scene content, settings, start, and options of the run.

        The number of threads is included only in real time; otherwise plans are identical for any number of them.
        """
        config = self.config  # including default weights of cost terms from other packages
        config = replace(config, cost=replace(config.cost, extra=effective_weights(config.cost)))
        facts = flatten(self) | {"config": to_json(config)}
        if place := PLANTS.place(self.run.plant):
            facts["plant"] = place[1]  # its file counts by its content
        for name in ("scene", "number", *flatten(self.settings), *(["threads"] * (not self.real_time))):
            del facts[name]
        return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:16]

    @property
    def name(self) -> str:
        """Returns the name of the trial's folder."""
        return f"{self.task}-{self.run.method}-{self.number:03d}-{self.key[:8]}"

    @property
    def arguments(self) -> list[str]:
        """Returns the arguments for ``oimppi`` that run this trial alone, with the same result."""
        run, settings = self.run, self.settings
        words = ["run", self.scene, "--method", run.method, "--preset", settings.preset, "--engine", run.engine]
        words += ["--device", run.device]
        if run.threads is not None:
            words += ["--threads", str(run.threads)]
        words += ["--seed", str(run.seed)]
        if not starts_itself(run.plant):
            words += ["--start", ",".join(map(repr, self.start))]
        if settings.max_sim_seconds is not None:
            words += ["--max-sim-seconds", repr(settings.max_sim_seconds)]
        if settings.tolerance is not None:
            words += ["--tolerance", ",".join(map(repr, settings.tolerance))]
        for option in ("mode", "plant"):
            if (value := getattr(run, option)) != getattr(RunSpec(), option):
                words += [f"--{option}", value]
        if run.plant_options:
            words += ["--plant-options", *run.plant_options]
        if run.friction is not None:
            words += ["--friction", repr(run.friction)]
        if run.knock is not None:
            words += ["--knock", *map(repr, run.knock)]
        if settings.assignments:
            words += ["--set", *settings.assignments]
        return words

    @property
    def command(self) -> str:
        """Returns the shell command that runs this trial alone, with the same result."""
        return shlex.join(["oimppi", *self.arguments])

    def row(self) -> dict[str, Any]:
        """Returns the trial in JSON types, with its options and settings inlined."""
        return to_json(flatten(self))


def make_episode(trial: Trial) -> Episode:
    """Creates the episode of a trial, as ``oimppi run`` does.

    Raises:
        SceneError: The scene cannot be read, or the task cannot be done.
        ConfigError: A setting is invalid.
        DeviceError: The device does not exist.
    """
    from oimppi_warp.compute.device import pick_device
    from oimppi_warp.runtime.episode import Episode

    run = replace(trial.run, device=pick_device(trial.run.device))
    return Episode(prepare_scene(trial.scene, start=trial.start), trial.config, run)


def trial_seed(seed: int, number: int) -> int:
    """Returns the seed of a trial's noise and, if its start is drawn, of its start.

    For a suite's seed up to 100000 and a number below 10000 it is ``10000 * seed + number``. All others are hashed with
    NumPy's ``SeedSequence`` into the 32-bit numbers above those, so that a hashed seed never equals an arithmetic one.
    Two hashed seeds collide only by chance, one pair in 3.3 billion.

    Args:
        seed: Seed of the suite.
        number: Number of the trial.
    """
    if seed <= _SEEDS and number < _NUMBERS:
        return _NUMBERS * seed + number
    counted = _NUMBERS * (_SEEDS + 1)
    (word,) = np.random.SeedSequence([seed, number]).generate_state(1, np.uint64)
    return counted + int(word) % (LARGEST_SEED + 1 - counted)


def make_trials(suite: Suite) -> tuple[list[Trial], dict[str, Scene]]:
    """Creates all trials of a suite, and loads the scenes of its tasks.

    The lowest numbers use the starts that the scene lists, for any seed; all other starts are drawn with the trial's
    seed.
    Start and seed depend only on the task, the suite's seed and the trial's number, so that methods can be compared in
    pairs.

    Returns:
        The trials in the order in which the suite lists them, and the scenes by :attr:`Trial.task`.

    Raises:
        SceneError: A scene cannot be read, or no start can be drawn.
        ConfigError: A scene does not exist, or a task and method occur twice without different labels.
    """
    from oimppi_warp.usd import load_scene, scene_content

    trials: list[Trial] = []
    scenes: dict[str, Scene] = {}
    known: set[tuple[str, str]] = set()
    for entry in suite.entries:
        for task in entry.tasks:
            path = _scene_path(suite, task)
            try:
                scene = load_scene(path)
            except SceneError as error:
                raise error if Path(path).is_file() else ConfigError(f"{suite.file}: {error}") from None
            name = f"{scene.name}-{entry.label}" if entry.label else scene.name
            for method in entry.methods:
                if (name, method) in known:
                    raise ConfigError(
                        f"{suite.file}: {method} on {name} is listed twice\n"
                        '  to do:   give one of the entries a label = "..."'
                    )
                known.add((name, method))
            scenes[name] = scene
            content = scene_content(scene.file)
            if place := PLANTS.place(entry.run.plant):
                content += hashlib.sha256(place[0].read_bytes()).hexdigest()[:24]
            for number in entry.numbers:
                seed = trial_seed(entry.run.seed, number)
                start = scene.start if starts_itself(entry.run.plant) else _start(scene, number, seed, entry.beside)
                for method in entry.methods:
                    run = replace(entry.run, method=method, seed=seed)
                    trials.append(Trial(name, path, content, number, start, run, entry.settings))
    return trials, scenes


def _scene_path(suite: Suite, task: str) -> str:
    """Returns the path, from the current folder, of a scene file next to the suite, or else what the suite names.

    A file that does not exist is one next to the suite, unless the name has no ending, like that of a shipped scene.
    """
    beside = suite.file.parent / task
    meant = beside.is_file() or (Path(task).suffix and not Path(os.path.expanduser(task)).is_file())
    return os.path.relpath(beside) if meant else task


def _start(scene: Scene, number: int, seed: int, beside: tuple[float, float] | None) -> PlanarPose:
    from oimppi_warp.geometry.feasibility import sample_beside, sample_start

    if beside is not None:
        return sample_beside(scene, seed, beside)
    if number < len(scene.starts):
        x, y, yaw = map(float, scene.starts[number])
        return x, y, yaw
    return sample_start(scene, seed)
