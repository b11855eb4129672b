"""System information and diagnosis: facts about this machine, and problems found from these facts alone."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, metadata, version
from pathlib import Path
from typing import Any

import warp as wp

from oimppi_warp.compute.cache import cache_folder
from oimppi_warp.compute.device import core_count, has_nvidia_device, kernels_are_cached, old_driver, start_warp
from oimppi_warp.errors import ConfigError
from oimppi_warp.registries import COST_TERMS, ENGINES, METHODS, OPTIMIZERS, PLANTS, SHAPES
from oimppi_warp.registry import Registry

NAME = "oimppi-warp"
"""Name of this package's distribution."""
PACKAGES = (NAME, "warp-lang", "newton", "mujoco", "mujoco-warp", "usd-core", "numpy", "trimesh", "shapely", "viser")
"""Packages whose versions are reported."""
REGISTRIES: dict[str, Registry[Any]] = {
    "methods": METHODS,
    "optimizers": OPTIMIZERS,
    "engines": ENGINES,
    "plants": PLANTS,
    "cost_terms": COST_TERMS,
    "shapes": SHAPES,
}
"""Registries whose entries are reported, in order."""
_FOR_DEVELOPERS = ("dev", "site")
"""Extras that nobody needs to plan or to push."""
_LEAST_MEMORY = 4e9
"""Memory required for a run, with a margin [B]."""


@dataclass(frozen=True)
class Gpu:
    """A CUDA device.

    Attributes:
        alias: Warp's alias, such as ``cuda:0``.
        name: The vendor's name.
        arch: Compute capability, such as 90.
        memory: Memory [B].
    """

    alias: str
    name: str
    arch: int
    memory: int


@dataclass(frozen=True)
class Facts:
    """Facts about this machine.

    Attributes:
        python, system, cpu: Names of the Python version, the operating system and the processor.
        cores: Number of cores.
        usable_cores: Number of cores that this process may use, which is the planner's number of threads.
        memory: Memory [B]; 0 if unknown.
        gpus: CUDA devices that Warp can use.
        gpu_hardware: Whether there is any NVIDIA device.
        driver: CUDA version that the driver supports; ``None`` without one.
        toolkit: CUDA version that Warp was built with; ``None`` if it was built without.
        versions: Versions of :data:`PACKAGES`; empty for one that is not installed.
        extras: Whether each extra of this package is installed, by name.
        kernel_cache, field_cache: Folders of compiled kernels and computed fields.
        kernel_bytes, field_bytes: Sizes of their contents [B].
        writable: Whether each of the two folders is writable.
        compiled: Whether kernels are compiled already.
        scenes: Number of shipped scenes.
        device: Device that the planner will use.
        blas_threads: Setting that limits NumPy's threads; empty if there is none.
        entries: For each of :data:`REGISTRIES`, its names, each with the installed package that adds it; empty for
            built-in entries.
        broken: Entries of installed packages that cannot be imported, each with the reason.
    """

    python: str
    system: str
    cpu: str
    cores: int
    usable_cores: int
    memory: int
    gpus: tuple[Gpu, ...]
    gpu_hardware: bool
    driver: tuple[int, int] | None
    toolkit: tuple[int, int] | None
    versions: dict[str, str]
    extras: dict[str, bool]
    kernel_cache: str
    field_cache: str
    kernel_bytes: int
    field_bytes: int
    writable: tuple[bool, bool]
    compiled: bool
    scenes: int
    device: str
    blas_threads: str
    entries: dict[str, dict[str, str]]
    broken: dict[str, str]


@dataclass(frozen=True)
class Finding:
    """A problem and its remedy.

    Attributes:
        what: The problem, in one line.
        remedy: How to fix it.
    """

    what: str
    remedy: str


def gather_facts() -> Facts:
    """Collects system information."""
    from oimppi_warp.usd import shipped_scenes

    start_warp()
    devices = wp.get_cuda_devices()
    kernel_cache = Path(wp.config.kernel_cache_dir or "")
    fields = cache_folder()
    return Facts(
        python=platform.python_version(),
        system=platform.platform(),
        cpu=processor(),
        cores=os.cpu_count() or 1,
        usable_cores=core_count(),
        memory=_memory(),
        gpus=tuple(Gpu(device.alias, device.name, device.arch, device.total_memory) for device in devices),
        gpu_hardware=has_nvidia_device(),
        driver=wp.get_cuda_driver_version(),
        toolkit=wp.get_cuda_toolkit_version(),
        versions={name: _version(name) for name in PACKAGES},
        extras=_extras(),
        kernel_cache=str(kernel_cache),
        field_cache=str(fields),
        kernel_bytes=_size(kernel_cache),
        field_bytes=_size(fields),
        writable=(_writable(kernel_cache), _writable(fields)),
        compiled=kernels_are_cached(),
        scenes=len(shipped_scenes()),
        device="cuda:0" if devices else "cpu",
        blas_threads=os.environ.get("OMP_NUM_THREADS", ""),
        entries={kind: {name: known.package_of(name) for name in known} for kind, known in REGISTRIES.items()},
        broken=dict(_broken_entries()),
    )


def diagnose(facts: Facts) -> list[Finding]:
    """Returns the problems found in the facts, the worst first."""
    found = []
    for name, installed in facts.versions.items():
        if not installed and name != NAME:  # which runs from its source then
            found.append(Finding(f"{name} is not installed", "pip install -r requirements.lock"))
    newton, batched = (facts.versions[name].split(".")[:2] for name in ("mujoco", "mujoco-warp"))
    if newton != batched:
        of = f"mujoco {facts.versions['mujoco']} and mujoco-warp {facts.versions['mujoco-warp']} are incompatible"
        found.append(Finding(of, "pip install -r requirements.lock"))
    for entry, reason in facts.broken.items():
        found.append(Finding(f"{entry} cannot be imported: {reason}", "fix the package that adds it, or remove it"))
    if not facts.scenes:
        found.append(Finding("this installation contains no shipped scenes", "reinstall the package"))
    if old := old_driver(facts.driver, facts.toolkit):
        found.append(Finding(f"{old}; Warp lists no GPU, and plans run on the CPU", "update NVIDIA's driver"))
    elif facts.gpu_hardware and not facts.gpus:
        remedy = "install NVIDIA's driver, or make the device visible to this process (CUDA_VISIBLE_DEVICES, container)"
        found.append(Finding("an NVIDIA device is present, but Warp cannot use it", remedy))
    for folder, writable, variable in zip(
        (facts.kernel_cache, facts.field_cache), facts.writable, ("WARP_CACHE_PATH", "OIMPPI_CACHE"), strict=True
    ):
        if not writable:
            remedy = f"set {variable} to a writable folder, or every run will start slowly"
            found.append(Finding(f"{folder} is not writable", remedy))
    if 0 < facts.memory < _LEAST_MEMORY:
        found.append(Finding(f"only {facts.memory / 1e9:.1f} GB of memory", "plan with fewer samples"))
    if facts.usable_cores < facts.cores:
        of = f"this process may use only {facts.usable_cores} of {facts.cores} cores"
        found.append(Finding(of, "lift the limit (taskset, container), unless it is intended"))
    return found


def processor() -> str:
    """Returns the processor's name, as far as the system reports it."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _broken_entries() -> Iterator[tuple[str, str]]:
    """Yields entries of installed packages that cannot be imported, with the reasons."""
    for known in REGISTRIES.values():
        for name in known:
            if package := known.package_of(name):
                try:
                    known[name]
                except ConfigError as error:  # raised for any error during the package's import
                    yield (
                        f"the {known.kind} {name!r} of {package}",
                        f"{type(error.__cause__).__name__}: {error.__cause__}",
                    )


def _memory() -> int:
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return 0


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def _extras() -> dict[str, bool]:
    """Returns whether each extra for users is installed: whether all packages that it requires are."""
    try:
        about = metadata(NAME)
    except PackageNotFoundError:  # it runs from its source
        return {}
    found = {extra: True for extra in about.get_all("Provides-Extra") or () if extra not in _FOR_DEVELOPERS}
    for requirement in about.get_all("Requires-Dist") or ():
        needed, extra = re.match(r"[\w.-]+", requirement), re.search(r"extra == ['\"]([\w-]+)", requirement)
        if needed and extra and extra[1] in found:
            found[extra[1]] &= bool(_version(needed[0]))
    return found


def _size(folder: Path) -> int:
    """Returns the size of a folder's contents [B]; 0 if it does not exist."""
    total = 0
    for file in folder.rglob("*"):
        with suppress(FileNotFoundError):  # others may remove files meanwhile
            total += file.stat().st_size
    return total


def _writable(folder: Path) -> bool:
    """Returns whether a file can be written to a folder, which is created if needed."""
    there = next(place for place in (folder, *folder.parents) if place.exists())
    return there.is_dir() and os.access(there, os.W_OK | os.X_OK)
