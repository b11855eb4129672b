"""The protocol of the xArm's controller: frames of commands and replies, and reports.

Written from the vendor's manual and from what xarm-python-sdk 1.18.4 sends and accepts. Headers and 16-bit numbers are
big endian; 32-bit floats are little endian.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

COMMAND_PORT = 502
"""TCP port of the commands."""
REPORT_PORTS = {"normal": 30001, "rich": 30002, "real": 30003}
"""TCP ports of the reports."""
REPORT_PERIODS = {"normal": 0.2, "rich": 0.2, "real": 0.01}
"""Intervals between the reports of a real controller [s]."""
JOINTS = 7
"""Number of joints in every message; an arm with fewer leaves the last ones at zero."""
ALL_JOINTS = 8
"""Number that stands for all joints."""
HEARTBEAT = 1
"""Protocol number of the SDK's heartbeat, which is not answered."""

_HEADER = struct.Struct(">HHH")


class Register(IntEnum):
    """Registers, which are the commands."""

    VERSION = 1
    SERIAL_NUMBER = 2
    ENABLE = 11
    SET_STATE = 12
    GET_STATE = 13
    COMMAND_COUNT = 14
    GET_ERROR = 15
    CLEAR_ERROR = 16
    CLEAR_WARNING = 17
    SET_MODE = 19
    SET_LOAD = 36
    SET_SENSITIVITY = 37
    GET_POSE = 41
    GET_JOINTS = 42
    GET_TORQUES = 55
    JOINT_VELOCITY = 81


class Mode(IntEnum):
    """Modes of the controller."""

    POSITION = 0
    SERVO = 1
    TEACHING = 2
    JOINT_VELOCITY = 4


class State(IntEnum):
    """States of the controller, as it reports them."""

    MOVING = 1
    READY = 2
    PAUSED = 3
    STOPPED = 4
    MODE_CHANGED = 5


class Status(IntEnum):
    """Bits of the status in a reply."""

    OK = 0
    NOT_READY = 0x10
    WARNING = 0x20
    ERROR = 0x40


@dataclass(frozen=True)
class Request:
    """A command, as the controller receives it.

    Attributes:
        transaction: Number that the reply repeats.
        protocol: Protocol number, which the reply repeats as well.
        register: Register, one of :class:`Register` unless it is unknown here.
        data: Parameters.
    """

    transaction: int
    protocol: int
    register: int
    data: bytes

    def floats(self, count: int, begin: int = 0) -> np.ndarray:
        """Returns floats among the parameters, shape [count].

        Args:
            count: Their number.
            begin: Offset of the first [B].

        Raises:
            ValueError: There are not as many.
        """
        if len(self.data) < begin + 4 * count:
            raise ValueError(f"register {self.register} has {len(self.data)} bytes of parameters")
        return np.frombuffer(self.data, "<f4", count, begin).astype(float)

    def reply(self, status: int, data: bytes = b"") -> bytes:
        """Returns the frame that answers this request.

        Args:
            status: Bits of :class:`Status`.
            data: Results.
        """
        header = _HEADER.pack(self.transaction, self.protocol, 2 + len(data))
        return header + bytes([self.register, status]) + data


def take_requests(buffer: bytearray) -> list[Request]:
    """Takes all complete requests out of a buffer of received bytes; what is incomplete stays in it."""
    requests = []
    while len(buffer) >= _HEADER.size:
        transaction, protocol, length = _HEADER.unpack_from(buffer)
        end = _HEADER.size + length
        if len(buffer) < end:
            break
        body = bytes(buffer[_HEADER.size : end])
        del buffer[:end]
        if body and protocol != HEARTBEAT:
            requests.append(Request(transaction, protocol, body[0], body[1:]))
    return requests


def floats(values: Sequence[float] | np.ndarray) -> bytes:
    """Returns the bytes of floats."""
    return np.asarray(values, dtype="<f4").tobytes()


def seven(values: Sequence[float] | np.ndarray) -> np.ndarray:
    """Returns the values of an arm's joints, followed by zeros, shape [7]."""
    padded = np.zeros(JOINTS)
    padded[: len(values)] = values
    return padded


@dataclass(frozen=True, eq=False)
class Snapshot:
    """State of the controller and its arm at one instant, as it is reported.

    Attributes:
        mode: One of :class:`Mode`.
        state: One of :class:`State`.
        error, warning: Codes; 0 for none.
        enabled: Whether the motors are on.
        axes: Number of joints.
        version: The controller's description of itself.
        joints: Joint positions, shape [dof] [rad].
        velocities: Joint velocities, shape [dof] [rad/s].
        torques: Joint torques, shape [dof] [N m].
        tip: Position of the tool's tip [mm] and its orientation as roll, pitch and yaw [rad], shape [6].
        load: Mass [kg] and centre [mm] of the payload.
        sensitivity: Sensitivity of the collision detection, 0 to 5.
    """

    mode: int
    state: int
    error: int
    warning: int
    enabled: bool
    axes: int
    version: str
    joints: np.ndarray
    velocities: np.ndarray
    torques: np.ndarray
    tip: np.ndarray
    load: tuple[float, float, float, float]
    sensitivity: int


def report(kind: str, seen: Snapshot) -> bytes:
    """Returns a report.

    Args:
        kind: ``real``, ``normal`` or ``rich``: each has what the one before has, and more.
        seen: What to report.
    """
    body = bytes([seen.mode << 4 | seen.state]) + struct.pack(">H", 0)
    body += floats(seven(seen.joints)) + floats(seen.tip) + floats(seven(seen.torques))
    if kind in ("normal", "rich"):
        motors = (1 << seen.axes) - 1 if seen.enabled else 0
        body += bytes([motors, motors, seen.error, seen.warning]) + floats(np.zeros(6)) + floats(seen.load)
        body += bytes([seen.sensitivity, 1]) + floats((0.0, 0.0, -9.81))
    if kind == "rich":
        body += bytes([seen.axes, seen.axes, 0xAA, 0x55, 0, 0]) + seen.version.encode().ljust(30, b"\0")[:30]
        body += floats(np.zeros(10)) + floats(np.zeros(2)) + bytes(14) + bytes(2) + bytes(JOINTS)
        body += floats([0.0]) + floats(seven(seen.velocities)) + struct.pack(">I", 0) + floats(np.zeros(6)) + bytes(2)
    return struct.pack(">I", 4 + len(body)) + body
