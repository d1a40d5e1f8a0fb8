"""Types of options: numbers with limits and units, texts, and options that several commands share."""

import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from numbers import Integral, Real
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import AfterValidator, BeforeValidator, Field, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.fields import FieldInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from sean_jax.core.bounds import MAX_COORDINATE, MAX_DURATION, MAX_MAGNITUDE, MAX_PEOPLE, TIME_STEP_RANGE
from sean_jax.core.messages import listed, shorten

# Limits of datasets and networks; files with more are refused.
MAX_HOURS = 1e6
MAX_SHARD = 100_000  # episodes in a shard
MAX_SIDE = 4_096  # pixels of a depth image's side, and the width of a network
MAX_PIXELS = 4_000_000  # of a depth image
MAX_RATE = 1_000  # rows per second
INFINITE = "inf"  # infinity in a file


@dataclass(frozen=True)
class Option:
    """How a field is used: ``positional`` ones have no flag, and some do not affect results, such as a folder."""

    positional: bool = False
    affects_results: bool = True

    @classmethod
    def of(cls, field: FieldInfo) -> "Option":
        """The mark of a field."""
        return next((mark for mark in field.metadata if isinstance(mark, cls)), cls())


NO_EFFECT = Option(affects_results=False)


class HelpTopic(NamedTuple):
    """The options of a class that several commands embed; each command shows them by ``--help-WORD``."""

    word: str
    subject: str  # what has these options


@dataclass(frozen=True)
class Number:
    """Marks a number from ``low`` to ``high``; numpy's numbers count, bool and text do not.

    With ``or_infinity`` it may be infinity, which is the text "inf" in files: JSON has no number for it.
    """

    low: float
    high: float
    unit: str = ""
    or_infinity: bool = False

    def __get_pydantic_core_schema__(self, source: type, handler: GetCoreSchemaHandler) -> CoreSchema:
        text = core_schema.plain_serializer_function_ser_schema(
            lambda value: INFINITE if math.isinf(value) else value, when_used="json"
        )
        return core_schema.no_info_before_validator_function(
            partial(self.read, source), handler(source), serialization=text if self.or_infinity else None
        )

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        limited = {**handler(schema), "minimum": self.low, "maximum": self.high}
        return {"anyOf": [limited, {"const": INFINITE}]} if self.or_infinity else limited

    def read(self, kind: type, value: Any) -> int | float:
        """The value as an int or a float of Python.

        Raises:
            ValueError: it is not a number of this kind, or out of range.
        """
        if getattr(value, "shape", None) == () and hasattr(value, "item"):  # of numpy or JAX
            value = value.item()
        if self.or_infinity and isinstance(value, str | Real) and value in (math.inf, INFINITE):
            return math.inf
        if isinstance(value, bool) or not isinstance(value, Integral if kind is int else Real):
            if value is None:
                raise ValueError(f"an empty value is not a {'whole ' if kind is int else ''}number")
            raise ValueError(f"{shorten(repr(value))} is not a {'whole ' if kind is int else ''}number")
        number = kind(value)  # pyright: ignore[reportArgumentType]
        if not self.low <= number <= self.high:
            least, most = (f"{limit:,}" if kind is int else f"{limit:,g}" for limit in (self.low, self.high))
            limits = f"{least} to {most}{self.unit and ' ' + self.unit}"
            raise ValueError(f"{number} must be from {limits}{', or inf' if self.or_infinity else ''}")
        return number


def _path_as_text(value: object) -> object:
    return str(value) if isinstance(value, Path) else value


def _at_home(path: Path | None) -> Path | None:
    """A path with the user's folder in place of ~, which a shell leaves as it is in --out=~/mine."""
    return None if path is None else Path(os.path.expanduser(path))


def join_names(value: object) -> object:
    """Names with commas between them, of a list of names or paths; other values as they are."""
    several = isinstance(value, list | tuple) and all(isinstance(name, str | Path) for name in value)
    return ",".join(map(str, value)) if several else value  # pyright: ignore[reportArgumentType]


def check_once(names: Sequence[Any]) -> None:
    """Refuse names, or components, that are listed twice."""
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"'{getattr(name, 'kind', name)}' is listed twice; list it once")


def named_values(texts: Iterable[str]) -> dict[str, str]:
    """NAME -> VALUE of texts NAME=VALUE.

    Raises:
        ValueError: a name is listed twice.
    """
    pairs = [text.partition("=") for text in texts]
    check_once([name for name, _, _ in pairs])
    return {name: value for name, _, value in pairs}


def float_or_nan(text: str) -> float:
    """The number of a text; NaN if it is none."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def _check_names(text: str) -> str:
    check_once(listed(text))
    return text


People = Annotated[int, Number(0, MAX_PEOPLE)]
EpisodeCount = Annotated[int, Number(1, 2**31 - 1)]
EpisodeNumber = Annotated[int, Number(0, 2**31 - 2)]
BatchSize = Annotated[int, Number(1, 2**24)]
ShardSize = Annotated[int, Number(1, MAX_SHARD)]
Rate = Annotated[int, Number(1, MAX_RATE, "Hz")]
Seed = Annotated[int, Number(0, 2**32 - 1)]
Count = Annotated[int, Number(1, 10**9)]
StepCount = Annotated[int, Number(1, 10**12)]
Substeps = Annotated[int, Number(1, 1_000)]
Side = Annotated[int, Number(8, MAX_SIDE)]
Width = Annotated[int, Number(1, MAX_SIDE)]
Share = Annotated[float, Number(0.0, 1.0)]
OpenShare = Annotated[float, Number(1e-6, 1 - 1e-6)]
Duration = Annotated[float, Number(0.0, MAX_DURATION, "s")]
TimeLimit = Annotated[float, Number(0.1, MAX_DURATION, "s")]
TimeStep = Annotated[float, Number(*TIME_STEP_RANGE, "s")]
Radius = Annotated[float, Number(0.01, 1_000.0, "m")]
Distance = Annotated[float, Number(0.0, MAX_COORDINATE, "m")]
DistanceOrInfinity = Annotated[float, Number(0.0, MAX_COORDINATE, "m", or_infinity=True)]
PoseNumber = Annotated[float, Number(-1e6, 1e6)]  # m or degrees
Congestion = Annotated[float, Number(0.0, 1e6, "m2")]
FrameRate = Annotated[float, Number(0.001, 1e4, "frames a second")]
Minutes = Annotated[float, Number(0.1, 60.0 * MAX_HOURS, "min")]
RouteTemperature = Annotated[float, Number(0.0, 1e3, "m")]
Temperature = Annotated[float, Number(1e-3, 1e3, "m")]
Taste = Annotated[float, Number(0.0, 1.0)]
Hours = Annotated[float, Number(1e-6, MAX_HOURS, "h")]
HoursOfMinutes = Annotated[float, Number(0.0166, MAX_HOURS, "h")]
WalkingSpeed = Annotated[float, Number(0.0, 100.0, "m/s")]
Threshold = Annotated[float, Number(-MAX_MAGNITUDE, MAX_MAGNITUDE)]
Range = tuple[Threshold, Threshold]  # least and greatest value
Noise = Annotated[float, Number(1e-3, 1.0)]
Delay = Annotated[int, Number(0, 1_000, "steps")]
LearningRate = Annotated[float, Number(1e-12, 1.0)]
Mass = Annotated[float, Number(0.01, 1e5, "kg")]
RobotSpeed = Annotated[float, Number(0.01, 30.0, "m/s")]
RobotTurnRate = Annotated[float, Number(0.01, 100.0, "rad/s")]
RobotAcceleration = Annotated[float, Number(0.01, 1_000.0, "m/s2")]
Height = Annotated[float, Number(0.06, 100.0, "m")]
TimingSeconds = Annotated[float, Number(1e-6, 1e5, "s")]
Text = Annotated[
    str,
    BeforeValidator(_path_as_text),
    Field(min_length=1, max_length=4_096),
]
Names = Annotated[Text, AfterValidator(_check_names)]  # separated by commas

# ------------------------------------------------------------------ options of several commands

Out = Annotated[Path | None, AfterValidator(_at_home), Option(affects_results=False)]
Quiet = Annotated[bool, Option(affects_results=False), Field(description="Print only errors.")]
EnvironmentName = Annotated[Text, Field(description="Physical environment: a name, or the folder of your own.")]
PeopleOrDefault = Annotated[
    People | None,
    Field(description="Number of people; the environment's own number by default (62 in the warehouse)."),
]
Dynamics = Annotated[
    Literal["twin", "mjx", "kinematic"],
    Field(
        description="Robot motion: twin (the law of MuJoCo's MJX in closed form), mjx (the same law by MJX, slower) "
        "or kinematic (no inertia, as in SEAN 2.0)."
    ),
]
RecordingFormat = Annotated[
    Literal["eth_ucy", "juelich", "groups", "csv"] | None,
    Field(description="Format of the recording; by default detected from its columns, if it has velocities."),
]
RecordingRate = Annotated[
    FrameRate | None, Field(description="Frames a second of the recording; by default those of its format.")
]
Routing = Annotated[
    Literal["trips", "whole", "edge"],
    Field(
        description="trips: people have errands at their goals, come in and leave at entrances and walk in curves; "
        "whole: they walk from goal to goal; edge: they choose again at each node, as in SEAN 2.0's code."
    ),
]
WalkingGroups = Annotated[
    tuple[Share, Share], Field(description="Shares of the people who walk in pairs and in triples.")
]
