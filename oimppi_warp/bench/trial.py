"""One trial: everything that decides its result, the command that makes it again, and how it is run."""

from __future__ import annotations

import hashlib
import json
import os
import shlex
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from oimppi_warp.bench.suite import MODES, MOST, PLANTS, Entry, Suite
from oimppi_warp.config import Config
from oimppi_warp.errors import ConfigError
from oimppi_warp.log import to_json
from oimppi_warp.task import make_config, make_task

if TYPE_CHECKING:
    from oimppi_warp.episode import Episode
    from oimppi_warp.scene import PlanarPose, Scene


@dataclass(frozen=True)
class Trial:
    """One episode that is to be run.

    Attributes:
        task: Short name of the scene, with the entry's label behind it if it has one.
        scene: What to load it by: the name of a shipped scene, or a file.
        content: Hash of the scene's files.
        method, preset, engine, device, threads, mode, plant: As in the suite.
        number: From 0; the same number is the same start and the same seed for every method.
        seed: Of the planner's noise.
        start: Planar pose of the object.
        assignments: Settings that differ from the preset, ``NAME=VALUE``.
        max_sim_seconds: Time limit, if another than the preset's.
    """

    task: str
    scene: str
    content: str
    method: str
    number: int
    seed: int
    start: PlanarPose
    preset: str
    engine: str
    device: str
    threads: int
    assignments: tuple[str, ...]
    max_sim_seconds: float | None
    mode: str
    plant: str

    @property
    def real_time(self) -> bool:
        """Whether it runs against the clock, and must have the machine for itself."""
        return self.mode != MODES[0]

    @property
    def config(self) -> Config:
        """All settings."""
        return make_config(self.preset, self.method, assignments=self.assignments, max_sim_seconds=self.max_sim_seconds)

    @property
    def key(self) -> str:
        """Hash of what decides the result: the scene's content, all settings, method, engine, device, start, seed.

        Threads count only in real time: they change no bit of a plan.
        """
        facts = asdict(self) | {"config": to_json(self.config)}
        for name in (
            "scene",
            "number",
            "preset",
            "assignments",
            "max_sim_seconds",
            *(["threads"] * (not self.real_time)),
        ):
            del facts[name]
        return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:16]

    @property
    def name(self) -> str:
        """Name of its folder."""
        return f"{self.task}-{self.method}-{self.number:03d}-{self.key[:8]}"

    @property
    def arguments(self) -> list[str]:
        """What follows ``oimppi`` to run this trial alone, with the same result."""
        words = ["run", self.scene, "--method", self.method, "--preset", self.preset, "--engine", self.engine]
        words += ["--device", self.device, "--threads", str(self.threads), "--seed", str(self.seed)]
        words += ["--start", ",".join(map(repr, self.start))]
        if self.max_sim_seconds is not None:
            words += ["--max-sim-seconds", repr(self.max_sim_seconds)]
        for name, value in mode_options(self).items():
            words += [f"--{name}", value]
        if self.assignments:
            words += ["--set", *self.assignments]
        return words

    @property
    def command(self) -> str:
        """The same as one line for a shell."""
        return shlex.join(["oimppi", *self.arguments])


def mode_options(trial: Trial) -> dict[str, Any]:
    """``mode`` and ``plant``, as options of ``oimppi run`` and of :class:`Episode`; only what is not the default."""
    chosen = {"mode": (trial.mode, MODES[0]), "plant": (trial.plant, PLANTS[0])}
    return {name: value for name, (value, usual) in chosen.items() if value != usual}


def make_episode(trial: Trial) -> Episode:
    """The episode of a trial, as ``oimppi run`` makes it."""
    from oimppi_warp.device import pick_device
    from oimppi_warp.episode import Episode

    return Episode(
        make_task(trial.scene, start=trial.start),
        trial.config,
        method=trial.method,
        engine=trial.engine,
        device=pick_device(trial.device),
        threads=trial.threads,
        seed=trial.seed,
        **mode_options(trial),
    )


def make_trials(suite: Suite) -> tuple[list[Trial], dict[str, Scene]]:
    """Every trial of a suite, and its tasks by their short names.

    The scene's own starts come first, then ones drawn with the trial's seed. Start and seed depend on the task and the
    number only, so that methods can be compared in pairs.

    Raises:
        SceneError: A scene cannot be read, or no start can be drawn.
        ConfigError: Two entries have the same task and method, and no labels to tell them apart.
    """
    from oimppi_warp.usd import load_scene, scene_content

    trials: list[Trial] = []
    scenes: dict[str, Scene] = {}
    known: set[tuple[str, str]] = set()
    for entry in suite.entries:
        for task in entry.tasks:
            path = _scene_path(suite, task)
            scene = load_scene(path)
            name = f"{scene.name}-{entry.label}" if entry.label else scene.name
            for method in entry.methods:
                if (name, method) in known:
                    raise ConfigError(
                        f"{suite.file}: {method} on {name} stands there twice\n"
                        '  to do:   give one of its entries a label = "..."'
                    )
                known.add((name, method))
            scenes[name] = scene
            content = scene_content(scene.file)
            for number in range(entry.trials):
                seed = MOST * entry.seed + number
                start = _start(scene, number, seed)
                for method in entry.methods:
                    trials.append(_trial(entry, name, path, content, method, number, seed, start))
    return trials, scenes


def _scene_path(suite: Suite, task: str) -> str:
    """What to load a scene by from here: a file that stands beside the suite, or the name as it is."""
    beside = suite.file.parent / task
    return os.path.relpath(beside) if beside.is_file() else task


def _start(scene: Scene, number: int, seed: int) -> PlanarPose:
    from oimppi_warp.feasibility import draw_start

    if number < len(scene.starts):
        x, y, yaw = map(float, scene.starts[number])
        return x, y, yaw
    return draw_start(scene, seed)


def _trial(
    entry: Entry, task: str, path: str, content: str, method: str, number: int, seed: int, start: PlanarPose
) -> Trial:
    return Trial(
        task=task,
        scene=path,
        content=content,
        method=method,
        number=number,
        seed=seed,
        start=start,
        preset=entry.preset,
        engine=entry.engine,
        device=entry.device,
        threads=entry.threads,
        assignments=entry.set,
        max_sim_seconds=entry.max_sim_seconds,
        mode=entry.mode,
        plant=entry.plant,
    )
