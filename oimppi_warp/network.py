"""Addresses, the URL of a page, and a TCP server that serves each connection in a thread."""

from __future__ import annotations

import errno
import socket
import threading
from collections.abc import Callable
from contextlib import suppress

from oimppi_warp.errors import ConfigError, HardwareError


class Listener:
    """Accepts connections and serves each in a thread of its own, until it is closed.

    Args:
        host: Address to listen on.
        port: Port; 0 takes a free one.
        serve: Serves one connection; the socket is closed when it returns or raises an ``OSError``.

    Attributes:
        port: The port.

    Raises:
        HardwareError: The address cannot be listened on.
    """

    def __init__(self, host: str, port: int, serve: Callable[[socket.socket], None]) -> None:
        self._serve = serve
        self._connections: set[socket.socket] = set()
        self._lock = threading.Lock()
        try:
            self._socket = socket.create_server((host, port))
        except OSError as error:
            low = "\n  to do:   ports below 1024 may need root; choose another one" if 0 < port < 1024 else ""
            raise HardwareError(f"cannot listen on {host}:{port}: {error.strerror or error}{low}") from None
        self._socket.settimeout(None)  # whatever the default of this process: the xArm's SDK changes it
        self.port: int = self._socket.getsockname()[1]
        threading.Thread(target=self._accept, name=f"oimppi-listen-{self.port}", daemon=True).start()

    def close(self) -> None:
        """Stops listening and ends all connections."""
        # A thread that waits in `accept` is woken by a shutdown only.
        for each in (self._socket, *self.connections()):
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()

    def connections(self) -> list[socket.socket]:
        """Returns the connections that are open."""
        with self._lock:
            return list(self._connections)

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._socket.accept()
            except OSError:
                return
            connection.settimeout(None)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with self._lock:
                self._connections.add(connection)
            threading.Thread(target=self._run, args=(connection,), daemon=True).start()

    def _run(self, connection: socket.socket) -> None:
        with suppress(OSError), connection:
            self._serve(connection)
        with self._lock:
            self._connections.discard(connection)


def split_address(address: str, port: int) -> tuple[str, int]:
    """Splits an address into host and port.

    Args:
        address: ``HOST`` or ``HOST:PORT``; an IPv6 address with a port is in brackets.
        port: Port if none is given.

    Raises:
        ConfigError: The port is no number from 1 to 65535, or there is no host.
    """
    host, colon, given = address.rpartition(":")
    if not colon or (":" in host and not host.endswith("]")):
        host, given = address, str(port)
    host = host.strip("[]")
    if not host or not given.isdecimal() or not 1 <= int(given) <= 65535:
        raise ConfigError(f"{address} is no address\n  allowed: HOST or HOST:PORT, with a port from 1 to 65535")
    return host, int(given)


def check_listening(host: str, port: int) -> None:
    """Checks that this machine can listen at an address, on a port or, if that is taken, on another one.

    Args:
        host: Address or name of this machine, or ``0.0.0.0`` or ``::`` for all of its addresses.
        port: Port.

    Raises:
        ConfigError: It cannot.
    """
    try:
        family, kind, protocol, _, where = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as tried:
            tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            tried.bind(where)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            return
        remedy = (
            "choose a port from 1024 to 65535" if error.errno == errno.EACCES else "give an address of this machine"
        )
        raise ConfigError(f"cannot listen at {host}, port {port}: {error.strerror}\n  to do:   {remedy}") from None


def free_port(host: str, port: int) -> int:
    """Returns the first port from a given one on at which nothing listens.

    Args:
        host: Address of this machine.
        port: First port to try.

    Raises:
        ConfigError: There is none.
    """
    family, kind, protocol, _, where = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    for number in range(port, 65536):
        with socket.socket(family, kind, protocol) as tried, suppress(OSError):
            tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            tried.bind((where[0], number, *where[2:]))
            return number
    raise ConfigError(f"no port from {port} on is free at {host}\n  to do:   choose a lower port")


def page_url(host: str, port: int) -> str:
    """Returns the URL of a page that is served at an address.

    Args:
        host: Address that the server listens at; for ``0.0.0.0`` and ``::``, the URL has the name of this machine.
        port: Port.
    """
    if host in ("0.0.0.0", "::", ""):
        host = socket.gethostname()
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
