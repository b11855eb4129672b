"""A connection to an xArm's controller through the vendor's SDK: its facts, its joint reports, commands and stops."""

from __future__ import annotations

import io
import logging
import socket
import statistics
import sys
import threading
import time
import warnings
from contextlib import redirect_stdout
from dataclasses import dataclass
from typing import Any

import numpy as np

from oimppi_warp.errors import HardwareError, missing_package
from oimppi_warp.network import split_address
from oimppi_warp.plants.real.arm import Check, JointReports, check_limits
from oimppi_warp.plants.xarm.codes import describe
from oimppi_warp.plants.xarm.protocol import COMMAND_PORT, REPORT_PORTS, Mode, State
from oimppi_warp.scene import Robot

EXPIRES = 0.1
"""Time after which the controller stops the arm by itself if no further command arrives [s]."""
OLDEST_FIRMWARE = (1, 9, 0)
"""Oldest firmware that can be used: it stops by itself, and reports torques."""
_ANSWER = 1.0
"""Time to wait for the reply to a command while the arm moves [s]; by then it has long stopped by itself."""
RATE = 100.0
"""Rate of the joint reports [1/s]."""
TORQUES = np.array([40.0, 40.0, 26.0, 26.0, 26.0, 16.0, 16.0])
"""Joint torques from which on the arm is stopped: 0.8 of those of the vendor's description, 50 to 20 N m."""
_POLLS = 5
"""Ticks between two readings of the controller's error, and between two of the torques."""


def _sdk() -> Any:
    """Imports the vendor's SDK, and keeps it from printing.

    Raises:
        ConfigError: It is not installed.
    """
    try:
        with redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore", SyntaxWarning)  # it has some on Python 3.12
            import xarm.wrapper as sdk
            from xarm.core.utils.log import logger, origin_logger
    except ImportError:
        raise missing_package("the plant xarm", "xarm-python-sdk", "xarm") from None
    for each in (logger, origin_logger):
        each.setLevel(logging.CRITICAL)
    for name, module in list(sys.modules.items()):
        if name.startswith("xarm."):
            module.print = _say_nothing  # pyright: ignore[reportAttributeAccessIssue]
    return sdk


def _say_nothing(*_args: object, **_options: object) -> None:
    """Takes the place of ``print`` in the SDK."""


@dataclass(frozen=True, eq=False)
class ArmFacts:
    """State and settings of a controller and its arm, as the controller reports them.

    Attributes:
        axes: Number of joints.
        firmware: Version.
        mode, state: See :class:`oimppi_warp.plants.xarm.protocol.Mode` and ``State``.
        error, warning: Codes; 0 for none.
        joints: Joint positions, shape [axes] [rad].
        load: Mass of the payload that is set [kg].
        sensitivity: Sensitivity of the collision detection, 0 (off) to 5.
        report_rate: Rate of the joint reports that was measured [1/s].
        round_trip: Median time of a command and its reply [s].
    """

    axes: int
    firmware: tuple[int, int, int]
    mode: int
    state: int
    error: int
    warning: int
    joints: np.ndarray
    load: float
    sensitivity: int
    report_rate: float
    round_trip: float


def check_facts(facts: ArmFacts, robot: Robot) -> list[Check]:
    """Checks what a controller says against the arm of a scene.

    Args:
        facts: What it says.
        robot: The arm of the scene.
    """
    firmware, oldest = (".".join(map(str, version)) for version in (facts.firmware, OLDEST_FIRMWARE))
    return [
        Check(
            f"{facts.axes} joints; the scene's robot has {robot.dof}",
            facts.axes == robot.dof,
            "use a scene with this robot (`oimppi scene robot`)",
        ),
        Check(f"firmware {firmware}", facts.firmware >= OLDEST_FIRMWARE, f"update it: {oldest} or newer is needed"),
        Check(
            "no error" if not facts.error else describe(facts.error).splitlines()[0],
            not facts.error,
            "" if not facts.error else describe(facts.error).partition("to do:   ")[2],
        ),
        Check(
            f"mode {facts.mode}" + (" (manual)" if facts.mode == Mode.TEACHING else ""),
            facts.mode != Mode.TEACHING,
            "leave manual mode in UFACTORY Studio",
        ),
        check_limits(facts.joints[: robot.dof], robot),
        Check(
            f"payload {facts.load:.2f} kg",
            0.02 <= facts.load <= 2.0,
            "set the mass and the centre of the stick in UFACTORY Studio, or collisions are detected that are none",
            needed=False,
        ),
        Check(
            f"collision detection {'off' if not facts.sensitivity else f'on, sensitivity {facts.sensitivity}'}",
            facts.sensitivity > 0,
            "set a sensitivity of 1 to 5 in UFACTORY Studio",
            needed=False,
        ),
        Check(
            f"joint reports at {facts.report_rate:.0f} Hz",
            facts.report_rate >= 0.9 * RATE,
            "connect by cable, not by wireless, and close other programs that use the arm",
            needed=facts.report_rate < 0.5 * RATE,
        ),
        Check(
            f"a command takes {1e3 * facts.round_trip:.1f} ms",
            facts.round_trip <= 0.02,
            "connect by cable, directly or over one switch",
            needed=facts.round_trip > EXPIRES,
        ),
    ]


class XArm:
    """A connection to a controller (:class:`oimppi_warp.plants.real.arm.Arm`).

    Args:
        address: Address of the controller, as ``HOST`` or ``HOST:PORT``, with the port of the commands; the SDK cannot
            read reports from other ports than the usual ones.

    Attributes:
        address: As given.
        place: The host.
        simulated: Whether the controller is on this machine, as an emulated one is.
        reports: Its joint reports, of 7 joints.
        report_rate: :data:`RATE`.
        expires: :data:`EXPIRES`.

    Raises:
        ConfigError: The SDK is not installed, or the address cannot be read.
        HardwareError: There is no controller at the address.
    """

    report_rate = RATE
    expires = EXPIRES

    def __init__(self, address: str) -> None:
        sdk = _sdk()
        from xarm.core.config.x_config import XCONF

        self.address = address
        host, port = split_address(address, COMMAND_PORT)
        sockets: Any = XCONF.SocketConf  # the SDK has no other way to choose a port
        sockets.TCP_CONTROL_PORT = port
        self.place = host
        self.simulated = host.startswith("127.") or host == "localhost"
        self.reports = JointReports()
        try:
            self._sdk, self._host = sdk, socket.gethostbyname(host)  # the SDK takes no names
        except OSError as error:
            raise HardwareError(f"{host} cannot be found in the network: {error.strerror or error}") from None
        self._arm = self._connect("real")
        self._arm.register_report_location_callback(self._take_report, report_cartesian=False, report_joints=True)
        self._wait_for(lambda: self.reports.count > 1, 3.0, "the controller sends no joint reports")

    def facts(self) -> ArmFacts:
        """Asks the controller about itself; it takes half a second.

        Raises:
            HardwareError: The connection is lost.
        """
        rich = self._connect("rich")  # its reports have more than those used while the arm moves
        arrived = threading.Event()
        rich.register_report_location_callback(lambda _: arrived.set(), report_cartesian=False, report_joints=True)
        came = arrived.wait(3.0)
        load, sensitivity = float(rich.tcp_load[0]), int(rich.collision_sensitivity)
        rich.disconnect()
        if not came:
            raise HardwareError(f"the controller at {self.address} sends no reports on port {REPORT_PORTS['rich']}")
        began, before = time.monotonic(), self.reports.count
        trips, error, warning = [], 0, 0
        while time.monotonic() < began + 0.5:
            asked = time.perf_counter()
            error, warning = self._codes()
            trips.append(time.perf_counter() - asked)
            time.sleep(0.02)
        rate = (self.reports.count - before) / (time.monotonic() - began)
        return ArmFacts(
            axes=self._arm.axis,
            firmware=tuple(self._arm.version_number),
            mode=self._arm.mode,
            state=self._arm.state,
            error=error,
            warning=warning,
            joints=self.reports.latest()[1],
            load=load,
            sensitivity=sensitivity,
            report_rate=rate,
            round_trip=statistics.median(trips),
        )

    def enable(self) -> None:
        """Switches the motors on and gets ready to take joint velocities.

        Raises:
            HardwareError: The controller has an error, is in manual mode, or refuses.
        """
        self.check_error()
        if self._arm.mode == Mode.TEACHING:
            raise HardwareError(
                f"the arm at {self.address} is in manual mode\n  to do:   leave manual mode in UFACTORY Studio"
            )
        self._arm.set_timeout(_ANSWER)
        self._arm.motion_enable(True)
        self._arm.set_mode(int(Mode.JOINT_VELOCITY))
        self._arm.set_state(0)
        self._wait_for(
            lambda: self._arm.mode == Mode.JOINT_VELOCITY and self._arm.state in (State.MOVING, State.READY),
            2.0,
            "the controller does not get ready to move: is it enabled in UFACTORY Studio?",
        )

    def check(self, robot: Robot) -> list[Check]:
        """Checks what the controller says against the arm of a scene; it takes half a second.

        Raises:
            HardwareError: The connection is lost.
        """
        return check_facts(self.facts(), robot)

    def send(self, joint_velocity: np.ndarray) -> str:
        """Sends joint velocities, shape [dof] [rad/s], which expire; returns why they are refused, empty if not."""
        code = self._arm.vc_set_joint_velocity(
            joint_velocity.tolist(), is_radian=True, is_sync=False, check_mode=False, duration=EXPIRES
        )
        return self._refusal(code)

    def rest(self) -> bool:
        """Does nothing, and returns so: the controller stops the arm by itself."""
        return False

    def lost(self) -> str:
        """Returns in words that the connection for commands is lost; empty if it is not."""
        if self._arm.connected:
            return ""
        return (
            f"the connection to {self.address} is lost\n"
            "  to do:   check cable and control box; the controller has stopped the arm by itself"
        )

    def fault(self, tick: int, *, moving: bool) -> str:
        """Returns why the arm must not move: an error, a torque beyond :data:`TORQUES`, or another mode while it moves.

        Raises:
            HardwareError: The controller does not answer.
        """
        if tick % _POLLS == 0 and (code := self.error()):
            return describe(code)
        if tick % _POLLS == 2:
            torques = self.torques()
            over = np.flatnonzero(np.abs(torques) > TORQUES)
            if len(over):
                joint = int(over[0])
                return (
                    f"joint {joint + 1} bears {abs(torques[joint]):.0f} N m (at most {TORQUES[joint]:.0f} N m)\n"
                    "  to do:   look what the arm presses on"
                )
        if moving and self._arm.mode != Mode.JOINT_VELOCITY:
            return (
                f"the controller is in mode {self._arm.mode} now\n"
                "  to do:   another program has changed it; close that program (UFACTORY Studio included)"
            )
        return ""

    def stop(self) -> None:
        """Stops the arm: velocity zero, and state 4, in which the controller takes no command."""
        for command in (
            lambda: self._arm.vc_set_joint_velocity([0.0] * 7, is_radian=True, is_sync=False, duration=EXPIRES),
            lambda: self._arm.set_state(4),
        ):
            try:
                if self._arm.connected:
                    command()
            except Exception:  # whatever fails here, the velocities expire
                continue

    def check_error(self) -> None:
        """Raises the controller's error, if it has one.

        Raises:
            HardwareError: It has an error, or does not answer.
        """
        error = self.error()
        if error:
            raise HardwareError(describe(error))

    def error(self) -> int:
        """Returns the controller's error code; 0 for none.

        Raises:
            HardwareError: It does not answer.
        """
        return self._codes()[0]

    def torques(self) -> np.ndarray:
        """Returns the joint torques, shape [7] [N m].

        Raises:
            HardwareError: The controller does not answer.
        """
        code, found = self._arm.get_joints_torque()
        if code != 0:
            raise HardwareError(f"the controller at {self.address} does not tell the joint torques (code {code})")
        return np.array(found, dtype=float)

    def disconnect(self) -> None:
        """Ends the connection."""
        self._arm.disconnect()

    def _codes(self) -> tuple[int, int]:
        """Returns the codes of the controller's error and warning; 0 for none.

        Raises:
            HardwareError: It does not answer.
        """
        code, found = self._arm.get_err_warn_code()
        if code != 0:
            raise HardwareError(f"the controller at {self.address} does not answer (code {code} of the SDK)")
        return int(found[0]), int(found[1])

    def _connect(self, reports: str) -> Any:
        try:
            usual = socket.getdefaulttimeout()
            try:
                arm = self._sdk.XArmAPI(self._host, is_radian=True, report_type=reports, forbid_uds=True)
            finally:
                socket.setdefaulttimeout(usual)  # the SDK changes it for the whole process
        except Exception as error:
            raise HardwareError(
                f"there is no xArm controller at {self.address}: {error}\n"
                "  to do:   check the address in UFACTORY Studio, the cable, and that this machine is in its network"
            ) from None
        if not arm.connected:
            raise HardwareError(
                f"there is no xArm controller at {self.address}\n"
                "  to do:   check the address in UFACTORY Studio, the cable, and that this machine is in its network"
            )
        return arm

    def _take_report(self, found: dict[str, Any]) -> None:
        self.reports.take(np.array(found["joints"], dtype=float))

    def _refusal(self, code: int) -> str:
        """Returns the fault that follows from the SDK's return code of a motion command."""
        if code in (0, 2):
            return ""
        if code == 1 and (error := self.error()):
            return describe(error)
        if code == 9:
            state = self._arm.state
            stopped = state in (State.STOPPED, State.PAUSED, State.MODE_CHANGED)
            return (
                f"the controller does not take motion commands{f' (state {state})' if stopped else ''}\n"
                "  to do:   another program or the emergency stop has stopped it; see UFACTORY Studio"
            )
        return f"a command failed (code {code} of the SDK)\n  to do:   check the cable and the control box"

    def _wait_for(self, reached: Any, seconds: float, problem: str) -> None:
        until = time.monotonic() + seconds
        while not reached():
            if time.monotonic() > until:
                raise HardwareError(f"{problem} (at {self.address})")
            time.sleep(0.01)
