"""``oimppi doctor`` and ``oimppi warmup``: what is judged wrong, and that after a warm-up nothing is compiled."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import warp as wp
from support import small_tasks

from oimppi_warp.cli.main import main
from oimppi_warp.compute.device import EMULATED_GPU, start_warp
from oimppi_warp.config.overrides import set_option
from oimppi_warp.config.presets import best
from oimppi_warp.registries import METHODS
from oimppi_warp.system import doctor, precompile
from oimppi_warp.system.doctor import PACKAGES, Facts, Gpu, diagnose, gather_facts
from oimppi_warp.system.precompile import Variant, compile_for, needed_on_cuda, record_modules
from oimppi_warp.usd import shipped_scenes

WELL = Facts(
    python="3.11.7",
    system="Linux",
    cpu="a CPU",
    cores=8,
    usable_cores=8,
    memory=16_000_000_000,
    gpus=(Gpu("cuda:0", "a GPU", 90, 80_000_000_000),),
    gpu_hardware=True,
    driver=(13, 0),
    toolkit=(13, 4),
    versions=dict.fromkeys(PACKAGES, "3.17.0"),
    extras={"xarm": False},
    kernel_cache="/caches/warp",
    field_cache="/caches/fields",
    kernel_bytes=20_000_000,
    field_bytes=0,
    writable=(True, True),
    compiled=True,
    scenes=8,
    device="cuda:0",
    blas_threads="1",
    entries={"methods": {"cloi": ""}},
    broken={},
)


def test_nothing_is_wrong_with_a_machine_that_is_well():
    assert diagnose(WELL) == []
    assert diagnose(replace(WELL, gpus=(), gpu_hardware=False, driver=None, device="cpu")) == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"versions": WELL.versions | {"newton": ""}}, "newton is not installed"),
        ({"versions": WELL.versions | {"mujoco": "3.16.1"}}, "are incompatible"),
        ({"scenes": 0}, "no shipped scenes"),
        ({"gpus": (), "driver": None}, "Warp cannot use it"),
        ({"gpus": (), "driver": (13, 0)}, "Warp cannot use it"),
        ({"driver": (12, 2)}, "CUDA 12.2, and Warp"),
        ({"writable": (False, True)}, "/caches/warp is not writable"),
        ({"writable": (True, False)}, "/caches/fields is not writable"),
        ({"memory": 2_000_000_000}, "2.0 GB of memory"),
        ({"usable_cores": 2}, "only 2 of 8 cores"),
        ({"broken": {"the method 'rrt' of oimppi-rrt": "ImportError: no"}}, "'rrt' of oimppi-rrt cannot be imported"),
    ],
)
def test_what_is_wrong_is_said_with_what_to_do(change, said):
    (finding,) = diagnose(replace(WELL, **change))
    assert said in finding.what
    assert len(finding.remedy) > 10


def test_a_package_that_runs_from_its_source_is_not_missing(monkeypatch: pytest.MonkeyPatch):
    def unknown(name: str) -> Any:
        if name == doctor.NAME:
            raise PackageNotFoundError(name)
        return version(name)

    monkeypatch.setattr(doctor, "metadata", unknown)
    monkeypatch.setattr(doctor, "version", unknown)
    facts = gather_facts()
    assert facts.extras == {} and facts.versions[doctor.NAME] == ""
    assert not any("not installed" in finding.what for finding in diagnose(facts))


def test_the_doctor_sees_this_machine(capsys):
    facts = gather_facts()
    assert 1 <= facts.usable_cores <= facts.cores and facts.memory > 0 and facts.scenes == len(shipped_scenes())
    assert all(facts.versions.values())
    assert facts.extras and facts.kernel_bytes > 0
    status = main(["doctor", "--json"])
    told = json.loads(capsys.readouterr().out)
    assert status == (1 if diagnose(facts) else 0)
    assert told["facts"]["usable_cores"] == facts.usable_cores
    assert len(told["findings"]) == len(diagnose(facts))


def test_the_doctor_speaks_to_people(capsys):
    main(["doctor"])
    out = capsys.readouterr().out
    for word in (
        "machine",
        "extras",
        " MB",
        "GPUs",
        "packages",
        "will use",
        "kernels",
        "methods",
        "optimizers",
        "engines",
        "plants",
    ):
        assert word in out


def test_the_doctor_lists_what_installed_packages_add_and_what_of_it_is_broken(tmp_path):
    installed = tmp_path / "oimppi_extra-1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: oimppi-extra\nVersion: 1.0\n")
    (installed / "entry_points.txt").write_text(
        "[oimppi_warp.methods]\nrrt = extra:Rrt\n\n[oimppi_warp.engines]\nrigid = extra_engine:Rigid\n"
    )
    (tmp_path / "extra.py").write_text("Rrt = object()\n")
    paths = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    command = [sys.executable, "-m", "oimppi_warp", "doctor", "--json"]
    environment = os.environ | {"PYTHONPATH": paths}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    told = json.loads(done.stdout)
    assert done.returncode == 1
    assert told["facts"]["entries"]["methods"] == dict.fromkeys(METHODS, "") | {"rrt": "oimppi-extra"}
    assert told["facts"]["entries"]["engines"]["rigid"] == "oimppi-extra"
    (finding,) = [each for each in told["findings"] if "imported" in each["what"]]
    assert "the engine 'rigid' of oimppi-extra cannot be imported: ModuleNotFoundError" in finding["what"]


@pytest.mark.parametrize("arch", ["sm_9", "hopper", "20"])
def test_an_architecture_that_is_none_is_bad_input(arch, capsys):
    assert main(["warmup", "--arch", arch]) == 2
    assert "sm_90" in capsys.readouterr().err


def run(*arguments: str, caches: Path) -> str:
    """What a command says on its error output, with caches of its own."""
    environment = os.environ | {"WARP_CACHE_PATH": str(caches / "warp"), "OIMPPI_CACHE": str(caches / "fields")}
    command = [sys.executable, "-m", "oimppi_warp", *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode in (0, 1), done.stderr
    return done.stderr


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_after_a_warmup_a_run_compiles_nothing(tmp_path):
    short = ("run", "task01", "--device", "cpu", "--max-sim-seconds", "0.1", "--set", "robot.optimizer.samples=64")
    cold = run(*short, "--engine", "quasistatic", caches=tmp_path / "other")
    assert "compiled oimppi_warp.kernels.upright_rollout" in cold
    run("warmup", "task01", "--out", str(tmp_path / "shipped"), caches=tmp_path)
    assert not (tmp_path / "warp").exists()
    for engine in ("quasistatic", "newton"):
        for method in ("cloi", "soi"):
            said = run(*short, "--engine", engine, "--method", method, caches=tmp_path / "shipped")
            assert "compil" not in said


def test_what_a_gpu_needs_of_ours_is_found():
    names = {each.module.name for each in needed_on_cuda(small_tasks.shipped("task01"), ["quasistatic"])}
    kernels = ("upright_rollout", "rollouts.object", "sample_controls_3_6", "optimizers.update", "update_nominal_3")
    assert {f"oimppi_warp.kernels.{name}" for name in kernels} <= names
    assert "oimppi_warp.kernels.fields.cost_to_go" in names, "SOI follows its cost-to-go there"
    assert "oimppi_warp.kernels.fields.distance" not in names, "the CPU computes the fields there too"


def test_what_a_gpu_needs_is_found_with_as_many_samples_as_will_run_there(monkeypatch):
    made = []

    class Made:
        def warm_up(self):
            pass

    def make(scene, config, **spec):
        made.append((spec["method"], spec["engine"], spec["device"], config.robot.optimizer.samples))
        return Made()

    monkeypatch.setattr(precompile, "make_planner", make)
    scene, many = small_tasks.shipped("task01"), set_option(best("cloi"), "robot.optimizer.samples=777")
    assert needed_on_cuda(scene, ["newton"], lambda method: many) == []
    assert made == [(method, "newton", EMULATED_GPU, 777) for method in METHODS]


def test_a_gpu_looks_for_the_format_that_a_warmup_compiles_whatever_its_driver():
    start_warp()
    newest = SimpleNamespace(driver_version=(99, 0), toolkit_version=wp.get_cuda_toolkit_version())
    gpu = SimpleNamespace(is_cpu=False, is_cubin_supported=True, runtime=newest)
    assert type(wp.get_device("cpu")).get_cuda_output_format(gpu) == "cubin"


@wp.kernel(module="unique")
def count_up(numbers: wp.array[int]):
    numbers[wp.tid()] += 1


def test_a_rehearsal_lists_what_is_launched_in_it_with_the_blocks_that_are_asked_for():
    numbers = wp.zeros(64, dtype=int, device="cpu")
    wp.launch(count_up, dim=64, inputs=[numbers], device="cpu", block_dim=64)
    for block, dim in ((64, 64), (None, 64), (None, 0)):
        with record_modules() as found:
            wp.launch(count_up, dim=dim, inputs=[numbers], device="cpu", block_dim=block)
        assert found == ([Variant(count_up.module, block or 256)] if dim else [])
    assert not wp.config.enable_cpu_blocks
    with record_modules() as found:
        wp.launch(count_up, dim=64, inputs=[wp.zeros(64, dtype=int, device="cpu")], device="cpu", block_dim=64)
        wp.get_suggested_block_size(count_up)  # a GPU loads the variant with the usual block to answer
    assert sorted(variant.block for variant in found) == [64, 256]
    wp.launch(count_up, dim=64, inputs=[numbers], device="cpu", block_dim=64)
    assert set(numbers.numpy()) == {4}


@wp.kernel(module="unique")
def copy_any(source: wp.array[Any], target: wp.array[Any]):
    target[wp.tid()] = source[wp.tid()]


def test_a_generic_kernel_is_compiled_in_every_state_that_is_loaded(tmp_path, monkeypatch):
    start_warp()
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    with record_modules() as found:
        for dtype in (float, wp.vec3, float):
            numbers = [wp.zeros(4, dtype=dtype, device="cpu") for _ in range(2)]
            wp.launch(copy_any, dim=4, inputs=[numbers[0]], outputs=[numbers[1]], device="cpu", block_dim=256)
    assert [len(each.overloads[0][1]) for each in found] == [1, 2]
    assert compile_for(found, 90, lambda module: None) == 2
    states = {file.parent.name for file in tmp_path.rglob("*.cubin")}
    assert states == {file.parent.name for file in tmp_path.rglob("*.o")}, "what the launches loaded, under one name"


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_all_that_a_newton_plan_needs_compiles_for_a_hopper_gpu(tmp_path, monkeypatch):
    start_warp()  # it fills in the folder that is put back in the end
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    variants = needed_on_cuda(small_tasks.shipped("task02"), ["newton"])
    names = {each.module.name for each in variants}
    assert {each.block for each in variants} >= {32, 64, 128, 256}, "as MuJoCo Warp asks for them"
    broad = {each.block for each in variants if each.module.name.startswith("_nxn_broadphase")}
    assert len(broad) == 2 and 256 in broad, "the kernel is launched with one size, and its occupancy asked with 256"
    assert {"mujoco_warp._src.solver", "mujoco_warp._src.smooth", "oimppi_warp.kernels.rollouts.worlds"} <= names
    assert len(variants) > 60
    assert compile_for(variants, 90, lambda module: None) == len(variants)
    cubins = list(tmp_path.rglob("*.sm90.cubin"))
    assert len(cubins) == len(variants)
    assert all(file.read_bytes()[:4] == b"\x7fELF" for file in cubins)
