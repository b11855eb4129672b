"""Commands to prepare and check an installation: ``oimppi warmup`` and ``oimppi doctor``."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import FlagCreatePairsOff, Positional, arg

from oimppi_warp.cli.printing import print_rows
from oimppi_warp.config.run_spec import listed
from oimppi_warp.errors import ConfigError
from oimppi_warp.registries import ENGINES, METHODS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rich.progress import Progress

    from oimppi_warp.scene import Scene


@dataclass(frozen=True)
class Warmup:
    """Compile kernels and compute a scene's distance fields in advance, so that runs start at once.

    The kernels are those of the preset best. With --out, kernels and fields are written to a folder that can be copied
    to another machine; to use them there, set WARP_CACHE_PATH=FOLDER/warp and OIMPPI_CACHE=FOLDER/fields. Kernels
    compiled for this machine's CPU run only on CPUs of the same kind.
    """

    scene: Annotated[Positional[str], arg(metavar="[SCENE]")] = "task02"
    """A USD file, or the name of a shipped scene (`oimppi scenes` lists them).
    The Newton engine's kernels depend on the scene's shapes."""

    engine: Annotated[str, arg(metavar=listed("all", *ENGINES))] = "all"
    """Rollout engine whose kernels are compiled."""

    arch: Annotated[tuple[str, ...], arg(metavar="SM", help_behavior_hint="(default: none)")] = ()
    """GPU architectures to compile for in addition to the CPU: one or more, such as sm_90.
    This machine needs no such GPU. Compiling the Newton engine's kernels takes minutes."""

    out: Annotated[
        Path | None, arg(metavar="FOLDER", help_behavior_hint="(default: the caches shown by `oimppi doctor`)")
    ] = None
    """Folder to which kernels and fields are written."""

    def execute(self) -> int:
        """Compiles the kernels and returns the exit status."""
        ENGINES.check(self.engine, "all")
        architectures = [_architecture(name) for name in self.arch]
        if self.out is not None:
            os.environ["WARP_CACHE_PATH"] = str(self.out.absolute() / "warp")
            os.environ["OIMPPI_CACHE"] = str(self.out.absolute() / "fields")

        import warp as wp
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

        from oimppi_warp.compute.device import start_warp
        from oimppi_warp.config.presets import best
        from oimppi_warp.physics.world import World
        from oimppi_warp.planning.factory import make_planner
        from oimppi_warp.plants.plant import SimulatedPlant
        from oimppi_warp.runtime.estimator import Estimator
        from oimppi_warp.usd import load_scene

        console = Console(stderr=True, highlight=False)
        start_warp()
        columns = (TextColumn("{task.description:48}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        engines = tuple(ENGINES) if self.engine == "all" else (self.engine,)
        with Progress(*columns, console=console) as progress:
            scene = load_scene(self.scene)
            bar = progress.add_task("compiling for the CPU", total=len(engines) * len(METHODS) + 1)
            for engine in engines:
                for method in METHODS:
                    progress.update(bar, description=f"compiling for the CPU: {engine}, {method}")
                    make_planner(scene, best(method), method=method, engine=engine, device="cpu").warm_up()
                    progress.advance(bar)
            progress.update(bar, description="compiling the simulator and the estimator")
            SimulatedPlant(World(scene))
            Estimator(scene, best("cloi"))
            progress.advance(bar)
            for arch in architectures:
                self._compile_for(arch, engines, progress, scene)
        console.print(f"compiled kernels are in {wp.config.kernel_cache_dir}", soft_wrap=True)
        return 0

    def _compile_for(self, arch: int, engines: Sequence[str], progress: Progress, scene: Scene) -> None:
        """Compiles the kernels that these engines need for a scene on a GPU, for an architecture such as 90 (sm_90)."""
        from oimppi_warp.system.precompile import compile_for, needed_on_cuda

        bar = progress.add_task(f"for sm_{arch}: finding the kernels needed", total=None)
        variants = needed_on_cuda(scene, engines)
        progress.update(bar, total=len(variants))

        def on_module(module) -> None:
            progress.update(bar, description=f"for sm_{arch}: {module.name[:34]}", advance=1)

        compile_for(variants, arch, on_module)


@dataclass(frozen=True)
class Doctor:
    """Report the hardware and software of this machine, the resources that a run will use, and any problems.

    With --robot-address, check an xArm and the camera instead, with --ros2 an arm on ROS 2; nothing moves. Exit status:
    0 no problems found, 1 problems found.
    """

    robot_address: Annotated[str | None, arg(metavar="HOST", help_behavior_hint="")] = None
    """Address of an xArm's controller to check, HOST or HOST:PORT."""

    pose_address: Annotated[
        str | None, arg(metavar="HOST:PORT", help_behavior_hint="(default: that of the robot, port 17501)")
    ] = None
    """Address of the server that sends the object's poses."""

    ros2: FlagCreatePairsOff[bool] = False
    """Check what is on the ROS 2 topics of an arm, like `oimppi ros2 check`."""

    plant_options: Annotated[tuple[str, ...], arg(metavar="NAME=VALUE", help_behavior_hint="(repeatable)")] = ()
    """With --ros2: options of the plant ros2, such as domain=3."""

    scene: Annotated[str, arg(metavar="SCENE")] = "lab01"
    """Scene whose robot the arm is compared with."""

    json: FlagCreatePairsOff[bool] = False
    """Print the whole report as JSON, for tools."""

    def execute(self) -> int:
        """Prints the report and returns the exit status."""
        if self.robot_address is not None:
            from oimppi_warp.cli.hardware import check_setup, print_checks

            return print_checks(check_setup(self.robot_address, self.pose_address, self.scene), json=self.json)
        if self.ros2:
            from oimppi_warp.cli.ros2 import Ros2Check

            return Ros2Check(self.scene, self.plant_options, self.json).execute()
        from oimppi_warp.system.doctor import diagnose, gather_facts

        facts = gather_facts()
        findings = diagnose(facts)
        if self.json:
            print(json.dumps({"facts": asdict(facts), "findings": [asdict(each) for each in findings]}, indent=2))
            return 1 if findings else 0

        from rich.console import Console

        gpus = [f"{gpu.alias}: {gpu.name}, sm_{gpu.arch}, {gpu.memory / 2**30:.0f} GiB" for gpu in facts.gpus]
        driver = "" if facts.driver is None else f"; the driver supports CUDA {'.'.join(map(str, facts.driver))}"
        rows = {
            "machine": f"{facts.cpu}, {facts.usable_cores} of {facts.cores} cores usable, "
            f"{facts.memory / 2**30:.0f} GiB; {facts.system}",
            "GPUs": ("; ".join(gpus) or "none usable by Warp, and none needed") + driver,
            "packages": f"Python {facts.python}, " + ", ".join(f"{k} {v or '-'}" for k, v in facts.versions.items()),
            "extras": _extras(facts.extras),
            "will use": f"device {facts.device}, {facts.usable_cores} CPU threads; each run times the engines and "
            "selects one that keeps up, unless --engine is given",
            **{
                kind.replace("_", " "): ", ".join(_with_package(entries))
                or f"no additional {kind.replace('_', ' ')} installed"
                for kind, entries in facts.entries.items()
            },
            "compiled kernels": f"{facts.kernel_cache}, {facts.kernel_bytes / 1e6:.0f} MB"
            f"{'' if facts.compiled else ' (`oimppi warmup` compiles all, or each run what it needs)'}",
            "fields, models": f"{facts.field_cache}, {facts.field_bytes / 1e6:.0f} MB",
            "scenes": f"{facts.scenes} shipped",
        }
        print_rows(rows)
        console = Console(highlight=False)
        for finding in findings:
            console.print(f"[bold red]problem[/]  {finding.what}\n         to do: {finding.remedy}", soft_wrap=True)
        if not findings:
            console.print("[bold green]no problems found")
        return 1 if findings else 0


def _extras(extras: dict[str, bool]) -> str:
    """Returns in words which extras are installed."""
    there, missing = ([name for name, found in extras.items() if found is wanted] for wanted in (True, False))
    return f"installed: {', '.join(there) or 'none'}; not installed: {', '.join(missing) or 'none'}"


def _with_package(entries: dict[str, str]) -> Iterator[str]:
    """Yields the name of each registry entry, followed by the installed package that adds it, if one does.

    Args:
        entries: Package by name of the entry; empty for shipped entries.
    """
    for name, package in entries.items():
        yield f"{name} (from {package})" if package else name


def _architecture(name: str) -> int:
    """Returns the number of a GPU architecture, such as 90 for ``sm_90``.

    Raises:
        ConfigError: The name is not that of a GPU architecture from sm_70 to sm_130.
    """
    number = name.removeprefix("sm_")
    if not number.isdecimal() or not 70 <= int(number) <= 130:
        raise ConfigError(f"--arch {name} is not supported\n  allowed: sm_70 to sm_130, such as sm_80, sm_90 or sm_120")
    return int(number)
