"""An emulation of the xArm's controller: its registers, its states, and what it does to the joints' velocities."""

from __future__ import annotations

import threading

import numpy as np

from oimppi_warp.plants.xarm.codes import COLLISION, JOINT_LIMIT, TOO_FAST
from oimppi_warp.plants.xarm.protocol import JOINTS, Mode, Register, Request, Snapshot, State, Status, floats, seven
from oimppi_warp.scene import Robot

ACCELERATION = np.radians(1145.0)
"""Largest acceleration of a joint [rad/s^2]."""
FASTEST = np.radians(180.0)
"""Largest speed of a joint [rad/s]."""
COLLISION_TORQUES = {1: 30.0, 2: 24.0, 3: 18.0, 4: 12.0, 5: 8.0}
"""Torque from contacts at a joint beyond which a collision is detected, by the sensitivity [N m]; the vendor publishes
none, so these are guesses."""
FIRMWARE = (2, 5, 0)
"""Version of the firmware that is emulated."""
_BEYOND = 0.02
"""Largest distance of a joint outside its limits that is no error [rad]."""


class EmulatedController:
    """The controller of an xArm, without sockets and without an arm.

    It takes commands in joint-velocity mode alone. What is not emulated is answered, and does nothing. It may be used
    from several threads.

    Args:
        robot: The arm.
        load: Mass [kg] and centre [mm] of the payload that is set.

    Attributes:
        firmware: Version that it reports.
        axes: Number of joints that it reports.
        sensitivity: Sensitivity of the collision detection, 0 (off) to 5.
        moves: Number of motion commands taken so far.
        refused: Number of motion commands refused so far.
        expired: Number of times that it stopped a moving arm because no command had followed.
    """

    def __init__(self, robot: Robot, *, load: tuple[float, float, float, float] = (0.2, 0.0, 0.0, 90.0)) -> None:
        self.firmware = FIRMWARE
        self.axes = robot.dof
        self.sensitivity = 3
        self.moves = self.refused = self.expired = 0
        self._dof = robot.dof
        self._limits = np.array([(joint.lower, joint.upper) for joint in robot.joints]).T
        self._load = load
        self._lock = threading.RLock()
        self._mode, self._state = int(Mode.POSITION), int(State.STOPPED)
        self._error = self._warning = 0
        self._enabled = False
        self._wanted, self._driven = np.zeros(self._dof), np.zeros(self._dof)
        self._left = np.inf  # time until the velocity expires [s]
        self._joints, self._velocities, self._torques = (np.zeros(self._dof) for _ in range(3))
        self._tip = np.zeros(6)

    def handle(self, request: Request) -> bytes:
        """Carries out a request and returns the reply's frame."""
        with self._lock:
            try:
                data, taken = self._answer(request)
            except (ValueError, IndexError):
                return request.reply(self._status() | 0x08)
            status = self._status()
            return request.reply(status if taken else status | Status.NOT_READY, data)

    def raise_error(self, code: int) -> None:
        """Raises an error by itself: the arm stops, and takes no command until the error is cleared."""
        with self._lock:
            if not self._error:
                self._error = code
                self._halt(State.STOPPED)

    def tick(self, dt: float) -> np.ndarray:
        """Advances by a cycle; returns the joint velocities to drive until the next one, shape [dof] [rad/s].

        Args:
            dt: Duration of the cycle [s].
        """
        with self._lock:
            self._left -= dt
            if self._left < 1e-9:
                self.expired += bool(np.any(self._wanted))
                self._wanted, self._left = np.zeros(self._dof), np.inf
            most = ACCELERATION * dt
            self._driven = self._driven + np.clip(self._wanted - self._driven, -most, most)
            if self._state in (State.READY, State.MOVING):
                self._state = int(State.MOVING if np.any(self._driven) else State.READY)
            return self._driven.copy()

    def sense(
        self, joints: np.ndarray, velocities: np.ndarray, torques: np.ndarray, contact: np.ndarray, tip: np.ndarray
    ) -> None:
        """Takes over what the arm's sensors measure, and raises the errors that follow from it.

        Args:
            joints: Joint positions, shape [dof] [rad].
            velocities: Joint velocities, shape [dof] [rad/s].
            torques: Joint torques, shape [dof] [N m].
            contact: Torques from contacts, shape [dof] [N m].
            tip: Position of the tip [m], shape [3].
        """
        with self._lock:
            self._joints, self._velocities, self._torques = joints.copy(), velocities.copy(), torques.copy()
            self._tip[:3] = 1e3 * tip
            lower, upper = self._limits
            if self.sensitivity and np.abs(contact).max() > COLLISION_TORQUES[self.sensitivity]:
                self.raise_error(COLLISION)
            if (joints < lower - _BEYOND).any() or (joints > upper + _BEYOND).any():
                self.raise_error(JOINT_LIMIT)
            if np.abs(velocities).max() > 1.1 * FASTEST:
                self.raise_error(TOO_FAST)

    def snapshot(self) -> Snapshot:
        """Returns what the controller reports now."""
        with self._lock:
            return Snapshot(
                mode=self._mode,
                state=self._state,
                error=self._error,
                warning=self._warning,
                enabled=self._enabled,
                axes=self.axes,
                version=self._version(),
                joints=self._joints,
                velocities=self._velocities,
                torques=self._torques,
                tip=self._tip.copy(),
                load=self._load,
                sensitivity=self.sensitivity,
            )

    def _version(self) -> str:
        return f"{self.axes},{self.axes},XI130206A0001,AC130200A0001,v{'.'.join(map(str, self.firmware))}"

    def _status(self) -> int:
        """Returns the status of a reply."""
        ready = self._enabled and self._state in (State.MOVING, State.READY, State.PAUSED)
        status = Status.OK if ready else Status.NOT_READY
        return status | (Status.ERROR if self._error else 0) | (Status.WARNING if self._warning else 0)

    def _answer(self, request: Request) -> tuple[bytes, bool]:
        """Carries out a request; returns the results, and whether it was taken."""
        match request.register:
            case Register.VERSION:
                return self._version().encode().ljust(40, b"\0"), True
            case Register.SERIAL_NUMBER:
                return b"XI130206A0001\0AC130200A0001\0".ljust(40, b"\0"), True
            case Register.ENABLE:
                self._enabled = bool(request.data[1]) and not self._error
                self._halt(State.MODE_CHANGED if self._enabled else State.STOPPED)
            case Register.SET_STATE:
                return b"", self._set_state(request.data[0])
            case Register.GET_STATE:
                return bytes([self._state]), True
            case Register.COMMAND_COUNT:
                return b"\0\0", True
            case Register.GET_ERROR:
                return bytes([self._error, self._warning]), True
            case Register.CLEAR_ERROR:
                self._error = 0
            case Register.CLEAR_WARNING:
                self._warning = 0
            case Register.SET_MODE:
                self._mode = request.data[0]
                self._halt(State.MODE_CHANGED)
            case Register.SET_LOAD:
                mass, x, y, z = request.floats(4).tolist()
                self._load = (mass, x, y, z)
                self._halt(State.MODE_CHANGED)
            case Register.SET_SENSITIVITY:
                self.sensitivity = min(request.data[0], max(COLLISION_TORQUES))
                self._halt(State.MODE_CHANGED)
            case Register.GET_POSE:
                return floats(self._tip), True
            case Register.GET_JOINTS:
                count = request.data[0] if request.data else 1
                return b"".join(
                    floats(seven(values)) for values in (self._joints, self._velocities, self._torques)[:count]
                ), True
            case Register.GET_TORQUES:
                return floats(seven(self._torques)), True
            case Register.JOINT_VELOCITY:
                return b"", self._move(request)
        return b"", True

    def _set_state(self, state: int) -> bool:
        """Asks for a state: 0 ready, 3 pause, 4 stop; returns whether it was reached."""
        if state in (State.STOPPED, 6) or self._error:
            self._halt(State.STOPPED)
            return state != 0
        if state == State.PAUSED:
            self._halt(State.PAUSED)
        elif state == 0 and self._enabled:
            self._state = int(State.READY)
        return state != 0 or self._enabled

    def _move(self, request: Request) -> bool:
        """Takes joint velocities; returns whether it did."""
        velocities = request.floats(JOINTS)[: self._dof]
        duration = request.floats(1, 4 * JOINTS + 1)[0] if len(request.data) > 4 * JOINTS + 1 else -1.0
        ready = self._enabled and self._state in (State.MOVING, State.READY) and self._mode == Mode.JOINT_VELOCITY
        if not ready or self._error or not np.isfinite(velocities).all():
            self.refused += 1
            return False
        self.moves += 1
        self._wanted = np.clip(velocities, -FASTEST, FASTEST)
        self._left = duration if duration > 0.0 else np.inf
        return True

    def _halt(self, state: State) -> None:
        self._state = int(state)
        self._wanted, self._left = np.zeros(self._dof), np.inf
