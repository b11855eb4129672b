"""Kernels that another process compiles."""

from __future__ import annotations

import pickle
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
import warp as wp
from support import modules

from oimppi_warp.compute import loading as loading_module
from oimppi_warp.compute.build_process import BuildProcess, ModuleSource
from oimppi_warp.compute.device import CompileNotice, start_warp
from oimppi_warp.compute.loading import await_loaded, loading
from oimppi_warp.config.presets import best
from oimppi_warp.config.run_spec import RunSpec
from oimppi_warp.planning.early_kernels import kernels_with_own_flags
from oimppi_warp.registries import METHODS

(MODULE,) = modules.small()


@pytest.fixture
def kernel_cache(tmp_path, monkeypatch) -> Iterator[Path]:
    """An empty cache of kernels, on a machine with two cores; the module is not loaded."""
    start_warp()
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    monkeypatch.setattr(loading_module, "core_count", lambda: 2)
    MODULE.unload()
    yield tmp_path
    monkeypatch.undo()
    MODULE.unload()


@pytest.fixture
def built_here(monkeypatch) -> list[str]:
    """Files of the modules that this process compiles."""
    from warp._src import build

    files: list[str] = []
    build_cpu = build.build_cpu

    def count(path: str, *arguments: object, **options: object) -> None:
        files.append(path)
        build_cpu(path, *arguments, **options)

    monkeypatch.setattr(build, "build_cpu", count)
    return files


def built(source: ModuleSource) -> bool:
    """Has another process compile modules, and returns whether it was not stopped."""
    process = BuildProcess(source)
    try:
        return process.wait()
    finally:
        process.stop()


def compiled(cache: Path) -> list[str]:
    """Folders of the compiled modules in a cache."""
    return [path.parent.name for path in cache.glob("*/*.o")]


def test_what_another_process_compiles_is_only_loaded_here(kernel_cache, built_here, monkeypatch):
    said: list[str] = []
    before = wp.get_logger()
    wp.set_logger(CompileNotice(said.append))
    monkeypatch.setattr(wp.config, "log_level", wp.LOG_INFO)
    try:
        with loading([], by_other_process=modules.small):
            await_loaded([MODULE])
            assert MODULE.execs
    finally:
        wp.set_logger(before)
    assert compiled(kernel_cache) == [MODULE.get_module_identifier(1)]
    assert built_here == []
    assert [line.split(" in ")[0] for line in said] == [f"compiled {MODULE.name} for cpu"]


def test_several_modules_are_waited_for_one_after_the_other(kernel_cache, built_here):
    wanted = modules.two()
    for module in wanted:
        module.unload()
    with loading([], by_other_process=modules.two):
        await_loaded(wanted)
        assert all(module.execs for module in wanted)
    assert built_here == []
    wanted[1].unload()


def test_it_imports_nothing_that_this_process_would_not(kernel_cache, tmp_path_factory, monkeypatch):
    folder = tmp_path_factory.mktemp("work")
    (folder / "pickle.py").write_text("raise RuntimeError('not the library')\n")
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path])
    assert built(modules.small)
    assert len(compiled(kernel_cache)) == 1


def test_it_compiles_with_the_settings_of_this_process(kernel_cache, monkeypatch):
    before = MODULE.get_module_identifier(1)
    monkeypatch.setattr(wp.config, "kernel_cache_dir", kernel_cache)  # not a string
    monkeypatch.setattr(wp.config, "verify_fp", True)
    MODULE.mark_modified()
    assert MODULE.get_module_identifier(1) != before
    assert built(modules.small)
    assert compiled(kernel_cache) == [MODULE.get_module_identifier(1)]


UNUSABLE = {"fails": modules.failing, "has another module": modules.different, "is local": lambda: [MODULE]}


@pytest.mark.parametrize("source", UNUSABLE.values(), ids=UNUSABLE)
def test_what_another_process_cannot_compile_is_compiled_here(kernel_cache, built_here, source):
    with loading([], by_other_process=source):
        await_loaded([MODULE])
        assert MODULE.execs
    assert len(built_here) == 1
    assert compiled(kernel_cache) == [MODULE.get_module_identifier(1)]


def test_the_process_ends_with_the_block_that_an_error_leaves(kernel_cache, built_here, monkeypatch):
    started: list[subprocess.Popen[bytes]] = []

    class Popen(subprocess.Popen):
        def __init__(self, *arguments: object, **options: object) -> None:
            super().__init__(*arguments, **options)
            started.append(self)

    monkeypatch.setattr(subprocess, "Popen", Popen)
    began = time.monotonic()
    with pytest.raises(ValueError, match="the block"), loading([], by_other_process=modules.slow):
        time.sleep(0.2)
        raise ValueError("the block")
    assert time.monotonic() - began < 30.0
    assert [process.returncode for process in started] == [-9]
    assert built_here == []


def test_the_process_ends_with_the_one_that_has_started_it(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    script = (
        "import os, time\n"
        "from support import modules\n"
        "from oimppi_warp.compute.build_process import BuildProcess\n"
        "print(BuildProcess(modules.slow)._process.pid, flush=True)\n"
        "time.sleep(4.0)\n"
        "os._exit(0)\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, cwd=Path(__file__).parents[1]
    )
    other = int(ended.stdout)
    deadline = time.monotonic() + 30.0
    while Path(f"/proc/{other}").exists() and "zombie" not in Path(f"/proc/{other}/status").read_text():
        assert time.monotonic() < deadline
        time.sleep(0.1)


@pytest.mark.parametrize("reason", ["one core", "a version is cached", "embedded", "nothing is cached"])
def test_no_process_is_started_in_vain(kernel_cache, monkeypatch, reason):
    started = []
    monkeypatch.setattr(subprocess, "Popen", lambda *arguments, **options: started.append(arguments))
    monkeypatch.setattr(wp, "force_load", lambda _device, modules: None)
    if reason == "one core":
        monkeypatch.setattr(loading_module, "core_count", lambda: 1)
    elif reason == "embedded":
        monkeypatch.setattr(sys, "executable", "/opt/studio/bin/studio")
    elif reason == "nothing is cached":
        monkeypatch.setattr(wp.config, "cache_kernels", False)
    else:
        (kernel_cache / f"wp_{MODULE.name}_0123abc").mkdir()
    with loading([], by_other_process=modules.small):
        await_loaded([MODULE])
    assert started == []


@pytest.mark.parametrize("method", METHODS)
def test_the_kernels_of_every_method_can_be_named_to_another_process(method):
    task = partial(kernels_with_own_flags, best(method), RunSpec(method=method, device="cpu"))
    found = pickle.loads(pickle.dumps(task))()
    assert found == task()
    assert any("rollout" in module.name for module in found)
