"""Writes a task and its dependencies to a user's folder, and checks them before they are moved there."""

from __future__ import annotations

import filecmp
import os
import re
import shutil
import tempfile
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from pxr import Sdf, Tf, Usd

from oimppi_warp.authoring.arm_start import clear_start
from oimppi_warp.authoring.attribute_docs import write_attribute_docs
from oimppi_warp.authoring.bundle import copy_bundle
from oimppi_warp.authoring.objects.flat_object import Pushable
from oimppi_warp.authoring.objects.stored import ENDINGS, StoredObject, is_object_file, read_body
from oimppi_warp.authoring.task import StaticObject, Task, write
from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.feasibility import check_task
from oimppi_warp.record.log import write_atomically
from oimppi_warp.scene import Scene
from oimppi_warp.usd import load_scene
from oimppi_warp.usd.conversion.property_types import usd_reason
from oimppi_warp.usd.stage import SCENES

_DRAFT_FIXES = {
    "change oimppi:goal, or give another goal": "give another goal (--goal)",
    "move the object in the file, or give another start": "give another start (--start)",
}
"""The remedy given when a file was not written."""


@dataclass(frozen=True, eq=False)
class WrittenTask:
    """The result of writing a task.

    Attributes:
        file: The scene file.
        scene: The scene as read back from the file.
        files: Every new or changed file, the scene first.
    """

    file: Path
    scene: Scene
    files: tuple[Path, ...]


def write_task(task: Task, folder: str | Path = ".", *, force: bool = False) -> WrittenTask:
    """Writes a task's scene to a folder, with the object in ``objects/`` and the robot in ``robots/`` beside it.

    The files are first written to a draft folder, read back and checked, and moved only if they are valid. A robot or
    an object that is already in the folder is used as it is. If a different object has the same name, the new one is
    written under a name that includes the task's. If the arm would start inside the object or an obstacle, another
    start is used.

    Args:
        task: The task; its robot is a USD file, or the name of one that is shipped or in the folder's ``robots/``.
        folder: Destination, created if necessary.
        force: Whether an existing scene of this name may be overwritten.

    Raises:
        SceneError: The scene already exists, or the task is not feasible; nothing was written.
    """
    folder = Path(folder).expanduser()
    target = folder / f"{task.name}.usda"
    _check_target(task.name, target, force)
    own = _own_objects(target, task.name) if target.exists() else frozenset()
    with tempfile.TemporaryDirectory(prefix="oimppi-") as temporary:
        draft = Path(temporary)
        try:
            _draft(task, draft, folder, own)
            scene = load_scene(draft / target.name)
            check_task(scene)
        except SceneError as error:
            raise _relocated(error, draft, folder) from None
        except Tf.ErrorException as error:
            what, fix = (
                f"OpenUSD cannot write the scene ({usd_reason(error)})",
                "correct the object's or the robot's file",
            )
            raise SceneError(what, file=target, allowed="valid USD", fix=fix) from None
        files = _install(draft, folder, Path(target.name), own)
    return WrittenTask(target, replace(scene, file=target.resolve()), files)


def write_object(obj: Pushable, folder: str | Path = ".", *, force: bool = False, picture: bool = False) -> Path:
    """Writes an object to ``objects/`` in a folder, with its attributes documented.

    Args:
        obj: The object.
        folder: Destination, created if necessary.
        force: Whether an existing object of this name may be overwritten.
        picture: Whether to draw a picture of it beside it, with the same name.

    Raises:
        SceneError: An object of this name already exists, or this one is invalid; nothing was written.
    """
    folder = Path(folder).expanduser()
    files = [Path("objects") / f"{obj.name}{ending}" for ending in (".usda", *([".png"] if picture else []))]
    for file in files:
        _check_target(obj.name, folder / file, force)
    with tempfile.TemporaryDirectory(prefix="oimppi-") as temporary:
        draft = Path(temporary)
        try:
            _write_object(obj, draft / files[0])
            body = read_body(draft / files[0])
        except SceneError as error:
            raise _relocated(error, draft, folder) from None
        if picture:
            from oimppi_warp.authoring.objects.preview import draw_preview

            draw_preview(obj, body, draft / files[1])
        _install(draft, folder, files[0], frozenset(files))
    return folder / files[0]


def find_robot(robot: str, folder: Path) -> Path:
    """Finds the file of a robot, by the name of one in ``robots/`` of a folder or of a shipped one, or by its path.

    Raises:
        SceneError: The robot does not exist.
    """
    file = Path(robot).expanduser()
    own = (folder / "robots" / f"{robot}{ending}" for ending in ENDINGS)
    for found in (*own, SCENES / "robots" / f"{robot}.usda", file):
        if found.is_file() and is_object_file(found):
            return found
    shipped = sorted(f.stem for f in (SCENES / "robots").glob("*.usda") if not f.stem.endswith("_skin"))
    raise SceneError(
        f"--robot {robot}: there is no such robot",
        allowed=f"{', '.join(shipped)}, a robot in {folder / 'robots'}, or a USD file",
    )


def _check_target(name: str, file: Path, force: bool) -> None:
    """Raises SceneError for invalid file names, existing files, and folders that are not writable."""
    if not re.fullmatch(r"[A-Za-z0-9][\w-]*", name, flags=re.ASCII):
        raise SceneError(
            f"{name!r} is not a valid name",
            allowed="letters a to z, digits, - and _, beginning with a letter or digit, as in push_s",
        )
    if file.exists() and not force:
        raise SceneError("the file already exists", file=file, allowed="a new name", fix="use --force to overwrite it")
    parent = next(place for place in (file.absolute(), *file.absolute().parents) if place.is_dir())
    if not os.access(parent, os.W_OK) or (file.parent.exists() and not file.parent.is_dir()):
        raise SceneError("the folder is not writable", file=file.parent, fix="choose another one with --out")


def _own_objects(scene: Path, task: str) -> frozenset[Path]:
    """Returns the objects that only a task's earlier scene uses and that are named after the task; relative paths."""
    others = set().union(*(_objects_in(other) for other in scene.parent.glob("*.usd*") if other != scene))
    return frozenset(file for file in _objects_in(scene) - others if f"_{task}" in file.stem)


def _objects_in(scene: Path) -> set[Path]:
    """Returns the files in ``objects/`` that a scene refers to."""
    with suppress(Tf.ErrorException):
        layer = Sdf.Layer.OpenAsAnonymous(str(scene)) if scene.is_file() else None
        used = map(Path, layer.GetCompositionAssetDependencies() if layer else [])
        return {file for file in used if file.parent == Path("objects")}
    return set()


def _draft(task: Task, draft: Path, folder: Path, own: frozenset[Path]) -> None:
    """Writes the files to an empty draft folder."""
    robot = copy_bundle(find_robot(task.robot, folder), draft / "robots")
    obj = _add_object(task.object, task.name, draft, folder, own)
    obstacles = [
        replace(o, object=_add_object(o.object, task.name, draft, folder, own)) if isinstance(o, StaticObject) else o
        for o in task.obstacles
    ]
    task = replace(task, robot=robot.name, object=obj, obstacles=tuple(obstacles))
    note = f"View it: oimppi view {task.name}.usda. Run it: oimppi run {task.name}.usda. Metres, kilograms, z up"
    file = write(task, draft, note=note, find_arm_start=None if task.robot_start else clear_start)
    stage = Usd.Stage.Open(str(file))
    write_attribute_docs(stage)
    stage.Save()


def _add_object(obj: Pushable, task: str, draft: Path, folder: Path, own: frozenset[Path]) -> Pushable:
    """Writes an object into the draft, under a name not taken by another object there or in the folder."""
    objects = Path("objects")
    if isinstance(obj, StoredObject) and obj.file == (folder / objects / f"{obj.name}.usda").resolve() and obj.is_ready:
        copy_bundle(obj.file, draft / objects)
        return obj
    made = draft / "new" / "object.usda"
    _write_object(obj, made)
    for name in (obj.name, *(f"{obj.name}_{task}{end}" for end in ("", *(f"_{i}" for i in range(2, 100))))):
        file = objects / f"{name}.usda"
        others = [draft / file] if file in own else [draft / file, folder / file]
        if all(filecmp.cmp(made, other, shallow=False) for other in others if other.exists()):
            shutil.copytree(made.parent, draft / objects, dirs_exist_ok=True)
            (draft / objects / made.name).replace(draft / file)
            shutil.rmtree(made.parent)
            return replace(obj, name=name)  # pyright: ignore[reportArgumentType]  # every object is a dataclass
    raise SceneError(f"a hundred objects are called {obj.name}", file=folder, fix="choose another folder with --out")


def _write_object(obj: Pushable, file: Path) -> None:
    """Writes an object's file with its attributes documented."""
    file.parent.mkdir(parents=True, exist_ok=True)
    obj.write(file)
    if not isinstance(obj, StoredObject):
        stage = Usd.Stage.Open(str(file))
        write_attribute_docs(stage)
        stage.Save()


def _install(draft: Path, folder: Path, main: Path, own: frozenset[Path]) -> tuple[Path, ...]:
    """Moves the files to their destination, the main one last, and returns those that changed, the main one first.

    The caller has checked that the main file and the task's own files may be overwritten; no other existing file is.
    """
    changed = []
    found = sorted(path.relative_to(draft) for path in draft.rglob("*") if path.is_file())
    found = [path for path in found if not _same(draft / path, folder / path)]
    for path in found:
        if (folder / path).exists() and path != main and path not in own:
            fix = f"choose another folder with --out, or rename the {path.name} that the new task uses"
            raise SceneError("a different file with this name already exists", file=folder / path, fix=fix)
    for path in sorted(found, key=lambda path: path == main):
        target = folder / path
        target.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(target, (draft / path).read_bytes())
        changed.insert(0, target)
    return tuple(changed)


def _same(made: Path, there: Path) -> bool:
    return there.exists() and filecmp.cmp(made, there, shallow=False)


def _relocated(error: SceneError, draft: Path, folder: Path) -> SceneError:
    """Rewrites an error about a draft to refer to the file that it would have become."""
    file = error.file.replace(str(draft.resolve()), str(folder)).replace(str(draft), str(folder))
    fix = _DRAFT_FIXES.get(error.fix, error.fix)
    what = f"{error.what} (nothing was written)"
    return SceneError(what, file=file, prim=error.prim, allowed=error.allowed, fix=fix)
