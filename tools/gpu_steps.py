"""The steps of ``tools/gpu_check.py``, each a process that writes what it finds as JSON while it goes on.

Usage: ``python tools/gpu_steps.py STEP --out FILE [--device cuda:0] [--reference FILE] [--limit SECONDS] [--small]``

The steps ``reference`` and ``kernels`` run on the machine that packs (``tools/gpu_pack.py``), ``one_plan`` under a
profiler, ``one_method`` within another step; ``gpu_check.py`` runs the others.
"""

from __future__ import annotations

import argparse
import ctypes
import gzip
import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

    from oimppi_warp.config.settings import Config
    from oimppi_warp.planning.planner import Planner

ROOT = Path(__file__).resolve().parents[1]
SCENE = "task02"
COMMAND_TOLERANCE = 0.01
"""Largest difference of a command from the CPU's [rad/s]; rounding differs, and SOI follows a plan of many updates."""
TERMS_TOLERANCE = 0.01
"""Largest difference of a cost term of the nominal from the CPU's, as a share of the largest term."""
POSE_TOLERANCE = (0.0005, 0.005)
"""Largest median difference of Newton worlds from C rollouts [m, rad]: single against double precision."""
PUSH = 0.005
"""Distance that an object is pushed in a control period, about [m]."""
LEAST_WAY = 0.001
"""Median distance that rollouts to compare have to move the object [m]."""
BLOCKS = (4, 8, 16, 32, 64)
"""Numbers of threads per block of samples to compare."""
NCU = ("ncu", "--clock-control", "none", "--cache-control", "none", "--profile-from-start", "off")
"""Nsight Compute, which is to leave clocks and caches as they are; :func:`one_plan` says when to begin."""
METRICS = (
    "gpu__time_duration.sum",
    "launch__grid_size",
    "launch__block_size",
    "launch__registers_per_thread",
    "smsp__inst_executed.sum",
    "smsp__thread_inst_executed_per_inst_executed.ratio",
    "smsp__inst_executed.max",
    "smsp__cycles_active.max",
    "sm__throughput.avg.pct_of_peak_sustained_elapsed",
    "dram__throughput.avg.pct_of_peak_sustained_elapsed",
    "l1tex__t_sector_hit_rate.pct",
    *(
        f"smsp__average_warps_issue_stalled_{cause}_per_issue_active.ratio"
        for cause in (
            "long_scoreboard",
            "short_scoreboard",
            "wait",
            "no_instruction",
            "branch_resolve",
            "imc_miss",
            "math_pipe_throttle",
            "lg_throttle",
            "barrier",
            "dispatch_stall",
        )
    ),
)
"""Metrics of Nsight Compute: times, sizes, instructions, throughputs, and what warps wait for."""
SOLVER_VARIANTS: dict[str, dict[str, Any]] = {
    "as it is": {},
    "3 iterations, unrolled": {"graph_conditional": False, "iterations": 3},
    "6 iterations, unrolled": {"graph_conditional": False, "iterations": 6},
}
"""Options of MuJoCo Warp's solver to compare."""
TESTS = re.compile(r"\bdevice\b[,)]|support\.(device|engines)")
"""Found in test files that compute on the device under test."""


class Check:
    """A step: its sizes, and the findings that it writes.

    Args:
        out: JSON file, written anew after each finding.
        device: Device to check.
        reference: File with the CPU's plans.
        limit: Time that the step may take [s].
        small: Whether to use small problems.
        aside: Folder for what is too long for the findings; by default, that of the JSON file.
    """

    def __init__(
        self, out: Path, device: str, reference: Path | None, limit: float, small: bool, aside: Path | None = None
    ) -> None:
        self.out, self.device, self.reference, self.small = out, device, reference, small
        self.aside = aside or out.parent
        self.samples, self.horizon = (64, 5) if small else (1200, 25)
        self.found: dict[str, Any] = {"problems": []}
        self._end = time.monotonic() + limit

    @property
    def left(self) -> float:
        """Time left for this step [s]."""
        return self._end - time.monotonic()

    def note(self, name: str, value: Any) -> None:
        """Adds a finding."""
        self.found[name] = value
        self._write()

    def problem(self, text: str) -> None:
        """Adds a problem."""
        self.found["problems"].append(text)
        self._write()

    def expected(self) -> dict[str, Any]:
        """Returns the CPU's plans."""
        if self.reference is None or not self.reference.exists():
            raise FileNotFoundError("no reference.json: tools/gpu_pack.py makes it")
        return json.loads(self.reference.read_text())

    def settings(self, method: str, *, samples: int | None = None, horizon: int | None = None, **level: Any) -> Config:
        """Returns the settings of a method with the step's sizes, or others."""
        from oimppi_warp.config.presets import best

        config = best(method)
        horizon = horizon or self.horizon
        optimizer = config.robot.optimizer
        optimizer = replace(optimizer, samples=samples or self.samples, horizon=horizon)
        optimizer = replace(optimizer, knots=min(optimizer.knots, horizon))
        return replace(config, robot=replace(config.robot, optimizer=optimizer, **level))

    def planner(self, method: str, engine: str, device: str | None = None, **sizes: Any) -> Planner:
        """Makes a planner."""
        from oimppi_warp.planning.factory import make_planner
        from oimppi_warp.usd import load_scene

        config = self.settings(method, **sizes)
        device = device or self.device
        return make_planner(load_scene(SCENE), config, method=method, engine=engine, device=device, seed=5)

    def _write(self) -> None:
        partial = self.out.with_suffix(".part")
        partial.write_text(json.dumps(self.found, indent=1) + "\n")
        partial.replace(self.out)


def facts(check: Check) -> None:
    """Reports the machine, and every module that is compiled although the pack should have it."""
    from oimppi_warp.compute.device import tell_compilation

    compiled: list[str] = []
    tell_compilation(compiled.append)
    from oimppi_warp.record.log import versions
    from oimppi_warp.registries import METHODS
    from oimppi_warp.system.doctor import diagnose, gather_facts

    found = gather_facts()
    check.note("facts", {k: v for k, v in asdict(found).items() if k not in ("entries", "broken")})
    check.note("doctor", [finding.what for finding in diagnose(found)])
    check.note("versions", versions())
    if shutil.which("nvidia-smi"):
        check.note(
            "nvidia-smi", _output(["nvidia-smi", "--query-gpu=name,driver_version,memory.total", "--format=csv"])
        )
    for engine, methods in (("quasistatic", tuple(METHODS)), ("newton", ("mppi",))):
        for method in methods:
            began = time.perf_counter()
            planner = check.planner(method, engine)
            made = time.perf_counter()
            planner.warm_up()
            warm = time.perf_counter()
            check.note(f"{engine}, {method}", {"made_s": round(made - began, 2), "warm_up_s": round(warm - made, 2)})
    wrong = [line for line in compiled if f" for {check.device}" in line or check.small]
    check.note("compiled", compiled)
    if wrong:
        check.problem(f"{len(wrong)} modules were compiled here, not in the pack: {'; '.join(wrong[:5])}")


def plans(check: Check) -> None:
    """Compares plans with the CPU's, and replayed graphs with launches one by one."""
    import numpy as np

    expected = check.expected()["plans"]
    for method, plan in expected.items():
        found = _two_plans(check.planner(method, "quasistatic"))
        off = np.abs(np.array(found["commands"]) - np.array(plan["commands"])).max()
        poses = np.abs(np.array(found["poses"]) - np.array(plan["poses"])).max()
        terms = np.abs(np.array(found["terms"]) - np.array(plan["terms"])).max() / np.abs(plan["terms"]).max()
        eager = check.planner(method, "quasistatic")
        _launch_one_by_one(eager)
        apart = np.abs(np.array(_two_plans(eager)["commands"]) - np.array(found["commands"])).max()
        figures = {"command_off": float(off), "poses_off": float(poses), "terms_off": float(terms)}
        figures["graph_off_eager"] = float(apart)
        check.note(method, figures | {"costs": found["costs"], "costs_cpu": plan["costs"]})
        if not off <= COMMAND_TOLERANCE:
            check.problem(f"{method}: the command differs by {off:.2g} rad/s from the CPU's")
        if not terms <= TERMS_TOLERANCE:
            check.problem(f"{method}: cost terms differ by {terms:.2g} of the largest from the CPU's")
        if not apart <= 1e-5:
            check.problem(f"{method}: the graph's command differs by {apart:.2g} rad/s from that of single launches")


def newton(check: Check) -> None:
    """Compares Newton worlds with MuJoCo's C rollouts; reports the time of a capture, and solver iterations."""
    import numpy as np

    from oimppi_warp.geometry.footprint import wrap_angle
    from oimppi_warp.planning.engines.newton_worlds import NewtonWorlds

    planner = check.planner("mppi", "newton")
    began = time.perf_counter()
    planner.warm_up()
    check.note("first_plan_s", round(time.perf_counter() - began, 2))
    expected = check.expected()["rollouts"]
    ends = _newton_ends(check, expected, check.device)
    off = np.abs(ends - np.array(expected["ends"]))
    off = np.column_stack([np.hypot(off[:, 0], off[:, 1]), np.abs(wrap_angle(off[:, 2]))])
    median, worst = np.median(off, axis=0), off.max(axis=0)
    moved = _median_way(ends, expected)
    figures = {"median_m_rad": median.tolist(), "max_m_rad": worst.tolist(), "rollouts": len(off)}
    check.note("off_c_threads", figures | {"median_moved_m": moved})
    if moved < LEAST_WAY:
        check.problem("the rollouts to compare do not move the object")
    if not (median <= POSE_TOLERANCE).all():
        check.problem(f"worlds end {median[0]:.2g} m, {median[1]:.2g} rad off the C rollouts")
    dynamics = planner.dynamics
    assert isinstance(dynamics, NewtonWorlds)
    iterations = dynamics.solver.mjw_data.solver_niter.numpy()
    check.note("solver_iterations", {"mean": float(iterations.mean()), "max": int(iterations.max())})


def times(check: Check) -> None:
    """Times plans: methods and engines, block sizes, K and H."""
    from bench_loops import ObjectLoop, race

    from oimppi_warp.compute import step
    from oimppi_warp.registries import METHODS
    from oimppi_warp.usd import load_scene

    loop = _loops(check)
    repeats = 2 if check.small else 300
    for engine, method in (*(("quasistatic", method) for method in METHODS), ("newton", "mppi")):
        timing = race({"plan": loop(method, engine)}, repeats if engine == "quasistatic" else max(repeats // 15, 2))[
            "plan"
        ]
        check.note(f"{engine}, {method}", timing.figures())
        for problem in timing.problems[:3]:
            check.problem(f"{engine}, {method}: {problem}")
    scene = load_scene(SCENE)
    usual = step.samples_block
    for block in BLOCKS[:2] if check.small else BLOCKS:
        step.samples_block = lambda _, block=block: block
        alone = ObjectLoop(scene, check.settings("cloi"), device=check.device)
        for name, runner in (("cloi", loop("cloi", "quasistatic")), ("object level", alone)):
            check.note(f"blocks of {block}, quasistatic, {name}", race({"": runner}, repeats)[""].figures())
    step.samples_block = usual
    script = [sys.executable, str(Path(__file__)), "one_method", "--precise", "--device", check.device]
    apart = check.out.with_suffix(".precise")
    _output([*script, "--out", str(apart), *(["--small"] if check.small else [])], check.left)
    check.note("without fast math", json.loads(apart.read_text()))
    for samples in (64,) if check.small else (128, 256, 512, 1024, 2048, 4096, 8192, 16384):
        timing = race({"plan": loop("mppi", "quasistatic", samples=samples)}, max(repeats // 3, 2))["plan"]
        check.note(f"quasistatic, mppi, K {samples}", timing.figures())
    for horizon in (10,) if check.small else (10, 50, 100):
        timing = race({"plan": loop("mppi", "quasistatic", horizon=horizon)}, max(repeats // 3, 2))["plan"]
        check.note(f"quasistatic, mppi, H {horizon}", timing.figures())


def one_method(check: Check) -> None:
    """Times CLOI."""
    from bench_loops import race

    timing = race({"plan": _loops(check)("cloi", "quasistatic")}, 2 if check.small else 300)["plan"]
    check.note("quasistatic, cloi", timing.figures())


def newton_times(check: Check) -> None:
    """Times the Newton engine over K and substeps, with the memory that it takes."""
    import numpy as np
    from bench_loops import race

    from oimppi_warp.compute.device import free_memory, warp_device
    from oimppi_warp.errors import DeviceError

    loop = _loops(check)
    usual: np.ndarray | None = None
    runner = loop("mppi", "newton")
    for name, options in SOLVER_VARIANTS.items():
        planner = runner.planner
        for option, value in options.items():
            setattr(planner.dynamics.solver.mjw_model.opt, option, value)
        planner.__dict__.pop("steps")  # they are captured again
        planner.start(runner.first)
        planner.plan(runner.first).details()
        costs = planner.optimizer.costs.numpy()
        usual = costs if usual is None else usual
        figures = race({"plan": runner}, 2 if check.small else 10)["plan"].figures()
        check.note(f"solver: {name}", figures | {"costs_apart": float(np.median(np.abs(costs / usual - 1.0)))})
        runner.seen = runner.first
    for substeps in (3,) if check.small else (3, 4, 5):
        timing = race({"plan": loop("mppi", "newton", substeps=substeps)}, 2 if check.small else 10)["plan"]
        check.note(f"substeps {substeps}", timing.figures())
    for samples in (16, 32) if check.small else (128, 256, 512, 1024, 2048, 4096, 8192, 16384):
        before = free_memory(warp_device(check.device))
        try:
            runner = loop("mppi", "newton", samples=samples)
        except DeviceError as error:
            check.note(f"K {samples}", {"refused": str(error)})
            continue
        taken = before - free_memory(warp_device(check.device))
        figures = race({"plan": runner}, 2 if check.small else 6)["plan"].figures()
        check.note(f"K {samples}", figures | {"taken_MB": round(taken / 1e6)})
        del runner


def episodes(check: Check) -> None:
    """Runs a whole episode of every method with every engine."""
    from oimppi_warp.record.metrics import summarize
    from oimppi_warp.registries import METHODS
    from oimppi_warp.runtime.episode import Episode
    from oimppi_warp.usd import load_scene

    scene = load_scene(SCENE)
    for engine in ("quasistatic", "newton"):
        for method in METHODS:
            config = check.settings(method)
            seconds = 0.1 if check.small else 20.0
            config = replace(config, episode=replace(config.episode, max_sim_seconds=seconds))
            began = time.perf_counter()
            log = Episode(scene, config, method=method, engine=engine, device=check.device, seed=1).run()
            metrics = summarize(log)
            found = {
                "success": metrics.success,
                "steps": len(log),
                "plan_ms_median": metrics.plan_ms_median,
                "plan_ms_p95": metrics.plan_ms_p95,
                "wall_s": round(time.perf_counter() - began, 2),
            }
            check.note(f"{engine}, {method}", found)


def tests(check: Check) -> None:
    """Runs the fast tests that compute on the device, as many as fit into the time."""
    files = sorted(file for file in (ROOT / "tests").rglob("test_*.py") if TESTS.search(file.read_text()))
    first = ("test_emulated_gpu", "test_parity", "test_methods", "test_newton", "test_kernels_against_twins")
    files.sort(key=lambda file: next((i for i, name in enumerate(first) if file.stem == name), len(first)))
    if check.small:
        files = files[1:2]
    command = [sys.executable, "-m", "pytest", "-v", "-m", "not slow", "-p", "no:cacheprovider", "--tb=short", "-rf"]
    command += ["--numprocesses", str(max(min((os.cpu_count() or 1) - 2, 12), 1))]
    environment = os.environ | {"OIMPPI_TEST_DEVICE": check.device}
    process = subprocess.Popen(
        [*command, *map(str, files)],
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert process.stdout is not None
    counts = {"PASSED": 0, "FAILED": 0, "ERROR": 0, "SKIPPED": 0}
    failed: list[str] = []
    for line in process.stdout:
        print(line, end="")
        if found := re.search(r"\] (PASSED|FAILED|ERROR|SKIPPED) (\S+)", line):
            counts[found[1]] += 1
            if found[1] in ("FAILED", "ERROR"):
                failed.append(found[2])
                check.problem(f"{found[1].lower()}: {found[2]}")
            check.note("counts", counts)
    check.note("status", process.wait())
    if not counts["PASSED"]:
        check.problem("no test passed")


def profile(check: Check) -> None:
    """Profiles kernels with Nsight Compute, and looks for memory errors and races with Compute Sanitizer."""
    script = [sys.executable, str(Path(__file__)), "one_plan", "--device", check.device]
    plan = [*script, "--out", f"{check.out}.plan", "--reference", str(check.reference)]
    for tool in ("ncu", "compute-sanitizer"):
        if not shutil.which(tool):
            check.problem(f"{tool} is not installed")
    small = ["--small"] if check.small else []
    if shutil.which("ncu"):
        for engine, metrics, count in (("quasistatic", METRICS, 40), ("newton", METRICS[:3], 320)):
            which = ["--csv", "--page", "raw", "--metrics", ",".join(metrics), "-c", str(count)]
            found = _profiled(_output([*NCU, *which, *plan, "--engine", engine, *small], check.left / 2, quiet=True))
            check.note(f"ncu, {engine}", found if engine == "quasistatic" else _per_kernel(found))
        report = check.out.with_suffix(".ncu-rep")
        which = ["--set", "full", "--import-source", "no", "-k", "regex:rollout", "-c", "2", "-f", "-o", str(report)]
        _output([*NCU, *which, *plan, *small], check.left / 2)
        for page in ("details", "source"):
            text = _output(["ncu", "--import", str(report), "--page", page, "--csv"], check.left / 2, quiet=True)
            (check.aside / f"rollout-{page}.csv.gz").write_bytes(gzip.compress(text.encode()))
    for tool, engine in (("memcheck", "quasistatic"), ("racecheck", "quasistatic"), ("memcheck", "newton")):
        if shutil.which("compute-sanitizer") and check.left > 20.0:
            command = ["compute-sanitizer", "--tool", tool, *plan, "--engine", engine, "--samples", "64", *small]
            said = _output(command, check.left)
            errors = re.findall(r"(?:ERROR SUMMARY: |RACECHECK SUMMARY: )(\d+) (?:error|hazard)", said)
            check.note(f"compute-sanitizer, {tool}, {engine}", errors[-1] if errors else said[-300:])
            if errors != ["0"]:
                check.problem(f"compute-sanitizer, {tool}, {engine}: {errors[-1] if errors else 'no'} errors reported")


def one_plan(check: Check, engine: str = "quasistatic", samples: int | None = None) -> None:
    """Makes one plan with the object in contact, launch by launch, for a profiler."""
    import numpy as np
    import warp as wp

    from oimppi_warp.observation import Observation

    horizon = 3 if check.small else 25 if engine == "quasistatic" else 10
    planner = check.planner("cloi" if engine == "quasistatic" else "mppi", engine, horizon=horizon, samples=samples)
    _launch_one_by_one(planner)
    state = check.expected()["rollouts"]
    joints = np.array(state["joints"])
    seen = Observation(0.0, joints, 0.0 * joints, np.array(state["pose"]), np.array(state["transform"]))
    planner.plan(seen).details()
    if wp.get_device(planner.compute.device).is_cuda:
        ctypes.CDLL("libcuda.so.1").cuProfilerStart()
    planner.plan(seen).details()
    check.note("done", True)


def reference(check: Check) -> None:
    """Plans on this machine's CPU, for comparison."""
    import numpy as np
    from bench_loops import PlannerLoop

    from oimppi_warp.registries import METHODS
    from oimppi_warp.usd import load_scene

    check.note("plans", {method: _two_plans(check.planner(method, "quasistatic", "cpu")) for method in METHODS})
    config = check.settings("mppi", controls="joint")  # as Newton worlds take them
    loop = PlannerLoop(load_scene(SCENE), config, method="mppi", engine="quasistatic", device="cpu")
    rollouts: dict[str, Any] = {}
    ends = np.zeros((0, 3))
    for _ in range(200):
        loop()
        poses = loop.planner.dynamics.traced().poses
        if np.hypot(*(poses[-1] - poses[0])[:2]) > 0.1 * PUSH * len(poses):  # the arm has come to push the object
            cheapest = np.argsort(loop.optimizer.costs.numpy())[: 8 if check.small else 128]  # few others move it
            rollouts = {
                "joints": loop.seen.joint_position.tolist(),
                "pose": loop.seen.object_pose.tolist(),
                "transform": loop.seen.object_transform.tolist(),
                "controls": loop.optimizer.controls.numpy()[cheapest].tolist(),
            }
            ends = _newton_ends(check, rollouts, "cpu")
            if _median_way(ends, rollouts) > 2.0 * LEAST_WAY:  # not only by the quasi-static engine
                break
    check.note("rollouts", rollouts | {"ends": ends.tolist()})


def _median_way(ends: np.ndarray, rollouts: dict[str, Any]) -> float:
    """Returns the median distance of the object's final poses, shape [n, 3], from where rollouts begin [m]."""
    import numpy as np

    return float(np.median(np.linalg.norm(ends[:, :2] - np.array(rollouts["pose"])[:2], axis=1)))


def kernels(check: Check, arch: int | None = None, blocks: tuple[int, ...] = BLOCKS) -> None:
    """Puts the kernels that the check needs into ``kernels`` beside the file: for a GPU, or for an emulated one."""
    import warp as wp

    from oimppi_warp.compute import step
    from oimppi_warp.registries import METHODS
    from oimppi_warp.system import precompile
    from oimppi_warp.usd import load_scene

    folder = check.out.parent / "kernels" / wp.config.version
    usual = step.samples_block
    if arch is None:
        with precompile.record_modules() as variants:
            for block in BLOCKS[:2]:
                step.samples_block = lambda _, block=block: block
                check.planner("cloi", "quasistatic", "emulated-gpu").warm_up()
            step.samples_block = usual
            for method in METHODS:
                _two_plans(check.planner(method, "quasistatic", "emulated-gpu"))
            check.planner("mppi", "newton", "emulated-gpu").warm_up()
        for variant in variants:
            for block in (1, variant.block):  # on the CPU, blocks have one thread where nothing is said
                with precompile.as_launched(variant._replace(block=block)):
                    name = variant.module.get_module_identifier(block)
                source = Path(wp.config.kernel_cache_dir or "") / name
                if source.exists():
                    shutil.copytree(source, folder / name, dirs_exist_ok=True)
        check.note("modules", len(variants))
        return
    scene = load_scene(SCENE)
    variants = precompile.needed_on_cuda(scene, ("quasistatic", "newton"), check.settings)
    ours = precompile.needed_on_cuda(scene, ("quasistatic",), check.settings)
    wanted = dict.fromkeys([*variants, *(each._replace(block=block) for each in ours for block in blocks)])
    wp.config.kernel_cache_dir = str(folder)
    missing = []
    for variant in wanted:
        with precompile.as_launched(variant):
            place = folder / variant.module.get_module_identifier(variant.block)
        if not any(place.glob(f"*.sm{arch}.cubin")):
            missing.append(variant)
    print(f"{len(missing)} of {len(wanted)} to compile", flush=True)
    precompile.compile_for(missing, arch, lambda module: print(module.name, flush=True))
    for file in [*folder.rglob("*.cu"), *folder.rglob("*.cpp"), *folder.rglob("*.o")]:
        file.unlink()
    check.note("modules", len(wanted))


def _two_plans(planner: Planner) -> dict[str, Any]:
    """Starts an episode and plans twice from its start."""
    from bench_loops import first_observation

    seen = first_observation(planner.scene)
    planner.start(seen)
    found = [planner.plan(seen) for _ in range(2)]
    return {
        "commands": [plan.command.tolist() for plan in found],
        "poses": [plan.object_poses.tolist() for plan in found],
        "terms": [plan.terms.tolist() for plan in found],
        "costs": [plan.update.min_cost for plan in found],
    }


def _launch_one_by_one(planner: Planner) -> None:
    """Makes a planner run its steps without a graph."""
    planner.__dict__["steps"] = (
        planner.compute.step([*planner.object_launches, *planner._robot_launches], one_graph=False),
        planner._late.step(planner._command_launches, one_graph=False),
        planner.compute.step(planner._trace_launches, one_graph=False, upload=False),
    )


def _newton_ends(check: Check, rollouts: dict[str, Any], device: str) -> np.ndarray:
    """Returns the object's final poses [rollout, 3] with the Newton engine, from the reference's state and controls."""
    import numpy as np
    import warp as wp

    from oimppi_warp.geometry.fields import from_center
    from oimppi_warp.observation import Observation
    from oimppi_warp.planning.engines.dynamics import control_type
    from oimppi_warp.planning.engines.newton import NewtonDynamics

    controls = np.array(rollouts["controls"], dtype=np.float32)
    planner = check.planner("mppi", "newton", device, samples=len(controls), horizon=controls.shape[1])
    engine = planner.dynamics
    assert isinstance(engine, NewtonDynamics)
    place = planner.compute.device
    costs = wp.zeros(len(controls), dtype=float, device=place)
    packed = wp.array(controls, dtype=control_type(controls.shape[2]), device=place)
    joints = np.array(rollouts["joints"])
    pose, transform = np.array(rollouts["pose"]), np.array(rollouts["transform"])
    rollout = engine.rollout(packed, costs)
    engine.set_state(Observation(0.0, joints, np.zeros_like(joints), pose, transform), planner.goal)
    engine.reference.host[:] = planner.goal
    planner.compute.step([rollout], one_graph=False)()
    return from_center(engine.task.geometry.surface, engine.poses.numpy()[:, -1].astype(float))


def _loops(check: Check) -> Callable[..., Any]:
    """Returns a function that makes a planner in closed loop with itself."""
    from bench_loops import PlannerLoop

    from oimppi_warp.usd import load_scene

    scene = load_scene(SCENE)

    def make(method: str, engine: str, **sizes: Any) -> Any:
        config = check.settings(method, **sizes)
        return PlannerLoop(scene, config, method=method, engine=engine, device=check.device, threads=1)

    return make


def _output(command: list[str], limit: float = 60.0, *, quiet: bool = False) -> str:
    """Runs a command, and returns what it printed, also if it was ended by the time limit.

    Unless ``quiet``, it is printed as well.
    """
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=max(limit, 1.0))
    except subprocess.TimeoutExpired as error:
        return f"{(error.stdout or b'').decode(errors='replace')}\nended after {limit:.0f} s"
    if not quiet:
        print(done.stdout, done.stderr, sep="\n")
    return done.stdout + done.stderr


def _profiled(text: str) -> dict[str, dict[str, str]] | str:
    """Returns the metrics of each kernel in Nsight Compute's table."""
    import csv

    lines = [line for line in text.splitlines() if line.startswith('"')]
    if len(lines) < 3:
        return text[-300:]
    names, units, *entries = csv.reader(lines)
    found = {}
    for index, entry in enumerate(entries):
        cells = dict(zip(names, entry, strict=False))
        kernel = f"{index} {cells.get('Kernel Name', '?')}"
        unit = dict(zip(names, units, strict=False))
        found[kernel] = {k: f"{v} {unit.get(k, '')}".strip() for k, v in cells.items() if k in METRICS}
    return found


def _per_kernel(found: dict[str, dict[str, str]] | str) -> dict[str, dict[str, float]] | str:
    """Returns the number of launches of each kernel, and their time [us], the longest first."""
    if isinstance(found, str):
        return found
    sums: dict[str, list[float]] = {}
    for name, metrics in found.items():
        time_ns = metrics.get("gpu__time_duration.sum", "0").split()[0].replace(",", "")
        sums.setdefault(name.split(" ", 1)[1], []).append(float(time_ns) / 1e3)
    longest = sorted(sums, key=lambda name: -sum(sums[name]))
    return {name: {"launches": len(sums[name]), "us": round(sum(sums[name]), 1)} for name in longest}


@contextmanager
def _reported(check: Check) -> Iterator[None]:
    """Turns an error into a problem of the step."""
    try:
        yield
    except Exception as error:
        check.problem(f"{type(error).__name__}: {str(error)[:500]}")
        raise


def main() -> int:
    """Run a step."""
    steps = (
        facts,
        plans,
        newton,
        times,
        one_method,
        newton_times,
        episodes,
        tests,
        profile,
        one_plan,
        reference,
        kernels,
    )
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=[step.__name__ for step in steps], help="Step to run.")
    parser.add_argument("--out", type=Path, required=True, help="JSON file for the findings.")
    parser.add_argument("--device", default="cuda:0", help="Warp device.")
    parser.add_argument("--reference", type=Path, help="File with the CPU's plans.")
    parser.add_argument("--limit", type=float, default=1e6, help="Time that the step may take [s].")
    parser.add_argument("--small", action="store_true", help="Use small problems.")
    parser.add_argument("--precise", action="store_true", help="Compile the kernels without fast math.")
    parser.add_argument("--aside", type=Path, help="Folder for long reports. (default: that of FILE)")
    parser.add_argument("--engine", default="quasistatic", help="Engine, for the step one_plan.")
    parser.add_argument("--samples", type=int, help="Number of samples, for the step one_plan.")
    parser.add_argument("--arch", type=int, help="GPU architecture, for the step kernels. (default: an emulated GPU)")
    arguments = parser.parse_args()
    check = Check(
        arguments.out, arguments.device, arguments.reference, arguments.limit, arguments.small, arguments.aside
    )
    if arguments.precise:
        from oimppi_warp.kernels import options as compiler

        compiler.FAST_MATH = False
    step = next(step for step in steps if step.__name__ == arguments.step)
    options: dict[str, dict[str, Any]] = {
        "one_plan": {"engine": arguments.engine, "samples": arguments.samples},
        "kernels": {"arch": arguments.arch, "blocks": () if arguments.precise else BLOCKS},
    }
    with _reported(check):
        step(check, **options.get(arguments.step, {}))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
