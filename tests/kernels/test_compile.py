"""Every kernel compiles for the GPUs that we support, on a machine that has none."""

from __future__ import annotations

import pkgutil
import re
import subprocess
from collections.abc import Iterator
from importlib import import_module
from importlib.metadata import distribution
from pathlib import Path

import pytest
import warp as wp

import oimppi_warp.kernels
from oimppi_warp.compute.step import BLOCK
from oimppi_warp.kernels.costs.stage_costs import TERMS

ARCHITECTURES = (90, pytest.param(80, marks=pytest.mark.slow), pytest.param(120, marks=pytest.mark.slow))
"""Hopper, and at night Ampere and Blackwell."""
CHAINS = ("RRRRRR", "PP", "RRRRRRR")
"""The xArm6, the point robot and the arm of seven joints."""
ARGUMENTS = {
    "make_place_arm": [(chain,) for chain in CHAINS],
    "make_robot_cost": [((),)],
    "make_robot_rollout": [(chain, ()) for chain in CHAINS],
    "make_upright_rollout": [((),)],
    "make_upright_clearance": [(chain,) for chain in CHAINS],
    "make_sample_controls": [(3, 5), (3, 6), (2, 6), (6, 6), (7, 6), (6, 0)],
    "make_pick_trace": [(len(TERMS),)],
    "make_track_object": [(chain,) for chain in CHAINS],
    "make_stage_costs": [(chain, precision, ()) for chain in CHAINS for precision in (wp.float32, wp.float64)],
}
"""What a factory is asked for; controls of 2, 3, 6 and 7 numbers where nothing is said."""
MOST_REGISTERS, MOST_STACK = 255, 64
"""Most registers per thread, and bytes of local memory per thread, where registers that do not fit are spilled."""
OTHER_ARMS = re.compile("_(PP|RRRRRRR|2|7)(_|$)")
"""Finds the modules for the point robot and the arm of seven joints by their names; they are compiled at night."""
STACK = {"oimppi_warp.kernels.fields.distance": 512}
"""Modules with a larger stack: that of a mesh query, which runs on the CPU only."""


def kernel_modules() -> Iterator[wp.Module]:
    """The Warp modules of all kernels, also of those that are made for a size."""
    found: dict[str, wp.Module] = {}
    for info in pkgutil.walk_packages(oimppi_warp.kernels.__path__, "oimppi_warp.kernels."):
        module = import_module(info.name)
        for name, value in vars(module).items():
            if isinstance(value, wp.Kernel):
                found[value.module.name] = value.module
            elif name.startswith("make_") and value.__module__ == info.name:
                for arguments in ARGUMENTS.get(name, [(2,), (3,), (6,), (7,)]):
                    made = value(*arguments)
                    if isinstance(made, wp.Kernel):
                        found[made.module.name] = made.module
    yield from found.values()


def short_name(module: wp.Module) -> str:
    """The last part of a module's name."""
    return module.name.rpartition(".")[2]


MODULES = [
    pytest.param(module, marks=[pytest.mark.slow] if OTHER_ARMS.search(module.name) else [], id=short_name(module))
    for module in kernel_modules()
]


def test_all_kernel_files_are_found():
    stems = {short_name(module).rstrip("_0123456789PR") for module in kernel_modules()}
    wanted = {
        "distance",
        "cost_to_go",
        "object",
        "robot_rollout",
        "upright_rollout",
        "sample_controls",
        "update",
        "update_nominal",
    }
    assert wanted <= stems


def resources(cubin: Path) -> dict[str, dict[str, int]]:
    """Returns registers (REG) and bytes of STACK, SHARED and LOCAL memory of each function of a cubin, by cuobjdump."""
    (tool,) = [file for file in distribution("nvidia-cuda-cuobjdump").files or () if file.name == "cuobjdump"]
    command = [str(tool.locate()), "--dump-resource-usage", str(cubin)]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    found = re.findall(r"Function (\S+):\s*\n\s*(REG:.*)", said)
    return {name: {key: int(value) for key, value in re.findall(r"(\w+):(\d+)", line)} for name, line in found}


@pytest.mark.parametrize("arch", ARCHITECTURES)
@pytest.mark.parametrize("module", MODULES)
def test_a_kernel_module_compiles_without_a_gpu_and_spills_no_registers(module, arch, tmp_path, monkeypatch):
    monkeypatch.setitem(module.options, "block_dim", BLOCK)
    (file,) = wp.compile_aot_module(module, arch=arch, module_dir=tmp_path, use_ptx=False)
    assert f"sm{arch}" in file.name
    assert file.read_bytes()[:4] == b"\x7fELF"
    found = resources(file)
    assert any("_cuda_kernel_forward" in name for name in found)
    for name, taken in found.items():
        assert taken["REG"] <= MOST_REGISTERS and taken["LOCAL"] == 0, name
        assert taken["STACK"] <= STACK.get(module.name, MOST_STACK), name


def test_no_kernel_has_a_gradient_that_nobody_needs():
    for module in kernel_modules():
        backward = module.options["enable_backward"]
        assert not any(kernel.options.get("enable_backward", backward) for kernel in module.kernels.values()), module
