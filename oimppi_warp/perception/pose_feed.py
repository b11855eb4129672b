"""The object's pose over TCP, from whatever detects the object: one line of JSON for each detection.

A line is ``{"stamp": 1764273000.25, "x": 0.5, "y": 0.1, "yaw": 0.3}``: the time at which the image was taken, in
seconds since 1970 as ``time.time()`` returns it, and the planar pose of the object's frame in the world, in metres and
radians. The detector is the server, so that it can run anywhere and serve several planners.
"""

from __future__ import annotations

import json
import math
import socket
import threading
import time
from collections import deque
from contextlib import suppress

import numpy as np

from oimppi_warp.network import Listener, split_address
from oimppi_warp.perception.pose_source import StampedPose

PORT = 17501
"""Default port."""
_KEPT = 4
"""Number of the latest poses that are kept."""
_RETRY = 0.5
"""Time between attempts to connect [s]."""
_SILENCE = 10.0
"""Time without a pose after which the connection is made anew [s]."""
_LONGEST_LINE = 4096
"""Longest line that is read [B]."""


class PoseServer:
    """Sends poses to every client; one that connects gets the latest ones at once.

    Args:
        host: Address to listen on.
        port: Port; 0 takes a free one.

    Attributes:
        port: The port.

    Raises:
        HardwareError: The address cannot be listened on.
    """

    def __init__(self, host: str, port: int = PORT) -> None:
        self._latest: deque[bytes] = deque(maxlen=_KEPT)
        self._listener = Listener(host, port, self._serve)
        self.port = self._listener.port

    def publish(self, pose: np.ndarray, stamp: float) -> None:
        """Sends a pose.

        Args:
            pose: Planar pose, shape [3] [m, m, rad].
            stamp: Time at which the object had it, in seconds since 1970.
        """
        x, y, yaw = map(float, pose)
        line = json.dumps({"stamp": stamp, "x": x, "y": y, "yaw": yaw}).encode() + b"\n"
        self._latest.append(line)
        for link in self._listener.connections():
            with suppress(OSError):
                link.sendall(line)

    def close(self) -> None:
        """Ends all connections."""
        self._listener.close()

    def _serve(self, link: socket.socket) -> None:
        link.sendall(b"".join(self._latest))
        while link.recv(4096):
            pass


class PoseReceiver:
    """Receives poses in the background, and connects again whenever the connection is lost.

    Args:
        address: Address of the server as ``HOST`` or ``HOST:PORT``.

    Raises:
        ConfigError: The address cannot be read.
    """

    def __init__(self, address: str) -> None:
        self._host, self._port = split_address(address, PORT)
        self._poses: deque[StampedPose] = deque(maxlen=_KEPT)
        self._problem = f"no pose of the object has arrived from {self._host}:{self._port}"
        self._open = True
        self._thread = threading.Thread(target=self._run, name="oimppi-poses", daemon=True)
        self._thread.start()

    @property
    def latest(self) -> StampedPose | None:
        """Returns the newest pose; ``None`` before the first one."""
        return self._poses[-1] if self._poses else None

    @property
    def poses(self) -> list[StampedPose]:
        """Returns the newest poses, the latest last."""
        return list(self._poses)

    @property
    def problem(self) -> str:
        """Returns why no poses arrive at present; empty if none is known."""
        return self._problem

    def close(self) -> None:
        """Stops receiving."""
        self._open = False
        self._thread.join(timeout=2.0)

    def _run(self) -> None:
        while self._open:
            try:
                with socket.create_connection((self._host, self._port), timeout=1.0) as link:
                    link.settimeout(_RETRY)
                    self._problem = f"connected to {self._host}:{self._port}, but no pose of the object has arrived yet"
                    self._receive(link)
                    self._problem = f"{self._host}:{self._port} closed the connection"
            except OSError as error:
                self._problem = f"the poses at {self._host}:{self._port} cannot be received: {error.strerror or error}"
            if self._open:
                time.sleep(_RETRY)

    def _receive(self, link: socket.socket) -> None:
        received, heard = b"", time.monotonic()
        while self._open:
            try:
                data = link.recv(4096)
            except TimeoutError:
                if time.monotonic() > heard + _SILENCE:
                    return  # the cable may have been cut
                continue
            heard = time.monotonic()
            if not data:
                return
            *lines, received = (received + data).split(b"\n")
            for line in lines:
                self._take(line)
            if len(received) > _LONGEST_LINE:
                self._problem = f"{self._host}:{self._port} sends no lines: is it a server of poses?"
                return

    def _take(self, line: bytes) -> None:
        try:
            found = json.loads(line)
            stamp, *pose = (float(found[name]) for name in ("stamp", "x", "y", "yaw"))
            if not all(map(math.isfinite, (stamp, *pose))):
                raise ValueError
        except Exception:  # whatever it is, it is no pose
            self._problem = f"{self._host}:{self._port} sent a line that is no pose: {line[:80]!r}"
            return
        self._problem = ""
        if not any(known.stamp == stamp for known in self._poses):  # a server repeats its latest ones to new clients
            self._poses.append(StampedPose(np.array(pose), time.monotonic(), time.time() - stamp, stamp))
