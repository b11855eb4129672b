"""Everything that would stop or spoil a run of a scene, found before it is run."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from oimppi_warp.errors import Problem, SceneError
from oimppi_warp.feasibility import draw_start, pose_mistakes, task_mistakes
from oimppi_warp.footprint import height_range
from oimppi_warp.scene import Scene
from oimppi_warp.tipping import can_tip, tipping_height
from oimppi_warp.usd import inspect_scene


def check_scene(scene: str | Path) -> tuple[Problem, ...]:
    """Every problem of a scene: errors first, then warnings.

    Args:
        scene: A USD file, or the name of a shipped scene.

    Raises:
        SceneError: There is no such file.
    """
    found = inspect_scene(scene)
    problems = [mistake.problem for mistake in found.mistakes]
    if found.scene is not None:
        problems += [mistake.problem for mistake in _task_errors(found.scene)]
        problems += _task_warnings(found.scene)
    return tuple(sorted(problems, key=lambda problem: problem.severity == "warning"))


def _task_errors(scene: Scene) -> Iterator[SceneError]:
    """Why the scene's own start and goal, or the starts that seeds draw, stop a run."""
    mistakes = list(task_mistakes(scene))
    yield from mistakes
    if not mistakes:
        try:
            draw_start(scene, 0)
        except SceneError as mistake:
            yield mistake


def _task_warnings(scene: Scene) -> Iterator[Problem]:
    for number, (x, y, yaw) in enumerate(scene.starts):
        start = (float(x), float(y), float(yaw))
        if start != scene.start:
            for mistake in pose_mistakes(scene, f"start {number}", start):
                yield _warning(scene, mistake.what, allowed=mistake.allowed, fix=mistake.fix)
    if scene.spread == (0.0, 0.0) and len(scene.starts) < 2:
        yield _warning(
            scene,
            "every run starts from the same pose",
            allowed="a spread above zero, or several starts",
            fix="give oimppi:spread, from which seeds draw starts, or list oimppi:starts",
        )
    body = scene.object
    if can_tip(body):
        top = body.rest_height + height_range(body.colliders)[1]
        yield _warning(
            scene,
            f"a push may tip the object over: its top is at {1000 * top:.0f} mm",
            prim=body.path,
            allowed=f"up to {1000 * tipping_height(body):.0f} mm at this width and friction",
            fix="make it lower, broader or smoother; as it is, the planner touches it low and slowly",
        )


def _warning(scene: Scene, what: str, *, prim: str = "", allowed: str = "", fix: str = "") -> Problem:
    return Problem(str(scene.file), "warning", prim, what, allowed, fix)
