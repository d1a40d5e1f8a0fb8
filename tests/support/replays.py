"""Episodes for a page to show, and reading of those in a page, as ``web/src/recording.ts`` does."""

import base64
import functools
import json
import re
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

import sean_jax
from sean_jax.policies import go_to_goal


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


@functools.cache
def lab_episodes():
    """A scenario, and the 60 frames of each of two of its episodes."""
    scenario = sean_jax.make("lab", routing="whole", people=3, dynamics="twin", time_limit=30.0, metrics="none")
    roll = jax.jit(lambda key: sean_jax.rollout(scenario, go_to_goal, key, steps=60)[1])
    return scenario, [jax.tree.map(np.asarray, roll(jax.random.key(k))) for k in (0, 1)]


@pytest.fixture(scope="module")
def walked():
    """The scenario, and the frames of its two episodes side by side, (T, B, ...)."""
    scenario, frames = lab_episodes()
    return scenario, jax.tree.map(lambda *leaves: np.stack(leaves, 1), *frames)
