"""A connection to ROS 2 through rclpy, where ROS is installed."""

# pyright: reportMissingImports=false

from __future__ import annotations

import importlib
import os
import threading
import uuid
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache
from typing import Any

from oimppi_warp.errors import ConfigError
from oimppi_warp.plants.ros2.link import Endpoint, Qos
from oimppi_warp.plants.ros2.messages import build

_DEPTH = 10
"""Number of messages that are kept for each subscriber."""
_LATCHED_DEPTH = 100


class RclpyLink:
    """A connection through rclpy (:class:`oimppi_warp.plants.ros2.link.Link`), with a context of its own.

    Args:
        domain: Number of the domain; -1: that of the environment variable ``ROS_DOMAIN_ID``, or 0.

    Raises:
        ConfigError: rclpy cannot be imported.
    """

    def __init__(self, domain: int = -1) -> None:
        try:
            import rclpy
            from rclpy.executors import SingleThreadedExecutor
            from rclpy.signals import SignalHandlerOptions
        except ImportError as error:
            raise ConfigError(
                f"rclpy cannot be imported: {error}\n  to do:   source the setup file of your ROS installation"
            ) from None
        self._context = rclpy.Context()
        # Ctrl-C ends our own loop first, which stops the arm over this connection.
        rclpy.init(
            context=self._context,
            domain_id=None if domain == -1 else domain,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        number = domain if domain != -1 else int(os.environ.get("ROS_DOMAIN_ID") or 0)
        self.name = f"ROS domain {number}"
        self._node_name = f"oimppi_{uuid.uuid4().hex[:8]}"  # no other planner has it
        self._node = rclpy.create_node(self._node_name, context=self._context)
        self._publishers: dict[tuple[str, str], Any] = {}
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._executor.spin, name="oimppi-rclpy", daemon=True)
        self._thread.start()

    def subscribe(
        self, topic: str, kind: str, take: Callable[[Any], None], *, latched: bool = False, depth: int = 10
    ) -> None:
        """Receives messages of any reliability; see :class:`oimppi_warp.plants.ros2.link.Link`."""

        def guarded(message: Any) -> None:
            with suppress(Exception):  # of a message that is broken; the others go on
                take(message)

        profile = _profile(latched=latched, reliable=latched, depth=depth)
        self._node.create_subscription(_class(kind), topic, guarded, profile)

    def advertise(
        self, topic: str, kind: str, *, latched: bool = False, reliable: bool = True
    ) -> Callable[[Mapping[str, Any]], None]:
        """Returns a function that publishes; see :class:`oimppi_warp.plants.ros2.link.Link`."""
        if (topic, kind) not in self._publishers:
            profile = _profile(latched=latched, reliable=reliable, depth=_DEPTH)
            self._publishers[topic, kind] = self._node.create_publisher(_class(kind), topic, profile)
        publisher = self._publishers[topic, kind]
        return lambda values: publisher.publish(build(kind, values, _class))

    def endpoints(self, topic: str) -> list[Endpoint]:
        """Returns the ends of a topic that are known now, own ones included."""
        node = self._node
        listed = (
            (True, node.get_publishers_info_by_topic(topic)),
            (False, node.get_subscriptions_info_by_topic(topic)),
        )
        return [
            Endpoint(end.topic_type, _quality(end.qos_profile), publishes, end.node_name == self._node_name)
            for publishes, ends in listed
            for end in ends
        ]

    def topics(self) -> list[str]:
        """Returns the topics that others publish, in alphabetical order."""
        names = [name for name, _ in self._node.get_topic_names_and_types()]
        return sorted(name for name in names if any(end.publishes and not end.own for end in self.endpoints(name)))

    def close(self) -> None:
        """Ends the connection."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()
        self._thread.join(timeout=2.0)


@cache
def _class(kind: str) -> Any:
    """Returns the class of a message.

    Raises:
        ConfigError: Its package is not installed.
    """
    package, folder, name = kind.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{folder}"), name)
    except ImportError:
        raise ConfigError(
            f"messages of type {kind} are not installed\n  to do:   install the ROS package {package}"
        ) from None


def _profile(*, latched: bool, reliable: bool, depth: int) -> Any:
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    return QoSProfile(
        depth=_LATCHED_DEPTH if latched else depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def _quality(profile: Any) -> Qos:
    """Returns a quality of service of rclpy as ours."""
    from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

    deadline = 1e-9 * profile.deadline.nanoseconds
    return Qos(
        reliable=profile.reliability == ReliabilityPolicy.RELIABLE,
        latched=profile.durability == DurabilityPolicy.TRANSIENT_LOCAL,
        deadline=deadline if 0.0 < deadline < 1e9 else float("inf"),
    )
