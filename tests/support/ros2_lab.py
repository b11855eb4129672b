"""A simulated lab on ROS 2 topics of this machine, for tests; every one has a domain of its own."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from support import small_tasks

from oimppi_warp.config.presets import lab
from oimppi_warp.plants.ros2.dds_link import DdsLink
from oimppi_warp.plants.ros2.lab import Ros2Lab
from oimppi_warp.plants.ros2.plant import Ros2Plant

HERE = "127.0.0.1"
_AT_ONCE = 8
"""Number of the latest domains of a process that stay locked."""
_taken: list[socket.socket] = []


def new_domain() -> int:
    """A domain that no other test on this machine uses at the same time: its number is locked by a port."""
    for domain in range(20, 101):  # beyond it, the ports of a domain may be in use by any program
        lock = socket.socket()
        try:
            lock.bind((HERE, 19000 + domain))
        except OSError:
            lock.close()
            continue
        _taken.append(lock)
        if len(_taken) > _AT_ONCE:
            _taken.pop(0).close()
        return domain
    raise RuntimeError("no domain is free")


@contextmanager
def simulated(**options: Any) -> Iterator[Ros2Lab]:
    """A lab with the object of lab01, whose camera makes no errors and sees the object ten times a second."""
    config = lab().lab
    exact = replace(config, rate=10.0, delay=0.05, position_noise=0.0, yaw_noise=0.0, outlier_probability=0.0)
    domain = options.pop("domain", None) or new_domain()
    link = options.pop("link", None) or DdsLink(domain, HERE)
    made = Ros2Lab(small_tasks.shipped("lab01"), exact, link, **options)
    made.domain = domain  # pyright: ignore
    made.start()
    try:
        yield made
    finally:
        made.close()


@contextmanager
def connected(made: Ros2Lab, **options: Any) -> Iterator[Ros2Plant]:
    """The plant on the topics of a lab, with the arm at its start posture."""
    options = {"yes": True, "domain": made.domain, "peers": HERE, **options}  # pyright: ignore
    plant = Ros2Plant(small_tasks.shipped("lab01"), lab(), **options)
    try:
        yield plant
    finally:
        plant.close()


@contextmanager
def other_node(domain: int) -> Iterator[DdsLink]:
    """Another program in a domain."""
    link = DdsLink(domain, HERE)
    try:
        yield link
    finally:
        link.close()
