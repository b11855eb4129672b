"""The command ``oimppi lab-emulator``, and the part of ``oimppi doctor`` that checks an arm."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from oimppi_warp.cli.options import notices
from oimppi_warp.errors import ConfigError, HardwareError
from oimppi_warp.priority import real_time_priority

if TYPE_CHECKING:
    from collections.abc import Sequence

    from oimppi_warp.plants.real.arm import Check


@dataclass(frozen=True)
class LabEmulator:
    """Emulate a lab on this machine: an xArm's controller, the arm and the object in simulation, and a camera.

    Move it with `oimppi run SCENE --plant xarm --robot-address 127.0.0.2`, or with any program that uses the vendor's
    SDK over TCP (forbid_uds). The object's pose is served as in a real lab (docs/hardware.md). Ctrl-C ends it.
    """

    scene: Annotated[Positional[str], arg(metavar="[SCENE]")] = "lab01"
    """A USD file, or the name of a shipped scene (`oimppi scenes` lists them)."""

    start: Annotated[str | None, arg(metavar="I|X,Y,YAW", help_behavior_hint="(default: drawn with --seed)")] = None
    """Start pose of the object in metres and radians, or the index I (from 0) of a start listed in the scene."""

    seed: Annotated[int, arg(metavar="N")] = 0
    """Seed of the start pose and of the camera's errors."""

    host: Annotated[str, arg(metavar="ADDRESS")] = "127.0.0.2"
    """Address to listen on; any address 127.x.x.x is this machine."""

    port: Annotated[int, arg(metavar="N")] = 502
    """Port of the controller's commands; one below 1024 may need root. Its reports are on ports 30001 to 30003."""

    pose_port: Annotated[int, arg(metavar="N")] = 17501
    """Port of the object's pose."""

    def execute(self) -> int:
        """Runs the emulation until Ctrl-C and returns the exit status."""
        from oimppi_warp.config.presets import lab
        from oimppi_warp.runtime.request import parse_start, prepare_scene

        for option, port in (("--port", self.port), ("--pose-port", self.pose_port)):
            if not 1 <= port <= 65535:
                raise ConfigError(f"{option} {port} cannot be used\n  allowed: 1 to 65535")
        start = parse_start(self.start)
        console = notices()
        with console.status("making the simulation"):
            from oimppi_warp.plants.xarm.emulator import LabEmulator as Lab
            from oimppi_warp.plants.xarm.protocol import COMMAND_PORT

            scene = prepare_scene(self.scene, start=start, goal=None, seed=self.seed)
            with real_time_priority():  # for its servers
                emulated = Lab(
                    scene,
                    lab().lab,
                    seed=self.seed,
                    host=self.host,
                    command_port=self.port,
                    pose_port=self.pose_port,
                )
        address = self.host if self.port == COMMAND_PORT else f"{self.host}:{self.port}"
        emulated.start()
        print(f"An emulated xArm listens at {address}, the camera at {self.host}:{self.pose_port}; Ctrl-C ends both.")
        print(f"In another terminal: oimppi run {self.scene} --plant xarm --robot-address {address}", flush=True)
        try:
            with suppress(KeyboardInterrupt):
                while emulated.running:
                    time.sleep(0.2)
        finally:
            emulated.close()
        forces, controller = emulated.forces, emulated.controller
        print(
            f"The largest forces were {forces.tool_object:.1f} N between tool and object, "
            f"{forces.object_obstacle:.1f} N between object and obstacles, "
            f"{forces.robot_obstacle:.1f} N between arm and obstacles or table. "
            f"The simulation was at most {1e3 * emulated.late:.0f} ms late; the controller got "
            f"{controller.moves} commands, {controller.refused} refused, {controller.expired} expired."
        )
        return 0


def print_checks(checks: Sequence[Check], *, json: bool) -> int:
    """Prints checks, item by item, and returns the exit status: 1 if something that is needed is missing.

    Args:
        checks: The checks.
        json: Whether to print them as JSON.
    """
    if json:
        import json as text

        print(text.dumps([asdict(check) for check in checks], indent=2))
    else:
        from rich.console import Console

        console = Console(highlight=False)
        for check in checks:
            if check.good:
                console.print(f"[green]good[/]     {check.what}", soft_wrap=True)
                continue
            mark = "[bold red]problem[/]" if check.needed else "[yellow]advice[/] "
            console.print(f"{mark}  {check.what}\n         to do: {check.remedy}", soft_wrap=True)
    return 0 if all(check.good or not check.needed for check in checks) else 1


def check_setup(address: str, poses: str | None, scene: str) -> list[Check]:
    """Checks an arm and the camera that detects the object, item by item; nothing moves.

    Args:
        address: Address of the controller.
        poses: Address of the object's poses; ``None``: that of the controller.
        scene: Name or file of a scene with the same robot.

    Raises:
        ConfigError: The SDK is not installed, or an address cannot be read.
        SceneError: The scene cannot be read.
    """
    from oimppi_warp.network import split_address
    from oimppi_warp.perception.pose_feed import PORT, PoseReceiver
    from oimppi_warp.plants.real.arm import Check, check_priority
    from oimppi_warp.plants.xarm.arm import XArm
    from oimppi_warp.plants.xarm.protocol import COMMAND_PORT
    from oimppi_warp.usd import load_scene

    robot = load_scene(scene).robot
    found = [check_priority()]
    try:
        arm = XArm(address)
        try:
            found += [Check(f"controller at {address}", True), *arm.check(robot)]
        finally:
            arm.disconnect()
    except HardwareError as error:
        what, _, remedy = str(error).partition("\n  to do:   ")
        found.append(Check(what, False, remedy))
    receiver = PoseReceiver(poses or f"{split_address(address, COMMAND_PORT)[0]}:{PORT}")
    until = time.monotonic() + 4.0
    while receiver.latest is None and time.monotonic() < until:
        time.sleep(0.05)
    receiver.close()
    seen = receiver.latest
    if seen is None:
        found.append(Check(receiver.problem, False, "start what detects the object (docs/hardware.md)"))
    else:
        right = -0.2 <= seen.age <= 2.5
        found.append(
            Check(
                f"object at {seen.pose[0]:.3f} m, {seen.pose[1]:.3f} m, {seen.pose[2]:.2f} rad, {seen.age:.2f} s old",
                right,
                "synchronise the clocks of camera and planner (NTP)",
            )
        )
    return found
