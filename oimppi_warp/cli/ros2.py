"""The commands ``oimppi ros2``: a simulated lab on topics, and a check of what is on the topics of a real one."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from tyro.conf import FlagCreatePairsOff, Positional, arg

from oimppi_warp.cli.hardware import print_checks
from oimppi_warp.cli.options import notices
from oimppi_warp.config.ros2_topics import JOINT_STATES
from oimppi_warp.errors import HardwareError
from oimppi_warp.priority import real_time_priority

if TYPE_CHECKING:
    from collections.abc import Sequence

    from oimppi_warp.plants.real.arm import Check
    from oimppi_warp.plants.ros2.link import Link


_DISCOVERY = 1.0
"""Time to look for others [s]."""


@dataclass(frozen=True)
class Ros2Plant:
    """Simulate a lab in real time on ROS 2 topics: an arm that takes joint velocities, and a camera.

    `oimppi run SCENE --plant ros2` moves it, and so does any other planner. Published are /clock, /joint_states, and
    the object's pose as the topic /object_pose and as the frame fp_object_pose in /tf. Commands are taken on
    /velocity_controller/commands_nominal; without them for 0.25 s, the arm stops. Ctrl-C ends it.
    """

    scene: Annotated[Positional[str], arg(metavar="[SCENE]")] = "lab01"
    """A USD file, or the name of a shipped scene (`oimppi scenes` lists them)."""

    start: Annotated[str | None, arg(metavar="I|X,Y,YAW", help_behavior_hint="(default: drawn with --seed)")] = None
    """Start pose of the object in metres and radians, or the index I (from 0) of a start listed in the scene."""

    seed: Annotated[int, arg(metavar="N")] = 0
    """Seed of the start pose and of the camera's errors."""

    domain: Annotated[int, arg(metavar="N", help_behavior_hint="(default: ROS_DOMAIN_ID, or 0)")] = -1
    """ROS domain."""

    peers: Annotated[str, arg(metavar="ADDRESS,…", help_behavior_hint="(default: multicast)")] = ""
    """Addresses of the machines to talk to, where multicast does not work; 127.0.0.1 is this machine."""

    def execute(self) -> int:
        """Runs the simulation until Ctrl-C and returns the exit status."""
        from oimppi_warp.config.presets import lab
        from oimppi_warp.runtime.request import parse_start, prepare_scene

        start = parse_start(self.start)
        console = notices()
        with console.status("making the simulation"):
            from oimppi_warp.plants.ros2.lab import Ros2Lab
            from oimppi_warp.plants.ros2.link import connect

            scene = prepare_scene(self.scene, start=start, goal=None, seed=self.seed)
            with real_time_priority():  # for the threads of the connection
                link = connect(domain=self.domain, peers=self.peers)
            _refuse_company(link)
            simulated = Ros2Lab(scene, lab().lab, link, seed=self.seed)
        simulated.start()
        options = (f"domain={self.domain}" if self.domain != -1 else "", f"peers={self.peers}" if self.peers else "")
        given = " ".join(option for option in options if option)
        print(f"A simulated lab is on {link.name}; Ctrl-C ends it.")
        print(
            f"In another terminal: oimppi run {self.scene} --plant ros2{f' --plant-options {given}' if given else ''}",
            flush=True,
        )
        try:
            with suppress(KeyboardInterrupt):
                while simulated.running:
                    time.sleep(0.2)
        finally:
            simulated.close()
        forces = simulated.forces
        print(
            f"The largest forces were {forces.tool_object:.1f} N between tool and object, "
            f"{forces.object_obstacle:.1f} N between object and obstacles, "
            f"{forces.robot_obstacle:.1f} N between arm and obstacles or table. "
            f"The simulation was at most {1e3 * simulated.late:.0f} ms late; the arm got "
            f"{simulated.taken} commands, {simulated.refused} refused, {simulated.expired} expired."
        )
        return 0


@dataclass(frozen=True)
class Ros2Check:
    """Check an arm and the object's pose on ROS 2, item by item; nothing moves.

    Exit status: 0 no problems found, 1 problems found.
    """

    scene: Annotated[Positional[str], arg(metavar="[SCENE]")] = "lab01"
    """Scene whose robot the arm is compared with."""

    plant_options: Annotated[tuple[str, ...], arg(metavar="NAME=VALUE", help_behavior_hint="(repeatable)")] = ()
    """Options of the plant ros2, such as domain=3 object=/object_pose; docs/ros2.md lists them."""

    json: FlagCreatePairsOff[bool] = False
    """Print the checks as JSON, for tools."""

    def execute(self) -> int:
        """Prints the checks and returns the exit status."""
        return print_checks(check_topics(self.plant_options, self.scene), json=self.json)


def _refuse_company(link: Link) -> None:
    """Refuses to simulate where an arm is already.

    Raises:
        HardwareError: Somebody publishes joint states.
    """
    time.sleep(_DISCOVERY)
    if any(end.publishes for end in link.endpoints(JOINT_STATES)):
        link.close()
        raise HardwareError(
            f"somebody publishes {JOINT_STATES} in {link.name} already\n  to do:   use another domain (--domain N)"
        )


def check_topics(assignments: Sequence[str], scene: str) -> list[Check]:
    """Checks an arm and the object's pose on ROS 2, item by item; nothing moves.

    Args:
        assignments: Options of the plant ``ros2``, ``NAME=VALUE``.
        scene: Name or file of a scene with the same robot.

    Raises:
        ConfigError: An option cannot be used, or no package for ROS 2 is installed.
        SceneError: The scene cannot be read.
    """
    from oimppi_warp.plants.factory import plant_options
    from oimppi_warp.plants.real.arm import Check, check_priority
    from oimppi_warp.plants.ros2.link import connect
    from oimppi_warp.plants.ros2.plant import Ros2Plant, Setup
    from oimppi_warp.usd import load_scene

    task = load_scene(scene)
    given = plant_options(Ros2Plant, "ros2", assignments)
    link = connect(domain=given.pop("domain", -1), peers=given.pop("peers", ""), through=given.pop("through", "auto"))
    setup = Setup(**{name: value for name, value in given.items() if name in vars(Setup())})
    try:
        arm, poses, _ = setup.find(link, task)
    except HardwareError as error:
        link.close()
        what, _, remedy = str(error).partition("\n  to do:   ")
        return [Check(what, False, remedy)]
    except BaseException:
        link.close()
        raise
    try:
        found = [Check(f"connected to {link.name}; topics there: {', '.join(link.topics())}", True)]
        found += [check_priority(), *arm.check(task.robot)]
        until = time.monotonic() + 4.0
        while not poses.poses and time.monotonic() < until:
            time.sleep(0.05)
        if seen := poses.poses:
            x, y, yaw = seen[-1].pose
            found.append(
                Check(
                    f"object at {x:.3f} m, {y:.3f} m, {yaw:.2f} rad, {seen[-1].age:.2f} s old",
                    -0.2 <= seen[-1].age <= 2.5,
                    "synchronise the clocks of camera and planner (NTP)",
                )
            )
        else:
            what, _, remedy = poses.problem.partition("\n  to do:   ")
            found.append(Check(what, False, remedy))
    finally:
        arm.disconnect()
    return found
