"""Reads a :class:`oimppi_warp.scene.Scene` from a USD file.

Physics is read from the standard UsdPhysics schemas; anything that USD has no schema for is read from this package's
own (`docs/schema.md`). The friction of a pair of shapes is the larger of their materials' coefficients, as in MuJoCo.

Reading does not stop at a mistake (:meth:`oimppi_warp.usd.stage.SceneStage.attempt`): the mistake is noted, and
everything that does not depend on it is still read. All mistakes are thus reported at once, but none that is only a
consequence of another.
"""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

from pxr import Sdf

from oimppi_warp.errors import SceneError
from oimppi_warp.scene import Scene
from oimppi_warp.suggestions import did_you_mean_file
from oimppi_warp.usd.bodies import check_roles, read_object, read_obstacle, read_table
from oimppi_warp.usd.robot import read_robot
from oimppi_warp.usd.stage import SCENES, SceneStage
from oimppi_warp.usd.task import read_gravity, read_task

__all__ = ["Inspection", "ShippedScene", "inspect_scene", "load_scene", "scene_content", "shipped_scenes"]


@dataclass(frozen=True)
class ShippedScene:
    """A scene shipped with the package: its name, a one-line description, and its file."""

    name: str
    title: str
    path: Path


def shipped_scenes() -> list[ShippedScene]:
    """Returns the scenes shipped with the package, ordered by name."""
    scenes = []
    for path in sorted(SCENES.glob("*.usda")):
        layer = Sdf.Layer.FindOrOpen(str(path))
        title = layer.GetAttributeAtPath(f"/{layer.defaultPrim}.oimppi:title")
        scenes.append(ShippedScene(path.stem, title.default if title else "", path))
    return scenes


@dataclass(frozen=True)
class Inspection:
    """The result of reading a scene.

    Attributes:
        file: The USD file.
        scene: The task; ``None`` if it cannot be read.
        mistakes: Errors found, in the order of reading.
        stage: The composed stage; ``None`` if the file is not USD.
    """

    file: Path
    scene: Scene | None
    mistakes: tuple[SceneError, ...]
    stage: SceneStage | None


def load_scene(scene: str | Path) -> Scene:
    """Reads and checks a scene.

    Args:
        scene: A USD file, or the name of a shipped scene (``"task02"``).

    Raises:
        SceneError: The scene cannot be run; the message gives the mistake, its place, the allowed values and a fix.
            Whether the arm can do the task is checked separately: :func:`oimppi_warp.geometry.feasibility.check_task`.
    """
    found = inspect_scene(scene)
    if found.scene is None:
        first, *others = found.mistakes
        raise first.among(len(others))
    return found.scene


def inspect_scene(scene: str | Path) -> Inspection:
    """Reads a scene and collects every mistake in it.

    Args:
        scene: A USD file, or the name of a shipped scene.

    Raises:
        SceneError: The file does not exist.
    """
    file, mistakes = _find(scene), list[SceneError]()
    stage = read = None
    try:
        stage = SceneStage(file, mistakes)
        read = _read(stage)
    except SceneError as error:
        mistakes.append(error.with_traceback(None))
    return Inspection(file, None if mistakes else read, tuple(mistakes), stage)


def _read(stage: SceneStage) -> Scene | None:
    """Reads as much of the scene as possible; mistakes are collected by the stage."""
    task = stage.attempt(None, read_task, stage)
    robot = stage.attempt(None, read_robot, stage)
    table = stage.attempt(None, read_table, stage)
    pushed = stage.attempt(None, read_object, stage)
    obstacles = [stage.attempt(None, read_obstacle, stage, prim) for prim in stage.prims_with("OimppiObstacleAPI")]
    gravity = stage.attempt((0.0, 0.0, 0.0), read_gravity, stage)
    check_roles(stage)
    if task is None or robot is None or table is None or pushed is None:
        return None
    body, start = pushed
    return Scene(
        file=stage.file,
        name=stage.file.stem,
        title=task.title,
        robot=robot,
        object=body,
        table=table,
        obstacles=tuple(obstacle for obstacle in obstacles if obstacle is not None),
        start=start,
        starts=task.starts_or(start),
        spread=task.spread,
        goal=task.goal,
        tolerance=task.tolerance,
        tight_tolerance=task.tight_tolerance,
        gravity=gravity,
    )


def scene_content(file: Path) -> str:
    """Returns a hash of the contents of a scene's file and of every USD file that it refers to.

    The hash does not depend on the names and folders of the files.

    Raises:
        SceneError: The file is not USD.
    """
    found = sorted(hashlib.sha256(each.read_bytes()).hexdigest() for each in SceneStage(file).layers)
    return hashlib.sha256("".join(found).encode()).hexdigest()[:24]


def _find(scene: str | Path) -> Path:
    """Returns the file of a scene given by its path or its shipped name."""
    names = [path.stem for path in sorted(SCENES.glob("*.usda"))]
    if str(scene) in names:
        return SCENES / f"{scene}.usda"
    file = Path(os.path.expanduser(scene))
    if file.is_file():
        return file.resolve()
    raise SceneError(
        "there is no such file",
        file=scene,
        allowed=f"a USD file, or one of {', '.join(names)}",
        fix=did_you_mean_file(scene, names, (".usda", ".usd", ".usdc", ".usdz"))
        or "`oimppi scenes` lists the scenes that come with the package",
    )
