"""The emulated GPU: plans like the CPU's with all that a GPU does differently, and planners in two threads."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from support import small_tasks

from oimppi_warp.compute.device import EMULATED_GPU, pick_device, start_warp
from oimppi_warp.compute.step import Compute
from oimppi_warp.config.presets import best
from oimppi_warp.config.settings import Config
from oimppi_warp.planning.engines.newton_worlds import NewtonWorlds
from oimppi_warp.planning.factory import make_planner
from oimppi_warp.planning.planner import Planner
from oimppi_warp.registries import METHODS


@pytest.fixture(autouse=True)
def blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Puts Warp's setting back that the emulated GPU switches on."""
    start_warp()
    monkeypatch.setattr(wp.config, "enable_cpu_blocks", wp.config.enable_cpu_blocks)


def settings(method: str, *, samples: int = 128, horizon: int = 25, substeps: int = 4) -> Config:
    """Settings of a method with fewer samples."""
    config = best(method)
    mppi = replace(config.robot.optimizer, samples=samples, horizon=horizon)
    return replace(config, robot=replace(config.robot, optimizer=mppi, substeps=substeps))


def planner(method: str, device: str, engine: str = "quasistatic", **sizes: int) -> Planner:
    scene = small_tasks.shipped("task02")
    return make_planner(scene, settings(method, **sizes), method=method, engine=engine, device=device, threads=1)


@pytest.mark.parametrize("method", METHODS)
def test_plans_are_those_of_the_cpu_to_rounding(method):
    scene = small_tasks.shipped("task02")
    emulated, cpu = planner(method, EMULATED_GPU), planner(method, "cpu")
    assert emulated.compute.on_gpu and not cpu.compute.on_gpu
    for _ in range(3):
        found, expected = (each.plan(small_tasks.observe(scene)) for each in (emulated, cpu))
        np.testing.assert_allclose(found.command, expected.command, atol=2e-4)
        np.testing.assert_allclose(found.object_poses, expected.object_poses, atol=2e-4)
        assert found.update.min_cost == pytest.approx(expected.update.min_cost, rel=1e-4)
        np.testing.assert_allclose(found.terms, expected.terms, rtol=1e-3, atol=0.01)
        np.testing.assert_allclose(found.tips, expected.tips, atol=2e-4)
        np.testing.assert_allclose(found.reference, expected.reference, atol=2e-3)
        shown = emulated.samples(4).terms
        assert shown == pytest.approx(cpu.samples(4).terms, rel=1e-2, abs=0.1)


@pytest.mark.slow
def test_the_newton_engine_there_is_the_one_of_a_gpu():
    there = planner("mppi", EMULATED_GPU, "newton", samples=2, horizon=6, substeps=3)
    assert isinstance(there.dynamics, NewtonWorlds)
    plans = [there.plan(small_tasks.observe(there.scene)) for _ in range(2)]
    assert all(np.isfinite(plan.update.min_cost) for plan in plans)


def test_the_host_sees_results_only_after_a_step():
    compute = Compute(EMULATED_GPU)
    read, written = compute.input(1, float), compute.output(1, float)
    step = compute.step([lambda: wp.copy(written.array, read.array)])
    for value in (3.0, 5.0):
        before = written.host[0]
        read.host[0] = value
        assert read.array.numpy()[0] != value
        step()
        assert (before, written.host[0]) == (before, value)


def test_it_is_known_by_its_name_and_listed_nowhere():
    assert pick_device(EMULATED_GPU) == EMULATED_GPU
    with pytest.raises(Exception, match="allowed") as problem:
        pick_device("cuda:7")
    assert EMULATED_GPU not in str(problem.value)


@pytest.fixture
def other_thread() -> Iterator[list[BaseException]]:
    """Errors of a thread that makes planners and captures their graphs for as long as the test runs."""
    errors: list[BaseException] = []
    over = threading.Event()

    def build() -> None:
        while not over.is_set():
            try:
                planner("cloi", EMULATED_GPU, samples=64).warm_up()
            except BaseException as error:
                errors.append(error)
                return

    thread = threading.Thread(target=build)
    thread.start()
    yield errors
    over.set()
    thread.join()


def test_a_planner_can_be_made_and_captured_while_another_plans(other_thread):
    scene = small_tasks.shipped("task02")
    watched, alone = planner("cloi", EMULATED_GPU), planner("cloi", EMULATED_GPU)
    for _ in range(20):
        plan = watched.plan(small_tasks.observe(scene))
        watched.samples(16)
        np.testing.assert_array_equal(plan.command, alone.plan(small_tasks.observe(scene)).command)
    watched.start(small_tasks.observe(scene))
    assert other_thread == []
