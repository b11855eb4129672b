"""The command ``oimppi scene robot``."""

from __future__ import annotations

import math
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import FlagCreatePairsOff, Positional, arg

from oimppi_warp.errors import ConfigError, SceneError

LIFTED = 0.1
"""Height of the tip from which on nothing is said about it: enough to pass over the usual objects [m]."""

if TYPE_CHECKING:
    from rich.console import Console

    from oimppi_warp.authoring.robots.chain import Chain
    from oimppi_warp.scene import Robot


@dataclass(frozen=True)
class AddRobot:
    """Convert a URDF, MJCF or USD file to a robot for scenes.

    The robot must be a serial arm of revolute or prismatic joints; a stick is added as its tool.

    Two files are written: the robot, robots/NAME.usda, and a sample task with a T block on an open table,
    NAME_open.usda. A robot that cannot do the sample task is written without it. Exit status: 0, or 2 for bad input.
    """

    file: Annotated[Positional[Path], arg(metavar="FILE")]
    """URDF file, MJCF file (MuJoCo's XML), or USD file with one articulation.
    The robot's base is placed at the world's origin with z up; the table's top is at z = 0."""

    tool_length: Annotated[float, arg(metavar="M")] = 0.17
    """Length of the stick from the flange to its tip [m]."""

    tool_radius: Annotated[float, arg(metavar="M")] = 0.008
    """Radius of the stick [m]."""

    tool_axis: Literal["x", "y", "z", "-x", "-y", "-z"] = "z"
    """Axis of the flange along which the stick points."""

    flange: Annotated[str, arg(metavar="LINK", help_behavior_hint="(default: the last link)")] = ""
    """Link that carries the stick; in an MJCF file, a body or a site.
    Moving links that are not between base and flange, such as the fingers of a gripper, are left out."""

    name: Annotated[str, arg(metavar="NAME", help_behavior_hint="(default: the file's name)")] = ""
    """Name of the robot, used for the files that are written."""

    out: Annotated[Path, arg(metavar="DIR")] = Path(".")
    """Folder for the sample task; the robot is written to its subfolder robots."""

    force: FlagCreatePairsOff[bool] = False
    """Overwrite an existing robot and sample task of the same name."""

    def execute(self) -> int:
        """Writes the robot and its sample task and returns the exit status."""
        name = self.name or self.file.name.partition(".")[0]
        self._check(name)
        from rich.console import Console

        from oimppi_warp.authoring.robots.chain import short_name
        from oimppi_warp.compute.device import tell_compilation

        tell_compilation(Console(stderr=True, highlight=False).print)
        from oimppi_warp.authoring.robots import arm_usd
        from oimppi_warp.authoring.robots.read import read_arm
        from oimppi_warp.authoring.robots.sample_task import write_sample_task
        from oimppi_warp.authoring.robots.start_pose import with_start

        console = Console(highlight=False, soft_wrap=True)
        with console.status("reading the robot"):
            chain, made = read_arm(
                self.file,
                name="".join(part.capitalize() for part in name.replace("-", "_").split("_")),
                doc=f"{name} with a stick of {self.tool_length:g} m, from {self.file.name}",
                length=self.tool_length,
                radius=self.tool_radius,
                axis=self.tool_axis,
                flange=self.flange,
            )
            made = with_start(made, file=self.file, links=chain.links, joints=chain.joints)
            robot = made.robot()
            with tempfile.TemporaryDirectory() as folder:  # nothing is installed unless the robot is complete
                skin = f"{name}_skin.usdc"
                drawn = arm_usd.write_visuals(made, Path(folder) / "robots" / skin)
                arm_usd.write(made, Path(folder) / "robots" / f"{name}.usda", skin=skin if drawn else "")
                try:
                    scene, no_trial = write_sample_task(robot, name, Path(folder), destination=self.out), ""
                except SceneError as error:
                    if error.prim.startswith("/World/Robot/"):  # not the task, but a part of the robot
                        raise SceneError(
                            error.what, file=self.file, allowed=error.allowed, fix="correct it in the robot's file"
                        ) from None
                    scene, no_trial = None, error.what
                self._install(Path(folder))
        bare = [part for link, part in zip(made.links, chain.links, strict=True) if not link.colliders]
        if bare:
            links = ", ".join(short_name(link) for link in bare)
            console.print(
                f"warning: no collision shapes on {links}: these links are not drawn, and collisions with them are not "
                "detected"
            )
        self._tell(console, robot, chain)
        if scene is None:
            console.print(f"warning: there is no sample task: {no_trial}", markup=False)
            console.print(f"  to do:   write a task: oimppi scene new TASK --robot {name} --out {self.out}")
        else:
            console.print(f"  try it   oimppi run {self.out / scene.name}")
        return 0

    def _tell(self, console: Console, robot: Robot, chain: Chain) -> None:
        """Prints what the robot is, and what it cannot do."""
        from oimppi_warp.authoring.robots.chain import short_name
        from oimppi_warp.geometry.reach import can_lift, can_tilt, highest_tip, reach_of

        name = self.name or self.file.name.partition(".")[0]
        reach = reach_of(robot)
        console.print(f"{self.out / 'robots' / name}.usda: {robot.dof} joints ({robot.chain}), from {self.file.name}")
        console.print(f"  joints   {', '.join(short_name(joint) for joint in chain.joints)}", markup=False)
        console.print(
            f"  stick    {self.tool_length:g} m along {self.tool_axis} of {short_name(chain.flange)}", markup=False
        )
        console.print(f"  reach    {reach.radius:.2f} m from the origin, with the stick upright")
        for note in chain.notes:
            console.print(f"  note     {note}", markup=False)
        highest = highest_tip(robot)
        if not can_lift(robot):
            console.print("  cannot   lift the stick: it goes around objects")
        elif highest < LIFTED:
            console.print(
                f"  cannot   lift the stick above {highest:.2f} m: it goes around objects that are not much lower"
            )
        if can_lift(robot) and not can_tilt(robot):
            console.print(f"  cannot   tilt the stick sideways, with {robot.dof} joints; pushing needs it upright only")

    def _check(self, name: str) -> None:
        """Checks the options, with the name that the robot gets.

        Raises:
            ConfigError: The name is not valid, a length is out of bounds, or a file would be overwritten.
        """
        if not name.replace("-", "_").isidentifier():
            given = f"--name {name}" if self.name else f"{self.file.name}: {name}, from the file's name,"
            valid = "arm_" + "".join(letter if letter.isalnum() or letter in "-_" else "_" for letter in name)
            raise ConfigError(
                f"{given} is not a valid name\n  allowed: letters, digits, - and _, with no digit first\n"
                f"  to do:   --name {valid}"
            )
        for option, value, most in (("length", self.tool_length, 2.0), ("radius", self.tool_radius, 0.1)):
            if not (math.isfinite(value) and 0.0 < value <= most):
                raise ConfigError(
                    f"--tool-{option} {value:g} cannot be used\n  allowed: above 0 and at most {most:g} m"
                )
        if self.tool_length <= 2.0 * self.tool_radius:
            raise ConfigError(
                f"--tool-length {self.tool_length:g}: the stick is shorter than it is thick\n"
                f"  allowed: above {2.0 * self.tool_radius:g} m, twice --tool-radius"
            )
        for file in (self.out / "robots" / f"{name}.usda", self.out / f"{name}_open.usda"):
            if file.exists() and not self.force:
                raise ConfigError(
                    f"{file} already exists\n  to do:   choose another --name, or overwrite it with --force"
                )

    def _install(self, folder: Path) -> None:
        """Copies the files written to a temporary folder to the folder ``--out``."""
        for file in folder.rglob("*.usd*"):
            target = self.out / file.relative_to(folder)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, target)
