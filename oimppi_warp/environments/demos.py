"""Demonstrations: episodes of an environment in which a planner of this package acts, as a Minari data set.

Each episode is stored in a file of its own when it has ended, so that an interrupted run goes on where it stopped.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from oimppi_warp.config.settings import Config
from oimppi_warp.errors import ConfigError, missing_package
from oimppi_warp.record.log import to_json, write_atomically

EPISODES = "episodes"
"""Folder of the episodes' files, in that of the data set."""
MOST_FAILURES = 20
"""Number of failures, beyond as many as there are successes, after which recording stops."""


@dataclass(frozen=True)
class Demonstrator:
    """Planner, task and settings of demonstrations.

    Attributes:
        scene: A USD file, or the name of a shipped scene.
        method: Name of the planner's method.
        config: All settings.
        actions: Kind of action: ``"joint"`` or ``"tool"`` velocities.
        tolerance: Tolerance for success, position [m] and yaw [rad].
        steps: Time limit of an episode, in control steps.
    """

    scene: str
    method: str
    config: Config
    actions: str
    tolerance: tuple[float, float]
    steps: int

    @property
    def key(self) -> str:
        """Returns a hash of everything that decides an episode, besides its seed and the code."""
        from oimppi_warp.usd import load_scene, scene_content

        facts = to_json(asdict(self)) | {"content": scene_content(load_scene(self.scene).file)}
        return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:12]


@dataclass(frozen=True, eq=False)
class Demonstration:
    """One episode; the arrays are those of :class:`oimppi_warp.environments.push.PushEnvironment`.

    Attributes:
        seed: Seed of the start and of the planner.
        success: Whether the object was held at its goal.
        observations: Shape [steps + 1, n].
        actions: Shape [steps, m].
        rewards: Shape [steps].
    """

    seed: int
    success: bool
    observations: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray

    def save(self, file: Path) -> None:
        """Writes the episode to a file, completely or not at all."""
        packed = io.BytesIO()
        np.savez_compressed(packed, **vars(self))
        write_atomically(file, packed.getvalue())

    @classmethod
    def load(cls, file: Path) -> Demonstration:
        """Reads an episode that :meth:`save` wrote."""
        with np.load(file) as found:
            arrays = {name: found[name] for name in ("observations", "actions", "rewards")}
            return cls(seed=int(found["seed"]), success=bool(found["success"]), **arrays)


def demonstrate(who: Demonstrator, seed: int) -> Demonstration:
    """Runs one episode.

    The planner's joint velocities become actions: with tool actions, the horizontal velocity of the tip that they mean.
    They are rounded to the precision of the action space before they are carried out, so that the recorded actions lead
    to the recorded observations.

    Args:
        who: The demonstrator.
        seed: Seed of the start and of the planner.
    """
    from oimppi_warp.environments.push import PushEnvironment
    from oimppi_warp.geometry.kinematics import tip_jacobian
    from oimppi_warp.planning.factory import make_planner

    made: Any = PushEnvironment(
        who.scene,
        actions=who.actions,  # pyright: ignore[reportArgumentType]
        tolerance=who.tolerance,
        control_period=who.config.control_period,
        config=who.config,
    )
    seen, _ = made.reset(seed=seed)
    planner = make_planner(
        made.scene, made.config, method=who.method, engine="quasistatic", device="cpu", threads=1, seed=seed
    )
    planner.start(made.state)
    observations, actions, rewards, success = [seen], [], [], False
    for _ in range(who.steps):
        command = planner.plan(made.state).command
        if who.actions == "tool":
            command = (tip_jacobian(made.scene.robot, made.state.joint_position) @ command)[:2]
        action = np.clip(command.astype(np.float32), made.action_space.low, made.action_space.high)
        seen, reward, ended, _, info = made.step(action)
        observations.append(seen)
        actions.append(action)
        rewards.append(reward)
        success = bool(info["is_success"])
        if ended:
            break
    return Demonstration(seed, success, np.array(observations), np.array(actions), np.array(rewards))


def record(
    who: Demonstrator,
    folder: Path,
    *,
    episodes: int,
    first: int = 0,
    jobs: int | None = None,
    on_episode: Callable[[int, int], None] | None = None,
) -> list[Demonstration]:
    """Records episodes until enough have succeeded; those that are in the folder already are not run again.

    Args:
        who: The demonstrator.
        folder: Folder of the data set.
        episodes: Number of successful episodes.
        first: First seed; the following ones are used in turn, failures included.
        jobs: Number of processes; ``None``: one per core.
        on_episode: Called after each episode with the numbers of successes and of failures so far.

    Returns:
        The successful episodes, by seed.

    Raises:
        ConfigError: Most episodes fail.
    """
    import joblib

    place = folder / EPISODES / who.key
    place.mkdir(parents=True, exist_ok=True)
    good: list[Demonstration] = []
    failed, seed = 0, first
    while len(good) < episodes:
        batch = range(seed, seed + episodes - len(good))
        seed = batch.stop
        missing = [each for each in batch if not _file(place, each).is_file()]
        outcomes = [Demonstration.load(_file(place, each)).success for each in batch if each not in missing]
        calls = (joblib.delayed(_store)(who, each, place) for each in missing)
        parallel: Any = joblib.Parallel(n_jobs=jobs or -1, return_as="generator_unordered")
        for success in parallel(calls) if missing else ():
            outcomes.append(success)
            if on_episode is not None:
                on_episode(len(good) + sum(outcomes), failed + outcomes.count(False))
        failed += outcomes.count(False)
        found = (Demonstration.load(_file(place, each)) for each in batch)
        good.extend(each for each in found if each.success)
        if failed > len(good) + MOST_FAILURES:
            raise ConfigError(
                f"{failed} of {failed + len(good)} episodes failed\n  to do:   allow a larger --tolerance, or more time"
            )
    return good


def write_dataset(who: Demonstrator, found: list[Demonstration], folder: Path, name: str) -> None:
    """Writes episodes as a Minari data set below ``folder``, replacing one of the same name.

    Args:
        who: The demonstrator.
        found: The episodes.
        folder: Destination; Minari finds it if the variable ``MINARI_DATASETS_PATH`` names this folder.
        name: Name of the data set, such as ``"oimppi/task02/cloi-v0"``.

    Raises:
        ConfigError: Minari is not installed.
    """
    try:
        import gymnasium
        import minari
        from minari.data_collector.episode_buffer import EpisodeBuffer
    except ImportError as error:
        raise missing_package("demonstrations", str(error.name), "demos") from None
    import oimppi_warp.environments  # noqa: F401  # registers the tasks

    environment = gymnasium.make(
        "oimppi/scene-v0",
        scene=who.scene,
        actions=who.actions,
        tolerance=who.tolerance,
        control_period=who.config.control_period,
        max_episode_steps=who.steps,
    )
    buffers = [
        EpisodeBuffer(
            id=index,
            seed=each.seed,
            observations=list(each.observations),
            actions=list(each.actions),
            rewards=each.rewards.tolist(),
            terminations=[*[False] * (len(each.actions) - 1), True],
            truncations=[False] * len(each.actions),
            infos={},
        )
        for index, each in enumerate(found)
    ]
    with _datasets_in(folder), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # author and code are those of the data set, which is the user's
        if name in minari.list_local_datasets():
            minari.delete_dataset(name)
        minari.create_dataset_from_buffers(
            name,
            buffers,
            env=environment,
            algorithm_name=f"oimppi-warp, {who.method}",
            description=f"The planner pushes the object of {environment.unwrapped.scene.name} to its goal.",  # pyright: ignore
            requirements=["oimppi-warp[gym]"],
        )


def _store(who: Demonstrator, seed: int, place: Path) -> bool:
    """Runs one episode in a worker process, stores it, and returns whether it succeeded."""
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    found = demonstrate(who, seed)
    found.save(_file(place, seed))
    return found.success


def _file(place: Path, seed: int) -> Path:
    return place / f"{seed:05d}.npz"


@contextmanager
def _datasets_in(folder: Path) -> Iterator[None]:
    """Lets Minari keep its data sets in a folder, inside the context."""
    before = os.environ.get("MINARI_DATASETS_PATH")
    os.environ["MINARI_DATASETS_PATH"] = str(folder)
    try:
        yield
    finally:
        if before is None:
            del os.environ["MINARI_DATASETS_PATH"]
        else:
            os.environ["MINARI_DATASETS_PATH"] = before
