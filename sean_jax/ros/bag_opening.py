"""Bags of others, opened within bounds: all that the package ``rosbags`` reads of them passes through here.

A bag may be damaged, or made to do harm. Only regular files are opened; what is unpacked of them, a message, and the
definition of a message are bounded before memory is used. Whatever ``rosbags`` raises becomes a sentence.
"""

import bz2
import contextlib
import urllib.parse
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import pydantic

from sean_jax.io import files
from sean_jax.ros.messages import typestore

MAX_FILE = 10**12  # bytes of a file of a bag
MAX_PART = 100_000_000  # bytes that are read or unpacked at once: a chunk
MAX_UNPACKED = 1_000_000_000, 100  # bytes that a bag may unpack to, and as many more for each byte of its files
MAX_MESSAGE = 4_000_000  # bytes of a message that is decoded
MAX_DEFINITION = 200_000  # characters of a message's definition
MAX_FIELDS = 2_000  # of a message, with those of the messages in it
CURE = "mend it with `rosbag reindex` or `mcap recover`, or record it again"
SUFFIXES = (".bag", ".mcap", ".db3")


# ------------------------------------------------------------------ metadata.yaml


class TopicMetadata(pydantic.BaseModel):
    """A topic of a rosbag2."""

    name: str
    type: str
    serialization_format: str


class TopicCount(pydantic.BaseModel):
    """A topic of a rosbag2, and how many messages it has."""

    topic_metadata: TopicMetadata
    message_count: int


class BagDuration(pydantic.BaseModel):
    """Time from the first message to the last."""

    nanoseconds: int


class BagStart(pydantic.BaseModel):
    """Time of the first message."""

    nanoseconds_since_epoch: int


class BagInformation(pydantic.BaseModel):
    """What ``rosbags`` needs of a rosbag2's metadata."""

    version: int
    storage_identifier: str
    relative_file_paths: list[str]
    message_count: int
    duration: BagDuration
    starting_time: BagStart
    topics_with_message_count: list[TopicCount]
    compression_format: str | None = None
    compression_mode: str | None = None


class BagMetadata(pydantic.BaseModel):
    """The file metadata.yaml of a rosbag2."""

    rosbag2_bagfile_information: BagInformation


def _check_metadata(metadata: BagMetadata) -> Iterator[tuple[tuple[str, ...], str]]:
    about = metadata.rosbag2_bagfile_information
    key = "rosbag2_bagfile_information"
    if not 1 <= about.version <= 9:
        yield (key, "version"), f"{about.version} is not one of 1 to 9, which are known"
    if about.storage_identifier not in ("mcap", "sqlite3"):
        yield (key, "storage_identifier"), f"{about.storage_identifier[:40]!r} is not one of mcap, sqlite3"
    if (about.compression_format or "zstd") != "zstd":
        yield (key, "compression_format"), f"{(about.compression_format or '')[:40]!r} is not zstd; convert the bag"
    if not about.relative_file_paths:
        yield (key, "relative_file_paths"), "names no file; restore it"
    for topic in about.topics_with_message_count:
        form = topic.topic_metadata.serialization_format
        if form != "cdr":
            text = f"{form[:40]!r} is a serialization format that is not known; use cdr"
            yield (key, "topics_with_message_count"), text


# ------------------------------------------------------------------ files and what is packed in them


class Budget:
    """How many bytes a bag may still unpack to."""

    def __init__(self, path: Path, size: int):
        self.path = path
        self.remaining = MAX_UNPACKED[0] + MAX_UNPACKED[1] * size

    def take(self, size: int) -> None:
        """Take so many bytes; FileError if there are none left."""
        self.remaining -= size
        if self.remaining < 0:
            raise files.file_error(self.path, "unpacks to far more than it is; cut pictures and points out of the bag")

    def unpack(self, start: Callable[[], Any], data: bytes) -> bytes:
        """The unpacked content of one chunk, of one or several streams of a decompressor.

        Args:
            start: makes a decompressor with ``decompress(data, max_length)``, as of bz2.
        """
        parts = []
        size = 0
        while data:
            stream = start()
            part = stream.decompress(data, MAX_PART - size + 1)
            size += len(part)
            if size > MAX_PART:
                raise files.file_error(self.path, f"has a chunk of more than {MAX_PART:,} bytes; cut the bag")
            self.take(len(part))
            if not stream.eof:
                raise files.file_error(self.path, f"is damaged: a chunk is cut off; {CURE}")
            parts.append(part)
            data = stream.unused_data
        return b"".join(parts)

    def plain(self, data: bytes) -> bytes:
        """A chunk that is not packed."""
        self.take(len(data))
        return data


class BoundedFile:
    """A regular file, of which no more than ``MAX_PART`` bytes are read at once."""

    def __init__(self, path: Path):
        self._path = path
        self._stack = contextlib.ExitStack()
        self._stream = self._stack.enter_context(files.open_file(path, MAX_FILE))

    def read(self, size: int = -1) -> bytes:
        """At most so many bytes; FileError if they are too many."""
        if size is None or size < 0:
            size = MAX_PART + 1
            data = self._stream.read(size)
        else:
            data = self._stream.read(min(size, MAX_PART + 1))
        if len(data) > MAX_PART:
            raise files.file_error(self._path, f"has a part of more than {MAX_PART:,} bytes; cut the bag")
        return data

    def readline(self) -> bytes:
        """A short line."""
        return self._stream.readline(100)

    def seek(self, place: int, whence: int = 0) -> int:
        """Go to a place."""
        return self._stream.seek(place, whence)

    def tell(self) -> int:
        """The place."""
        return self._stream.tell()

    def close(self) -> None:
        """Close the file."""
        self._stack.close()

    def __enter__(self) -> "BoundedFile":
        return self

    def __exit__(self, *error: Any) -> None:
        self.close()


class BoundedPath(type(Path())):
    """A path that ``rosbags`` opens as a ``BoundedFile``."""

    def open(self, *_: Any, **__: Any) -> Any:
        """The file, to be read as bytes."""
        return BoundedFile(Path(self))

    def read_text(self, *_: Any, **__: Any) -> str:
        """The text of a file that people write."""
        return files.read_text(Path(self))


@contextlib.contextmanager
def _bounded_unpacking(budget: Budget) -> Iterator[None]:
    """In this block ``rosbags`` unpacks within a budget; by itself it knows no bounds."""
    import lz4.frame  # pyright: ignore[reportMissingImports]
    from rosbags.rosbag1 import reader as rosbag1
    from rosbags.rosbag2 import reader as rosbag2
    from rosbags.rosbag2 import storage_mcap

    zstd = getattr(rosbag2, "zstd")  # noqa: B009 - the module that the reader itself uses, which it does not export

    class UnpackedFile(zstd.ZstdFile):
        def read(self, size: int | None = -1) -> bytes:
            data = super().read(MAX_PART if size is None or size < 0 else size)
            budget.take(len(data))
            return data

    lz4_start = lz4.frame.LZ4FrameDecompressor
    zstd_start = zstd.ZstdDecompressor
    of_bags = {
        "none": budget.plain,
        "bz2": lambda data: budget.unpack(bz2.BZ2Decompressor, data),
        "lz4": lambda data: budget.unpack(lz4_start, data),
    }
    of_mcap = {
        "": lambda data, _: budget.plain(data),
        "lz4": lambda data, _: budget.unpack(lz4_start, data),
        "zstd": lambda data, _: budget.unpack(zstd_start, data),
    }
    bounded_zstd = SimpleNamespace(
        decompress=lambda data: budget.unpack(zstd_start, data), open=lambda stream, _: UnpackedFile(stream)
    )
    changes = [
        (rosbag1, "decompressors", of_bags),
        (storage_mcap, "DECOMPRESSORS", of_mcap),
        (rosbag2, "zstd", bounded_zstd),
    ]
    with contextlib.ExitStack() as stack:
        for module, name, ours in changes:
            stack.callback(setattr, module, name, getattr(module, name))
            setattr(module, name, ours)
        yield


@contextlib.contextmanager
def _checked_databases(path: Path) -> Iterator[None]:
    """In this block ``rosbags`` opens the files of SQLite that it is given, and only those with plain tables.

    It hands their names to SQLite as addresses, in which %, ? and # mean something else; and what it unpacks into a
    temporary file is looked at as well, as each connection is before anything is read.
    """
    import apsw  # pyright: ignore[reportMissingImports]
    from rosbags.rosbag2 import reader as rosbag2
    from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

    class NamedReader(Sqlite3Reader):
        def open(self) -> None:
            self.path = Path(urllib.parse.quote(str(self.path), safe="/\\:"))
            super().open()

    def check(connection: Any) -> None:
        connection.limit(apsw.SQLITE_LIMIT_LENGTH, MAX_PART)
        _check_tables(path, connection)

    plugins = [(rosbag2.DirectoryReader, "sqlite3"), (rosbag2.Reader, ".db3")]
    with contextlib.ExitStack() as stack:
        for kind, name in plugins:
            stack.callback(setattr, kind, "STORAGE_PLUGINS", kind.STORAGE_PLUGINS)
            kind.STORAGE_PLUGINS = {**kind.STORAGE_PLUGINS, name: NamedReader}
        apsw.connection_hooks.append(check)
        stack.callback(apsw.connection_hooks.remove, check)
        yield


def _check_tables(path: Path, database: Any) -> None:
    """FileError unless an open database has plain tables alone, as others compute rows without end."""
    for kind, name, words in database.execute("SELECT type, name, sql FROM sqlite_master").fetchall():
        computed = kind not in ("table", "index")
        if kind == "table":
            computed = not str(words).lstrip().upper().startswith("CREATE TABLE")
            quoted = str(name).replace('"', '""')
            computed |= any(row[6] for row in database.execute(f'PRAGMA table_xinfo("{quoted}")'))
        if computed:
            raise files.file_error(path, f"{str(name)[:60]} is no plain table, and so it is no bag; {CURE}")


# ------------------------------------------------------------------ an open bag


class BagMessage(NamedTuple):
    """A message of a bag."""

    topic: str
    type: str  # such as nav_msgs/msg/Odometry
    received: int  # ns
    content: Any  # decoded; None if it was not asked for


class OpenBag:
    """A bag that is open for reading."""

    def __init__(self, path: Path, reader: Any, version: int):
        self._path = path
        self._reader = reader
        self._version = version
        self.types = {connection.topic: connection.msgtype for connection in reversed(reader.connections)}
        """Topic -> its type."""

    def messages(self, decoded: Collection[str], noted: Collection[str] = ()) -> Iterator[BagMessage]:
        """The messages of some topics in the order of their recording, decoded or without their content.

        Raises:
            FileError: the bag is damaged, or a message is too large.
        """
        connections = [connection for connection in self._reader.connections if connection.topic in {*decoded, *noted}]
        if not connections:
            return
        stores = {}
        for connection in connections:
            if connection.topic in decoded:
                stores[connection.topic] = self._store(connection)
        with files.sentence(self._path, CURE):
            for connection, received, raw in self._reader.messages(connections):
                if type(received) is not int:
                    raise files.file_error(self._path, f"is damaged: a message has no time; {CURE}")
                content = None
                if connection.topic in stores:
                    content = self._decode(stores[connection.topic], connection, raw)
                yield BagMessage(connection.topic, connection.msgtype, received, content)

    def _decode(self, store: Any, connection: Any, raw: Any) -> Any:
        if len(raw) > MAX_MESSAGE:
            raise files.file_error(
                self._path,
                f"{connection.topic}: a message has {len(raw):,} bytes, and at most {MAX_MESSAGE:,} are read; name "
                "other topics, or cut those messages out",
            )
        decode = store.deserialize_ros1 if self._version == 1 else store.deserialize_cdr
        return decode(raw, connection.msgtype)

    def _store(self, connection: Any) -> Any:
        """The types of a topic as the bag defines them; those of ``typestore`` if it does not."""
        from rosbags.interfaces import MessageDefinitionFormat
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        form = connection.msgdef.format
        text = connection.msgdef.data
        if form == MessageDefinitionFormat.NONE:
            return typestore(1 if self._version == 1 else 2)
        kind = connection.msgtype
        topic = connection.topic
        with files.sentence(self._path, f"the definition of {kind} on {topic} cannot be used; {CURE}"):
            if len(text) > MAX_DEFINITION:
                raise files.file_error(
                    self._path, f"the definition of {kind} on {topic} has {len(text):,} characters; name another topic"
                )
            if form == MessageDefinitionFormat.MSG:
                types = get_types_from_msg(text, kind)
            else:
                types = _types_of_idl(text)
            store = get_typestore(Stores.EMPTY)
            if _count_fields({**store.fielddefs, **types}, kind, ()) > MAX_FIELDS:
                raise files.file_error(
                    self._path,
                    f"the definition of {kind} on {topic} has more than {MAX_FIELDS:,} fields; name another topic",
                )
            store.register(types)
            return store


def _types_of_idl(text: str) -> dict[str, Any]:
    """The types of a definition in IDL: of one file, or of several with a line of = before each."""
    from rosbags.typesys import get_types_from_idl

    line = "=" * 80 + "\n"
    if not text.startswith(f"{line}IDL: "):
        return get_types_from_idl(text)
    types: dict[str, Any] = {}
    for file in text.split(line)[1:]:
        types |= get_types_from_idl(file.partition("\n")[2])
    return types


def _count_fields(types: dict[str, Any], name: str, outer: tuple[str, ...]) -> int:
    """The fields of a type with those of the types in it, up to ``MAX_FIELDS`` and some more.

    Raises:
        ValueError: a type is missing, holds itself, or has no field, so that a few bytes could be many of it.
    """
    if name in outer or name not in types or not types[name][1]:
        raise ValueError(name)
    count = 0
    for _, (form, inner) in types[name][1]:
        if form.name in ("ARRAY", "SEQUENCE"):  # of elements, which count once
            form, inner = inner[0]
        count += _count_fields(types, inner, (*outer, name)) if form.name == "NAME" else 1
        if count > MAX_FIELDS:
            return count
    return count


@contextlib.contextmanager
def open_bag(path: Path) -> Iterator[OpenBag]:
    """A bag: a .bag file, the folder of a rosbag2, or a .mcap or .db3 file.

    Raises:
        FileError: the bag cannot be read.
    """
    if not path.exists():
        raise files.file_error(path, "there is no such file; give a .bag file or the folder of a rosbag2")
    if path.suffix in (".mcap", ".db3") and (path.parent / "metadata.yaml").is_file():
        path = path.parent
    size = 0
    for file in _files(path):
        with files.open_file(file, MAX_FILE) as stream:
            size += stream.seek(0, 2)
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

    class IndexedReader(Reader1):
        """A reader that reads no part of the index twice."""

        indexed = 0

        def read_index_data(self, *arguments: Any) -> None:
            before = self.bio.tell()  # pyright: ignore[reportOptionalMemberAccess]
            super().read_index_data(*arguments)
            self.indexed += self.bio.tell() - before  # pyright: ignore[reportOptionalMemberAccess]
            if self.indexed > size:
                raise files.file_error(path, f"is damaged: its index is larger than the bag; {CURE}")

    version = 1 if path.suffix == ".bag" else 2
    with _bounded_unpacking(Budget(path, size)), _checked_databases(path), contextlib.ExitStack() as stack:
        with files.sentence(path, CURE):
            reader = stack.enter_context((IndexedReader if version == 1 else Reader2)(BoundedPath(path)))
            bag = OpenBag(path, reader, version)
        yield bag


def _files(path: Path) -> list[Path]:
    """The files of messages of a bag."""
    if not path.is_dir():
        if path.suffix not in SUFFIXES:
            known = ", ".join(SUFFIXES)
            raise files.file_error(path, f"is no bag by its name; give a file that ends in {known}, or a folder")
        return [path]
    about = files.load(path / "metadata.yaml", BagMetadata, _check_metadata).rosbag2_bagfile_information
    return [path / Path(name).name for name in about.relative_file_paths]
