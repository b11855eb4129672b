"""Addresses: what can be listened at, and the URL that a browser takes."""

from __future__ import annotations

import socket

import pytest

from oimppi_warp.cli.main import main
from oimppi_warp.errors import ConfigError
from oimppi_warp.network import check_listening, page_url


@pytest.mark.parametrize("host", ["192.0.2.1", "nosuch.host.invalid", "2001:db8::1"])
def test_an_address_that_this_machine_has_not(host, capsys):
    with pytest.raises(ConfigError, match=f"cannot listen at {host}, port 8941"):
        check_listening(host, 8941)
    assert main(["view", "task01", "--host", host, "--port", "8941"]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"oimppi: cannot listen at {host}, port 8941")
    assert "to do:" in said


def test_a_port_that_is_taken_is_no_reason(monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        taken.listen()
        check_listening("127.0.0.1", taken.getsockname()[1])
    for host in ("127.0.0.1", "localhost", "0.0.0.0"):
        check_listening(host, 8941)


def test_a_port_that_is_not_allowed(monkeypatch):
    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(socket.socket, "bind", refuse)
    with pytest.raises(ConfigError, match="1024 to 65535"):
        check_listening("127.0.0.1", 80)


def test_urls_that_a_browser_takes():
    assert page_url("127.0.0.1", 8080) == "http://127.0.0.1:8080"
    assert page_url("::1", 8941) == "http://[::1]:8941"
    assert page_url("0.0.0.0", 80) == page_url("::", 80) == f"http://{socket.gethostname()}:80"
