"""The TCP servers of an emulated controller: one for commands, and one for each kind of report."""

from __future__ import annotations

import socket
import time
from collections.abc import Mapping

from oimppi_warp.errors import HardwareError
from oimppi_warp.network import Listener
from oimppi_warp.plants.xarm.controller import EmulatedController
from oimppi_warp.plants.xarm.protocol import COMMAND_PORT, REPORT_PERIODS, REPORT_PORTS, report, take_requests


class ControllerServer:
    """Serves an emulated controller on TCP, to any number of clients.

    Args:
        controller: The controller.
        host: Address to listen on, such as 127.0.0.2.
        command_port: Port of the commands; 0 takes a free one.
        report_ports: Ports of the reports by their kinds; 0 takes a free one.

    Attributes:
        command_port: Port of the commands.
        report_ports: Ports of the reports by their kinds.
        frozen: Whether the reports go on with old values, as a fault.

    Raises:
        HardwareError: An address cannot be listened on.
    """

    def __init__(
        self,
        controller: EmulatedController,
        host: str,
        *,
        command_port: int = COMMAND_PORT,
        report_ports: Mapping[str, int] = REPORT_PORTS,
    ) -> None:
        self._controller = controller
        self._open = True
        self.frozen = False
        self._listeners = [Listener(host, command_port, self._take_commands)]
        self.command_port = self._listeners[0].port
        self.report_ports: dict[str, int] = {}
        try:
            for kind, port in report_ports.items():
                self._listeners.append(Listener(host, port, lambda link, kind=kind: self._send_reports(link, kind)))
                self.report_ports[kind] = self._listeners[-1].port
        except HardwareError:
            self.close()
            raise

    def close(self) -> None:
        """Stops serving."""
        self._open = False
        for listener in self._listeners:
            listener.close()

    def _take_commands(self, link: socket.socket) -> None:
        received = bytearray()
        while data := link.recv(4096):
            received += data
            for request in take_requests(received):
                link.sendall(self._controller.handle(request))

    def _send_reports(self, link: socket.socket, kind: str) -> None:
        due, seen = time.monotonic(), self._controller.snapshot()
        while self._open:
            if not self.frozen:
                seen = self._controller.snapshot()
            link.sendall(report(kind, seen))
            due = max(due + REPORT_PERIODS[kind], time.monotonic() - 0.1)
            time.sleep(max(due - time.monotonic(), 0.0))
