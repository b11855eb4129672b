"""Searches the values that the paper does not print, by successive halving.

Candidates differ at random from values found by hand; everything else is as in the preset ``paper-printed``. Each round
runs the tasks with SOI and CLOI on more trials (numbers from 100 up, which the results do not use), and keeps the
candidates with the highest success rate, of both methods and all tasks together. Plain MPPI takes no part in the
choice. Run the command again to resume::

    python tools/search_paper.py --out runs/search --methods soi cloi
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import tyro

from oimppi_warp.bench.results import Result
from oimppi_warp.bench.runner import SuiteRun
from oimppi_warp.bench.suite import Suite, load_suite

TASKS = ("task01", "task02", "task03", "task04", "task05")
FIRST = 100
"""Number of the first trial."""
ROUNDS = ((32, 1), (12, 2), (6, 4), (3, 8))
"""Number of candidates in each round, and of trials per task and method that each has run by its end."""

PROBE = Path(__file__).resolve().parent.parent / "docs" / "results" / "paper-probe.toml"
"""Suite with the values found by hand, around which the search begins."""

SPACE: dict[str, Sequence[str]] = {
    # Noise and temperature
    "robot.optimizer.knots": ("0", "4", "6", "12"),
    "robot.optimizer.temperature": ("0.2", "0.5", "1", "2"),
    "robot.joint_velocity_limit": ("0.5", "0.7", "1", "1.5"),
    "robot.tool_noise": ("0.1,0.1,0.06,0.2,0.2,0.5", "0.2,0.2,0.06,0.2,0.2,0.5", "0.35,0.35,0.06,0.2,0.2,0.5"),
    "object.optimizer.knots": ("0", "4", "5", "8"),
    "object.optimizer.effective_samples": ("0.004,0.008", "0.01,0.03", "0.03,0.1"),
    "object.noise": ("0.3", "0.6", "1.0"),
    # The object's speed, which is the reference's pace; with the horizon, it is how far the object level looks ahead
    "object.speed_limit": ("0.1,0.1,0.83", "0.12,0.12,1", "0.14,0.14,1.17", "0.17,0.17,1.42"),
    # Weights of equations 15 to 19
    "cost.w_d": ("1", "5", "15"),
    "cost.w_theta": ("0.015", "0.03", "0.06"),
    "cost.w_reference": ("100", "200", "400"),
    "cost.w_ee": ("1", "5", "20"),
    "cost.r_0": ("0.08", "0.12"),
    "cost.w_align": ("0.5", "2", "6", "15"),
    "cost.w_height": ("200", "1000"),
    "object_cost.w_d": ("3", "10", "30"),
    "object_cost.w_theta": ("0.015", "0.03", "0.06"),
    "object_cost.w_f": ("0.05", "1"),
}
"""Values that are tried for each setting."""
CHANGES = 4
"""Number of settings in which a candidate differs from the values found by hand, at most."""


@dataclass(frozen=True)
class Search:
    """Search the values that the paper does not print, by successive halving."""

    out: Path = Path("runs/search")
    """Folder for the trials and for search.json."""

    methods: tuple[Literal["mppi", "cloi", "soi"], ...] = ("soi", "cloi")
    """Methods whose success rate is the criterion."""

    seed: int = 0
    """Seed of the candidates."""

    jobs: int = 2
    """Number of concurrent trials."""


def candidates(count: int, seed: int) -> list[tuple[str, ...]]:
    """Draws candidates, each as assignments ``NAME=VALUE``; the first two are the preset as it is and ``PROBE``."""
    rng = np.random.default_rng(seed)
    start = dict(assignment.split("=", 1) for assignment in load_suite(PROBE).entries[0].settings.assignments)
    found: list[dict[str, str]] = [{}, start]
    for _ in range(count - 2):
        changed = rng.choice(list(SPACE), CHANGES, replace=False)
        found.append(start | {str(name): str(rng.choice(SPACE[name])) for name in changed})
    return [tuple(f"{name}={value}" for name, value in each.items()) for each in found]


def suite_of(chosen: dict[str, tuple[str, ...]], trials: int, methods: tuple[str, ...]) -> Suite:
    """Returns the suite of a round: every candidate, by its label, on all tasks."""
    plain = load_suite("paper-sim")
    base = replace(plain.entries[0], tasks=TASKS, methods=methods, first=FIRST, trials=trials)
    base = base.changed({"preset": "paper-printed"})
    entries = [base.changed({"label": label, "set": assignments}) for label, assignments in chosen.items()]
    return replace(plain, name="search-paper", title="Search of the preset paper", entries=tuple(entries))


def rates(results: Sequence[Result], label: str, methods: tuple[str, ...]) -> dict[str, float]:
    """Returns the success rate of a candidate with each method; a trial that raised counts as a failure."""
    found = {}
    for method in methods:
        own = [r for r in results if r.task.endswith(label) and r.run.method == method]
        found[method] = float(np.mean([bool(r.metrics.get("success", False)) for r in own])) if own else 0.0
    return found


def main(search: Search) -> None:
    """Runs all rounds, and writes what each found."""
    drawn = candidates(ROUNDS[0][0], search.seed)
    chosen = {f"c{number:02d}": assignments for number, assignments in enumerate(drawn)}
    log = []
    for keep, trials in ROUNDS:
        chosen = dict(list(chosen.items())[:keep])
        run = SuiteRun(suite_of(chosen, trials, search.methods), search.out)
        print(
            f"{len(chosen)} candidates, {trials} trials a task and method: {len(run.pending)} trials to run", flush=True
        )
        results = run.execute(jobs=search.jobs).results
        scored = {label: rates(results, label, search.methods) for label in chosen}
        order = sorted(chosen, key=lambda label: -float(np.mean(list(scored[label].values()))))
        for label in order:
            print(f"  {label} {scored[label]}", flush=True)
            log.append({"trials": trials, "label": label, "success": scored[label], "set": chosen[label]})
        chosen = {label: chosen[label] for label in order}
        (search.out / "search.json").write_text(json.dumps(log, indent=1) + "\n")
    best = next(iter(chosen))
    print(f"best: {best}", *chosen[best], sep="\n  ")


if __name__ == "__main__":
    main(tyro.cli(Search, description=__doc__))
