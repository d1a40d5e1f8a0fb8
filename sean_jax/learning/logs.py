"""The log of a training: for each epoch a line of metrics.jsonl and events for TensorBoard.

A file of TensorBoard is a sequence of records: a length, its checksum, a protocol buffer and its checksum. This module
writes them itself, because the packages that do so have many dependencies.
"""

import json
import struct
from pathlib import Path
from typing import Any

from sean_jax import files, writing
from sean_jax.errors import IncompleteError

LINES = "metrics.jsonl"
EVENTS = "events.out.tfevents.0000000000.sean"
_POLYNOMIAL = 0x82F63B78  # of crc32c, reflected


def _table() -> list[int]:
    table = []
    for value in range(256):
        for _ in range(8):
            value = (value >> 1) ^ (_POLYNOMIAL if value & 1 else 0)
        table.append(value)
    return table


_TABLE = _table()


def crc32c(data: bytes) -> int:
    """Compute the checksum of Castagnoli.

    Returns:
        A number of 32 bits.
    Source:
        RFC 3720.
    """
    value = 0xFFFFFFFF
    for byte in data:
        value = _TABLE[(value ^ byte) & 0xFF] ^ (value >> 8)
    return value ^ 0xFFFFFFFF


class Log:
    """The metrics of a training, in its folder."""

    def __init__(self, folder: Path, epochs: int):
        """Open a log, and drop the lines of epochs after the last checkpoint, which an interruption left."""
        self.folder = folder
        self.lines = [line for line in read_lines(folder) if line["epoch"] <= epochs]  # of before
        writing.write(folder / LINES, "".join(json.dumps(line) + "\n" for line in self.lines))
        first = _event(self.lines[0]["time"] if self.lines else 0.0, version="brain.Event:2")
        writing.write(folder / EVENTS, first + b"".join(_events(line) for line in self.lines))

    def add(self, line: dict[str, Any]) -> None:
        """Append the metrics of an epoch.

        Args:
            line: ``epoch``, ``time`` [s since 1970], and numbers, which may lie in dicts.

        Raises:
            IncompleteError: the log cannot be written. The checkpoints stay.
        """
        try:
            with (self.folder / LINES).open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(line) + "\n")
            with (self.folder / EVENTS).open("ab") as stream:
                stream.write(_events(line))
        except OSError as error:
            raise IncompleteError(
                f"{self.folder}: {writing.reason(error)}; the checkpoints until then are as they were."
            ) from error


def read_lines(folder: Path) -> list[dict[str, Any]]:
    """The metrics of a training until now.

    Returns:
        The complete lines of its log; a kill may have cut the last one.
    """
    file, lines = folder / LINES, []
    for text in files.read_text(file, files.MAX_RECORD).splitlines() if file.exists() else []:
        try:
            line = json.loads(text)
            lines.append({"epoch": int(line["epoch"]), "time": float(line["time"]), **line})
        except (ValueError, TypeError, KeyError, RecursionError):
            break
    return lines


def _events(line: dict[str, Any]) -> bytes:
    values = {}
    for name, value in line.items():
        parts = value.items() if isinstance(value, dict) else [("", value)]
        values.update({f"{name}/{key}".rstrip("/"): each for key, each in parts})
    metrics = {name: value for name, value in values.items() if name not in ("epoch", "time")}
    return b"".join(_event(line["time"], line["epoch"], name, value) for name, value in metrics.items())


def _event(time: float, step: int = 0, tag: str = "", value: float = 0.0, version: str = "") -> bytes:
    """A record: an Event with wall_time (1), step (2), and file_version (3) or summary (5) of one simple_value."""
    event = b"\x09" + struct.pack("<d", time) + b"\x10" + _varint(step)
    if version:
        event += b"\x1a" + _bytes(version.encode())
    else:
        one = b"\x0a" + _bytes(tag.encode()) + b"\x15" + struct.pack("<f", value)
        event += b"\x2a" + _bytes(b"\x0a" + _bytes(one))
    length = struct.pack("<Q", len(event))
    return length + _masked(length) + event + _masked(event)


def _bytes(data: bytes) -> bytes:
    return _varint(len(data)) + data


def _varint(number: int) -> bytes:
    out = bytearray()
    while number > 0x7F:
        out.append(number & 0x7F | 0x80)
        number >>= 7
    out.append(number)
    return bytes(out)


def _masked(data: bytes) -> bytes:
    """The checksum as records have it: rotated, plus a constant."""
    value = crc32c(data)
    return struct.pack("<I", ((value >> 15 | value << 17) + 0xA282EAD8) & 0xFFFFFFFF)
