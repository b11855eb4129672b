"""How long one plan takes, and which stage takes it: the robot level and the object level, each on one core.

Each level plans in closed loop on its own prediction, from the scene's start: plans without and with contact count.
A run counts only if its plans are sane: finite costs, at least one effective sample, and a nominal that costs less than
doing nothing.

Usage: ``python tools/bench_plan.py [--scene task02] [--repeats 100] [--device cpu] [--json FILE]``
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import warp as wp

    from oimppi_warp.config import Config
    from oimppi_warp.mppi import Update
    from oimppi_warp.observation import Observation
    from oimppi_warp.scene import Scene

STAGES = {"sample": "sample_controls", "weigh": "weigh_samples", "update": "update_nominal", "shift": "shift_nominal"}
"""Stages by the kernel that they launch; a rollout of all samples is ``rollout``, one of the nominal ``trace``."""
ORDER = ("sample", "rollout", "weigh", "update", "trace", "shift", "other")
"""All stages as they are shown; ``other`` is what is left, Python above all."""
BUDGET_MS = {"robot": 15.0, "object": 8.0}
"""What one plan may take in the median on one core [ms]."""
WARM_UP = 5
"""Plans that are not counted."""


@dataclass
class Level:
    """One level's benchmark.

    Attributes:
        name: ``"robot"`` or ``"object"``.
        samples, horizon: K and H.
        plan_ms: Wall time of each plan [ms].
        stage_ms: Median time of each stage in a plan [ms].
        cost_of_nothing, cost_of_plan: Cost of zero controls and of a nominal that had some updates, from one state.
        problems: Why the run does not count.
    """

    name: str
    samples: int
    horizon: int
    plan_ms: list[float] = field(default_factory=list)
    stage_ms: dict[str, float] = field(default_factory=dict)
    cost_of_nothing: float = 0.0
    cost_of_plan: float = 0.0
    problems: list[str] = field(default_factory=list)

    @property
    def median_ms(self) -> float:
        """Median of the plans [ms]."""
        return statistics.median(self.plan_ms)

    @property
    def p95_ms(self) -> float:
        """95th percentile of the plans [ms]."""
        return statistics.quantiles(self.plan_ms, n=20)[-1]

    def figures(self) -> dict[str, Any]:
        """Everything, for the record."""
        summary = {"median_ms": self.median_ms, "p95_ms": self.p95_ms, "budget_ms": BUDGET_MS[self.name]}
        return asdict(self) | summary


class RobotLoop:
    """The quasi-static engine under plain MPPI, the arm following its own plan."""

    def __init__(self, scene: Scene, config: Config, device: str) -> None:
        from oimppi_warp.planner import make_planner

        self.planner = make_planner(scene, config, method="mppi", device=device)
        self.mppi, self.dynamics = self.planner.mppi, self.planner.dynamics
        self.settings = config.robot.mppi
        self.seen = _first_observation(scene)

    def plan(self) -> Update:
        """One plan, and on to where it leads."""
        plan = self.planner.plan(self.seen)
        joints = self.seen.joint_position + self.planner.config.control_period * plan.command
        self.seen = replace(self.seen, joint_position=joints, object_pose=plan.object_poses[1])
        return plan.update


class ObjectLoop:
    """The object level, the object following its own plan."""

    def __init__(self, scene: Scene, config: Config, device: str) -> None:
        import numpy as np

        from oimppi_warp.clearance import build_geometry, to_center
        from oimppi_warp.planner import ObjectLevel

        geometry = build_geometry(scene, device)
        start, goal = (to_center(geometry.surface, np.array(pose)) for pose in (scene.start, scene.goal))
        self.level = ObjectLevel(geometry, goal, config, device=device, seed=0)
        self.mppi, self.dynamics = self.level._mppi, self.level._dynamics
        self.settings = config.object.mppi
        self.start, self.pose = start, start

    def plan(self) -> Update:
        """One plan, and on to where it leads."""
        update, path = self.level.improve(self.pose)
        self.pose = path[1]
        return update


def _first_observation(scene: Scene) -> Observation:
    import numpy as np

    from oimppi_warp.observation import Observation

    pose = np.array(scene.start)
    transform = np.array([pose[0], pose[1], scene.object.rest_height, 0, 0, np.sin(pose[2] / 2), np.cos(pose[2] / 2)])
    return Observation(0.0, scene.robot.start, np.zeros(scene.robot.dof), pose, transform)


def cost_of(loop: RobotLoop | ObjectLoop, controls: wp.array) -> float:
    """Cost of one control sequence [horizon] from the state that the dynamics last were set to."""
    import warp as wp

    cost = wp.zeros(1, dtype=float, device=loop.dynamics.device)
    loop.dynamics.rollout(controls.reshape((1, controls.shape[0])), cost)
    return float(cost.numpy()[0])


@contextmanager
def timed_launches(times: dict[str, float]) -> Iterator[None]:
    """Adds the time of every kernel launch to its stage, by waiting for each."""
    import warp as wp

    launch = wp.launch

    def timed(kernel, dim, *args, **kwargs):
        began = time.perf_counter()
        launch(kernel, dim, *args, **kwargs)
        wp.synchronize()
        stage = next((stage for stage, name in STAGES.items() if name in kernel.key), None)
        times[stage or ("trace" if dim == 1 else "rollout")] += time.perf_counter() - began

    wp.launch = timed
    try:
        yield
    finally:
        wp.launch = launch


def bench(name: str, make: Callable[[], RobotLoop | ObjectLoop], repeats: int) -> Level:
    """Runs one level's loop twice: for the time of whole plans, and for that of their stages."""
    import math

    import warp as wp

    loop = make()
    level = Level(name, loop.settings.samples, loop.settings.horizon)
    for step in range(WARM_UP + repeats):
        began = time.perf_counter()
        update = loop.plan()
        wp.synchronize()
        if step >= WARM_UP:
            level.plan_ms.append(round(1e3 * (time.perf_counter() - began), 3))
        if update.lost or not math.isfinite(update.min_cost):
            level.problems.append(f"plan {step}: {update.lost} samples have no finite cost")
        if update.effective_samples < 1.0 - 1e-3:
            level.problems.append(f"plan {step}: {update.effective_samples:.2f} effective samples")

    loop = make()
    found: dict[str, list[float]] = defaultdict(list)
    for step in range(WARM_UP + max(repeats // 2, 10)):
        times: dict[str, float] = dict.fromkeys((*STAGES, "rollout", "trace"), 0.0)
        began = time.perf_counter()
        with timed_launches(times):
            loop.plan()
        times["other"] = time.perf_counter() - began - sum(times.values())
        if step >= WARM_UP:
            for stage, seconds in times.items():
                found[stage].append(1e3 * seconds)
    level.stage_ms = {stage: round(statistics.median(found[stage]), 3) for stage in ORDER}

    # The nominal, improved from one and the same state, against doing nothing there.
    loop = make()
    loop.plan()
    level.cost_of_nothing = cost_of(loop, wp.zeros_like(loop.mppi.nominal))
    for _ in range(WARM_UP):
        loop.mppi.step()
    level.cost_of_plan = cost_of(loop, loop.mppi.nominal)
    if not level.cost_of_plan < level.cost_of_nothing:
        level.problems.append(f"the plan costs {level.cost_of_plan:.4g}, doing nothing {level.cost_of_nothing:.4g}")
    return level


def machine() -> dict[str, str | int]:
    """What the figures were measured on."""
    import warp as wp

    name = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        models = [line.partition(":")[2].strip() for line in info.read_text().splitlines() if "model name" in line]
        name = models[0] if models else name
    devices = ", ".join(device.name for device in wp.get_cuda_devices())
    return {"cpu": name, "cores": os.cpu_count() or 0, "gpu": devices or "none", "system": platform.platform()}


def print_table(levels: list[Level], heading: str) -> None:
    """The figures for a person."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=heading)
    for column in ("", *(f"{level.name}: K {level.samples}, H {level.horizon}" for level in levels)):
        table.add_column(column, justify="right" if column else "left")
    medians = (f"{level.median_ms:.2f} (at most {BUDGET_MS[level.name]:g})" for level in levels)
    table.add_row("plan, median (ms)", *medians)
    table.add_row("plan, 95th percentile (ms)", *(f"{level.p95_ms:.2f}" for level in levels), end_section=True)
    for stage in levels[0].stage_ms:
        cells = []
        for level in levels:
            share = level.stage_ms[stage] / sum(level.stage_ms.values())
            cells.append(f"{level.stage_ms[stage]:.2f} ms  {share:4.0%}")
        table.add_row(stage, *cells)
    table.add_section()
    table.add_row("cost of the plan / of nothing", *(f"{x.cost_of_plan:.4g} / {x.cost_of_nothing:.4g}" for x in levels))
    Console().print(table)


def main() -> int:
    """Measures, prints, writes; returns 1 where a run does not count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="task02", help="a shipped scene or a USD file")
    parser.add_argument("--device", default="cpu", help="Warp device")
    parser.add_argument("--repeats", type=int, default=100, help="plans to measure")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there")
    arguments = parser.parse_args()
    if arguments.repeats < 2:
        parser.error("--repeats: at least 2")

    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"  # before NumPy is loaded: its threads only get into each other's way here
    import warp as wp

    from oimppi_warp.device import CompileNotice
    from oimppi_warp.log import versions
    from oimppi_warp.presets import best
    from oimppi_warp.usd import load_scene

    wp.set_logger(CompileNotice(lambda line: print(line, file=sys.stderr)))
    if arguments.device == "cpu" and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    scene, config = load_scene(arguments.scene), best("cloi")
    config = replace(
        config,
        robot=replace(config.robot, mppi=replace(config.robot.mppi, samples=1200, horizon=25, iterations=1)),
        object=replace(config.object, mppi=replace(config.object.mppi, samples=1200, horizon=60, iterations=1)),
    )
    levels = [
        bench("robot", lambda: RobotLoop(scene, config, arguments.device), arguments.repeats),
        bench("object", lambda: ObjectLoop(scene, config, arguments.device), arguments.repeats),
    ]
    where = machine()
    device = where["cpu"] if arguments.device == "cpu" else where["gpu"]
    print_table(levels, f"One plan on {scene.name}, {arguments.device} ({device}), {arguments.repeats} plans")
    problems = [f"{level.name} level, {problem}" for level in levels for problem in level.problems]
    for problem in problems:
        print(f"this run does not count: {problem}", file=sys.stderr)
    if arguments.json:
        record = {
            "scene": scene.name,
            "engine": "quasistatic",
            "device": arguments.device,
            "counts": not problems,
            "levels": {level.name: level.figures() for level in levels},
            "machine": where,
            "versions": versions(),
        }
        arguments.json.write_text(json.dumps(record, indent=2) + "\n")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
