"""The address of a studio's page, kept in its folder for drives: a page goes on when the studio has started again."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import secrets
import socket
import stat
from pathlib import Path
from typing import Annotated, NamedTuple

import pydantic

from sean_jax.core.errors import FileError
from sean_jax.io import files

FILE = ".studio.json"
MACHINE = "/etc/machine-id"
MAX_ADDRESS = 1000  # bytes of the file


class KeptAddress(pydantic.BaseModel):
    """The content of the file."""

    model_config = pydantic.ConfigDict(extra="forbid")

    token: Annotated[str, pydantic.Field(pattern=r"^[A-Za-z0-9_-]{22}$")]
    port: Annotated[int, pydantic.Field(ge=1, le=65535)]
    place: Annotated[str, pydantic.Field(pattern=r"^[0-9a-f]{64}$")]
    """``_place`` of the file: whoever sends a folder does not know it, so that nobody chooses another's token."""


class Address(NamedTuple):
    """The secret of a page's address, and its port; 0 for a free one."""

    token: str
    port: int


def recall(folder: Path | None) -> Address:
    """The address that the folder has, or a new one.

    It is new in a folder that is copied, unpacked or moved to another disk, on another machine or for another user, and
    if others than its owner can read the file.
    """
    new = Address(secrets.token_urlsafe(16), 0)
    if folder is None:
        return new
    file = folder / FILE
    try:
        status = file.lstat()
        private = stat.S_ISREG(status.st_mode) and not status.st_mode & 0o077
        if not private or (hasattr(os, "getuid") and status.st_uid != os.getuid()):
            return new
        text = files.read_bytes(file, MAX_ADDRESS).decode("ascii", errors="replace")
        kept = files.check_json(file, files.parse_file_json(file, text), KeptAddress)
        place = _place(status, folder.stat())
    except (OSError, FileError):
        return new
    return Address(kept.token, kept.port) if secrets.compare_digest(kept.place, place) else new


def _place(file: os.stat_result, folder: os.stat_result) -> str:
    """SHA-256 of machine, user, and the numbers of the file and its folder on their disk."""
    try:
        machine = files.read_bytes(MACHINE, MAX_ADDRESS).hex()
    except FileError:  # it has another system
        machine = ""
    user = os.getuid() if hasattr(os, "getuid") else os.environ.get("USERNAME", "")
    numbers = [file.st_dev, file.st_ino, folder.st_dev, folder.st_ino]
    return hashlib.sha256(json.dumps([machine, socket.gethostname(), user, numbers]).encode()).hexdigest()


def keep(folder: Path | None, address: Address) -> None:
    """Write the address for the owner of the folder alone; a folder that cannot be written keeps none."""
    if folder is None:
        return
    file = folder / FILE
    with contextlib.suppress(OSError):
        file.unlink(missing_ok=True)
        descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with open(descriptor, "w", encoding="ascii") as stream:
            place = _place(os.fstat(descriptor), folder.stat())
            json.dump(address._asdict() | {"place": place}, stream)
