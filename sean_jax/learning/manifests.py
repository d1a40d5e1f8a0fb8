"""What the JSON files of learning must hold to be used: a dataset's manifest, and a trained network's configuration.

A dataset and a policy may come from anybody. What is not as this version writes it is refused when it is opened, by
the key that is wrong, and before sizes from these files are asked of the memory.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import pydantic

from sean_jax import files
from sean_jax.learning.options import MOST_BATCH, MOST_HOURS, MOST_PIXELS, MOST_SIDE
from sean_jax.quantities import LONGEST

LOOSE = pydantic.ConfigDict(extra="ignore", allow_inf_nan=False)
CONFIG = "config.json"  # what a network is, beside its checkpoints
Count = Annotated[int, pydantic.Field(ge=0, le=10**9)]
Some = Annotated[int, pydantic.Field(ge=1, le=MOST_BATCH)]
Side = Annotated[int, pydantic.Field(ge=1, le=MOST_SIDE)]  # pixels
Words = Annotated[list[str], pydantic.Field(max_length=1_000)]


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
    """Who was driven."""

    model_config = LOOSE

    name: str


class Manifest(pydantic.BaseModel):
    """What dataset.json holds; other keys are for people."""

    model_config = LOOSE

    command: str
    options: dict[str, Any]
    hours: Annotated[float, pydantic.Field(gt=0, le=MOST_HOURS)]
    batch: Some
    seconds: Annotated[int, pydantic.Field(ge=1, le=LONGEST)]  # of an episode, at most
    streams: Annotated[Words, pydantic.Field(min_length=1)]
    situations: Words
    camera: Camera
    robot: Robot
    shards: list[Shard]


class Trained(pydantic.BaseModel):
    """What config.json holds of a trained network."""

    model_config = LOOSE

    width: Side  # of encodings and hidden layers
    flags: bool  # whether it knows the situations
    image: tuple[Side, Side]  # pixels, height and width of a depth image
    situations: Words


def check_manifest(path: Path, data: Any, fields: tuple[str, ...]) -> None:
    """Raises files.FileError for values of a dataset.json that are none of a dataset with these fields of a row."""
    files.check_json(path, data, Manifest, lambda found: _relations(found, fields))


def read_trained(path: Path) -> Trained:
    """The configuration of a trained network. Raises files.FileError."""

    def sized(found: Trained) -> Iterator[files.Problem]:
        if found.image[0] * found.image[1] > MOST_PIXELS:
            yield ("image",), f"has more than {MOST_PIXELS:,} pixels"

    return files.check_json(path, files.read_json(path), Trained, sized)


def _relations(found: Manifest, fields: tuple[str, ...]) -> Iterator[files.Problem]:
    if found.camera.width * found.camera.height > MOST_PIXELS:
        yield ("camera",), f"has more than {MOST_PIXELS:,} pixels"
    for number, shard in enumerate(found.shards):
        here = ("shards", number)
        if shard.stream >= len(found.streams):
            yield (*here, "stream"), f"{shard.stream} is none of the {len(found.streams)} streams"
        for name, values in (("lengths", shard.lengths), ("completed", shard.completed)):
            if len(values) != found.batch:
                yield (*here, name), f"has {len(values)} values, and a batch has {found.batch} episodes"
        if max(shard.lengths, default=0) > found.seconds:
            yield (*here, "lengths"), f"an episode is {max(shard.lengths)} s long, and {found.seconds} s are the most"
        if missing := [name for name in fields if name not in shard.bytes]:
            yield (*here, "bytes"), f"lacks {', '.join(missing)}"
        if unknown := [name for name in shard.bytes if name not in fields]:
            yield (*here, "bytes"), f"has '{unknown[0][:40]}', which is no field of a row"
