"""A connection to ROS 2, through DDS or through rclpy, and why two ends of a topic do not match."""

from __future__ import annotations

import importlib.util
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from oimppi_warp.errors import ConfigError


@dataclass(frozen=True)
class Qos:
    """Quality of service of one end of a topic, as far as it decides whether two ends match.

    Attributes:
        reliable: Whether messages that were lost are sent again.
        latched: Whether late subscribers get the last messages (durability transient local).
        deadline: Longest time between two messages that is promised or asked for [s].
    """

    reliable: bool = True
    latched: bool = False
    deadline: float = math.inf

    def lacks(self, asked: Qos) -> str:
        """Returns what a publisher with this quality does not offer that a subscriber asks for; empty if nothing."""
        if asked.reliable and not self.reliable:
            return "reliability: best effort is offered, reliable is asked for"
        if asked.latched and not self.latched:
            return "durability: volatile is offered, transient local is asked for"
        if self.deadline > asked.deadline:
            return f"deadline: {self.deadline:g} s is offered, {asked.deadline:g} s is asked for"
        return ""


@dataclass(frozen=True)
class Endpoint:
    """One end of a topic.

    Attributes:
        kind: Type of its messages, such as ``std_msgs/msg/String``.
        qos: Its quality of service.
        publishes: Whether it publishes; otherwise it subscribes.
        own: Whether it belongs to this connection.
    """

    kind: str
    qos: Qos
    publishes: bool
    own: bool


class Link(Protocol):
    """A connection to ROS 2.

    Attributes:
        name: Name in messages.
    """

    name: str

    def subscribe(
        self, topic: str, kind: str, take: Callable[[Any], None], *, latched: bool = False, depth: int = 10
    ) -> None:
        """Receives messages of any reliability.

        Args:
            topic: Name of the topic, beginning with a slash.
            kind: Type of the messages.
            take: Receives each message, in a thread of the connection.
            latched: Whether to ask for the last messages from before too.
            depth: Number of messages that may wait.
        """
        ...

    def advertise(
        self, topic: str, kind: str, *, latched: bool = False, reliable: bool = True
    ) -> Callable[[Mapping[str, Any]], None]:
        """Returns a function that publishes a message, given by its fields (see ``messages.build``).

        A topic that is advertised again has one publisher still.
        """
        ...

    def endpoints(self, topic: str) -> list[Endpoint]:
        """Returns the ends of a topic that are known now, own ones included."""
        ...

    def topics(self) -> list[str]:
        """Returns the topics that others publish, in alphabetical order."""
        ...

    def close(self) -> None:
        """Ends the connection."""
        ...


def connect(*, domain: int, peers: str, through: str = "auto") -> Link:
    """Connects to ROS 2: through rclpy if it can be imported, otherwise through Cyclone DDS.

    Args:
        domain: Number of the domain; -1: that of the environment variable ``ROS_DOMAIN_ID``, or 0.
        peers: Addresses of other machines, with commas, where multicast does not reach them; empty: multicast, or as
            the environment variable ``CYCLONEDDS_URI`` says.
        through: ``rclpy``, ``dds`` or ``auto``.

    Raises:
        ConfigError: The package is not installed, or the domain is not allowed.
        HardwareError: There is no network to connect to.
    """
    if through == "rclpy" or (through == "auto" and not peers and importlib.util.find_spec("rclpy") is not None):
        from oimppi_warp.plants.ros2.rclpy_link import RclpyLink

        try:
            return RclpyLink(domain)
        except ConfigError as error:
            if through == "rclpy":
                raise
            print(f"using Cyclone DDS: {str(error).splitlines()[0]}", file=sys.stderr)
    from oimppi_warp.plants.ros2.dds_link import DdsLink

    return DdsLink(domain, peers)


def why_no_messages(link: Link, topic: str, kind: str, *, latched: bool = False) -> str:
    """Returns in words why a subscription gets nothing, with what to do.

    Args:
        link: The connection.
        topic: Name of the topic.
        kind: Type that was subscribed to.
        latched: Whether the last messages from before were asked for.
    """
    others = [end for end in link.endpoints(topic) if end.publishes and not end.own]
    if not others:
        known = ", ".join(link.topics()) or "none"
        return f"nothing publishes {topic} in {link.name}\n  to do:   start what publishes it; topics there: {known}"
    kinds = sorted({end.kind for end in others})
    if kind not in kinds:
        return f"{topic} is published as {', '.join(kinds)}, not as {kind}\n  to do:   name another topic or type"
    lacks = others[0].qos.lacks(Qos(reliable=False, latched=latched))
    if lacks:
        return f"the quality of service of {topic} does not match: {lacks}\n  to do:   change that of its publisher"
    return f"{topic} is published, but no message has arrived\n  to do:   see `ros2 topic echo {topic}` where it is"


def why_nobody_listens(link: Link, topic: str, kind: str, qos: Qos) -> str:
    """Returns in words why nobody receives what is published on a topic, with what to do; empty if somebody does.

    Args:
        link: The connection.
        topic: Name of the topic.
        kind: Type that is published.
        qos: Quality of service with which it is published.
    """
    others = [end for end in link.endpoints(topic) if not end.publishes and not end.own]
    if any(end.kind == kind and not qos.lacks(end.qos) for end in others):
        return ""
    if not others:
        return f"nothing listens to {topic} in {link.name}\n  to do:   start the arm's velocity controller"
    kinds = sorted({end.kind for end in others})
    if kind not in kinds:
        return f"what listens to {topic} expects {', '.join(kinds)}, not {kind}\n  to do:   set command_type"
    lacks = next(qos.lacks(end.qos) for end in others if end.kind == kind)
    return f"the quality of service of {topic} does not match: {lacks}\n  to do:   change that of its subscriber"
