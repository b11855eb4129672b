"""Fixtures shared by all tests: the device to compute on."""

from __future__ import annotations

import os

import pytest


def pytest_configure() -> None:
    """Ends the run at once where there is no such device as was asked for."""
    if os.environ.get("OIMPPI_TEST_DEVICE"):
        from oimppi_warp.errors import DeviceError

        try:
            import support.device  # noqa: F401
        except DeviceError as error:
            raise pytest.UsageError(str(error).replace("--device ", "OIMPPI_TEST_DEVICE=")) from None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Lets tests in real time run again where they fail, except slow ones, of which some take an hour.

    An emulated arm stops, as it should, where the machine stands still for a fifth of a second.
    """
    for item in items:
        if item.get_closest_marker("realtime") and not item.get_closest_marker("slow"):
            item.add_marker(pytest.mark.flaky(reruns=2))


@pytest.fixture(scope="session")
def device() -> str:
    """Warp device to compute on: the environment variable ``OIMPPI_TEST_DEVICE`` names it, ``cpu`` by default.

    Tests about the CPU itself (threads, MuJoCo's C engine, bits of a CPU plan, other processes) do not ask for it.
    """
    from support.device import DEVICE

    return DEVICE
