"""The command ``oimppi demos``."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, UseAppendAction, arg

from oimppi_warp.config.presets import PRESETS
from oimppi_warp.config.run_spec import LARGEST_SEED, MethodName
from oimppi_warp.errors import ConfigError, missing_package
from oimppi_warp.registries import METHODS

if TYPE_CHECKING:
    from rich.console import Console

Assignments = arg(name="set", metavar="NAME=VALUE", help_behavior_hint="(repeatable)")


@dataclass(frozen=True)
class Demos:
    """Record successful episodes of a planner as demonstrations for learning, as a Minari data set (HDF5).

    To resume a recording that was stopped, run the same command again. Exit status: 0 all episodes were recorded, 2 bad
    input, 130 stopped with Ctrl-C. docs/environments.md describes the environment and shows how to learn from the data.
    """

    scene: Annotated[Positional[str], arg(metavar="SCENE")]
    """A USD file, or the name of a shipped scene (`oimppi scenes` lists them)."""

    out: Annotated[Path, arg(metavar="FOLDER")]
    """Folder of the data set; let MINARI_DATASETS_PATH name this folder when the data set is loaded."""

    episodes: Annotated[int, arg(metavar="N")] = 200
    """Number of successful episodes."""

    method: MethodName = "cloi"
    """Method of the planner that demonstrates."""

    actions: Literal["joint", "tool"] = "joint"
    """Kind of action: joint velocities (joint), or the horizontal velocity of the tip (tool)."""

    first: Annotated[int, arg(metavar="N")] = 0
    """Seed of the first episode; each further episode has the next one."""

    tolerance: Annotated[
        str | None, arg(metavar="M,RAD", help_behavior_hint="(default: 0.005,0.02, or the scene's if it is stricter)")
    ] = None
    """Tolerance for success: position in metres and yaw in radians."""

    preset: Literal[tuple(PRESETS)] = "best"  # pyright: ignore[reportInvalidTypeForm]
    """Settings to start from."""

    assignments: Annotated[UseAppendAction[tuple[tuple[str, ...], ...]], Assignments] = ()
    """Change settings; docs/settings.md lists the names."""

    max_sim_seconds: Annotated[float | None, arg(metavar="S", help_behavior_hint="(default: the preset's)")] = None
    """Time limit of an episode in simulated seconds."""

    jobs: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: one per core)")] = None
    """Number of episodes to run in parallel, each in a separate process."""

    def execute(self) -> int:
        """Records the demonstrations and returns the exit status."""
        from oimppi_warp.runtime.request import SettingsRequest, parse_tolerance

        METHODS.check(self.method)
        for name, value, low in (
            ("--episodes", self.episodes, 1),
            ("--jobs", self.jobs, 1),
            ("--first", self.first, 0),
        ):
            if value is not None and value < low:
                raise ConfigError(f"{name} {value} cannot be used\n  allowed: {low} or more")
        if self.first + self.episodes > LARGEST_SEED:
            raise ConfigError(f"--first {self.first} cannot be used\n  allowed: seeds up to {LARGEST_SEED}")
        assignments = tuple(assignment for group in self.assignments for assignment in group)
        config = SettingsRequest(self.preset, assignments, self.max_sim_seconds).config(self.method)
        wanted = parse_tolerance(self.tolerance)
        try:
            from oimppi_warp.environments import demos
        except ImportError as error:
            raise missing_package("demonstrations", str(error.name), "demos") from None

        from rich.console import Console

        from oimppi_warp.runtime.request import prepare_scene

        console = Console(stderr=True, highlight=False)
        scene = prepare_scene(self.scene, start=0)
        strictest = scene.tolerance.strictest(scene.exact_tolerance)
        who = demos.Demonstrator(
            scene=self.scene,
            method=self.method,
            config=config,
            actions=self.actions,
            tolerance=wanted or (strictest.position, strictest.yaw),
            steps=round(config.episode.max_sim_seconds / config.control_period),
        )
        try:
            with _progress(self.episodes, console) as on_episode:
                found = demos.record(
                    who, self.out, episodes=self.episodes, first=self.first, jobs=self.jobs, on_episode=on_episode
                )
        except KeyboardInterrupt:
            console.print("stopped; run the same command again to resume", soft_wrap=True)
            return 130
        name = f"oimppi/{scene.name}/{self.method}-{self.actions}-v0"
        demos.write_dataset(who, found, self.out, name)
        steps = sum(len(each.actions) for each in found)
        print(f"{name}: {len(found)} episodes, {steps} steps, in {self.out}")
        print(f"MINARI_DATASETS_PATH={self.out.absolute()} lets minari.load_dataset({name!r}) find it")
        return 0


@contextmanager
def _progress(episodes: int, console: Console) -> Iterator[Callable[[int, int], None]]:
    """Shows a progress bar over the successful episodes; yields the function to call after each episode."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (BarColumn(), TextColumn("{task.completed:.0f} of {task.total:.0f}, {task.fields[failed]} failed"))
    with Progress(*columns, TimeRemainingColumn(), console=console, refresh_per_second=5, transient=True) as progress:
        bar = progress.add_task("", total=episodes, failed=0)
        yield lambda good, failed: progress.update(bar, completed=good, failed=failed)
