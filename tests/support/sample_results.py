"""Trials and results that need no planner, made from the episodes of ``synthetic_episode``."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache
from typing import Any

from support.synthetic_episode import make_log

from oimppi_warp.bench.footprints import scene_footprints
from oimppi_warp.bench.results import Result, ResultSet, make_result
from oimppi_warp.bench.suite import RUN
from oimppi_warp.bench.trial import Trial
from oimppi_warp.runtime.request import SettingsRequest
from oimppi_warp.usd import load_scene

LEFT = 0.6
"""Part of the way that a failing episode covers."""


def make_trial(task: str = "task01", method: str = "cloi", number: int = 0, **changes: Any) -> Trial:
    """A trial in which any field is changed, be it its own, of its options or of its settings."""
    trial = Trial(
        task=task,
        scene=task,
        content="c0",
        number=number,
        start=(0.3, -0.45, 0.1 * number),
        run=replace(RUN, method=method, seed=number),
        settings=SettingsRequest(),
    )
    return changed(trial, **changes)


def changed(trial: Trial, **changes: Any) -> Trial:
    """A trial with some fields changed, be they its own, of its options or of its settings."""

    def part(of: Any) -> Any:
        return replace(of, **{item.name: changes.pop(item.name) for item in fields(of) if item.name in changes})

    trial = replace(trial, run=part(trial.run), settings=part(trial.settings))
    return replace(trial, **changes)


def make_one(
    task: str = "task01",
    method: str = "cloi",
    number: int = 0,
    *,
    success: bool = True,
    error: str = "",
    steps: int = 80,
    label: str = "",
) -> Result:
    log = None if error else make_log(steps=steps, arrive=1.0 if success else LEFT, method=method)
    trial = make_trial(f"{task}-{label}" if label else task, method, number, scene=task)
    return make_result(trial, log, error=error, wall_s=1.0, code="c0de", machine="a machine", reach=2.0)


@cache
def place(task: str) -> dict[str, Any]:
    return scene_footprints(load_scene(task))


def make_set(results: list[Result], *, planned: int | None = None, suite: str = "made") -> ResultSet:
    return ResultSet(
        suite=suite,
        title="A made-up suite & its <results>",
        planned=len(results) if planned is None else planned,
        versions={"python": "3.11"},
        entries=[{}],
        places={result.task: place(result.task) for result in results},
        results=results,
    )
