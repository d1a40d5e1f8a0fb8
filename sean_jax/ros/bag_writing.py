"""Bags of ROS messages, written without ROS: rosbag 1 files, and rosbag2 folders with MCAP.

The package ``rosbags`` (extra ``ros``) does it. A bag holds the definitions of its messages, so readers do not need
this package. ``bag_import`` reads bags.
"""

import contextlib
import importlib.util
from pathlib import Path
from typing import Any, Literal

from sean_jax.core.errors import InputError
from sean_jax.ros.messages import Message, Topic, fill, typestore

Version = Literal["1", "2", "both"]


def check_package() -> None:
    """Raise InputError if the package ``rosbags`` is missing."""
    if importlib.util.find_spec("rosbags") is None:
        raise InputError('rosbags is missing; pip install "sean_jax[ros]".')


class Bag:
    """The bags of one episode: a file of rosbag 1, a folder of rosbag2, or both."""

    def __init__(self, folder: Path, name: str, table: dict[str, Topic], version: Version = "both"):
        """Bags ``NAME.bag`` and ``NAME`` in an existing folder; a context manager."""
        self.table = table
        self.count = 0  # messages written
        self._folder = folder
        self._name = name
        self._version = version
        self._stack = contextlib.ExitStack()
        self._writers: list[tuple[Any, Any, dict[str, Any], int]] = []

    def __enter__(self) -> "Bag":
        if self._version != "2":
            self._open_ros1()
        if self._version != "1":
            self._open_ros2()
        return self

    def __exit__(self, *error: Any) -> None:
        self._stack.__exit__(*error)

    def _open_ros1(self) -> None:
        from rosbags.rosbag1 import Writer

        store = typestore(1)
        writer = self._stack.enter_context(Writer(self._folder / f"{self._name}.bag"))
        connections = {}
        for name, topic in self.table.items():
            latching = int(topic.latched)
            connections[name] = writer.add_connection(name, topic.type, typestore=store, latching=latching)
        self._writers.append((writer, store, connections, 1))

    def _open_ros2(self) -> None:
        from rosbags.interfaces import (
            Qos,
            QosDurability,
            QosHistory,
            QosLiveliness,
            QosReliability,
            QosTime,
        )
        from rosbags.rosbag2 import StoragePlugin, Writer

        never = QosTime(sec=2**31 - 1, nsec=2**32 - 1)

        def qos(latched: bool) -> Any:
            durability = QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE
            times = (never, never, QosLiveliness.AUTOMATIC, never)
            return Qos(QosHistory.KEEP_LAST, 1 if latched else 10, QosReliability.RELIABLE, durability, *times, False)

        store = typestore(2)
        writer = Writer(self._folder / self._name, version=9, storage_plugin=StoragePlugin.MCAP)
        self._stack.enter_context(writer)
        connections = {}
        for name, topic in self.table.items():
            profiles = [qos(topic.latched)]
            connections[name] = writer.add_connection(name, topic.type, typestore=store, offered_qos_profiles=profiles)
        self._writers.append((writer, store, connections, 2))

    def write(self, messages: dict[str, Message], time: int) -> None:
        """Add the messages of a time [ns] by topic."""
        for writer, store, connections, version in self._writers:
            for name, message in messages.items():
                kind = self.table[name].type
                filled = fill(store, kind, message)
                pack = store.serialize_ros1 if version == 1 else store.serialize_cdr
                writer.write(connections[name], time, pack(filled, kind))
                self.count += 1
