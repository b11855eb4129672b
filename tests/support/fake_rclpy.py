"""As much of rclpy as the plant uses, within one process, written after its documentation.

It shows that the calls fit together, not that they fit a ROS installation.
"""

from __future__ import annotations

import sys
import threading
import types
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, ClassVar

import pytest

from oimppi_warp.plants.ros2.messages import dds_type, typestore


class ReliabilityPolicy(Enum):
    RELIABLE = 1
    BEST_EFFORT = 2


class DurabilityPolicy(Enum):
    TRANSIENT_LOCAL = 1
    VOLATILE = 2


@dataclass
class Duration:
    nanoseconds: int = 0


@dataclass
class QoSProfile:
    depth: int
    reliability: ReliabilityPolicy
    durability: DurabilityPolicy
    deadline: Duration = field(default_factory=Duration)


@dataclass
class EndpointInfo:
    node_name: str
    topic_type: str
    qos_profile: QoSProfile


class SignalHandlerOptions(Enum):
    NO = 1


class Context:
    def __init__(self) -> None:
        self.domain, self.open = 0, False

    def try_shutdown(self) -> None:
        self.open = False


class Node:
    nodes: ClassVar[list[Node]] = []

    def __init__(self, name: str, context: Context) -> None:
        assert context.open
        self.name, self.context = name, context
        self.ends: list[tuple[bool, str, type, QoSProfile, Any]] = []
        Node.nodes.append(self)

    def _all(self, publishes: bool, topic: str | None = None) -> list[tuple[Node, str, type, QoSProfile, Any]]:
        near = [node for node in Node.nodes if node.context.domain == self.context.domain]
        return [
            (node, *end[1:]) for node in near for end in node.ends if end[0] == publishes and topic in (None, end[1])
        ]

    def create_subscription(self, kind: type, topic: str, take: Any, qos: QoSProfile) -> None:
        self.ends.append((False, topic, kind, qos, take))

    def create_publisher(self, kind: type, topic: str, qos: QoSProfile) -> Any:
        self.ends.append((True, topic, kind, qos, None))

        def publish(message: Any) -> None:
            assert type(message) is kind
            for _, _, expected, _, take in self._all(False, topic):
                if expected is kind:
                    take(message)

        return types.SimpleNamespace(publish=publish)

    def _info(self, publishes: bool, topic: str) -> list[EndpointInfo]:
        return [EndpointInfo(node.name, kind.ros_name, qos) for node, _, kind, qos, _ in self._all(publishes, topic)]

    def get_publishers_info_by_topic(self, topic: str) -> list[EndpointInfo]:
        return self._info(True, topic)

    def get_subscriptions_info_by_topic(self, topic: str) -> list[EndpointInfo]:
        return self._info(False, topic)

    def get_topic_names_and_types(self) -> list[tuple[str, list[str]]]:
        return sorted({(topic, kind.ros_name) for _, topic, kind, _, _ in (*self._all(True), *self._all(False))})

    def destroy_node(self) -> None:
        Node.nodes.remove(self)


class SingleThreadedExecutor:
    def __init__(self, context: Context) -> None:
        self._ended = threading.Event()

    def add_node(self, node: Node) -> None:
        pass

    def spin(self) -> None:
        self._ended.wait()

    def shutdown(self) -> None:
        self._ended.set()


def install(monkeypatch: pytest.MonkeyPatch) -> None:
    """Makes rclpy, and the messages that rosbags knows, importable."""

    def init(*, context: Context, domain_id: int | None, signal_handler_options: SignalHandlerOptions) -> None:
        context.domain, context.open = domain_id or 0, True

    def add(name: str, **members: Any) -> None:
        module = types.ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)

    add("rclpy", Context=Context, init=init, create_node=lambda name, *, context: Node(name, context))
    add("rclpy.executors", SingleThreadedExecutor=SingleThreadedExecutor)
    add("rclpy.signals", SignalHandlerOptions=SignalHandlerOptions)
    add(
        "rclpy.qos",
        QoSProfile=QoSProfile,
        ReliabilityPolicy=ReliabilityPolicy,
        DurabilityPolicy=DurabilityPolicy,
    )
    packages: dict[str, dict[str, Any]] = {}
    for kind in typestore().fielddefs:
        package, folder, name = kind.split("/")
        if package in ("std_msgs", "geometry_msgs", "sensor_msgs", "tf2_msgs", "rosgraph_msgs", "builtin_interfaces"):
            made = type(name, (dds_type(kind),), {"ros_name": kind})
            packages.setdefault(f"{package}.{folder}", {})[name] = made
    for name, members in packages.items():
        add(name.partition(".")[0])
        add(name, **members)
