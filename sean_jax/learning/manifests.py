"""The JSON files of learning: the manifest of a dataset and the configuration of a trained network (section V).

Datasets and policies may come from other people. A file that this version would not write is refused when it is opened,
with the key that is wrong, before memory of the sizes in the file is allocated.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import pydantic

from sean_jax import files
from sean_jax.config import MAX_HOURS, MAX_PIXELS, MAX_RATE, MAX_SHARD, MAX_SIDE, METHODS
from sean_jax.errors import FileError
from sean_jax.quantities import MAX_DURATION

LOOSE = pydantic.ConfigDict(extra="ignore", allow_inf_nan=False)
CONFIG = "config.json"  # the configuration of a network, beside its checkpoints
Count = Annotated[int, pydantic.Field(ge=0, le=10**9)]
Positive = Annotated[int, pydantic.Field(ge=1, le=MAX_SHARD)]
Side = Annotated[int, pydantic.Field(ge=1, le=MAX_SIDE)]  # pixels
Names = Annotated[list[str], pydantic.Field(max_length=1_000)]


class Camera(pydantic.BaseModel):
    """Size of the depth images."""

    model_config = LOOSE

    width: Side
    height: Side


class Shard(pydantic.BaseModel):
    """A batch of episodes."""

    model_config = LOOSE

    stream: Count
    lengths: list[Count]  # rows
    completed: list[bool]
    bytes: dict[str, Annotated[int, pydantic.Field(ge=0, lt=2**62)]]  # of the file of each field


class Robot(pydantic.BaseModel):
    """The robot that was driven."""

    model_config = LOOSE

    name: str


class Manifest(pydantic.BaseModel):
    """The keys of dataset.json that are read; other keys are for people."""

    model_config = LOOSE

    command: str
    options: dict[str, Any]
    hours: Annotated[float, pydantic.Field(gt=0, le=MAX_HOURS)]
    batch: Positive
    seconds: Annotated[int, pydantic.Field(ge=1, le=MAX_DURATION)]  # of an episode, at most
    rate: Annotated[float, pydantic.Field(ge=1, le=MAX_RATE)] = 1.0  # rows a second, a whole number
    streams: Annotated[Names, pydantic.Field(min_length=1)]
    situations: Names
    camera: Camera
    robot: Robot
    shards: list[Shard]


class NetworkConfig(pydantic.BaseModel):
    """The keys of config.json that are read."""

    model_config = LOOSE

    width: Side  # of encodings and hidden layers
    flags: bool  # whether the situations are an input
    image: tuple[Side, Side]  # pixels, height and width of a depth image
    situations: Names


def check_manifest(path: Path, data: Any, fields: tuple[str, ...]) -> None:
    """Check the content of a dataset.json.

    Raises:
        FileError: a value cannot be that of a dataset with these fields.
    """
    files.check_json(path, data, Manifest, lambda manifest: _relations(manifest, fields))


def read_network_config(path: Path) -> NetworkConfig:
    """Read the configuration of a trained network.

    Raises:
        FileError: the file cannot be read or used.
    """

    def check_size(config: NetworkConfig) -> Iterator[files.Problem]:
        if config.image[0] * config.image[1] > MAX_PIXELS:
            yield ("image",), f"has more than {MAX_PIXELS:,} pixels"

    return files.check_json(path, files.read_json(path), NetworkConfig, check_size)


def read_method(folder: Path) -> str:
    """How the network in a folder is trained.

    Args:
        folder: that ``sean train`` has written.

    Returns:
        A word after ``sean train``; imitation where the folder does not say.

    Raises:
        FileError: its config.json cannot be read, or names a method that is none.
    """
    path = folder / CONFIG
    if not path.is_file():
        return "imitation"
    data = files.read_json(path)
    method = data.get("method", "imitation") if isinstance(data, dict) else "imitation"
    if method not in METHODS:
        raise FileError(f"{path}: method: {str(method)[:40]!r} is not one of {', '.join(METHODS)}.")
    return method


def _relations(manifest: Manifest, fields: tuple[str, ...]) -> Iterator[files.Problem]:
    if manifest.camera.width * manifest.camera.height > MAX_PIXELS:
        yield ("camera",), f"has more than {MAX_PIXELS:,} pixels"
    if manifest.rate != int(manifest.rate):
        yield ("rate",), f"{manifest.rate:g} is not a whole number"
    for number, shard in enumerate(manifest.shards):
        here = ("shards", number)
        if shard.stream >= len(manifest.streams):
            yield (*here, "stream"), f"{shard.stream} is none of the {len(manifest.streams)} streams"
        for name, values in (("lengths", shard.lengths), ("completed", shard.completed)):
            if len(values) != manifest.batch:
                yield (*here, name), f"has {len(values)} values, and a batch has {manifest.batch} episodes"
        longest = max(shard.lengths, default=0)
        if longest > manifest.rate * manifest.seconds:
            seconds = f"{longest / manifest.rate:g} s long, and {manifest.seconds} s are the most"
            yield (*here, "lengths"), f"an episode is {seconds}"
        if missing := [name for name in fields if name not in shard.bytes]:
            yield (*here, "bytes"), f"lacks {', '.join(missing)}"
        if unknown := [name for name in shard.bytes if name not in fields]:
            yield (*here, "bytes"), f"has '{unknown[0][:40]}', which is no field of a row"
