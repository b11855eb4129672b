"""A connection to ROS 2 without ROS: Cyclone DDS, with the names, types and qualities of service that ROS uses."""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache
from typing import Any
from xml.sax.saxutils import quoteattr

from oimppi_warp.errors import ConfigError, HardwareError
from oimppi_warp.plants.ros2.link import Endpoint, Qos
from oimppi_warp.plants.ros2.messages import build, dds_type, missing, ros_name, type_hash

_HERE = "127.0.0.1"
_DEPTH = 10
"""Number of messages that are kept for each subscriber."""
_LATCHED_DEPTH = 100
_MOST = 1000
"""Most news of endpoints that are read at once."""
_NEVER = 2**62
"""Deadline from which on there is none [ns]."""
_WAIT = 100_000_000
"""Time after which the receiving thread looks whether it should end [ns]."""


class DdsLink:
    """A connection through Cyclone DDS (:class:`oimppi_warp.plants.ros2.link.Link`).

    Args:
        domain: Number of the domain; -1: that of the environment variable ``ROS_DOMAIN_ID``, or 0.
        peers: Addresses of other machines, with commas; empty: multicast, or as ``CYCLONEDDS_URI`` says.

    Attributes:
        name: Name in messages.
        number: Number of the domain.

    Raises:
        ConfigError: cyclonedds is not installed, or the domain is not allowed.
        HardwareError: There is no network to connect to.
    """

    def __init__(self, domain: int = -1, peers: str = "") -> None:
        try:
            from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription
            from cyclonedds.core import DDSException, InstanceState, ReadCondition, SampleState, ViewState, WaitSet
            from cyclonedds.domain import DomainParticipant
            from cyclonedds.qos import Policy
            from cyclonedds.qos import Qos as DdsQos
        except ImportError:
            raise missing("cyclonedds") from None

        self.number = number = _domain(domain)
        peers = peers or (_HERE if _stays_here() else "")
        self.name = f"ROS domain {number}"
        try:
            if peers:
                _configure(number, peers)
            self._participant = DomainParticipant(number, DdsQos(Policy.Userdata(b"enclave=/;")))
        except DDSException as error:
            raise HardwareError(
                f"no connection to {self.name}: {error.msg if hasattr(error, 'msg') else error}\n"
                "  to do:   check the network, and CYCLONEDDS_URI if it is set"
            ) from None
        self._guid = self._participant.guid
        news = InstanceState.Any | ViewState.Any | SampleState.NotRead
        self._discovery = [
            (publishes, reader, ReadCondition(reader, news))
            for publishes, reader in (
                (True, BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)),
                (False, BuiltinDataReader(self._participant, BuiltinTopicDcpsSubscription)),
            )
        ]
        self._known: dict[Any, tuple[str, Endpoint]] = {}  # topic in DDS and endpoint, by the endpoint's key
        self._topics: dict[tuple[str, str], Any] = {}
        self._readers: list[tuple[Any, Callable[[Any], None]]] = []
        self._writers: dict[tuple[str, str], Any] = {}  # each publishes until the connection ends
        self._lock = threading.RLock()
        self._wait = WaitSet(self._participant)
        self._open = True
        self._thread = threading.Thread(target=self._receive, name="oimppi-dds", daemon=True)
        self._thread.start()

    def subscribe(
        self, topic: str, kind: str, take: Callable[[Any], None], *, latched: bool = False, depth: int = 10
    ) -> None:
        """Receives messages of any reliability; see :class:`oimppi_warp.plants.ros2.link.Link`."""
        from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState
        from cyclonedds.sub import DataReader

        qos = _qos(kind, latched=latched, reliable=latched, depth=depth)
        with self._lock:
            reader = DataReader(self._participant, self._topic(topic, kind), qos)
            condition = ReadCondition(reader, InstanceState.Alive | ViewState.Any | SampleState.NotRead)
            self._readers.append((reader, take))
            self._wait.attach(condition)

    def advertise(
        self, topic: str, kind: str, *, latched: bool = False, reliable: bool = True
    ) -> Callable[[Mapping[str, Any]], None]:
        """Returns a function that publishes; see :class:`oimppi_warp.plants.ros2.link.Link`."""
        from cyclonedds.pub import DataWriter

        with self._lock:
            if (topic, kind) not in self._writers:
                qos = _qos(kind, latched=latched, reliable=reliable, depth=_DEPTH)
                self._writers[topic, kind] = DataWriter(self._participant, self._topic(topic, kind), qos)
            writer = self._writers[topic, kind]
        return lambda values: writer.write(build(kind, values, dds_type))

    def endpoints(self, topic: str) -> list[Endpoint]:
        """Returns the ends of a topic that are known now, own ones included."""
        return [end for name, end in self._ends() if name == f"rt{topic}"]

    def topics(self) -> list[str]:
        """Returns the topics that others publish, in alphabetical order."""
        names = {name for name, end in self._ends() if end.publishes and not end.own}
        return sorted(name.removeprefix("rt") for name in names if name.startswith("rt/"))

    def close(self) -> None:
        """Ends the connection."""
        self._open = False
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout=2.0)
        with self._lock:
            self._readers.clear()
            self._discovery.clear()
            # Everything in it is deleted too, whoever still refers to it.
            self._participant._delete(self._participant._ref)  # pyright: ignore[reportCallIssue]

    def _ends(self) -> list[tuple[str, Endpoint]]:
        """Returns all ends of topics, with the names of these in DDS; only what is new is read."""
        from cyclonedds.core import InstanceState

        with self._lock:
            for publishes, reader, condition in self._discovery:
                for end in reader.read(_MOST, condition=condition):
                    if end.sample_info.instance_state == InstanceState.Alive and end.topic_name:
                        own = end.participant_key == self._guid
                        found = Endpoint(ros_name(end.type_name), _quality(end.qos), publishes, own)
                        self._known[end.key] = (end.topic_name, found)
                    else:
                        self._known.pop(end.key, None)
            return list(self._known.values())

    def _topic(self, topic: str, kind: str) -> Any:
        from cyclonedds.topic import Topic

        if (topic, kind) not in self._topics:
            self._topics[topic, kind] = Topic(self._participant, f"rt{topic}", dds_type(kind))
        return self._topics[topic, kind]

    def _receive(self) -> None:
        """Hands on messages as they arrive: the loop of the thread."""
        from cyclonedds.sub import InvalidSample  # pyright: ignore[reportPrivateImportUsage]

        while self._open:
            self._wait.wait(timeout=_WAIT)
            with self._lock:
                readers = list(self._readers)
            for reader, take in readers:
                with suppress(Exception):  # of a message that is broken; the others go on
                    for message in reader.take(_LATCHED_DEPTH):
                        if not isinstance(message, InvalidSample):
                            take(message)


def _stays_here() -> bool:
    """Returns whether ROS's environment variables restrict it to this machine."""
    reach = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()
    return os.environ.get("ROS_LOCALHOST_ONLY") == "1" or reach in ("LOCALHOST", "OFF")


def _domain(number: int) -> int:
    """Returns the number of the domain to use; -1 stands for that of the environment.

    Raises:
        ConfigError: It is not allowed.
    """
    text = str(number) if number != -1 else os.environ.get("ROS_DOMAIN_ID") or "0"
    if not text.isdecimal() or int(text) > 232:
        raise ConfigError(f"ROS domain {text} cannot be used\n  allowed: 0 to 232 (domain, or ROS_DOMAIN_ID)")
    return int(text)


@cache
def _configure(domain: int, peers: str) -> Any:
    """Makes a domain whose participants are looked for at addresses only, without multicast.

    Raises:
        HardwareError: The domain was used before, in another way.
    """
    from cyclonedds.core import DDSException
    from cyclonedds.domain import Domain

    addresses = [peer.strip() for peer in peers.split(",") if peer.strip()]
    here = all(peer.startswith("127.") or peer == "localhost" for peer in addresses)
    choice = 'name="lo" multicast="false"' if here else 'autodetermine="true"'
    listed = "".join(f"<Peer Address={quoteattr(peer)}/>" for peer in addresses)
    settings = (
        f"<CycloneDDS><Domain><General><Interfaces><NetworkInterface {choice}/></Interfaces>"
        "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
        f"<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex><Peers>{listed}</Peers></Discovery>"
        "</Domain></CycloneDDS>"
    )
    try:
        return Domain(domain, settings)
    except DDSException:
        raise HardwareError(
            f"ROS domain {domain} is used in this process already, with other peers\n  to do:   use another domain"
        ) from None


def _qos(kind: str, *, latched: bool, reliable: bool, depth: int) -> Any:
    """Returns a quality of service as nodes of ROS use it, with the type's hash."""
    from cyclonedds.qos import Policy
    from cyclonedds.qos import Qos as DdsQos
    from cyclonedds.util import duration

    return DdsQos(
        Policy.Reliability.Reliable(duration(milliseconds=10)) if reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(_LATCHED_DEPTH if latched else depth),
        Policy.WriterDataLifecycle(autodispose=False),
        Policy.Userdata(f"typehash={type_hash(kind)};".encode()),
    )


def _quality(qos: Any) -> Qos:
    """Returns a quality of service of DDS as ours."""
    from cyclonedds.qos import Policy

    # Policies are classes, or members of classes, named after the policy.
    policies = {policy.__scope__: policy for policy in qos}
    reliability, durability = policies.get("Reliability"), policies.get("Durability")
    deadline = getattr(policies.get("Deadline"), "deadline", _NEVER)
    return Qos(
        reliable=isinstance(reliability, Policy.Reliability.Reliable),
        latched=durability not in (None, Policy.Durability.Volatile),
        deadline=math.inf if deadline >= _NEVER else 1e-9 * deadline,
    )
