"""The benchmark of plan time runs, and does not count what is not sane."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import warp as wp

from oimppi_warp.compute.device import EMULATED_GPU
from oimppi_warp.compute.step import Compute

TOOL = Path(__file__).parents[2] / "tools" / "bench_plan.py"


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_quick_benchmark_measures_everything(tmp_path):
    out = tmp_path / "figures.json"
    done = subprocess.run([sys.executable, TOOL, "--quick", "--json", out], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    record = json.loads(out.read_text())
    assert record["problems"] == [] and record["solved"] == {"quasistatic": True, "newton": True}
    assert set(record["quasistatic"]) == {"robot level", "object level", "CLOI step"}
    assert record["newton"]["plan"]["median_ms"] > record["quasistatic"]["robot level"]["all cores"]["median_ms"]
    assert record["newton"]["ratio"] > 0.8
    assert record["randomized"]["ratio"] > 1.5
    assert 0.0 < record["arithmetic"]["of_vector_peak"] < 1.0
    assert "Newton engine" in done.stdout


def test_a_planner_that_plans_nothing_does_not_count(monkeypatch, device):
    monkeypatch.syspath_prepend(str(TOOL.parent))
    from bench_loops import PlannerLoop, race

    from oimppi_warp.config.overrides import set_option
    from oimppi_warp.config.presets import best
    from oimppi_warp.usd import load_scene

    config = set_option(best("mppi"), "robot.optimizer.samples=32")
    loop = PlannerLoop(load_scene("task01"), config, method="mppi", engine="quasistatic", device=device, threads=1)
    assert race({"sane": loop}, 2)["sane"].problems == []
    loop.seen.joint_position[:] = float("nan")
    assert any(
        "non-finite values in the joint positions" in problem for problem in race({"mad": loop}, 2)["mad"].problems
    )


def test_a_gpu_is_measured_over_the_same_ranges_as_the_cpu(monkeypatch):
    monkeypatch.syspath_prepend(str(TOOL.parent))
    from bench_loops import Timing
    from bench_plan import Benchmark

    from oimppi_warp.usd import load_scene

    made = []

    def loop(config, engine, threads, device="cpu", method="mppi"):
        made.append((device, engine, method, config.robot.optimizer.samples))
        return lambda: None

    bench = Benchmark(load_scene("task02"), repeats=2, quick=False)
    monkeypatch.setattr(bench, "loop", loop)
    monkeypatch.setattr(bench, "race", lambda what, runners, repeats=2: {name: Timing(ms=[1.0]) for name in runners})
    on_cpu = bench.sweeps()
    made.clear()
    on_gpu = bench.gpu("cuda:0", sweeps=True)
    assert {device for device, *_ in made} == {"cuda:0"}
    assert set(on_gpu["plans"]) == {f"quasistatic, {method}" for method in ("mppi", "soi", "cloi")} | {"newton, mppi"}
    assert on_gpu["sweeps"] == on_cpu
    assert ("cuda:0", "newton", "mppi", 16384) in made


def test_stages_on_a_gpu_are_timed_as_graphs(monkeypatch):
    monkeypatch.setattr(wp.config, "enable_cpu_blocks", wp.config.enable_cpu_blocks)
    monkeypatch.syspath_prepend(str(TOOL.parent))
    from bench_loops import time_of

    compute = Compute(EMULATED_GPU)
    numbers = wp.zeros(4, dtype=float, device=compute.device)
    called = []

    def launch():
        called.append(True)
        numbers.fill_(1.0)

    assert time_of(launch, 5, compute) > 0.0
    assert len(called) == 1, "captured, then replayed"
    assert time_of(launch, 5, Compute("cpu")) > 0.0
    assert len(called) == 6
