"""The plant ``ros2``: an arm moved through ROS 2 topics, with the object's pose from a topic or a TF frame."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from oimppi_warp.config import ros2_topics
from oimppi_warp.config.settings import Config
from oimppi_warp.errors import ConfigError, HardwareError
from oimppi_warp.observation import planar_pose
from oimppi_warp.perception.pose_source import PoseSource
from oimppi_warp.plants.real.plant import ArmOptions, ArmPlant, ticks_of
from oimppi_warp.plants.ros2.arm import Ros2Arm
from oimppi_warp.plants.ros2.link import Link, connect, why_no_messages
from oimppi_warp.plants.ros2.messages import CLOCK, NUMBERS, seconds
from oimppi_warp.plants.ros2.poses import Ros2Poses
from oimppi_warp.plants.ros2.tf import planar
from oimppi_warp.priority import real_time_priority
from oimppi_warp.scene import Obstacle, PlanarPose, Scene

_STEADY = 0.01
"""Difference of two poses of an obstacle that stands still [m, rad]."""
_FRAMES = 5.0
"""Time to wait for /clock, and for the frames of obstacles [s]."""


class Ros2Plant(ArmPlant):
    """An arm at a scene's table that speaks ROS 2.

    Args:
        scene: The task.
        config: All settings.
        seed: Not used.
        domain: Number of the ROS domain; -1: that of the environment variable ``ROS_DOMAIN_ID``, or 0.
        peers: Addresses of other machines, with commas, where multicast does not reach them.
        through: ``rclpy``, ``dds`` or ``auto``: rclpy where it can be imported.
        joint_states, joint_names, object, object_type, object_class, world, commands, command_type, obstacles,
            use_sim_time: See :class:`Setup`.
        speed, yes, dry_run, resume, pose_timeout: See :class:`oimppi_warp.plants.real.plant.ArmOptions`.
        poses: Source of the object's poses in this process, such as a camera, instead of a topic or frame.

    Raises:
        ConfigError: An option cannot be used, or no package for ROS 2 is installed.
        HardwareError: The arm or the object cannot be used, or the arm was not allowed to move.
    """

    def __init__(
        self,
        scene: Scene,
        config: Config,
        *,
        seed: int = 0,
        domain: int = -1,
        peers: str = "",
        through: str = "auto",
        joint_states: str = ros2_topics.JOINT_STATES,
        joint_names: str = "",
        object: str = ros2_topics.OBJECT_FRAME,
        object_type: str = "",
        object_class: str = "",
        world: str = ros2_topics.WORLD_FRAME,
        commands: str = ros2_topics.NOMINAL_COMMANDS,
        command_type: str = NUMBERS,
        obstacles: str = "",
        use_sim_time: bool = False,
        speed: float = 0.0,
        yes: bool = False,
        dry_run: bool = False,
        resume: bool = False,
        pose_timeout: float = 2.5,
        poses: PoseSource | None = None,
    ) -> None:
        options = ArmOptions(speed=speed, yes=yes, dry_run=dry_run, resume=resume, pose_timeout=pose_timeout)
        ticks_of(config)
        setup = Setup(
            joint_states=joint_states,
            joint_names=joint_names,
            object=object,
            object_type=object_type,
            object_class=object_class,
            world=world,
            commands=commands,
            command_type=command_type,
            obstacles=obstacles,
            use_sim_time=use_sim_time,
        )
        with real_time_priority():  # for the threads of the connection
            link = connect(domain=domain, peers=peers, through=through)
        try:
            arm, received, moves = setup.find(link, scene)
        except BaseException:
            link.close()
            if poses is not None:
                poses.close()
            raise
        super().__init__(scene, config, arm, poses or received, options, moves=moves)


@dataclass(frozen=True)
class Setup:
    """Names of topics and frames, and types; by default those of the paper's laboratory.

    Attributes:
        joint_states: Topic of the joint states.
        joint_names: Names of the joints, in the scene's order, with commas; empty: those in the scene.
        object: Topic of the object's pose, with a slash in front, or TF frame of the object.
        object_type: Type of that topic; empty: as it is published.
        object_class: Class of the object among several detections, by ``class_id`` or ``id``; empty: any.
        world: TF frame of the scene, whose origin is the robot's base.
        commands: Topic of the commands.
        command_type: Type of the commands: ``std_msgs/msg/Float64MultiArray``, ``control_msgs/msg/JointJog`` or
            ``trajectory_msgs/msg/JointTrajectory``.
        obstacles: TF frames at the centres of obstacles, as ``NAME=FRAME`` with commas: they are where these frames
            are when the run begins, wherever the scene has them.
        use_sim_time: Whether stamps are those of the topic ``/clock``.
    """

    joint_states: str = ros2_topics.JOINT_STATES
    joint_names: str = ""
    object: str = ros2_topics.OBJECT_FRAME
    object_type: str = ""
    object_class: str = ""
    world: str = ros2_topics.WORLD_FRAME
    commands: str = ros2_topics.NOMINAL_COMMANDS
    command_type: str = NUMBERS
    obstacles: str = ""
    use_sim_time: bool = False

    def find(self, link: Link, scene: Scene) -> tuple[Ros2Arm, Ros2Poses, dict[str, PlanarPose]]:
        """Finds arm, object and obstacles.

        Args:
            link: The connection; the arm ends it.
            scene: The task.

        Returns:
            The arm, the source of the object's pose, and by how much obstacles are away from where the scene has them,
            by their paths.

        Raises:
            ConfigError: A name or a type cannot be used.
            HardwareError: No joint states arrive, they are of other joints, or a frame is missing.
        """
        names, frames = _joint_names(self.joint_names, scene), _obstacle_frames(self.obstacles, scene)
        states, commands = (f"/{topic.lstrip('/')}" for topic in (self.joint_states, self.commands))
        clock = _Clock(link, simulated=self.use_sim_time)
        clock.wait()
        poses = Ros2Poses(
            link,
            self.object,
            kind=self.object_type,
            wanted=self.object_class,
            world=self.world,
            height=scene.object.rest_height,
            clock=clock.now,
        )
        arm = Ros2Arm(
            link,
            names,
            states=states,
            commands=commands,
            command_type=self.command_type,
            clock=clock.now,
        )
        return arm, poses, _moves(scene, frames, poses, self.world)


class _Clock:
    """The time of the stamps: that of this machine, or that of the topic /clock.

    Args:
        link: The connection.
        simulated: Whether it is that of /clock.
    """

    def __init__(self, link: Link, *, simulated: bool) -> None:
        self._link, self._simulated = link, simulated
        self._latest: tuple[float, float] | None = None
        if simulated:
            link.subscribe(ros2_topics.CLOCK, CLOCK, self._take)

    def wait(self) -> None:
        """Waits for the first message.

        Raises:
            HardwareError: None arrives.
        """
        until = time.monotonic() + _FRAMES
        while self._simulated and self._latest is None:
            if time.monotonic() > until:
                raise HardwareError(why_no_messages(self._link, ros2_topics.CLOCK, CLOCK))
            time.sleep(0.01)

    def now(self) -> float:
        """Returns the present time of the stamps [s]."""
        if self._latest is None:
            return time.time()
        stamp, arrived = self._latest
        return stamp + time.monotonic() - arrived

    def _take(self, message: Any) -> None:
        self._latest = seconds(message.clock), time.monotonic()


def _joint_names(text: str, scene: Scene) -> list[str]:
    """Returns the names of the joints.

    Raises:
        ConfigError: There are too few or too many.
    """
    dof, own = scene.robot.dof, [joint.name for joint in scene.robot.joints]
    names = [name.strip() for name in text.split(",") if name.strip()] or own
    if len(names) != dof:
        raise ConfigError(
            f"joint_names has {len(names)} names\n  allowed: {dof}, one for each joint of the scene's robot"
        )
    return names


def _obstacle_frames(text: str, scene: Scene) -> dict[str, str]:
    """Returns the TF frames of obstacles, by the obstacle's name.

    Raises:
        ConfigError: The text cannot be read, or the scene has no such obstacle.
    """
    known = [_name(obstacle) for obstacle in scene.obstacles]
    found: dict[str, str] = {}
    for each in filter(None, text.split(",")):
        name, equals, frame = (part.strip() for part in each.partition("="))
        if not equals or not frame or name not in known:
            raise ConfigError(
                f"obstacles={text}: {each} is no obstacle and frame\n"
                f"  allowed: NAME=FRAME with commas; the scene has {', '.join(known) or 'no obstacles'}"
            )
        found[name] = frame
    return found


def _moves(scene: Scene, frames: dict[str, str], poses: Ros2Poses, world: str) -> dict[str, PlanarPose]:
    """Returns by how much obstacles are away from where the scene has them, by their paths; see ``Obstacle.moved``.

    Raises:
        HardwareError: A frame is missing.
    """
    moves: dict[str, PlanarPose] = {}
    for name, frame in frames.items():
        obstacle = next(each for each in scene.obstacles if _name(each) == name)
        found = _steady(poses, world, frame)
        if found is None:
            known = ", ".join(poses.tree.frames()) or "none"
            raise HardwareError(
                f"the frame {frame} of the obstacle {name} is not connected with {world}, or does not stand still\n"
                f"  to do:   publish it, or name another one; there are {known}"
            )
        x, y, yaw = found
        at, was = obstacle.center, planar_pose(obstacle.colliders[0].transform)[2]
        moves[obstacle.path] = (float(x - at[0]), float(y - at[1]), math.remainder(yaw - was, math.tau))
    return moves


def _steady(poses: Ros2Poses, world: str, frame: str) -> np.ndarray | None:
    """Returns the planar pose of a frame that was twice in the same place, shape [3] [m, m, rad], or ``None``."""
    until, before = time.monotonic() + _FRAMES, None
    while time.monotonic() < until:
        found = poses.tree.lookup(world, frame)
        if found is not None:
            seen = planar(found[0])
            if before is not None and np.abs(seen - before[0]).max() < _STEADY:
                if found[1] == math.inf or found[1] > before[1]:
                    return seen
            elif before is None or found[1] > before[1]:
                before = seen, found[1]
        time.sleep(0.02)
    return None


def _name(obstacle: Obstacle) -> str:
    """Returns the last part of an obstacle's path."""
    return obstacle.path.rpartition("/")[2]
