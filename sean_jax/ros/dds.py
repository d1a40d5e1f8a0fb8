"""DDS with the names and types of ROS 2, by Cyclone DDS: Twist is geometry_msgs::msg::dds_::Twist_ on rt/cmd_vel.

The types are made of the definitions of the package ``rosbags``. Without CYCLONEDDS_URI the participant is on this
computer alone, as with ROS 2's ROS_LOCALHOST_ONLY.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Mapping
from typing import Any

import numpy as np

from sean_jax.core.bounds import parse_digits
from sean_jax.core.errors import InputError
from sean_jax.ros.messages import BYTES, fill, typestore
from sean_jax.ros.transport import Mailbox, Output

LOCAL = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>
<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex><Peers><Peer address="localhost"/></Peers></Discovery>
</Domain></CycloneDDS>"""
POLL = 0.2  # s, after which the reading thread looks whether it should end


class Participant:
    """A participant of a domain as a ``Transport``."""

    def __init__(self, domain: str, mailbox: Mailbox, outputs: Mapping[str, Output]):
        """Join a domain, whose number is a text.

        Raises:
            InputError: Cyclone DDS is missing, or cannot join.
        """
        try:
            from cyclonedds import core
            from cyclonedds.domain import Domain, DomainParticipant
        except ImportError as error:
            raise InputError(f'dds: {error.name} is missing; pip install "sean_jax[dds]".') from None
        number = parse_digits(domain)
        if number is None or number > 230:
            raise InputError(f"dds: {domain!r} is no number of a domain; give one from 0 to 230.")
        self.address = f"DDS domain {domain}"
        try:
            self._domain = None if "CYCLONEDDS_URI" in os.environ else Domain(number, LOCAL)
            self._participant: Any = DomainParticipant(number)
        except core.DDSException as error:
            raise InputError(f"dds: domain {domain} cannot be joined: {error}; see CYCLONEDDS_URI.") from None
        self._mailbox = mailbox
        self._services = list(mailbox.names.services.values())
        self._types = Types()
        self._kinds = {name: output.type for name, output in outputs.items()}
        self._latched = {name for name, output in outputs.items() if output.latched}

        self._request = mailbox.names.within(f"/{mailbox.names.node}/request")
        self._make_writers()
        self._make_readers()
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._read, name="sean-dds", daemon=True)
        self._thread.start()

    def _make_writers(self) -> None:
        """A writer for each topic of the simulation; late readers of latched ones get the last message."""
        from cyclonedds import pub, topic

        latched = _quality(latched=True, depth=1)
        queued = _quality(latched=False, depth=10)
        self._writers = {}
        for name, kind in self._kinds.items():
            quality = latched if name in self._latched else queued
            described = topic.Topic(self._participant, f"rt{name}", self._types.struct(kind), qos=quality)
            self._writers[name] = pub.DataWriter(self._participant, described, qos=quality)

    def _make_readers(self) -> None:
        """A reader for each topic of the controller; a topic of a String stands for services, which DDS has not."""
        from cyclonedds import core, sub, topic

        newest = _quality(latched=False, depth=1)
        unread = core.SampleState.NotRead | core.InstanceState.Any | core.ViewState.Any
        self._readers = {}
        self._wait = core.WaitSet(self._participant)
        for name, kind in {**self._mailbox.names.inputs, self._request: "std_msgs/msg/String"}.items():
            described = topic.Topic(self._participant, f"rt{name}", self._types.struct(kind), qos=newest)
            reader = sub.DataReader(self._participant, described, qos=newest)
            self._wait.attach(core.ReadCondition(reader, unread))
            self._readers[name] = reader

    def wanted(self, topic: str) -> bool:
        """Whether a reader of a topic is there; latched ones are kept for later."""
        return topic in self._latched or self._writers[topic].get_publication_matched_status().current_count > 0

    def publish(self, topic: str, message: dict[str, Any]) -> None:
        """Send a message; one that no reader takes within a second is left out, and named in the log."""
        try:
            self._writers[topic].write(self._types.fill(self._kinds[topic], message))
        except Exception as error:  # DDSException: a reliable reader does not answer
            self._mailbox.log("dds write", f"dds: a message of {topic} was left out: {error}.")

    def close(self) -> None:
        """End the thread, and leave the domain."""
        self._closed.set()
        self._thread.join(5.0)
        self._readers.clear()
        self._writers.clear()
        self._wait = self._participant = self._domain = None

    def _read(self) -> None:
        while not self._closed.is_set():
            self._wait.wait(int(POLL * 1e9))  # pyright: ignore[reportOptionalMemberAccess]
            for name, reader in self._readers.items():  # pyright: ignore[reportOptionalMemberAccess]
                try:
                    for sample in reader.take(16):
                        self._receive(name, sample)
                except Exception as error:  # bytes that are no message of the type
                    self._mailbox.log("dds read", f"dds: a message of {name} was dropped: {str(error)[:200]}.")

    def _receive(self, name: str, sample: Any) -> None:
        if type(sample).__name__ == "InvalidSample":  # a writer that has ended
            return
        if name != self._request:
            return self._mailbox.receive(name, _as_dict(sample))
        word = sample.data
        if word not in self._services:
            known = ", ".join(self._services)
            return self._mailbox.log("dds request", f"dds: the request {word[:40]!r} is not one of {known}.")
        threading.Thread(target=self._mailbox.request, args=(word,), name="sean-dds-request", daemon=True).start()


def _quality(latched: bool, depth: int) -> Any:
    """Cyclone DDS's quality of service: reliable, with so many messages that may wait for a reader."""
    from cyclonedds import core

    policy = core.Policy
    durability = policy.Durability.TransientLocal if latched else policy.Durability.Volatile
    return core.Qos(policy.Reliability.Reliable(1_000_000_000), durability, policy.History.KeepLast(depth))


class Types:
    """Classes of Cyclone DDS for ROS 2's message types, made of their definitions."""

    def __init__(self) -> None:
        self._store = typestore(2)
        self._structs: dict[str, type] = {}

    def struct(self, kind: str) -> type:
        """The class of a message type, such as geometry_msgs/msg/Twist."""
        if kind not in self._structs:
            from cyclonedds.idl import make_idl_struct

            package, _, name = kind.split("/")
            fields = {field: self._annotation(about) for field, about in self._store.fielddefs[kind][1]}
            self._structs[kind] = make_idl_struct(name, f"{package}::msg::dds_::{name}_", fields)
        return self._structs[kind]

    def _annotation(self, about: tuple) -> Any:
        from cyclonedds.idl import types

        kind, inner = about
        if kind.name == "NAME":
            return self.struct(inner)
        if kind.name == "BASE":
            base = BYTES.get(inner[0], str(inner[0]))
            return {"string": str, "bool": bool}.get(base) or getattr(types, base)
        element, count = inner
        annotation = self._annotation(element)
        return types.array[annotation, count] if kind.name == "ARRAY" else types.sequence[annotation]

    def fill(self, kind: str, message: dict[str, Any]) -> Any:
        """The object of a message type with the fields of a message; missing ones are 0 or empty."""
        return self._convert(kind, fill(self._store, kind, message))

    def _convert(self, kind: str, value: Any) -> Any:
        values = {}
        for field, (form, inner) in self._store.fielddefs[kind][1]:
            content = getattr(value, field)
            if form.name == "NAME":
                content = self._convert(inner, content)
            elif form.name != "BASE" and inner[0][0].name == "NAME":
                content = [self._convert(inner[0][1], item) for item in content]
            elif isinstance(content, np.ndarray):
                content = content.tolist()
            values[field] = content
        return self.struct(kind)(**values)


def _as_dict(value: Any) -> Any:
    """A sample as nested dicts."""
    if not hasattr(value, "__idl__"):
        return value
    return {name: _as_dict(field) for name, field in vars(value).items()}
