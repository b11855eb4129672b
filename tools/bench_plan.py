"""Measures plan times: all available engines and devices, the stages of a plan, and sweeps over K, H and substeps.

Variants are compared by timing them in turns within one run. A run is valid only if its plans are sane (finite costs,
effective samples), the time limits are met, and planning solves a short task in the simulator. ``docs/performance.md``
explains the figures.

Usage: ``python tools/bench_plan.py [--scene task02] [--repeats 60] [--quick] [--brief] [--json FILE]``
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"  # must be set before NumPy is imported; its threads would compete with the planner's

if TYPE_CHECKING:
    from bench_loops import PlannerLoop, Timing

    from oimppi_warp.config.settings import Config
    from oimppi_warp.scene import Scene

BUDGET_MS = {"robot level": 15.0, "object level": 8.0}
"""Maximum median time of one plan on one core [ms]."""
MOST_TO_RAW = 1.25
"""Maximum plan time of the Newton engine, as a multiple of the time of raw ``mujoco.rollout``."""
MOST_TO_ONE_CORE = 0.6
"""Maximum time of a quasi-static plan on two or more cores, as a multiple of its time on one core."""


def with_mppi(config: Config, *, samples: int, horizon: int = 25, **level: Any) -> Config:
    """Return the settings with this K and H at the robot level, and these fields of ``RobotLevel``."""
    mppi = replace(config.robot.optimizer, samples=samples, horizon=horizon, iterations=1)
    return replace(config, robot=replace(config.robot, optimizer=mppi, **level))


class Benchmark:
    """Runs all measurements on one scene.

    Args:
        scene: The task.
        repeats: Number of plans to time in each measurement.
        quick: Whether to run few, small problems, only to check that everything works.
    """

    def __init__(self, scene: Scene, *, repeats: int, quick: bool) -> None:
        from oimppi_warp.compute.device import core_count
        from oimppi_warp.config.presets import best

        self.scene = scene
        self.repeats = repeats
        self.quick = quick
        self.samples = 128 if quick else 1200
        self.cores = core_count()
        self.config = best("cloi")
        self.problems: list[str] = []

    def loop(self, config: Config, engine: str, threads: int, device: str = "cpu", method: Any = "mppi") -> PlannerLoop:
        """Create a planner in closed loop with itself."""
        from bench_loops import PlannerLoop

        return PlannerLoop(self.scene, config, method=method, engine=engine, device=device, threads=threads)

    def race(self, what: str, runners: dict[str, Callable[[], None]], repeats: int | None = None) -> dict[str, Timing]:
        """Time operations in turns, and record any problems with them."""
        from bench_loops import race

        found = race(runners, repeats or self.repeats)
        self.problems += [f"{what}, {name}: {p}" for name, timing in found.items() for p in timing.problems]
        return found

    def quasistatic(self) -> dict[str, Any]:
        """Time both levels and a CLOI step, on one core and on all."""
        from bench_loops import ObjectLoop

        config = with_mppi(self.config, samples=self.samples)
        object_mppi = replace(config.object.optimizer, samples=self.samples, horizon=60, iterations=1)
        config = replace(config, object=replace(config.object, optimizer=object_mppi))
        makers: dict[str, Callable[[int], Callable[[], None]]] = {
            "robot level": lambda threads: self.loop(config, "quasistatic", threads),
            "object level": lambda threads: ObjectLoop(self.scene, config, device="cpu", threads=threads),
            "CLOI step": lambda threads: self.loop(config, "quasistatic", threads, method="cloi"),
        }
        found = {}
        for name, make in makers.items():
            counts = (1, self.cores) if self.cores > 1 else (1,)
            timings = self.race(name, {f"{n} threads": make(n) for n in counts})
            one, most = timings["1 threads"], timings[f"{counts[-1]} threads"]
            ratio = statistics.median(b / a for a, b in zip(one.ms, most.ms, strict=True))
            found[name] = {"one core": one.figures(), "all cores": most.figures(), "ratio": round(ratio, 3)}
            if not self.quick and name in BUDGET_MS and one.median > BUDGET_MS[name]:
                self.problems.append(f"{name}: {one.median:.1f} ms on one core, limit {BUDGET_MS[name]:g} ms")
            if not self.quick and name == "robot level" and self.cores > 1 and ratio > MOST_TO_ONE_CORE:
                self.problems.append(f"{name}: {ratio:.2f} of the time on one core, limit {MOST_TO_ONE_CORE}")
        return found

    def newton(self) -> dict[str, Any]:
        """Time a plan of the Newton engine on the CPU against raw rollouts of the same steps with the same threads."""
        config = with_mppi(self.config, samples=self.samples)
        loop = self.loop(config, "newton", self.cores)
        for _ in range(20):  # until the tool is in contact
            loop()
        timings = self.race(
            "newton",
            {"plan": loop, "raw": raw_rollouts(self.scene, loop)},
            3 if self.quick else max(self.repeats // 6, 5),
        )
        ratio = timings["plan"].median / timings["raw"].median
        if not self.quick and ratio > MOST_TO_RAW:
            self.problems.append(f"newton: {ratio:.2f} times raw mujoco.rollout, limit {MOST_TO_RAW}")
        return {
            "substeps": config.robot.substeps,
            "plan": timings["plan"].figures(),
            "raw mujoco.rollout": timings["raw"].figures(),
            "ratio": round(ratio, 3),
        }

    def sweeps(self, device: str = "cpu") -> dict[str, list[dict[str, float]]]:
        """Time plans over a range of K, H and substeps."""
        few = self.quick
        sizes = (128, 256) if few else (128, 256, 512, 1024, 2048, 4096, 8192, 16384)
        plan: list[tuple[str, str, dict[str, Any]]] = []
        plan += [("quasistatic over K", "quasistatic", {"samples": k}) for k in sizes]
        plan += [
            ("quasistatic over H", "quasistatic", {"samples": self.samples, "horizon": h}) for h in (10, 25, 50, 100)
        ]
        plan += [("newton over K", "newton", {"samples": k}) for k in sizes]
        plan += [("newton over H", "newton", {"samples": 128, "horizon": h}) for h in (10, 25, 50)]
        plan += [("newton over substeps", "newton", {"samples": 128, "substeps": s}) for s in (3, 4, 5, 10, 20)]
        found: dict[str, list[dict[str, float]]] = {}
        for title, engine, setting in plan:
            loop = self.loop(with_mppi(self.config, **setting), engine, self.cores, device)
            cost = setting["samples"] * setting.get("horizon", 25) * setting.get("substeps", 4)
            repeats = 2 if few else max(3, min(20, 2_000_000 // cost))
            timing = self.race(f"{device}, {title}", {"plan": loop}, repeats)["plan"]
            found.setdefault(title, []).append({**setting, "median_ms": round(timing.median, 2)})
        return found

    def randomized(self) -> dict[str, Any]:
        """Measure the cost of planning with four random draws of the uncertain parameters."""
        from oimppi_warp.config.settings import Uncertainty

        certain = with_mppi(self.config, samples=self.samples)
        uncertain = with_mppi(self.config, samples=self.samples, uncertainty=Uncertainty(draws=4))
        runners = {
            "off": self.loop(certain, "quasistatic", self.cores),
            "4 draws": self.loop(uncertain, "quasistatic", self.cores),
        }
        timings = self.race("randomized", runners, max(self.repeats // 3, 3))
        ratio = timings["4 draws"].median / timings["off"].median
        return {name: timing.figures() for name, timing in timings.items()} | {"ratio": round(ratio, 2)}

    def arithmetic(self, rollout_ms: float) -> dict[str, Any]:
        """Compare the fused kernel's operation rate with the peak of a core."""
        from bench_peak import kernel_peak, operations_per_step, vector_peak

        parts = operations_per_step()
        rate = sum(parts.values()) * self.samples * 25 / (1e-3 * rollout_ms)
        kernel, vector = kernel_peak(), vector_peak()
        return {
            "operations_per_step": parts,
            "gflops": round(rate / 1e9, 2),
            "kernel_peak_gflops": round(kernel / 1e9, 2),
            "vector_peak_gflops": round(vector / 1e9, 2),
            "of_kernel_peak": round(rate / kernel, 3),
            "of_vector_peak": round(rate / vector, 3),
        }

    def memory(self) -> dict[str, float]:
        """Return the memory used per rollout or per world [bytes]."""
        from oimppi_warp.compute.step import Compute
        from oimppi_warp.planning.engines.newton_worlds import SCRATCH_PER_CONTACT, NewtonWorlds

        threads = self.loop(with_mppi(self.config, samples=64), "newton", 1).planner.dynamics
        arrays = sum(value.nbytes for value in vars(threads).values() if hasattr(value, "nbytes"))
        worlds = NewtonWorlds(replace(threads.task, compute=Compute("cpu")))
        data, model = worlds.solver.mjw_data, worlds.solver.mjw_model
        scratch = SCRATCH_PER_CONTACT * data.naconmax
        return {
            "newton, C threads [B/rollout]": round(arrays / 64),
            "newton, batched worlds: data [B/world]": round(_array_bytes(data) / 64),
            "newton, batched worlds: model [B/world]": round(_array_bytes(model) / 64),
            "newton, batched worlds: temporary arrays of a step [B/world]": round(scratch / 64),
        }

    def gpu(self, device: str, *, sweeps: bool) -> dict[str, Any]:
        """Time plans of every method and engine on a GPU, and on request over a range of K, H and substeps."""
        from oimppi_warp.registries import METHODS

        found: dict[str, Any] = {}
        for engine, method in (*(("quasistatic", method) for method in METHODS), ("newton", "mppi")):
            loop = self.loop(with_mppi(self.config, samples=self.samples), engine, 1, device, method)
            timing = self.race(f"{device}, {engine}, {method}", {"plan": loop})["plan"]
            found[f"{engine}, {method}"] = timing.figures()
        return {"plans": found, "sweeps": self.sweeps(device) if sweeps else {}}

    def solved(self) -> dict[str, bool]:
        """Return which engines solve a short task."""
        from bench_loops import solves

        found = {}
        for engine, samples in (("quasistatic", 512), ("newton", 64)):
            found[engine] = solves(engine, "cpu", with_mppi(self.config, samples=samples))
            if not found[engine]:
                self.problems.append(f"{engine} does not solve the short task")
        return found


def raw_rollouts(scene: Scene, loop: PlannerLoop) -> Callable[[], None]:
    """Return a raw ``mujoco.rollout`` call with a Newton plan's states, controls, threads and sensorless model."""
    import mujoco
    import numpy as np
    from mujoco import rollout

    from oimppi_warp.physics.world import World
    from oimppi_warp.planning.engines.newton_threads import NewtonThreads, model_in_draw
    from oimppi_warp.planning.engines.uncertainty import CERTAIN

    engine = loop.planner.dynamics
    assert isinstance(engine, NewtonThreads)
    model = model_in_draw(World(scene).mujoco, scene, CERTAIN, 0, step=engine.model.opt.timestep)
    threads = loop.planner.compute.threads
    pool = rollout.Rollout(nthread=threads if threads > 1 else 0)
    data = [mujoco.MjData(model) for _ in range(threads)]
    states = np.zeros_like(engine._states)
    samples, steps = states.shape[:2]
    nothing = np.zeros((samples, steps, 0))
    models, warm_start = [model] * samples, np.zeros((samples, model.nv))

    def run() -> None:
        pool.rollout(
            models, data, engine._first, engine._drives, skip_checks=True, nstep=steps, initial_warmstart=warm_start,
            state=states, sensordata=nothing,
        )  # fmt: skip

    return run


def _array_bytes(owner: Any) -> int:
    """Returns the total size in bytes of all Warp arrays of a dataclass, including nested ones."""
    import warp as wp

    total = 0
    for value in vars(owner).values():
        if isinstance(value, wp.array):
            total += value.capacity
        elif hasattr(value, "__dataclass_fields__"):
            total += _array_bytes(value)
    return total


def machine() -> dict[str, str | int]:
    """Describe the machine on which the measurements are made."""
    import warp as wp

    from oimppi_warp.compute.device import core_count

    name = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        models = [line.partition(":")[2].strip() for line in info.read_text().splitlines() if "model name" in line]
        name = models[0] if models else name
    devices = ", ".join(device.name for device in wp.get_cuda_devices())
    return {"cpu": name, "cores": core_count(), "gpu": devices or "none", "system": platform.platform()}


def main() -> int:
    """Measure, print and write the results, and return exit status 1 if the run is invalid."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="task02", help="Shipped scene or USD file.")
    parser.add_argument("--repeats", type=int, default=60, help="Number of plans to time.")
    parser.add_argument(
        "--quick", action="store_true", help="Run few, small problems, only to check that everything works."
    )
    parser.add_argument(
        "--brief", action="store_true", help="Skip the sweeps and start-up times, which take most of the time."
    )
    parser.add_argument("--gpu", metavar="DEVICE", help="GPU to measure, such as cuda:0. (default: all of them)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="Write the measurements to this file.")
    arguments = parser.parse_args()
    if arguments.repeats < 2:
        parser.error("--repeats: must be at least 2")

    import warp as wp
    from bench_start import start_seconds
    from bench_tables import print_tables

    from oimppi_warp.compute.device import pick_device, tell_compilation
    from oimppi_warp.record.log import versions
    from oimppi_warp.usd import load_scene

    tell_compilation(lambda line: print(line, file=sys.stderr))
    scene = load_scene(arguments.scene)
    sweeps = arguments.quick or not arguments.brief
    gpus = [each.alias for each in wp.get_cuda_devices()] if arguments.gpu is None else [pick_device(arguments.gpu)]
    bench = Benchmark(scene, repeats=4 if arguments.quick else arguments.repeats, quick=arguments.quick)
    record: dict[str, Any] = {
        "command": f"python tools/bench_plan.py {' '.join(sys.argv[1:])}".strip(),
        "scene": scene.name,
        "samples": bench.samples,
        "machine": machine(),
        "versions": versions(),
        "solved": bench.solved(),
        "quasistatic": bench.quasistatic(),
        "newton": bench.newton(),
        "randomized": bench.randomized(),
        "memory": bench.memory(),
        "sweeps": bench.sweeps() if sweeps else {},
        "gpus": {name: bench.gpu(name, sweeps=sweeps) for name in gpus},
        "start": {}
        if arguments.quick or arguments.brief
        else {engine: start_seconds(engine) for engine in ("quasistatic", "newton")},
    }
    rollout = record["quasistatic"]["robot level"]["one core"]["stage_ms"]["rollout"]
    record["arithmetic"] = bench.arithmetic(rollout)
    record["problems"] = bench.problems
    print_tables(record)
    for problem in bench.problems:
        print(f"invalid run: {problem}", file=sys.stderr)
    if arguments.json:
        arguments.json.write_text(json.dumps(record, indent=2) + "\n")
    return 1 if bench.problems else 0


if __name__ == "__main__":
    sys.exit(main())
