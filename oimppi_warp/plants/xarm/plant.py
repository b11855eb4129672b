"""The plant ``xarm``: a real xArm, moved by joint velocities through the vendor's SDK.

Three things stop the arm when something is wrong, each by itself. The controller does when no command has arrived for
:data:`oimppi_warp.plants.xarm.arm.EXPIRES`; the thread that sends the commands does at the first fault that it sees
(:attr:`XArmPlant.fault`); and the control loop does for what only it knows
(:class:`oimppi_warp.runtime.watch.Watch`).
"""

from __future__ import annotations

import atexit
import json
import math
import os
import signal
import sys
import termios
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import takewhile
from pathlib import Path

import numpy as np

from oimppi_warp.config.settings import Config
from oimppi_warp.errors import ConfigError, HardwareError
from oimppi_warp.network import split_address
from oimppi_warp.observation import Observation, planar_transform
from oimppi_warp.perception.pose_feed import PORT as POSE_PORT
from oimppi_warp.perception.pose_feed import PoseReceiver
from oimppi_warp.physics.world import World
from oimppi_warp.plants.plant import StopRules, checked_stream
from oimppi_warp.plants.xarm.arm import EXPIRES, OLDEST, RATE, XArm, check_facts
from oimppi_warp.plants.xarm.codes import describe
from oimppi_warp.plants.xarm.protocol import COMMAND_PORT, Mode, State
from oimppi_warp.plants.xarm.start_move import StartMove
from oimppi_warp.scene import Scene

TICK = 0.01
"""Interval of the commands [s]."""
FIRST_SPEED = 0.1
"""Share of the usual speed with which an arm at an address is moved for the first time."""
TORQUES = np.array([40.0, 40.0, 26.0, 26.0, 26.0, 16.0, 16.0])
"""Joint torques from which on the arm is stopped: 0.8 of those of the vendor's description, 50 to 20 N m."""
_START_SPEED = 0.25
"""Speed of the fastest joint on the way to the start posture, at full speed [rad/s]."""
_AT_START = 0.01
"""Distance of every joint from the start posture at which the arm has arrived [rad]."""
_GAIN = 2.0
"""Rate at which deviations from the way to the start posture are reduced [1/s]."""
_LATENCY = 0.02
"""Time from a command to its effect: sending, the controller's cycle, and the arm's response [s]."""
_FUTURE = 0.2
"""Largest time by which the stamp of a pose may be in the future [s]."""
_PATIENCE = 0.5
"""Control periods by which the control loop may be late before the arm is let stop."""
_SLOWEST_TOUCH = 1e-3
"""Least value of the setting `robot.touch_speed` [m/s]."""
_POLLS = 5
"""Ticks between two readings of the controller's error, and between two of the torques."""
_ASTRAY, _ASTRAY_SECONDS = 0.06, 0.4
"""Deviation of the motion within this time [s] from what was commanded, from which on somebody else moves the arm or
something holds it [rad]."""
_MOST_REPORTS = 0.85
"""Share of the usual number of joint reports that have to be there for this to be judged."""
_LEAST_ASTRAY = 0.3
"""Least share of this deviation that counts, at a low speed."""
_RESPONSE, _SURELY = 0.06, 0.003
"""Time after which a command has surely moved the arm [s], and motion that its reports surely show [rad]."""
_GET_THERE = 5.0
"""Time that the way to the start posture may take beyond twice the planned one [s]."""
_FIRST_POSE = 5.0
"""Time to wait for a pose of the object before the arm moves [s]."""
_AGREE = 0.03
"""Distance of two detections that agree [m]."""
_FIRST_RUN = 100
"""Control periods after which a run without a fault counts as one with this arm."""
_OLDEST_AT_REST = 60.0
"""Age of a pose up to which the arm may go to its start posture: it may hide the object where it stands [s]."""


class XArmPlant:
    """An xArm at a scene's table, and the object's pose from a camera.

    Making it checks the controller and, after a confirmation, moves the arm to the scene's start posture. It runs in
    real time only. Commands are sent from a thread, one per :data:`TICK`.

    Args:
        scene: The task.
        config: All settings.
        seed: Not used.
        robot_address: Address of the controller, ``HOST`` or ``HOST:PORT``.
        pose_address: Address of the object's poses (:mod:`oimppi_warp.perception.pose_feed`); empty: that of the
            controller, as with the emulator.
        speed: Share of the usual speed, 0.01 to 1; 0 for 1, or :data:`FIRST_SPEED` at an address that is new.
        yes: Whether the arm moves to its start posture without asking.
        dry_run: Whether everything is done but moving.
        resume: See :class:`oimppi_warp.plants.plant.StopRules`.
        pose_timeout: Likewise [s].

    Raises:
        ConfigError: An option cannot be used, or the SDK is not installed.
        HardwareError: The arm or the camera cannot be used, or the arm was not allowed to move.

    Attributes:
        control_period: Control period [s].
        ticks: Number of commands per control period.
        latency: Time from a command to its effect [s].
        rules: Rules for stopping and going on.
        speed: Share of the usual speed.
        arm: The connection to the controller.
    """

    latency = _LATENCY
    own_world = True
    rules = StopRules()

    def __init__(
        self,
        scene: Scene,
        config: Config,
        *,
        seed: int = 0,
        robot_address: str = "",
        pose_address: str = "",
        speed: float = 0.0,
        yes: bool = False,
        dry_run: bool = False,
        resume: bool = False,
        pose_timeout: float = 2.5,
    ) -> None:
        if not robot_address:
            raise ConfigError(
                "--plant xarm needs the address of the controller\n  to do:   --robot-address 192.168.1.x"
            )
        self.control_period = config.control_period
        self.ticks = round(self.control_period / TICK)
        if abs(self.ticks * TICK - self.control_period) > 1e-9:
            raise ConfigError(
                f"control_period = {self.control_period:g}: commands are sent every {TICK:g} s\n"
                "  allowed: a multiple of this interval"
            )
        if not 0.01 <= speed <= 1.0 and speed != 0.0:
            raise ConfigError(f"--speed {speed:g} cannot be used\n  allowed: 0.01 to 1")
        if not 0.1 <= pose_timeout <= 60.0:
            raise ConfigError(f"--pose-timeout {pose_timeout:g} cannot be used\n  allowed: 0.1 to 60 s")
        self._scene, self._dof, self._dry_run = scene, scene.robot.dof, dry_run
        self.rules = StopRules(pose_timeout=pose_timeout, resume=resume)
        self.speed = _speed(robot_address, speed)
        self._origin = time.monotonic()
        self._fault, self._fault_passes = "", False
        self._streamed = 0
        self._lock = threading.RLock()
        self._queue: deque[tuple[float, np.ndarray]] = deque()
        self._sent: deque[tuple[float, np.ndarray]] = deque(maxlen=200)
        self._open = True
        self._since = 0.0
        self._poses: PoseReceiver | None = None
        self._sender: threading.Thread | None = None
        self.arm = XArm(robot_address)
        atexit.register(self.close)
        try:
            host, _ = split_address(robot_address, COMMAND_PORT)
            self._poses = PoseReceiver(pose_address or f"{host}:{POSE_PORT}")
            self._check()
            self._sender = threading.Thread(target=self._send_all, name="oimppi-xarm", daemon=True)
            if not dry_run:
                self._go_to_start(confirmed=yes)
            else:
                self._sender.start()
            if self._agreed_pose(oldest=pose_timeout, wait=_FIRST_POSE) is None:
                raise self._unseen()
        except BaseException:
            self.close()
            raise

    def limited(self, config: Config) -> Config:
        """Returns settings with which plans keep to the speed that was asked for, and as much more time."""
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

    @property
    def now(self) -> float:
        """Returns the present time, on the clock of the observations [s]."""
        return time.monotonic() - self._origin

    def observe(self) -> Observation:
        """Returns the newest joint report, those since the last call, and the newest pose of the object."""
        reports = self.arm.since(self._since)
        if not reports:
            reports = [self.arm.joints()]
        self._since = reports[-1][0]
        trail = np.array([[at - self._origin, *joints[: self._dof]] for at, joints in reports])
        velocity = np.zeros(self._dof)
        if len(trail) > 1 and trail[-1, 0] > trail[0, 0]:
            velocity = (trail[-1, 1:] - trail[0, 1:]) / (trail[-1, 0] - trail[0, 0])
        seen = None if self._poses is None else self._poses.latest
        pose, taken = (np.full(3, np.nan), np.nan) if seen is None else (seen.pose, seen.taken - self._origin)
        if seen is not None and seen.age < -_FUTURE:
            pose, taken = np.full(3, np.nan), np.nan
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
        began = time.monotonic()
        self._streamed += 1
        with self._lock:
            self._queue.clear()
            self._queue.extend((began + i * TICK, command) for i, command in enumerate(commands))

    @property
    def fault(self) -> str:
        """Returns why the arm must not move, in words, with what to do; empty if it may."""
        # The thread may be waiting for a controller that does not answer.
        return self._fault or self._lost()

    @property
    def blind(self) -> str:
        """Returns why the object's pose is not known, as far as its connection tells; empty if it is."""
        if self._poses is None:
            return ""
        seen = self._poses.latest
        if seen is not None and seen.age < -_FUTURE:
            return (
                f"the object's pose is stamped {-seen.age:.1f} s in the future\n"
                "  to do:   synchronise the clocks of camera and planner (NTP)"
            )
        if seen is not None and seen.age > self.rules.pose_timeout:
            return (
                f"the object's pose was {seen.age:.1f} s old when it arrived\n"
                "  to do:   synchronise the clocks of camera and planner (NTP), or see why the camera is late"
            )
        return self._poses.problem

    def recover(self) -> None:
        """Gets ready to move again after a fault; an error of the controller is never cleared.

        Raises:
            HardwareError: The controller has an error, or the connection is lost.
        """
        if not self._dry_run:
            self.arm.enable()
        with self._lock:
            self._queue.clear()
            self._sent.clear()
            self._fault = ""

    @property
    def fault_passes(self) -> bool:
        """Returns whether the present fault may pass by itself: joint reports that come again."""
        return not self._fault or self._fault_passes

    def close(self) -> None:
        """Stops the arm and ends the connection; it is also called when the process ends."""
        with uninterrupted():
            self._open = False
            if self._sender is not None and self._sender.is_alive():
                self._sender.join(timeout=1.0)
            with suppress(Exception):
                if self._dry_run:
                    self.arm.disconnect()
                else:
                    self.arm.close()
            if self._poses is not None:
                self._poses.close()
            if self._streamed > _FIRST_RUN and not self._fault and not self._dry_run:
                _remember(self.arm.address)
            atexit.unregister(self.close)

    def _check(self) -> None:
        """Checks the controller, and says what is not as it should be.

        Raises:
            HardwareError: The arm must not move like this.
        """
        for check in check_facts(self.arm.facts(), self._scene.robot):
            if check.good:
                continue
            if check.needed:
                raise HardwareError(f"{self.arm.address}: {check.what}\n  to do:   {check.remedy}")
            _say(f"{self.arm.address}: {check.what}; to do: {check.remedy}")

    def _agreed_pose(self, *, oldest: float, wait: float) -> np.ndarray | None:
        """Waits until the latest two detections of the object agree; returns the later pose, shape [3] [m, m, rad].

        Args:
            oldest: Largest age of the later one [s].
            wait: Time after which ``None`` is returned [s].
        """
        assert self._poses is not None
        until = time.monotonic() + wait
        while time.monotonic() < until:
            latest = self._poses.poses[-2:]
            if len(latest) == 2:
                before, seen = latest
                timely = seen.age >= -_FUTURE and time.monotonic() - seen.taken <= oldest
                if timely and np.hypot(*(seen.pose - before.pose)[:2]) < _AGREE:
                    return seen.pose
            time.sleep(0.02)
        return None

    def _unseen(self) -> HardwareError:
        """Returns the error of an object that is not seen."""
        why = self.blind or "no two detections of the object agree"
        remedy = "" if "to do:" in why else "\n  to do:   start what detects the object, and let nothing hide it"
        return HardwareError(f"{why}{remedy} (docs/hardware.md)")

    def _go_to_start(self, *, confirmed: bool) -> None:
        """Moves the arm to the start posture, after a confirmation.

        Where the object is not seen, the arm may hide it, and where it seems to be in the tool, its pose is not exact:
        the tool is lifted first, straight up, wherever the object is.

        Raises:
            HardwareError: The object is not seen, the way is not free, the answer is no, or a fault stops the arm.
        """
        assert self._sender is not None
        start, way = np.asarray(self._scene.robot.start, dtype=float), StartMove(World(self._scene))
        if self._agreed_pose(oldest=_OLDEST_AT_REST, wait=_FIRST_POSE) is None and not self._ever_seen:
            raise self._unseen()
        degrees = math.degrees(float(np.abs(start - self._joints()).max()))
        pace = math.degrees(self.speed * _START_SPEED)
        if not confirmed and not _ask(
            "The arm will lift its tool if need be, and move to its start posture (joints turn by up to "
            f"{degrees:.0f} degrees, at {pace:.0f} degrees/s). Then it pushes at {100 * self.speed:.0f} % of the usual "
            "speed. Is everybody out of its reach, and the emergency stop at hand?"
        ):
            raise HardwareError("the arm was not moved\n  to do:   confirm the move, or use --yes in a script")
        # Everything is looked at again: nobody knows how long the answer took.
        self._check()
        pose = self._agreed_pose(oldest=_OLDEST_AT_REST, wait=_FIRST_POSE)
        here = self._joints()
        if pose is None or way.clearance(here, pose)[1] < 0.0:
            path = way.lift(here)
            self.arm.enable()
            self._sender.start()
            self._follow(path)
            pose = self._agreed_pose(oldest=_OLDEST_AT_REST, wait=_FIRST_POSE)
            if pose is None:
                raise self._unseen()
            self._follow(way.path(self._joints(), start, pose))
            return
        path = way.path(here, start, pose)
        self.arm.enable()
        self._sender.start()
        self._follow(path)

    @property
    def _ever_seen(self) -> bool:
        """Returns whether any pose of the object has arrived."""
        return self._poses is not None and bool(self._poses.poses)

    def _joints(self) -> np.ndarray:
        """Returns the newest joint positions, shape [dof] [rad]."""
        return self.arm.joints()[1][: self._dof]

    def _follow(self, path: np.ndarray) -> None:
        """Moves slowly through postures, shape [n, dof] [rad], and stops at the last one.

        Raises:
            HardwareError: A fault stopped the arm, it is not where the way begins, or it does not get to its end.
        """
        if np.abs(path[0] - self._joints()).max() > _AT_START:
            raise HardwareError("the arm was moved meanwhile\n  to do:   let it stand still, and start again")
        pace = self.speed * _START_SPEED
        knots = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(path, axis=0)).max(axis=1))])
        at, speed, target = 0.0, 0.0, path[0]
        until = time.monotonic() + 2.0 * knots[-1] / pace + _GET_THERE
        while True:
            if time.monotonic() > until:
                raise HardwareError(
                    "the arm does not get to its start posture\n  to do:   see what holds it, or use a larger --speed"
                )
            if self.fault:
                raise HardwareError(f"on the way to its start posture the arm was stopped: {self.fault}")
            here = self._joints()
            left = knots[-1] - at
            if left <= 0.0 and np.abs(path[-1] - here).max() < _AT_START:
                break
            # Accelerates and brakes with 0.5 rad/s^2; what is left of an error is reduced in proportion to it.
            speed = min(speed + 0.5 * self.control_period, pace, math.sqrt(max(left, 0.0)))
            ahead = min(at + speed * self.control_period, knots[-1])
            wanted = np.array([np.interp(ahead, knots, column) for column in path.T])
            velocity = (wanted - target) / self.control_period + _GAIN * (target - here)
            at, target = ahead, wanted
            self.apply(np.clip(velocity, -1.2 * pace, 1.2 * pace))
            time.sleep(self.control_period)
        self.apply(np.zeros(self._dof))

    def _send_all(self) -> None:
        """Sends the commands as they become due, and stops the arm at the first fault: the loop of the thread."""
        tick, due = 0, time.monotonic()
        while self._open:
            due = max(due + TICK, time.monotonic() - TICK)
            time.sleep(max(due - time.monotonic(), 0.0))
            tick += 1
            if self._fault:
                continue  # until somebody calls `recover`
            passes = False
            try:
                fault = self._lost()
                passes = bool(fault)
                fault = fault or self._find_fault(tick)
                if not fault:
                    command = self._next_command()
                    if command is not None and not self._dry_run:
                        code = self.arm.send(command)
                        self._sent.append((time.monotonic(), command))
                        fault = self._refusal(code)
            except Exception as error:  # whatever it is, the arm must not go on
                fault = str(error) or type(error).__name__
            if fault:
                self._fault, self._fault_passes = fault, passes
                if not self._dry_run:
                    self.arm.stop()

    def _next_command(self) -> np.ndarray | None:
        """Returns the joint velocities that are due, shape [dof]; ``None`` once the last ones are over."""
        now = time.monotonic()
        with self._lock:
            while len(self._queue) > 1 and self._queue[1][0] <= now + 0.5 * TICK:
                self._queue.popleft()
            if not self._queue or now > self._queue[-1][0] + TICK + _PATIENCE * self.control_period:
                return None
            return self._queue[0][1]

    def _find_fault(self, tick: int) -> str:
        """Returns why the arm must not move, by what is known now and by what the controller is asked in this tick."""
        if tick % _POLLS == 0 and (code := self.arm.error()):
            return describe(code)
        if tick % _POLLS == 2:
            torques = self.arm.torques()
            over = np.flatnonzero(np.abs(torques) > TORQUES)
            if len(over):
                joint = int(over[0])
                return (
                    f"joint {joint + 1} bears {abs(torques[joint]):.0f} N m (at most {TORQUES[joint]:.0f} N m)\n"
                    "  to do:   look what the arm presses on"
                )
        if not self._dry_run and self._sent:
            if self.arm.mode != Mode.JOINT_VELOCITY:
                return (
                    f"the controller is in mode {self.arm.mode} now\n"
                    "  to do:   another program has changed it; close that program (UFACTORY Studio included)"
                )
            return self._frozen() or self._astray()
        return ""

    def _lost(self) -> str:
        """Returns a fault if joint reports do not arrive any more."""
        if not self.arm.connected:
            return (
                f"the connection to {self.arm.address} is lost\n"
                "  to do:   check cable and control box; the controller has stopped the arm by itself"
            )
        age = time.monotonic() - self.arm.joints()[0]
        if age > OLDEST:
            return (
                f"the newest joint report is {age:.2f} s old (at most {OLDEST:g} s)\n"
                "  to do:   check the cable, and that nothing else takes this machine's time"
            )
        return ""

    def _told(self, begin: float, end: float) -> np.ndarray | None:
        """Returns by how much the joints were told to move between two times, shape [dof] [rad].

        ``None`` if the commands of that time are not all known.
        """
        sent = list(self._sent)
        if not sent or sent[0][0] > begin:
            return None
        starts = np.array([at for at, _ in sent])
        ends = np.minimum([*starts[1:], np.inf], starts + EXPIRES)
        durations = np.clip(ends, begin, end) - np.clip(starts, begin, end)
        return durations @ np.array([command for _, command in sent])

    def _frozen(self) -> str:
        """Returns a fault if the joint reports have not changed although the arm was told to move."""
        reports = self.arm.since(0.0)
        same = takewhile(lambda report: np.array_equal(report[1], reports[-1][1]), reversed(reports))
        now, since = time.monotonic(), min(at for at, _ in same)
        if now - since < OLDEST - TICK:
            return ""
        told = self._told(max(since, self._sent[0][0]), now - _RESPONSE)
        if told is None or np.abs(told).max() < _SURELY:
            return ""
        return (
            "the joint reports do not change although the arm was told to move\n"
            "  to do:   see in UFACTORY Studio whether the arm moved; if it did, restart the control box"
        )

    def _astray(self) -> str:
        """Returns a fault if the arm has moved otherwise than it was told to."""
        now = time.monotonic()
        begin = now - _ASTRAY_SECONDS
        told = self._told(begin - _LATENCY, now - _LATENCY)
        reports = self.arm.since(begin)
        if told is None or len(reports) < _MOST_REPORTS * RATE * _ASTRAY_SECONDS:
            return ""  # reports were held up: it is not known when the arm was where
        moved = (reports[-1][1] - reports[0][1])[: self._dof]
        off = np.abs(told - moved)
        worst = int(np.argmax(off))
        if off[worst] < _ASTRAY * max(self.speed, _LEAST_ASTRAY):
            return ""
        return (
            f"joint {worst + 1} moved {moved[worst]:+.2f} rad in {_ASTRAY_SECONDS:g} s, not {told[worst]:+.2f} rad as "
            "commanded\n  to do:   see whether another program commands the arm, or something holds it"
        )

    def _refusal(self, code: int) -> str:
        """Returns the fault that follows from the SDK's return code of a motion command."""
        if code in (0, 2):
            return ""
        if code == 1 and (error := self.arm.error()):
            return describe(error)
        if code == 9:
            stopped = self.arm.state in (State.STOPPED, State.PAUSED, State.MODE_CHANGED)
            return (
                f"the controller does not take motion commands{f' (state {self.arm.state})' if stopped else ''}\n"
                "  to do:   another program or the emergency stop has stopped it; see UFACTORY Studio"
            )
        return f"a command failed (code {code} of the SDK)\n  to do:   check the cable and the control box"


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Holds back Ctrl-C, and signals to end, until the block is over."""
    held = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, held)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _ask(question: str) -> bool:
    """Asks a question on the terminal; without one, the answer is no."""
    if not sys.stdin.isatty():
        return False
    print(question, end=" [y/N] ", file=sys.stderr, flush=True)
    termios.tcflush(sys.stdin, termios.TCIFLUSH)  # an answer from before the question does not count
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def _say(line: str) -> None:
    print(line, file=sys.stderr)


def _speed(address: str, wanted: float) -> float:
    """Returns the share of the usual speed: at an address that is new, and not this machine, a small one."""
    host, _ = split_address(address, COMMAND_PORT)
    if host.startswith("127.") or host == "localhost" or host in _known():
        return wanted or 1.0
    if wanted > FIRST_SPEED or not wanted:
        _say(f"{host} is new here: the first run is at {100 * FIRST_SPEED:.0f} % of the usual speed")
    return min(wanted or FIRST_SPEED, FIRST_SPEED)


def _file() -> Path:
    """Returns the file of the addresses at which an arm was moved before."""
    state = os.environ.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
    return Path(state) / "oimppi-warp" / "arms.json"


def _known() -> list[str]:
    try:
        return list(json.loads(_file().read_text()))
    except (OSError, ValueError):
        return []


def _remember(address: str) -> None:
    """Notes that the arm at an address was moved."""
    host, _ = split_address(address, COMMAND_PORT)
    known = _known()
    if host not in known:
        with suppress(OSError):
            _file().parent.mkdir(parents=True, exist_ok=True)
            _file().write_text(json.dumps([*known, host]) + "\n")
