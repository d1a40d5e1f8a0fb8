"""Reading of the episodes in a replay's page, as ``web/src/recording.ts`` does."""

import base64
import json
import re
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np


def decode(encoded: Mapping[str, Any], frames: int) -> dict[str, np.ndarray]:
    """The inverse of ``replay.encode``: name -> (T, K) numbers, as far as the encoding is exact."""
    halves = np.frombuffer(zlib.decompress(base64.b64decode(encoded["data"])), np.uint8)
    low, high = halves.reshape(2, -1).astype(np.uint16)
    rows = np.cumsum((low + 256 * high).reshape(-1, frames), axis=1, dtype=np.uint16).astype(float)
    columns, first = {}, 0
    for head in encoded["columns"]:
        count = head["count"]
        columns[head["name"]] = rows[first : first + count].T * head["scale"] + head["offset"]
        first += count
    return columns


def played(page: Path) -> list[dict[str, Any]]:
    """Each player's recording, of which episodes have their columns."""
    text = page.read_text(encoding="utf-8")
    held = re.findall(r'<script type="application/json" id="[^"]*">(.*?)</script>', text, re.S)
    found = [json.loads(part) for part in held]
    for part in found:
        part["episodes"] = [each | {"columns": decode(each, each["frames"])} for each in part["episodes"]]
    return found
