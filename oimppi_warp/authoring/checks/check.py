"""Checks a scene, before it is run, for everything that would stop or spoil the run."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from oimppi_warp.errors import Problem, SceneError
from oimppi_warp.geometry.feasibility import pose_mistakes, sample_start, task_mistakes
from oimppi_warp.geometry.footprint import height_range
from oimppi_warp.geometry.rolling import IN_WORDS, REMEDY, rolling
from oimppi_warp.geometry.tipping import can_tip, tipping_height
from oimppi_warp.scene import PlanarPose, Scene
from oimppi_warp.usd import Inspection, inspect_scene
from oimppi_warp.usd.inertia import given_moments
from oimppi_warp.usd.lint import lint_stage

if TYPE_CHECKING:
    from oimppi_warp.authoring.checks.free_path import Bottleneck, FreePaths

NARROW = 0.005
"""Clearance on either side of the object below which a path is reported as narrow [m]."""

MAX_NODES = 2e8
"""Maximum number of nodes in the grid of phi_2, which then takes 800 MB."""


def check_scene(scene: str | Path) -> tuple[Problem, ...]:
    """Returns every problem of a scene, errors first, then warnings.

    Args:
        scene: A USD file, or the name of a shipped scene.

    Raises:
        SceneError: The file does not exist.
    """
    found = inspect_scene(scene)
    problems = [mistake.problem for mistake in found.mistakes]
    if found.stage is not None:
        problems += lint_stage(found.stage)
    if found.scene is not None:
        errors = [mistake.problem for mistake in _task_errors(found.scene)]
        problems += [*errors, *_task_warnings(found.scene), *_mass_warnings(found)]
        if not errors:
            problems += _path_warnings(found.scene)
    placed = [problem if problem.prim else replace(problem, prim=_task_prim(found)) for problem in problems]
    return tuple(sorted(placed, key=lambda problem: problem.severity == "warning"))


def _task_prim(found: Inspection) -> str:
    """Returns the path of the prim that holds the goal and the starts, if the scene can be read."""
    if found.scene is None or found.stage is None:
        return ""
    return str(found.stage.prims_with("OimppiTaskAPI")[0].GetPath())


def _task_errors(scene: Scene) -> Iterator[SceneError]:
    """Yields errors in the scene's own start and goal, or in the starts drawn from seeds, that would stop a run."""
    mistakes = [*task_mistakes(scene), *_too_large(scene)]
    yield from mistakes
    if not mistakes:
        try:
            sample_start(scene, 0)
        except SceneError as mistake:
            yield mistake


def _too_large(scene: Scene) -> Iterator[SceneError]:
    """Yields an error if the part of the table within reach is too large for the planner's fields to fit in memory."""
    from oimppi_warp.geometry.pose_grid import STEP, YAW_NODES
    from oimppi_warp.geometry.reach import stretched_length

    reach = stretched_length(scene.robot)
    size = np.minimum(scene.table.upper, reach) - np.maximum(scene.table.lower, -reach)
    if YAW_NODES * float(np.prod(np.maximum(size, 0.0) / STEP)) > MAX_NODES:
        yield SceneError(
            f"the arm reaches {size[0]:.3g} x {size[1]:.3g} m of the table",
            file=scene.file,
            prim=scene.table.path,
            allowed=f"at most {MAX_NODES / YAW_NODES * STEP**2:.0f} m^2, for the planner's grid to fit in memory",
            fix="reduce the size of the table, or the arm's links or limits",
        )


def _task_warnings(scene: Scene) -> Iterator[Problem]:
    for number, start in _starts(scene):
        for mistake in _mistakes(scene, number, start):
            yield _warning(scene, mistake.what, allowed=mistake.allowed, fix=mistake.fix)
    if scene.spread == (0.0, 0.0) and len(scene.starts) < 2:
        yield _warning(
            scene,
            "every run starts from the same pose",
            allowed="a spread above zero, or several starts",
            fix="set oimppi:spread, from which seeds draw starts, or list several oimppi:starts",
        )
    body = scene.object
    if rolls := rolling(body):
        yield _warning(
            scene,
            IN_WORDS[rolls],
            prim=body.path,
            allowed="an object that rests on a flat side; the planner predicts sliding only",
            fix=REMEDY,
        )
    if tipping_height(body) > 0.0 and can_tip(body):  # zero means a wrong centre of mass, which has its own warning
        top = body.rest_height + height_range(body.colliders)[1]
        yield _warning(
            scene,
            f"a push may tip the object over: its top is at {1000 * top:.0f} mm",
            prim=body.path,
            allowed=f"up to {1000 * tipping_height(body):.0f} mm at this width and friction",
            fix="make it lower, wider or smoother; otherwise the planner pushes it low and slowly",
        )


def _mass_warnings(found: Inspection) -> Iterator[Problem]:
    from oimppi_warp.authoring.checks.mass import mass_warnings

    scene, stage = found.scene, found.stage
    assert scene is not None and stage is not None
    inertia = given_moments(stage.stage.GetPrimAtPath(scene.object.path))
    for warning in mass_warnings(scene, stage, inertia):
        yield _warning(scene, warning.what, prim=scene.object.path, allowed=warning.allowed, fix=warning.fix)


def _starts(scene: Scene) -> Iterator[tuple[int, PlanarPose]]:
    """Yields the listed starts with their numbers, except the file's own start, which may be rounded in the list."""
    for number, (x, y, yaw) in enumerate(scene.starts.tolist()):
        turn = math.remainder(yaw - scene.start[2], 2.0 * math.pi)
        if not np.allclose((x - scene.start[0], y - scene.start[1], turn), 0.0, atol=1e-6):
            yield number, (x, y, yaw)


def _mistakes(scene: Scene, number: int, start: PlanarPose) -> Iterator[SceneError]:
    return pose_mistakes(scene, f"start {number}", start)


def _path_warnings(scene: Scene) -> Iterator[Problem]:
    """Yields warnings about poses without room, starts without a free path, and narrow paths.

    Start and goal must not overlap anything.
    """
    from oimppi_warp.authoring.checks.free_path import FreePaths
    from oimppi_warp.geometry.fields import build_geometry

    paths = FreePaths(scene, build_geometry(scene, "cpu"))
    listed = {f"start {number}": start for number, start in _starts(scene) if not any(_mistakes(scene, number, start))}
    poses = {"goal": scene.goal, "start": scene.start, **listed}
    cramped = [name for name, pose in poses.items() if paths.clearance_near(pose) <= 0.0]
    for name in cramped:
        next_to = " and ".join(paths.neighbors(poses[name])[0])
        yield _warning(
            scene,
            f"there is hardly any room around the object's {name}, next to {next_to}",
            allowed="enough room for the object to overlap nothing on a grid of 1 cm and 5 degrees",
            fix="move these away from it, or choose another pose",
        )
    starts = {name: pose for name, pose in poses.items() if name not in ("goal", *cramped)}
    if "goal" not in cramped and starts:
        yield from _narrow_warnings(scene, paths, starts)


def _narrow_warnings(scene: Scene, paths: FreePaths, starts: dict[str, PlanarPose]) -> Iterator[Problem]:
    """Yields a warning about the bottleneck of the first start without a free path, or else of the first start."""
    blocked = [name for name, start in starts.items() if paths.is_blocked(start)]
    bottleneck = paths.bottleneck(starts[blocked[0]] if blocked else next(iter(starts.values())))
    if blocked:
        more = len(blocked) - 1
        which = blocked[0] + (f" and {more} other{'s' if more > 1 else ''}" if more else "")
        where = "" if bottleneck is None else f": {_describe(bottleneck)}"
        yield _warning(
            scene,
            f"no free path leads to the goal from the object's {which}{where}",
            allowed="a path along which the object overlaps nothing, on a grid of 1 cm and 5 degrees",
            fix="move what is in the way, or choose another start or goal",
        )
    elif bottleneck is not None and bottleneck.clearance < NARROW:
        yield _warning(
            scene,
            f"the path to the goal is narrow: {_describe(bottleneck)}",
            allowed=f"{2000 * NARROW:g} mm more than the object's width there",
            fix="move these apart, or choose another start or goal",
        )


def _describe(bottleneck: Bottleneck) -> str:
    """Describes a path's bottleneck in words."""
    x, y, yaw = bottleneck.pose
    where = f"at ({x:.2f}, {y:.2f}, {yaw:.2f}) the widest path runs"
    missing = 1000.0 * abs(bottleneck.clearance)
    if bottleneck.gap is None:
        left = f"with {missing:.0f} mm to spare" if bottleneck.clearance > 0.0 else f"{missing:.0f} mm into it"
        return f"{where} past {bottleneck.neighbors[0]}, {left}"
    left = f"{2.0 * missing:.0f} mm {'more' if bottleneck.clearance > 0.0 else 'less'} than the object needs there"
    apart = f"{1000 * bottleneck.gap:.0f} mm apart"
    return f"{where} between {' and '.join(bottleneck.neighbors)}, which are {apart}: about {left}"


def _warning(scene: Scene, what: str, *, prim: str = "", allowed: str = "", fix: str = "") -> Problem:
    return Problem(str(scene.file), "warning", prim, what, allowed, fix)
