"""The command ``oimppi import-bag``."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from oimppi_warp.cli.printing import print_rows
from oimppi_warp.config import ros2_topics as names
from oimppi_warp.errors import ConfigError

if TYPE_CHECKING:
    from oimppi_warp.record.import_bag import ImportedBag


@dataclass(frozen=True)
class ImportBag:
    """Make a record of a bag from a laboratory, to replay it, plot it and compute its metrics.

    No ROS is needed. Exit status: 0, or 2 for bad input; a message then names what the bag contains.
    """

    bag: Annotated[Positional[Path], arg(metavar="BAG")]
    """Bag to read: a rosbag2 folder, an MCAP or SQLite file, or a bag of ROS 1."""

    scene: Annotated[str, arg(metavar="SCENE")]
    """The task: a USD file, or the name of a shipped scene (`oimppi scenes` lists them)."""

    joint_states: Annotated[
        str | None, arg(metavar="TOPIC", help_behavior_hint=f"(default: {names.JOINT_STATES}, or the only one)")
    ] = None
    """Topic of the joint states (sensor_msgs/JointState)."""

    joint_names: Annotated[str | None, arg(metavar="NAME,...", help_behavior_hint="(default: the scene's)")] = None
    """Names in the bag of the arm's joints, in their order from the base."""

    object: Annotated[
        str | None,
        arg(metavar="TOPIC|FRAME", help_behavior_hint=f"(default: {names.OBJECT_POSE}, or {names.OBJECT_FRAME})"),
    ] = None
    """Object's pose: a topic of PoseStamped, PoseWithCovarianceStamped, Odometry, Detection3D or Detection3DArray, or a
    frame."""

    commands: Annotated[
        str | None, arg(metavar="TOPIC", help_behavior_hint=f"(default: {names.FILTERED_COMMANDS}, if recorded)")
    ] = None
    """Topic of the commanded joint velocities: Float64MultiArray, JointState or JointTrajectory."""

    world_frame: Annotated[str, arg(metavar="FRAME")] = names.WORLD_FRAME
    """Frame in the bag that is the scene's world."""

    goal: Annotated[str | None, arg(metavar="X,Y,YAW", help_behavior_hint="(default: the scene's)")] = None
    """Goal pose of the object, as X,Y,YAW in metres and radians."""

    control_period: Annotated[float, arg(metavar="S")] = 0.05
    """Duration of a control step of the record in seconds."""

    longest_gap: Annotated[float, arg(metavar="S")] = 0.5
    """Longest time without a joint state that is accepted, in seconds."""

    output: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: beside the bag)")] = None
    """Folder of the record to write."""

    def execute(self) -> int:
        """Writes the record and returns the exit status."""
        from oimppi_warp.cli.options import notices
        from oimppi_warp.runtime.request import parse_pose

        goal = None if self.goal is None else parse_pose("--goal", self.goal)
        for option, value in (("--control-period", self.control_period), ("--longest-gap", self.longest_gap)):
            if not 0.001 <= value <= 1000.0:
                raise ConfigError(f"{option} {value:g} cannot be used\n  allowed: 0.001 to 1000 s")
        folder = self._folder()
        console = notices()
        from oimppi_warp.record.import_bag import TILTED, BagSources, import_bag
        from oimppi_warp.record.metrics import summarize
        from oimppi_warp.usd import load_scene

        with console.status("reading the scene"):
            scene = load_scene(self.scene)
        scene = scene if goal is None else scene.with_goal(goal)
        sources = BagSources(
            joint_states=self.joint_states,
            joint_names=tuple(self.joint_names.split(",")) if self.joint_names else (),
            object=self.object,
            commands=self.commands,
            world_frame=self.world_frame,
            control_period=self.control_period,
            longest_gap=self.longest_gap,
        )
        with console.status("reading the bag"):
            imported = import_bag(self.bag, scene, sources)
        if imported.tilt > TILTED:
            console.print(
                f"the object is tilted by up to {math.degrees(imported.tilt):.0f} degrees in the bag; "
                "the record has only its yaw",
                soft_wrap=True,
            )
        imported.log.save(folder)
        with console.status("drawing plots"):
            from oimppi_warp.plots.episode import draw

            x, y, yaw = imported.log.header["start"]
            draw(imported.log, scene.with_start((x, y, yaw)), folder)
        metrics = summarize(imported.log)
        result = "goal reached" if metrics.success else "goal not reached"
        _print_summary(
            imported,
            {
                "result": f"{result}; {metrics.position_error_m:.3f} m, {metrics.yaw_error_rad:.3f} rad at the end",
                "record": f"{folder}: {metrics.steps} control steps of {self.control_period:g} s",
            },
        )
        return 0

    def _folder(self) -> Path:
        """Returns the folder to write.

        Raises:
            ConfigError: It cannot be written to.
        """
        folder = self.bag.absolute().with_name(f"{self.bag.stem}-record") if self.output is None else self.output
        parent = next(place for place in (folder.absolute(), *folder.absolute().parents) if place.exists())
        if not parent.is_dir() or not os.access(parent, os.W_OK):
            raise ConfigError(f"--output {folder}: {parent} is not a writable folder\n  to do:   choose another path")
        return folder


def _print_summary(imported: ImportedBag, rows: dict[str, str]) -> None:
    """Prints what was read from the bag, and more rows."""
    from rich.markup import escape

    end = imported.tracks["joint states"].times[-1]
    found = {}
    for role, track in imported.tracks.items():
        first = track.times[0]
        gap, _ = track.longest_gap(first, max(first, end))
        found[role] = (
            f"{escape(track.source)}: {len(track.times)} messages from {first:.2f} s on, "
            f"at most {gap:.3f} s without one"
        )
    print_rows(found | rows)
