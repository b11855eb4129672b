"""An emulated lab on loopback for tests, another client of its controller, and a cable that can be cut."""

from __future__ import annotations

import itertools
import os
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import Any

import numpy as np
from support import small_tasks

from oimppi_warp.config.presets import lab
from oimppi_warp.network import Listener
from oimppi_warp.plants.xarm.emulator import LabEmulator
from oimppi_warp.plants.xarm.plant import XArmPlant
from oimppi_warp.plants.xarm.protocol import REPORT_PORTS, Register, floats, seven

COMMAND_PORT, POSE_PORT = 12502, 29501
"""Ports that need no root. The SDK has those of the reports fixed, so every lab has an address of its own."""
_addresses = itertools.count(1)


def address() -> str:
    """An address of this machine that no other test uses."""
    number, process = next(_addresses), os.getpid()
    return f"127.{2 + process % 250}.{1 + process // 250 % 250}.{number}"


@contextmanager
def emulated(**options: Any) -> Iterator[LabEmulator]:
    """A lab with the object of lab01, whose camera makes no errors and sees the object ten times a second."""
    config = lab().lab
    exact = replace(config, rate=10.0, delay=0.05, position_noise=0.0, yaw_noise=0.0, outlier_probability=0.0)
    options = {"host": address(), **options}
    made = LabEmulator(
        small_tasks.shipped("lab01"),
        options.pop("lab", exact),
        command_port=COMMAND_PORT,
        pose_port=POSE_PORT,
        **options,
    )
    made.host = options["host"]  # pyright: ignore
    made.start()
    try:
        yield made
    finally:
        made.close()


@contextmanager
def connected(host: str, **options: Any) -> Iterator[XArmPlant]:
    """The plant at an address, with the arm at its start posture."""
    options = {"yes": True, "pose_address": f"{host}:{POSE_PORT}", **options}
    plant = XArmPlant(small_tasks.shipped("lab01"), lab(), robot_address=f"{host}:{COMMAND_PORT}", **options)
    try:
        yield plant
    finally:
        plant.close()


class OtherClient:
    """Another program that is connected to a controller; it speaks the protocol itself."""

    def __init__(self, host: str) -> None:
        self._link = socket.create_connection((host, COMMAND_PORT), timeout=2.0)

    def command(self, register: int, data: bytes = b"") -> bytes:
        """Sends a command; the status and the data of its reply."""
        self._link.sendall(struct.pack(">HHHB", 1, 2, 1 + len(data), register) + data)
        return self._link.recv(4096)[7:]

    def move(self, joint_velocity: np.ndarray) -> None:
        self.command(Register.JOINT_VELOCITY, floats(seven(joint_velocity)) + b"\0" + floats([0.1]))

    def close(self) -> None:
        self._link.close()


class Cable:
    """Forwards the ports of a lab to another address, until it is cut: then nothing passes, and nothing is closed."""

    def __init__(self, host: str) -> None:
        self.host = address()
        self._to, self.cut = host, False
        ports = (COMMAND_PORT, *REPORT_PORTS.values(), POSE_PORT)
        self._listeners = [Listener(self.host, port, lambda link, port=port: self._serve(link, port)) for port in ports]

    def close(self) -> None:
        for listener in self._listeners:
            listener.close()

    def _serve(self, near: socket.socket, port: int) -> None:
        with socket.create_connection((self._to, port)) as far:
            far.settimeout(None)  # whatever the default of this process: the xArm's SDK changes it
            back = threading.Thread(target=self._pass, args=(far, near), daemon=True)
            back.start()
            self._pass(near, far)
            back.join()

    def _pass(self, source: socket.socket, sink: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(4096):
                if not self.cut:
                    sink.sendall(data)
            sink.shutdown(socket.SHUT_RDWR)
