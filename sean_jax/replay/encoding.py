"""Episodes as the page reads them: whole numbers, as differences from frame to frame, deflated, as text.

A column is T numbers. They are rounded to 16 bits, and each is the difference from the one before it, modulo 2**16:
differences of people who walk are small and alike, so that they deflate to a seventh of their size. Low bytes of all
columns come first, then high bytes, which are mostly 0 or 255. ``web/src/recording.ts`` reads them.
"""

import base64
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np

LEVELS = 2**16 - 1
TURN = 2.0 * np.pi / 2**16  # rad, of a level of an angle
CENTIMETRE = 0.01
LOWEST = -300.0  # m: 655 m from there on are what places in whole centimetres can be


def encode(columns: Mapping[str, np.ndarray], kinds: Mapping[str, str]) -> dict[str, Any]:
    """Columns of an episode, (T,) or (T, K) by name, as the list of (name, count, scale, offset) and base64 data.

    Args:
        kinds: name -> ``place`` [m], to a centimetre; ``angle`` [rad]; ``index``, whole numbers from -1 on; any other
            name is a number, whose range is divided into 65,535 levels.
    """
    heads, levels = [], []
    for name, given in columns.items():
        values = np.asarray(given, float)
        values = values[:, None] if values.ndim == 1 else values
        scale, offset = _scale(values, kinds.get(name, "number"))
        levels.append(np.round((values.T - offset) / scale).astype(np.int64))
        heads.append({"name": name, "count": values.shape[1], "scale": scale, "offset": offset})
    steps = [np.diff(each, axis=1, prepend=0).astype(np.uint16).ravel() for each in levels]
    whole = np.concatenate([*steps, np.zeros(0, np.uint16)])
    halves = np.concatenate([whole & 0xFF, whole >> 8]).astype(np.uint8)
    packed = base64.b64encode(zlib.compress(halves.tobytes(), 9)).decode("ascii")
    return {"columns": heads, "data": packed}


def _scale(values: np.ndarray, kind: str) -> tuple[float, float]:
    """What a level is worth, and the value of level 0."""
    if kind == "place":
        inside = values.size == 0 or (values.min() > LOWEST and values.max() < LOWEST + LEVELS * CENTIMETRE)
        if inside:
            return CENTIMETRE, LOWEST
    if kind == "angle":
        return TURN, 0.0
    if kind == "index":
        return 1.0, -1.0
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
    return max((high - low) / LEVELS, 1e-9), low


def decode(encoded: Mapping[str, Any], frames: int) -> dict[str, np.ndarray]:
    """The inverse of ``encode``: name -> (T, K) numbers, as far as the encoding is exact."""
    halves = np.frombuffer(zlib.decompress(base64.b64decode(encoded["data"])), np.uint8)
    low, high = halves.reshape(2, -1).astype(np.uint16)
    rows = np.cumsum((low + 256 * high).reshape(-1, frames), axis=1, dtype=np.uint16).astype(float)
    columns, first = {}, 0
    for head in encoded["columns"]:
        count = head["count"]
        columns[head["name"]] = rows[first : first + count].T * head["scale"] + head["offset"]
        first += count
    return columns
