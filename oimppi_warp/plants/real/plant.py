"""The plant of a real arm that takes joint velocities, with the object's pose from elsewhere.

Three things stop the arm when something is wrong, each by itself. The arm does when no command has arrived for a while,
if it has a watchdog (:attr:`oimppi_warp.plants.real.arm.Arm.expires`); the thread that sends the commands does at the
first fault that it sees (:attr:`ArmPlant.fault`); and the control loop does for what only it knows
(:class:`oimppi_warp.runtime.watch.Watch`).
"""

from __future__ import annotations

import atexit
import sys
import threading
import time
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace

import numpy as np

from oimppi_warp.config.settings import Config
from oimppi_warp.errors import ConfigError, HardwareError
from oimppi_warp.observation import Observation, planar_transform
from oimppi_warp.perception.pose_source import PoseSource
from oimppi_warp.plants.plant import StopRules, checked_stream
from oimppi_warp.plants.real.arm import OLDEST, Arm
from oimppi_warp.plants.real.commands import LATENCY, TICK, Commands
from oimppi_warp.plants.real.known import allowed_speed, remember
from oimppi_warp.plants.real.sight import Sight
from oimppi_warp.plants.real.start import FIRST_POSE, StartProcedure
from oimppi_warp.priority import SENDER, real_time_priority, without_pauses
from oimppi_warp.scene import PlanarPose, Scene
from oimppi_warp.signals import uninterrupted

_SLOWEST_TOUCH = 1e-3
"""Least value of the setting `robot.touch_speed` [m/s]."""
_FIRST_RUN = 100
"""Control periods after which a run without a fault counts as one with this arm."""


@dataclass(frozen=True)
class ArmOptions:
    """Options of every real arm.

    Attributes:
        speed: Share of the usual speed, 0.01 to 1; 0 for 1, or :data:`oimppi_warp.plants.real.known.FIRST_SPEED` with
            an arm that is new.
        yes: Whether the arm moves to its start posture without asking.
        dry_run: Whether everything is done but moving.
        resume: See :class:`oimppi_warp.plants.plant.StopRules`.
        pose_timeout: Likewise [s].

    Raises:
        ConfigError: A value is not allowed.
    """

    speed: float = 0.0
    yes: bool = False
    dry_run: bool = False
    resume: bool = False
    pose_timeout: float = 2.5

    def __post_init__(self) -> None:
        if not 0.01 <= self.speed <= 1.0 and self.speed != 0.0:
            raise ConfigError(f"--speed {self.speed:g} cannot be used\n  allowed: 0.01 to 1")
        if not 0.1 <= self.pose_timeout <= 60.0:
            raise ConfigError(f"--pose-timeout {self.pose_timeout:g} cannot be used\n  allowed: 0.1 to 60 s")


def ticks_of(config: Config) -> int:
    """Returns the number of commands per control period.

    Raises:
        ConfigError: The control period is no multiple of :data:`oimppi_warp.plants.real.commands.TICK`.
    """
    ticks = round(config.control_period / TICK)
    if abs(ticks * TICK - config.control_period) > 1e-9:
        raise ConfigError(
            f"control_period = {config.control_period:g}: commands are sent every {TICK:g} s\n"
            "  allowed: a multiple of this interval"
        )
    return ticks


class ArmPlant:
    """A real arm at a scene's table, and the object's pose from a camera.

    Making it checks the arm and, after a confirmation, moves it to the scene's start posture. It runs in real time
    only. Commands are sent from a thread, one per :data:`oimppi_warp.plants.real.commands.TICK`.

    Args:
        scene: The task.
        config: All settings.
        arm: The connection to the arm; the plant ends it.
        poses: The source of the object's pose; the plant ends it.
        options: Options.
        moves: By how much obstacles are away from where the scene has them, by their paths
            (:meth:`oimppi_warp.scene.Obstacle.moved`).

    Raises:
        ConfigError: The control period cannot be used.
        HardwareError: The arm or the camera cannot be used, or the arm was not allowed to move.

    Attributes:
        control_period: Control period [s].
        ticks: Number of commands per control period.
        latency: Time from a command to its effect [s].
        rules: Rules for stopping and going on.
        speed: Share of the usual speed.
        arm: The connection to the arm.
        sight: What is known of the object's pose.
    """

    latency = LATENCY
    own_world = True
    rules = StopRules()

    def __init__(
        self,
        scene: Scene,
        config: Config,
        arm: Arm,
        poses: PoseSource,
        options: ArmOptions,
        *,
        moves: Mapping[str, PlanarPose] | None = None,
    ) -> None:
        self.control_period, self.ticks = config.control_period, ticks_of(config)
        self.rules = StopRules(pose_timeout=options.pose_timeout, resume=options.resume)
        self._moves = dict(moves or {})
        self._scene, self._dof, self._dry_run = self.surveyed(scene), scene.robot.dof, options.dry_run
        joints = scene.robot.joints
        self._limits = np.array([(joint.lower, joint.upper, joint.velocity_limit) for joint in joints]).T
        self._origin = time.monotonic()
        self._fault, self._fault_passes = "", False
        self._streamed = 0
        self._since = 0.0
        self._open = True
        self.arm, self.sight = arm, Sight(poses, timeout=options.pose_timeout)
        self.speed = allowed_speed(arm, options.speed)
        self._commands = Commands(arm, period=self.control_period, speed=self.speed)
        self._sender = threading.Thread(target=self._send_all, name="oimppi-arm", daemon=True)
        self._calm = ExitStack()
        atexit.register(self.close)
        try:
            self._calm.enter_context(without_pauses())
            with real_time_priority():  # for this thread and the one that sends
                self.check()
                if options.dry_run:
                    self._sender.start()
                else:
                    StartProcedure(self, self._scene).run(confirmed=options.yes)
            if self.sight.agreed(oldest=options.pose_timeout, wait=FIRST_POSE) is None:
                raise self.sight.error()
        except BaseException:
            self.close()
            raise

    def limited(self, config: Config) -> Config:
        """Returns settings with which plans keep to the speed that was asked for, and as much more time.

        Raises:
            ConfigError: The safety filter is off.
        """
        if not config.safety.filter:
            raise ConfigError(
                f"safety.filter = false (preset {config.preset}): a real arm is moved with the filter only\n"
                "  to do:   --set safety.filter=true, or --preset lab"
            )
        s = self.speed
        robot, level, episode, move = config.robot, config.object, config.episode, config.reposition
        return replace(
            config,
            robot=replace(
                robot,
                tip_speed_limit=s * robot.tip_speed_limit,
                joint_velocity_limit=s * robot.joint_velocity_limit,
                tip_noise=s * robot.tip_noise,
                touch_speed=max(s * robot.touch_speed, _SLOWEST_TOUCH),
            ),
            object=replace(level, speed_limit=tuple(s * v for v in level.speed_limit)),
            episode=replace(episode, max_sim_seconds=episode.max_sim_seconds / s),
            reposition=replace(move, stall_seconds=move.stall_seconds / s, longest_seconds=move.longest_seconds / s),
        )

    def surveyed(self, scene: Scene) -> Scene:
        """Returns a task with the obstacles where they were found when the plant was made."""
        for path, by in self._moves.items():
            scene = scene.with_obstacle_moved(path, by)
        return scene

    @property
    def now(self) -> float:
        """Returns the present time, on the clock of the observations [s]."""
        return time.monotonic() - self._origin

    def joints(self) -> np.ndarray:
        """Returns the newest joint positions, shape [dof] [rad]."""
        return self.arm.reports.latest()[1][: self._dof]

    def observe(self) -> Observation:
        """Returns the newest joint report, those since the last call, and the newest pose of the object."""
        reports = self.arm.reports.since(self._since)
        if not reports:
            reports = [self.arm.reports.latest()]
        self._since = reports[-1][0]
        trail = np.array([[at - self._origin, *joints[: self._dof]] for at, joints in reports])
        velocity = np.zeros(self._dof)
        if len(trail) > 1 and trail[-1, 0] > trail[0, 0]:
            velocity = (trail[-1, 1:] - trail[0, 1:]) / (trail[-1, 0] - trail[0, 0])
        seen = self.sight.latest
        pose, taken = (np.full(3, np.nan), np.nan) if seen is None else (seen.pose, seen.taken - self._origin)
        x, y, yaw = pose
        return Observation(
            time=float(trail[-1, 0]),
            joint_position=trail[-1, 1:],
            joint_velocity=velocity,
            object_pose=pose,
            object_transform=planar_transform((x, y, yaw), self._scene.object.rest_height),
            object_time=float(taken),
            trail=trail,
        )

    def apply(self, joint_velocity: np.ndarray) -> None:
        """Moves with joint velocities, shape [dof] [rad/s], for one control period."""
        self.stream(np.tile(np.asarray(joint_velocity, dtype=float), (self.ticks, 1)))

    def stream(self, joint_velocities: np.ndarray) -> None:
        """Moves for one control period with joint velocities, shape [ticks, dof] [rad/s]; returns at once.

        Raises:
            ValueError: A velocity is not finite, or their number is wrong.
        """
        commands = checked_stream(joint_velocities, self.ticks)
        self._streamed += 1
        self._commands.put(commands)

    @property
    def fault(self) -> str:
        """Returns why the arm must not move, in words, with what to do; empty if it may."""
        # The thread may be waiting for an arm that does not answer.
        return self._fault or self._lost()

    @property
    def fault_passes(self) -> bool:
        """Returns whether the present fault may pass by itself: joint reports that come again."""
        return not self._fault or self._fault_passes

    @property
    def blind(self) -> str:
        """Returns why the object's pose is not known, as far as its source tells; empty if it is."""
        return self.sight.problem

    def enable(self) -> None:
        """Gets the arm ready to move, and begins to send.

        Raises:
            HardwareError: The arm has a fault that only a person can clear, or refuses.
        """
        self.arm.enable()
        if not self._sender.is_alive():
            self._sender.start()

    def recover(self) -> None:
        """Gets ready to move again after a fault; an error of the controller is never cleared.

        Raises:
            HardwareError: The controller has an error, or the connection is lost.
        """
        if not self._dry_run:
            self.arm.enable()
        self._commands.forget()
        self._fault = ""

    def check(self) -> None:
        """Checks the arm, and says what is not as it should be.

        Raises:
            HardwareError: The arm must not move like this.
        """
        for check in self.arm.check(self._scene.robot):
            if check.good:
                continue
            if check.needed:
                raise HardwareError(f"{self.arm.address}: {check.what}\n  to do:   {check.remedy}")
            print(f"{self.arm.address}: {check.what}; to do: {check.remedy}", file=sys.stderr)

    def close(self) -> None:
        """Stops the arm and ends the connection; it is also called when the process ends."""
        with uninterrupted():
            self._open = False
            if self._sender.is_alive():
                self._sender.join(timeout=2.0 * TICK)  # after that it sends nothing any more
            self._stop()
            if self._sender.is_alive():  # it waits for an arm that does not answer
                self._sender.join(timeout=1.0)
                self._stop()
            with suppress(Exception):
                self.arm.disconnect()
            with suppress(Exception):
                self.sight.close()
            if self._streamed > _FIRST_RUN and not self._fault and not self._dry_run:
                remember(self.arm)
            self._calm.close()
            atexit.unregister(self.close)

    def _stop(self) -> None:
        if not self._dry_run:
            with suppress(Exception):
                self.arm.stop()

    def _send_all(self) -> None:
        """Sends the commands as they become due, and stops the arm at the first fault: the loop of the thread."""
        with real_time_priority(SENDER):
            self._keep_sending()

    def _keep_sending(self) -> None:
        tick, due = 0, time.monotonic()
        while self._open:
            due = max(due + TICK, time.monotonic() - TICK)
            time.sleep(max(due - time.monotonic(), 0.0))
            tick += 1
            passes = False
            try:
                if self._fault:
                    self._rest()
                    continue  # until somebody calls `recover`
                fault = self._lost()
                passes = bool(fault)
                moving = not self._dry_run and self._commands.any_sent
                fault = fault or self.arm.fault(tick, moving=moving) or (self._commands.deviation() if moving else "")
                if not fault:
                    command = self._commands.due()
                    if command is None:
                        self._rest()
                    elif not self._dry_run:
                        fault = self._beyond(command) or self.arm.send(command)
                        self._commands.note(command)
            except Exception as error:  # whatever it is, the arm must not go on
                fault = str(error) or type(error).__name__
            if fault:
                self._fault, self._fault_passes = fault, passes
                self._stop()

    def _rest(self) -> None:
        if not self._dry_run and self.arm.rest():
            self._commands.note(np.zeros(self._dof))

    def _beyond(self, command: np.ndarray) -> str:
        """Returns in words which limit a command would break until it expires; empty if none.

        The planner and the safety filter keep the limits; this is what is left if they do not.
        """
        lower, upper, fastest = self._limits
        here = self.joints()
        then = here + self.arm.expires * command
        fast = np.flatnonzero(np.abs(command) > 1.01 * fastest)
        out = np.flatnonzero(((then > upper) & (command > 0.0)) | ((then < lower) & (command < 0.0)))
        if len(fast):
            joint = int(fast[0])
            return (
                f"joint {joint + 1} was to move at {command[joint]:.2f} rad/s (at most {fastest[joint]:.2f} rad/s)\n"
                "  to do:   report it: plans keep the limits"
            )
        if len(out):
            joint = int(out[0])
            return (
                f"joint {joint + 1}, at {here[joint]:.2f} rad, was to move beyond its limits\n"
                "  to do:   move the arm away from its limits, and report it: plans keep them"
            )
        return ""

    def _lost(self) -> str:
        """Returns a fault if joint reports do not arrive any more."""
        lost = self.arm.lost()
        if lost:
            return lost
        age = time.monotonic() - self.arm.reports.latest()[0]
        if age > OLDEST:
            return (
                f"the newest joint report is {age:.2f} s old (at most {OLDEST:g} s)\n"
                "  to do:   check the cable, and that nothing else takes this machine's time"
            )
        return ""
