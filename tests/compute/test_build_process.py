"""Kernels that another process compiles."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import pytest
import warp as wp
from support import modules

from oimppi_warp.compute import loading as loading_module
from oimppi_warp.compute.build_process import BuildProcess
from oimppi_warp.compute.device import CompileNotice, start_warp
from oimppi_warp.compute.loading import await_loaded, loading

(MODULE,) = modules.small()


@pytest.fixture
def kernel_cache(tmp_path, monkeypatch) -> Path:
    """An empty cache of kernels, from which the module is loaded."""
    start_warp()
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    monkeypatch.setattr(loading_module, "core_count", lambda: 2)
    MODULE.unload()
    return tmp_path


@pytest.fixture
def said(monkeypatch) -> list[str]:
    """What is said about compiled modules."""
    lines: list[str] = []
    before = wp.get_logger()
    wp.set_logger(CompileNotice(lines.append))
    monkeypatch.setattr(wp.config, "log_level", wp.LOG_INFO)
    yield lines
    wp.set_logger(before)


def objects(cache: Path) -> list[Path]:
    """Compiled modules in a cache."""
    return list(cache.glob(f"wp_{MODULE.name}_*/*.o"))


def test_what_another_process_compiles_is_only_loaded_here(kernel_cache, said):
    with loading([], elsewhere=modules.small):
        await_loaded([MODULE])
        (made,) = objects(kernel_cache)
        before = made.stat()
        assert MODULE.execs
    after = made.stat()
    assert (after.st_ino, after.st_mtime_ns) == (before.st_ino, before.st_mtime_ns)
    assert [line.split(" in ")[0] for line in said] == [f"compiled {MODULE.name} for cpu"]


def test_it_imports_nothing_from_the_working_directory(kernel_cache, tmp_path_factory, monkeypatch):
    folder = tmp_path_factory.mktemp("work")
    (folder / "pickle.py").write_text("raise RuntimeError('not the library')\n")
    monkeypatch.chdir(folder)
    assert BuildProcess(modules.small).wait()
    assert len(objects(kernel_cache)) == 1


def test_it_compiles_with_the_settings_of_this_process(kernel_cache, monkeypatch):
    before = MODULE.get_module_hash(1)
    monkeypatch.setattr(wp.config, "verify_fp", True)
    MODULE.mark_modified()
    assert MODULE.get_module_hash(1) != before
    process = BuildProcess(modules.small)
    assert process.wait()
    assert [path.parent.name for path in objects(kernel_cache)] == [MODULE.get_module_identifier(1)]
    MODULE.mark_modified()


@pytest.mark.parametrize("elsewhere", [modules.failing, lambda: [MODULE]], ids=["fails", "cannot be pickled"])
def test_what_another_process_cannot_compile_is_compiled_here(kernel_cache, said, elsewhere):
    with loading([], elsewhere=elsewhere):
        await_loaded([MODULE])
        assert MODULE.execs
    assert len(said) == 1


def test_the_process_ends_with_the_block(kernel_cache):
    began = time.monotonic()
    process = BuildProcess(modules.slow)
    process.stop()
    assert not process.wait()
    assert time.monotonic() - began < 30.0


@pytest.mark.parametrize("reason", ["one core", "a version is cached", "embedded"])
def test_no_process_is_started_in_vain(kernel_cache, monkeypatch, reason):
    import subprocess

    started = []
    monkeypatch.setattr(subprocess, "Popen", lambda *arguments, **options: started.append(arguments))
    monkeypatch.setattr(wp, "force_load", lambda _device, modules: None)
    if reason == "one core":
        monkeypatch.setattr(loading_module, "core_count", lambda: 1)
    elif reason == "embedded":
        monkeypatch.setattr(sys, "executable", "/opt/studio/bin/studio")
    else:
        (kernel_cache / f"wp_{MODULE.name}_0123abc").mkdir()
    with loading([], elsewhere=modules.small):
        await_loaded([MODULE])
    assert started == []
