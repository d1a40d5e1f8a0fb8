"""What every command is told, as one typed description: a scenario (section IV-B), a run, a collection, a training, ...

The command line, ``config.yaml``, manifests, JSON Schema and ``make`` derive from these classes, so an option stands
here and nowhere else. A component (behavior, task, robot, policy, ...) is described by its ``kind`` and by options of
its own: ``{kind: graph, routing: edge}``, or ``GraphBehavior(routing="edge")``. Where a kind can stand, your own part
can stand: ``my.py:thing`` (``components`` loads it), or in Python the part itself.

Nothing here imports JAX or numpy, so that the command line answers at once.
"""

import datetime
import math
import re
import typing
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial, reduce
from numbers import Integral, Real
from operator import or_
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import pydantic
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    Tag,
)
from pydantic.fields import FieldInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, ErrorDetails, core_schema

from sean_jax.errors import InputError
from sean_jax.files.reading import listed, suggest
from sean_jax.presets import PRESETS

# The most that datasets and networks may hold: options go no further, and files that do are refused.
MAX_HOURS = 1e6
MAX_SHARD = 100_000  # episodes in a shard
MAX_SIDE = 4_096  # pixels of a depth image's side, and the width of a network
MAX_PIXELS = 4_000_000  # of a depth image
MAX_RATE = 1_000  # rows a second
MAX_PEOPLE = 100_000
DAY = 86_400.0  # s
INFINITE = "inf"  # how a file says infinity

OWN_PART = re.compile(r"(?P<file>.+\.py):(?P<name>[A-Za-z_]\w*)")

ALIASES = {
    "environment": "env env_id env_name world map",
    "people": "num_people n_people humans num_humans human_num pedestrians num_pedestrians",
    "time_step": "dt timestep",
    "time_limit": "max_steps max_episode_steps episode_length max_episode_length",
    "episodes": "num_episodes n_episodes eval_episodes",
    "evaluation_episodes": "n_eval_episodes num_eval_episodes eval_episodes",
    "evaluate_every": "eval_freq eval_interval eval_every",
    "scenarios": "num_envs n_envs envs num_workers num_actors",
    "steps": "total_timesteps timesteps num_timesteps max_timesteps total_steps",
    "horizon": "n_steps num_steps rollout_length rollout_steps unroll_length",
    "minibatches": "num_minibatches n_minibatches n_minibatch",
    "batch": "batch_size minibatch_size num_envs n_envs",
    "epochs": "n_epochs num_epochs update_epochs num_updates_per_batch",
    "learning_rate": "lr",
    "discount": "gamma discounting",
    "advantage_decay": "gae_lambda lam gae",
    "clip": "clip_range clip_coef clip_eps clip_epsilon clipping_epsilon",
    "entropy": "ent_coef entropy_coef entropy_cost",
    "width": "hidden_size hidden_dim hidden_units",
    "layers": "num_layers n_layers",
    "noise": "log_std_init init_std",
    "pretrained": "checkpoint resume load load_path restore init_from",
    "policy": "agent driver controller",
    "rewards": "reward_fn",
    "terminations": "termination_fn dones",
    "randomization": "domain_randomization randomize",
    "action_delay": "delay latency",
    "seeds": "num_seeds n_seeds",
    "out": "output output_dir out_dir log_dir logdir save_dir save_path",
    "quiet": "silent",
}
"""Option -> names that other projects have for it, by which it is proposed."""

USUAL_TASKS = {"graph": ("join_group", "leave_group"), "handcrafted": ("handcrafted",)}
"""behavior -> its robot tasks in the paper's protocol (section V-B); of others it is random_ab_nav."""


@dataclass(frozen=True)
class Number:
    """Marks a number from ``low`` to ``high``; numpy's numbers count, and bool and text do not.

    With ``or_infinity`` it may also be infinity, which is the text "inf" in files: JSON has no number for it.
    """

    low: float
    high: float
    unit: str = ""
    or_infinity: bool = False

    def __get_pydantic_core_schema__(self, source: type, handler: GetCoreSchemaHandler) -> CoreSchema:
        text = core_schema.plain_serializer_function_ser_schema(_finite_or_text, when_used="json")
        return core_schema.no_info_before_validator_function(
            partial(self.read, source), handler(source), serialization=text if self.or_infinity else None
        )

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        limited = {**handler(schema), "minimum": self.low, "maximum": self.high}
        return {"anyOf": [limited, {"const": INFINITE}]} if self.or_infinity else limited

    def read(self, kind: type, value: Any) -> int | float:
        """The number as a Python number.

        Args:
            kind: int or float.

        Returns:
            The same number.

        Raises:
            ValueError: it is no such number, or not within the limits.
        """
        if getattr(value, "shape", None) == () and hasattr(value, "item"):  # of numpy or JAX
            value = value.item()
        if self.or_infinity and isinstance(value, str | Real) and value in (math.inf, INFINITE):
            return math.inf
        if isinstance(value, bool) or not isinstance(value, Integral if kind is int else Real):
            raise ValueError(f"{short(value)} is not a {'whole ' if kind is int else ''}number")
        number = kind(value)  # pyright: ignore[reportArgumentType]
        if not self.low <= number <= self.high:
            limits = f"{self.low:,g} to {self.high:,g}{self.unit and ' ' + self.unit}"
            raise ValueError(f"{number} must be from {limits}{', or inf' if self.or_infinity else ''}")
        return number


def _finite_or_text(value: float) -> float | str:
    return INFINITE if math.isinf(value) else value


def _text(value: object) -> object:
    return str(value) if isinstance(value, Path) else value


def _both(value: object) -> object:
    """A number as the least and the most."""
    return (value, value) if isinstance(value, Integral) else value


def _compact(value: object) -> object:
    """A component without options as its name."""
    if isinstance(value, list):
        return [_compact(each) for each in value]
    return value["kind"] if isinstance(value, dict) and value.keys() == {"kind"} else value


def meant(word: str, known: Iterable[str], named: Callable[[str], str] = str) -> str:
    """The end of a message about an unknown option.

    Args:
        known: the fields or options that there are.

    Returns:
        The option that other projects call so, or one whose name is like it, as a question; nothing if there is none.
    """
    known = list(known)
    alike = [name for name in known if word.lower() in ALIASES.get(name, "").split()]
    return f"; did you mean '{named(alike[0])}'?" if alike else suggest(named(word), map(named, known))


def short(value: object) -> str:
    """A value as messages give it: not too long.

    Returns:
        At most 60 characters.
    """
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


People = Annotated[int, Number(0, MAX_PEOPLE)]
EpisodeCount = Annotated[int, Number(1, 2**31 - 1)]
EpisodeNumber = Annotated[int, Number(0, 2**31 - 2)]
BatchSize = Annotated[int, Number(1, 2**24)]
ShardSize = Annotated[int, Number(1, MAX_SHARD)]
Rate = Annotated[int, Number(1, MAX_RATE, "Hz")]
Seed = Annotated[int, Number(0, 2**32 - 1)]
Count = Annotated[int, Number(1, 10**9)]
Substeps = Annotated[int, Number(1, 1_000)]
Side = Annotated[int, Number(8, MAX_SIDE)]
Width = Annotated[int, Number(1, MAX_SIDE)]
Share = Annotated[float, Number(0.0, 1.0)]
OpenShare = Annotated[float, Number(1e-6, 1 - 1e-6)]
Duration = Annotated[float, Number(0.0, DAY, "s")]
TimeLimit = Annotated[float, Number(0.1, DAY, "s")]
TimeStep = Annotated[float, Number(0.001, 1.0, "s")]
Radius = Annotated[float, Number(0.01, 1_000.0, "m")]
Distance = Annotated[float, Number(0.0, 10_000.0, "m")]
DistanceOrInfinity = Annotated[float, Number(0.0, 10_000.0, "m", or_infinity=True)]
Coordinate = Annotated[float, Number(-1e6, 1e6)]  # m or degrees
Congestion = Annotated[float, Number(0.0, 1e6, "m2")]
FrameRate = Annotated[float, Number(0.001, 1e4, "frames a second")]
Minutes = Annotated[float, Number(0.1, 60.0 * MAX_HOURS, "min")]
RouteTemperature = Annotated[float, Number(0.0, 1e3, "m")]
Temperature = Annotated[float, Number(1e-3, 1e3, "m")]
Hours = Annotated[float, Number(1e-6, MAX_HOURS, "h")]
HoursOfMinutes = Annotated[float, Number(0.0166, MAX_HOURS, "h")]
WalkingSpeed = Annotated[float, Number(0.0, 100.0, "m/s")]
Threshold = Annotated[float, Number(-1e9, 1e9)]
Noise = Annotated[float, Number(1e-3, 1.0)]
Delay = Annotated[int, Number(0, 1_000, "steps")]
LearningRate = Annotated[float, Number(1e-12, 1.0)]
Height = Annotated[float, Number(0.06, 100.0, "m")]
TimingSeconds = Annotated[float, Number(1e-6, 1e5, "s")]
Text = Annotated[str, BeforeValidator(_text), Field(min_length=1, max_length=4_096)]


def _each_once(value: Any) -> Any:
    """Refuse names, or components, of which one is there twice."""
    each = listed(value) if isinstance(value, str) else value or ()
    each = [part for part in each if not isinstance(part, Value)]
    for part in each:
        if each.count(part) > 1:
            raise ValueError(f"'{part if isinstance(part, str) else part.kind}' is there twice; give it once")
    return value


Names = Annotated[Text, AfterValidator(_each_once)]  # separated by commas


class Config(pydantic.BaseModel):
    """A description: it cannot be changed, and has no key that it does not know."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)

    if not TYPE_CHECKING:  # which knows the fields by the class

        def __init__(self, **values: Any) -> None:
            try:
                super().__init__(**values)
            except pydantic.ValidationError as error:
                raise InputError(sentence(type(self), error.errors(include_url=False)[0])) from None

        __init__.__pydantic_base_init__ = True  # what validates a description does not call it

    def replace(self, **changes: object) -> Self:
        """The description with other values.

        Returns:
            Another description of the same class, checked anew.
        """
        return type(self)(**{**_given(self), **changes})

    def decisive(self) -> dict[str, Any]:
        """All fields that decide the results, as JSON has words for: what is recorded, and what is compared."""
        names = {name for name, field in type(self).model_fields.items() if Incidental() not in field.metadata}
        return {name: _compact(value) for name, value in self.model_dump(mode="json", include=names).items()}


Described = typing.TypeVar("Described", bound=Config)


@dataclass(frozen=True)
class Incidental:
    """Marks an option that decides nothing of the results, such as where they are written."""


@dataclass(frozen=True)
class Positional:
    """Marks what stands right after the command, without its name."""


# ------------------------------------------------------------------ components


class Component(Config):
    """A part of a scenario or run: its kind, and options of its own."""

    kind: Text


class Named(Component):
    """A part without options: a name of ``sean list``; for a policy also the folder of a training."""


class OwnPart(Component):
    """Your own part, ``FILE.py:NAME``. With further keys, NAME is called with them and gives the part."""

    model_config = pydantic.ConfigDict(extra="allow")

    kind: Annotated[str, Field(pattern=f"^{OWN_PART.pattern}$".replace("?P<file>", "").replace("?P<name>", ""))]
    _named_in: Path | None = pydantic.PrivateAttr(default=None)

    def model_post_init(self, context: Any, /) -> None:
        """Remember the file whose description names it, as ``validate`` tells.

        Args:
            context: that file, or None.
        """
        self._named_in = context if isinstance(context, Path) else None

    @property
    def named_in(self) -> Path | None:
        """The file whose description names it; None if the user has, on the command line or in Python."""
        return self._named_in

    @property
    def file(self) -> str:
        """The file, as it was given."""
        return self.kind.rpartition(":")[0]

    @property
    def name(self) -> str:
        """What is taken from the file."""
        return self.kind.rpartition(":")[2]

    @property
    def options(self) -> dict[str, Any]:
        """The further keys."""
        return dict(self.model_extra or {})


class Value(Component):
    """A value of a Python program, which no file can hold."""

    kind: Literal["value"] = "value"
    name: str = ""
    value: Any = Field(default=None, exclude=True, repr=False)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return {"not": {}}  # no file can hold one


class GraphBehavior(Component):
    """People walk, gather and disperse on the environment's behavior graph."""

    kind: Literal["graph"] = "graph"
    routing: Literal["whole", "edge"] = "whole"
    """whole: the way to a goal is kept; edge: people choose anew at each node, as in SEAN 2.0's code."""
    members: Literal["turnover", "permanent"] = "turnover"
    """turnover: members of groups come and go; permanent: who starts in a group stays, as in SEAN 2.0's code."""
    congestion_cost: Congestion = 0.0
    """How much people avoid crowded edges: for each person per m2 an edge costs so many times more; try 10."""
    temperature: RouteTemperature = 0.0
    """How freely people choose their ways: one that costs so many metres more is taken e times less often; 0: never."""
    walking_groups: tuple[Share, Share] = (0.0, 0.0)
    """Shares of the people who walk in pairs and in triples."""


class RandomBehavior(Component):
    """People walk from one random place to another."""

    kind: Literal["random"] = "random"
    walking_groups: tuple[Share, Share] = (0.0, 0.0)
    """Shares of the people who walk in pairs and in triples."""


class HandcraftedBehavior(Component):
    """People walk as the environment's handcrafted sets say."""

    kind: Literal["handcrafted"] = "handcrafted"
    sets: Text = "all"
    """A set, a situation whose sets take part, or all; or a further collection of handcrafted.yaml, such as staged, and
    after its name and _ a situation or set of it."""


class PlaybackBehavior(Component):
    """People walk as they were recorded."""

    kind: Literal["playback"] = "playback"
    recording: Text | None = None
    """A CSV file with the columns frame, id, x and y in metres."""
    recording_format: Literal["eth_ucy", "juelich", "groups", "csv"] | None = None
    """Format of the recording; recognised by default if it tells velocities."""
    frame_rate: FrameRate | None = None
    """Frames a second of the recording; those of its format by default."""


class CustomTask(Component):
    """From a start of your own to a goal of your own."""

    kind: Literal["custom"] = "custom"
    start: tuple[Coordinate, ...] | None = None
    """x and y in metres, and a heading in degrees if you like."""
    goal: tuple[Coordinate, ...] | None = None
    """x and y in metres, and a heading in degrees if you like."""

    @pydantic.field_validator("start", "goal")
    @classmethod
    def _pose(cls, value: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if value is not None and len(value) not in (2, 3):
            raise ValueError(f"has {len(value)} numbers; give x and y, and a heading in degrees if you like")
        return value


@dataclass(frozen=True)
class Family:
    """The components that can stand in a field, by which the command line offers their options."""

    variants: tuple[type[Component], ...]
    singular: str | None = None  # of a field with several, the option that adds one
    several: bool = False  # also without such an option, as tasks that take turns

    def __get_pydantic_core_schema__(self, source: type, handler: GetCoreSchemaHandler) -> CoreSchema:
        tagged = [Annotated[each, Tag(each.__name__)] for each in (*self.variants, OwnPart, Value)]
        union: Any = Annotated[reduce(or_, tagged), Discriminator(self._tag)]  # type: ignore[arg-type]
        one = core_schema.no_info_before_validator_function(self._read, handler.generate_schema(union))
        if not (self.several or self.singular):
            return one
        many = core_schema.tuple_variable_schema(one, min_length=1 if self.several else 0)
        once = core_schema.no_info_after_validator_function(_each_once, many)
        return core_schema.no_info_before_validator_function(self._read_several, once)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return {"anyOf": [{"type": "string"}, handler(schema)]}

    def _read(self, value: object) -> object:
        """What a component is made of: a mapping with a kind, or the component itself."""
        if isinstance(value, Component):
            return value
        if isinstance(value, str | Path):
            value = {"kind": str(value)}
        if not isinstance(value, Mapping):
            name = getattr(value, "__name__", None) or getattr(value, "name", None) or type(value).__name__
            return Value(value=value, name=str(name))
        kind = value.get("kind")
        if kind == "value":
            raise ValueError("was a value of a Python program, which no file holds; put it into a file of its own")
        if not isinstance(kind, str):
            raise ValueError(f"{short(dict(value))} has no kind; there are {', '.join(self.kinds)}")
        if not is_own_part(kind) and self.variant(kind) is None:
            raise ValueError(f"'{kind}' is not one of {', '.join(self.kinds)}{suggest(kind, self.kinds)}")
        return dict(value)

    def _read_several(self, value: object) -> object:
        """Several components: a mapping has names of values, and a text commas between names."""
        if value is None:
            return []
        if isinstance(value, str):
            return listed(value)
        if isinstance(value, Mapping) and "kind" not in value:
            named = value.items()
            return [each if isinstance(each, str) else Value(value=each, name=str(name)) for name, each in named]
        if isinstance(value, Iterable) and not isinstance(value, Component | Mapping):
            return list(value)
        return [value]

    def _tag(self, value: Component | Mapping[str, str]) -> str:
        if isinstance(value, Component):
            return type(value).__name__
        kind = value["kind"]
        variant = OwnPart if is_own_part(kind) else self.variant(kind)
        return variant.__name__ if variant is not None else ""

    @property
    def kinds(self) -> list[str]:
        """The names that have options of their own, or no other description."""
        return [variant.model_fields["kind"].default for variant in self.variants if _is_one_kind(variant)]

    def variant(self, kind: str) -> type[Component] | None:
        """What describes a component of that kind.

        Returns:
            Its class; None if no component of the family has that name.
        """
        for variant in self.variants:
            if not _is_one_kind(variant) or variant.model_fields["kind"].default == kind:
                return variant
        return None

    def options(self) -> dict[str, list[type[Component]]]:
        """Option -> the components that have it."""
        found: dict[str, list[type[Component]]] = {}
        for variant in self.variants:
            for name in variant.model_fields:
                if name != "kind":
                    found.setdefault(name, []).append(variant)
        return found


def _is_one_kind(variant: type[Component]) -> bool:
    return not variant.model_fields["kind"].is_required()


def is_own_part(kind: object) -> bool:
    """Whether a kind stands for a part in a file, ``FILE.py:NAME``.

    Returns:
        True or False.
    """
    return isinstance(kind, str) and OWN_PART.fullmatch(kind) is not None


Forces = Annotated[tuple[Component, ...], Family((Named,), "force")]
Situations = Annotated[tuple[Component, ...], Family((Named,), "situation")]
Metrics = Annotated[tuple[Component, ...], Family((Named,), "metric")]
Sensors = Annotated[tuple[Component, ...], Family((Named,), "sensor")]
Observations = Annotated[tuple[Component, ...], Family((Named,), "observation")]
Rewards = Annotated[tuple[Component, ...], Family((Named,), "reward")]
Terminations = Annotated[tuple[Component, ...], Family((Named,), "termination")]
BehaviorPart = Annotated[
    GraphBehavior | RandomBehavior | HandcraftedBehavior | PlaybackBehavior | Named | OwnPart | Value,
    Family((GraphBehavior, RandomBehavior, HandcraftedBehavior, PlaybackBehavior, Named)),
]
Part = Annotated[Named | OwnPart | Value, Family((Named,))]
Tasks = Annotated[tuple[Component, ...], Family((CustomTask, Named), several=True)]


# ------------------------------------------------------------------ descriptions


OBSERVED = ("goal", "goal_heading", "path", "distance", "speeds", "time", "obstacles", "people")
"""The terms of an agent's observation, where none are named."""

DEFAULT_FORCES = "calibrated"
"""The social forces of people, where none are named."""


class ScenarioConfig(Config):
    """A physical environment, a pedestrian behavior and a robot task (section IV-B), and all that belongs to them."""

    environment: Text = "warehouse"
    """Physical environment: a name, or the folder of your own."""
    preset: Annotated[Literal["sean2"] | None, Incidental()] = None
    """Values of all options of a preset that are not given: sean2, as in SEAN 2.0."""
    behavior: BehaviorPart = GraphBehavior()
    """Pedestrian behavior: who goes where."""
    task: Tasks | None = None
    """Robot task; several, separated by commas, take turns. By default join_group,leave_group with behavior graph,
    handcrafted with handcrafted, custom if a start and a goal are given, else random_ab_nav."""
    robot: Part = Named(kind="kuri")
    """Robot: a name, or an MJCF file."""
    dynamics: Literal["mjx", "twin", "kinematic"] = "mjx"
    """How the robot moves: mjx, its closed-form twin, faster, or kinematic, without inertia as in SEAN 2.0."""
    people: People | None = None
    """Number of people; the environment's own number by default (62 in the warehouse)."""
    model: Part = Named(kind="social_forces")
    """How people move."""
    forces: Forces = (Named(kind=DEFAULT_FORCES),)
    """Social forces: the terms of a preset, and further ones."""
    situations: Situations = (Named(kind="paper"),)
    """Which social situations are told apart: a set, and further ones."""
    thresholds: dict[str, Threshold] | None = None
    """Thresholds of the situation classifiers that differ from those of the set."""
    metrics: Metrics = (Named(kind="all"),)
    """What is measured: all of the package, and further ones."""
    sensors: Sensors = ()
    """Sensors that a policy can read with sean_jax.sense."""
    time_step: TimeStep = 0.1
    """Step of control in seconds."""
    time_limit: TimeLimit = 120.0
    """Longest duration of an episode in seconds."""
    goal_radius: Radius = 1.2
    """Distance in metres within which the goal counts as reached (SEAN 2.0: 1.2)."""
    hold_time: Duration = 5.0
    """Seconds to be spent there for the task to be completed (SEAN 2.0: 5)."""
    task_distance: tuple[Distance, DistanceOrInfinity] = (4.0, 20.0)
    """Shortest and longest path in metres from start to goal; inf for no longest (SEAN 2.0: 0 inf)."""
    places: Literal["uniform", "mesh"] = "uniform"
    """How goals of random people, and starts and goals of the robot where it may go anywhere, are drawn: uniform, or
    mesh, as SEAN 2.0 draws points on its navigation mesh."""
    substeps: Substeps | None = None
    """Steps of the social forces in a step of control; as many as their stiffness needs by default."""
    warm_up: Duration = 0.0
    """Seconds for which people walk before a task begins, as in a crowd that lasts while tasks follow one another."""

    @pydantic.model_validator(mode="before")
    @classmethod
    def _fill(cls, data: object) -> object:
        if isinstance(data, Mapping) and isinstance(data.get("preset"), str) and data["preset"] in PRESETS:
            rest = {name: value for name, value in data.items() if name != "preset"}
            return fill(cls, rest, PRESETS[data["preset"]].options)
        return data

    @pydantic.field_validator("thresholds", mode="before")
    @classmethod
    def _as_dict(cls, value: object) -> object:
        if not hasattr(value, "__dataclass_fields__"):
            return value
        return {name: float(number) for name, number in vars(value).items() if number is not None}

    @pydantic.model_validator(mode="after")
    def _check(self) -> "ScenarioConfig":
        if not self.task_distance[0] < self.task_distance[1]:
            raise ValueError(f"task_distance: {self.task_distance} must be a shorter and a longer distance in metres")
        if self.time_limit < self.time_step:
            raise ValueError(f"time_limit: {self.time_limit:g} must be at least the time step of {self.time_step:g} s")
        return self

    @property
    def tasks(self) -> tuple[Component, ...]:
        """The tasks, or those that the paper gives robots among people of that behavior."""
        if self.task is not None:
            return self.task
        return tuple(Named(kind=name) for name in USUAL_TASKS.get(self.behavior.kind, ("random_ab_nav",)))

    def decisive(self) -> dict[str, Any]:
        """All that decides the results, as JSON has words for: what manifests hold, and what is compared."""
        return super().decisive() | {"task": [_compact(task.model_dump(mode="json")) for task in self.tasks]}


class RunConfig(ScenarioConfig):
    """Simulate a batch of episodes and write a table, a report and an animation. `sean list` names the choices."""

    policy: Part = Named(kind="go_to_goal")
    """Who drives the robot: a name, or the folder that `sean train` or `sean export agent` has written."""
    episodes: EpisodeCount = 64
    """Number of episodes."""
    seed: Seed = 0
    """The same seed gives the same episodes."""
    batch: BatchSize = 1024
    """Most episodes that are simulated at once."""
    camera: Annotated[Text | None, Incidental()] = None
    """Also write camera.gif, the first episode as first_person, third_person, overhead or depth sees it."""
    trajectories: Literal["csv", "parquet"] | None = None
    """Also write the frames of all episodes, robot and people, as trajectories.csv or .parquet."""
    live: Annotated[bool, Incidental()] = False
    """Serve a page on this computer that plays the first episode while it is simulated."""
    name: Annotated[str, Incidental()] = ""
    """Name of the run, environment and behavior by default: the end of the folder's name."""
    out: Annotated[Path | None, Incidental()] = None
    """Folder to write, runs/<date>-<time>-<name> by default: a new or an empty one, or one that holds an unfinished run
    of the same options, which goes on."""
    quiet: Annotated[bool, Incidental()] = False
    """Print nothing but errors."""

    @pydantic.model_validator(mode="before")
    @classmethod
    def _drop_renderer(cls, data: object) -> object:
        """Files of version 0.2 may name a renderer of camera.gif: rays, or one that is gone."""
        if not isinstance(data, Mapping) or "renderer" not in data:
            return data
        if data["renderer"] not in (None, "rays"):
            raise ValueError("renderer: there is only one, which draws camera.gif by rays; leave the option out")
        return {name: value for name, value in data.items() if name != "renderer"}

    @pydantic.model_validator(mode="after")
    def _check_live(self) -> "RunConfig":
        if self.live and self.quiet:
            raise ValueError("live: its address is printed, which --quiet forbids; leave one of the two out")
        return self

    def folder(self, now: str) -> Path:
        """The folder to write.

        Returns:
            ``out``, or a folder in runs/.
        """
        name = self.name or f"{Path(self.environment).name}-{Path(self.behavior.kind).stem}"
        label = "".join(c if c.isalnum() or c in "-_." else "-" for c in name)
        return self.out or Path("runs") / f"{now}-{label}"


class CollectConfig(ScenarioConfig):
    """Record demonstrations: what a driver sees and does, second by second. A folder that has some is continued."""

    metrics: Annotated[tuple[Named, ...], Incidental()] = ()
    """Nothing is measured while demonstrations are recorded."""
    policy: Part = Named(kind="expert")
    """Who drives: a name, or the folder that `sean train` has written."""
    labels: Part | None = None
    """Who says what should be done, while the policy drives: it is recorded in place of the policy's commands."""
    noise: Noise | None = None
    """Standard deviation of noise on the driver's commands, as a share of the robot's limits: the robot is led astray,
    and the driver shows the way back. What is recorded are the commands without it."""
    hours: Annotated[Hours, Incidental()] = 1.0
    """Hours of demonstrations; several tasks get the same time, and so do the five situations of handcrafted people."""
    rate: Rate = 1
    """How many examples begin in a second: 1, or another divisor of the steps of control in a second. Within an example
    the images, and the places, are a second apart at any rate."""
    width: Side = 64
    """Width of the depth images in pixels."""
    height: Side = 48
    """Height of the depth images in pixels."""
    batch: Annotated[ShardSize | None, Incidental()] = None
    """Episodes that are simulated at once and stored in one file; by the device and the time asked for by default."""
    seed: Seed = 0
    """The same seed gives the same demonstrations."""
    out: Annotated[Path | None, Incidental()] = None
    """Folder of the dataset, runs/demonstrations-<environment>-<behavior>-<policy>-<seed> by default. If it holds one
    of the same options, that is continued."""
    quiet: Annotated[bool, Incidental()] = False
    """Print nothing but errors."""

    @pydantic.model_validator(mode="after")
    def _check_recorded(self) -> "CollectConfig":
        if self.width * self.height > MAX_PIXELS:
            size = f"{self.width} times {self.height} are more than {MAX_PIXELS:,} pixels"
            raise ValueError(f"width: {size}; ask for fewer")
        if self.behavior.kind == "playback":
            raise ValueError("behavior: playback is not recorded; choose behavior graph, random or handcrafted")
        if any(task.kind == "custom" for task in self.tasks):
            raise ValueError("task: custom is not recorded; choose another task")
        steps = round(1.0 / self.time_step)
        if steps % self.rate:
            text = f"{self.rate} examples a second do not divide its {steps} steps of control"
            raise ValueError(f"rate: {text}; choose a divisor")
        return self

    @property
    def folder(self) -> Path:
        """The folder of the dataset."""
        names = (
            Path(self.environment).name,
            Path(self.behavior.kind).stem,
            Path(self.policy.kind).stem,
            str(self.seed),
        )
        return self.out or Path("runs") / "-".join(("demonstrations", *names))


class TrainConfig(Config):
    """Train a network on a dataset. A folder that has a training of the same options is continued."""

    method: Annotated[Literal["imitation"], Positional(), Incidental()]
    """How: imitation of what the demonstrations do."""
    dataset: Annotated[Path, Positional(), Incidental()]
    """Folder that `sean collect` has written."""
    further: Annotated[tuple[Path, ...], Incidental()] = ()
    """Folders of further datasets, which are learned from as well."""
    part: tuple[Count, Count] = (1, 1)
    """Which of how many equal parts of the dataset's episodes is learned from: 3 10 for the third of ten."""
    pretrained: Path | None = None
    """Folder of a training whose best network goes on to learn."""
    flags: bool = False
    """Let the network know which social situations occur."""
    balance: bool = False
    """Draw examples so that all social situations are as frequent as one another."""
    width: Width = 64
    """Width of the encodings and hidden layers."""
    batch: BatchSize = 1024
    """Examples in a step."""
    learning_rate: LearningRate = 1e-3
    """Learning rate of AdamW."""
    weight_decay: Share = 0.01
    """Weight decay of AdamW."""
    patience: Annotated[Count, Incidental()] = 50
    """Epochs without a smaller loss in validation, after which training stops."""
    epochs: Annotated[Count, Incidental()] = 1000
    """Most epochs."""
    validation: OpenShare = 0.1
    """Share of the episodes that validate."""
    on_device: Annotated[Share, Incidental()] = 0.6
    """Share of the device's memory that a dataset may fill; a larger one is read from disk again and again."""
    seed: Seed = 0
    """The same seed gives the same network."""
    out: Annotated[Path | None, Incidental()] = None
    """Folder for checkpoints and metrics, runs/imitation-<dataset>-<seed> by default. If it holds a training of the
    same options, that is continued."""
    quiet: Annotated[bool, Incidental()] = False
    """Print nothing but errors."""

    @pydantic.model_validator(mode="after")
    def _check_part(self) -> "TrainConfig":
        which, parts = self.part
        if which > parts:
            raise ValueError(f"part: {which} of {parts} is none; give a first number of {parts} or less")
        return self

    @property
    def folder(self) -> Path:
        """The folder for checkpoints and metrics."""
        return self.out or Path("runs") / f"imitation-{self.dataset.resolve().name}-{self.seed}"


class DaggerConfig(TrainConfig):
    """Train networks in turn: each drives, an expert says what should have been done, and the next learns from it."""

    method: Annotated[Literal["dagger"], Positional(), Incidental()]  # pyright: ignore
    """How: imitation of an expert in the network's own states."""
    expert: Part = Named(kind="expert")
    """Who says what should be done: a name, or FILE.py:NAME."""
    rounds: Count = 5
    """Networks after that of the dataset alone."""
    hours: Hours = 0.25
    """Hours that each network drives."""

    @property
    def folder(self) -> Path:
        """The folder for all networks and what they drove."""
        return self.out or Path("runs") / f"dagger-{self.dataset.resolve().name}-{self.seed}"


class EnvConfig(ScenarioConfig):
    """A scenario as an environment of reinforcement learning: what the agent sees, and what it is rewarded for."""

    dynamics: Literal["mjx", "twin", "kinematic"] = "twin"
    """How the robot moves: twin, its closed form, mjx, or kinematic, without inertia as in SEAN 2.0."""
    observations: Observations = tuple(Named(kind=name) for name in OBSERVED)
    """What the agent sees: terms of `sean list`, and further ones."""
    rewards: Rewards = (Named(kind="default"),)
    """What it is rewarded for: default, terms of `sean list`, and further ones."""
    terminations: Terminations = ()
    """What ends an episode beside completion and the time limit: collision, obstacle, intimate, and further ones."""
    randomization: Part | None = None
    """What differs between episodes: behavior is how people behave; or a function (key, scenario) -> scenario."""
    action_delay: Annotated[tuple[Delay, Delay], BeforeValidator(_both)] = (0, 0)
    """Steps of control by which commands are late, least and most; drawn for each episode."""

    @pydantic.field_validator("action_delay")
    @classmethod
    def _in_order(cls, value: tuple[int, int]) -> tuple[int, int]:
        if value[0] > value[1]:
            raise ValueError(f"{value[0]} is more than {value[1]}; give the least steps first")
        return value


class ReinforcementConfig(EnvConfig):
    """What all ways of reinforcement learning are told."""

    SWEPT: ClassVar[tuple[str, ...]] = ("learning_rate", "discount", "advantage_decay")
    """Numbers in which agents that are trained side by side may differ."""

    method: Annotated[str, Positional(), Incidental()]
    """How."""
    environment: Names = "warehouse"
    """Physical environment: a name, or the folder of your own; several, separated by commas, share the scenarios, and
    one agent learns in all of them."""
    critic: Annotated[tuple[Component, ...], Family((Named,), "critic_term")] = ()
    """What the critic sees beside the observations, such as people: it does not drive, so it may see anything."""
    scenarios: BatchSize = 64
    """Scenarios that step together, of each agent; on a GPU try 8192."""
    steps: Count = 2_000_000
    """Scenario-steps of the whole training of an agent, over which the learning rate falls to 0."""
    horizon: Count = 32
    """Steps of each scenario between two updates."""
    minibatches: Count = 8
    """Parts of what was seen, each of which makes a step of the optimizer."""
    learning_rate: LearningRate = 5e-4
    """Learning rate of Adam at the beginning."""
    discount: Share = 0.99
    """What a reward is worth one step later."""
    advantage_decay: Share = 0.95
    """Lambda of the generalized advantage estimate."""
    width: Width = 256
    """Width of the hidden layers."""
    layers: Count = 2
    """Hidden layers of the actor and of the critic."""
    recurrent: bool = False
    """Give the network a memory, a gated recurrent unit."""
    bfloat16: bool = False
    """Keep and encode images in half precision: quicker on a GPU, slower on a CPU."""
    careful: bool = False
    """Let the noise of actions depend on what is seen, so that an agent can be exact where that matters."""
    noise: Noise | None = None
    """Standard deviation of actions at the beginning, 0.5 or that of the pretrained agent by default; they are from -1
    to 1."""
    pool: BatchSize = 1024
    """Starts of episodes that are drawn beforehand, in each environment."""
    curriculum: Literal["none", "situations", "regret"] = "none"
    """Which of them are taken more often: none, those of situations in which the agent costs people most, or those from
    which it could do better, among people who behave otherwise in each episode."""
    curriculum_every: Count = 20
    """Updates until a curriculum draws new starts for those that have least to teach."""
    pretrained: Path | None = None
    """Folder of a training whose agent goes on to learn."""
    imitate: Part | None = None
    """Who is imitated at first: the name of a policy, or the folder of a training, such as sean train dagger's."""
    seeds: Count = 1
    """Agents that are trained side by side, with seeds that follow one another."""
    sweep: tuple[Text, ...] = ()
    """Numbers in which agents differ, such as learning_rate=0.001,0.0003 or rewards.time=-0.1,-0.2; all combinations
    are trained side by side."""
    evaluate_every: Annotated[Count, Incidental()] = 50
    """Updates between two evaluations, each with a checkpoint."""
    evaluation_episodes: Annotated[EpisodeCount, Incidental()] = 64
    """Episodes of an evaluation, in each environment, in which the agent takes the mean of its actions."""
    seed: Seed = 0
    """The same seed gives the same agent."""
    out: Annotated[Path | None, Incidental()] = None
    """Folder for checkpoints and metrics, runs/METHOD-<environment>-<behavior>-<seed> by default. If it holds a
    training of the same options, that is continued."""
    distributed: Annotated[bool, Incidental()] = False
    """This process is one of several that train together, on one or more hosts, as SLURM and MPI start them."""
    quiet: Annotated[bool, Incidental()] = False
    """Print nothing but errors."""

    @pydantic.model_validator(mode="after")
    def _check_numbers(self) -> "ReinforcementConfig":
        if self.scenarios % self.minibatches:
            text = f"{self.scenarios} scenarios do not make {self.minibatches} minibatches of equal size"
            raise ValueError(f"minibatches: {text}; choose a divisor")
        if self.imitate is not None and self.pretrained is not None:
            raise ValueError(f"imitate: {self.imitate.kind} besides --pretrained {self.pretrained}; choose one")
        if self.scenarios % len(self.environments):
            text = f"{self.scenarios} do not spread evenly over {len(self.environments)} environments"
            raise ValueError(f"scenarios: {text}; take a multiple")
        if self.curriculum != "none" and len(self.environments) > 1:
            text = f"{self.curriculum} chooses the starts of one environment, and not of {self.environment}"
            raise ValueError(f"curriculum: {text}; choose one of the two")
        if self.seed + self.seeds > 2**32:
            raise ValueError(
                f"seeds: {self.seeds} that follow seed {self.seed} go beyond {2**32 - 1}; take a lesser seed"
            )
        _ = self.agents
        return self

    @property
    def environments(self) -> list[str]:
        """The environments in which one agent learns."""
        return listed(self.environment) or [self.environment]

    @property
    def of_each(self) -> list[Self]:
        """The description of a training in each of them alone."""
        return [self.replace(environment=name) for name in self.environments]

    @property
    def agents(self) -> list[dict[str, float]]:
        """What each agent has for itself: its seed, a number for each name in ``SWEPT``, and weights of rewards.

        Raises:
            ValueError: the sweep names something else, or an impossible number.
        """
        found = [{name: float(getattr(self, name)) for name in self.SWEPT}]
        swept = [text.partition("=")[0] for text in self.sweep]
        for text in self.sweep:
            name, _, values = text.partition("=")
            if name not in self.SWEPT and not name.startswith("rewards."):
                known = ", ".join((*self.SWEPT, "rewards.NAME"))
                raise ValueError(f"sweep: '{name}' cannot be swept; {known} can, as in {self.SWEPT[0]}=0.1,0.2")
            if swept.count(name) > 1:
                raise ValueError(f"sweep: '{name}' is there twice; give it once, with all of its numbers")
            limits = type(self).model_fields[name].metadata if name in self.SWEPT else [pydantic.AllowInfNan(False)]
            possible = pydantic.TypeAdapter(Annotated[float, *limits])
            try:
                numbers = [possible.validate_python(float(part)) for part in values.split(",")]
            except ValueError:
                raise ValueError(f"sweep: {name}={values} must be numbers that --{name} may have") from None
            if len({*numbers}) < len(numbers):
                raise ValueError(f"sweep: {name}={values} has a number twice; give it once")
            found = [{**agent, name: number} for agent in found for number in numbers]
        return [{"seed": self.seed + more, **agent} for agent in found for more in range(self.seeds)]

    @property
    def folder(self) -> Path:
        """The folder for checkpoints and metrics."""
        places = (Path(name).name for name in self.environments)
        return self.out or Path("runs") / "-".join(
            (self.method, *places, Path(self.behavior.kind).stem, str(self.seed))
        )


class PPOConfig(ReinforcementConfig):
    """Train a network by reinforcement learning, with proximal policy optimization. A folder that has a training of the
    same options is continued."""

    SWEPT = (*ReinforcementConfig.SWEPT, "clip", "entropy")

    method: Annotated[Literal["ppo"], Positional(), Incidental()]  # pyright: ignore
    """How: proximal policy optimization."""
    epochs: Count = 4
    """How often an update goes through what was seen."""
    clip: Share = 0.2
    """How far an update may change the probability of an action."""
    entropy: Share = 0.002
    """Weight of the entropy of actions."""


class APGConfig(ReinforcementConfig):
    """Train a network with the derivatives of the simulator itself over short horizons, and a critic for what follows
    (SHAC). A folder that has a training of the same options is continued."""

    method: Annotated[Literal["apg"], Positional(), Incidental()]  # pyright: ignore
    """How: analytic policy gradients over short horizons."""
    horizon: Count = 16
    """Steps of each scenario between two updates, through which derivatives are taken."""
    critic_epochs: Count = 4
    """How often the critic goes through what was seen."""
    through_people: bool = False
    """Take derivatives through people as well, who make way for the robot."""
    target_share: Share = 0.2
    """How far the critic that tells what follows moves to the learned one with each update."""


METHODS: dict[str, type[Config]] = {
    "imitation": TrainConfig,
    "dagger": DaggerConfig,
    "ppo": PPOConfig,
    "apg": APGConfig,
}
"""Word after ``sean train`` -> what it is told."""


class ExportConfig(Config):
    """Write a dataset in another project's format, or the best agent of a training as a small folder."""

    format: Annotated[Literal["lerobot", "agent"], Positional()]
    """Which: lerobot is a dataset as LeRobotDataset v3.0, agent a trained agent in two small files."""
    source: Annotated[Path, Positional()]
    """Folder that `sean collect` has written, or, for agent, `sean train ppo`."""
    out: Path
    """Folder to write; it must be new or empty."""
    quiet: bool = False
    """Print nothing but errors."""

    @property
    def folder(self) -> Path:
        """The folder to write."""
        return self.out


class ExperimentConfig(Config):
    """Table I or Figure 4 of the paper, beside its own numbers, as a report. A folder that has a part is continued."""

    which: Annotated[Literal["table1", "ablation", "figure4", "learning_curve"], Positional()]
    """table1: how much of the time the robot is in each social situation; ablation: the same with SEAN's conditions one
    by one. figure4: four policies in three scenarios; learning_curve: one of them, G, with more demonstrations, more
    examples a second, and social situations as an input."""
    quick: bool = False
    """Small enough for a CPU and ten minutes: less time, fewer seeds and episodes, smaller images."""
    environment: Text = "warehouse"
    """Physical environment: a name, or the folder of your own."""
    policies: Names = "go_to_goal,social_costmap,expert"
    """Of table1: who drives, separated by commas; none for recordings alone."""
    recordings: Names | None = None
    """Of table1: recordings, CSV files separated by commas; each of their people in turn plays the robot."""
    frame_rate: FrameRate | None = None
    """Frames a second of the recordings; those of their formats by default."""
    demonstrator: Text = "expert"
    """Of figure4 and learning_curve: who demonstrates."""
    others: Names | None = None
    """Of figure4: further drivers of the same episodes, separated by commas, or none: names, folders that `sean train`
    has written, such as runs/dagger of `sean train dagger` or runs/apg of `sean train apg`, or FILE.py:NAME. By default
    move_base, ppo, ppo_depth and sensing_expert, and none with --quick."""
    hours: HoursOfMinutes | None = None
    """Hours for each behavior, 1 by default: in table1 as often as --seeds says, in figure4 of demonstrations."""
    amounts: Annotated[tuple[HoursOfMinutes, ...] | None, Field(min_length=1)] = None
    """Of learning_curve: hours of demonstrations, 1, 10 and 100 by default. Networks of the first one are compared with
    those of other rates, and with those that know the situations."""
    rates: tuple[Rate, ...] | None = None
    """Of learning_curve: examples a second beside one a second, 10 by default."""
    updates: Count | None = None
    """Of learning_curve: most steps of a network's optimizer, 20,000 by default; a hundred hours end by it, fewer ones
    stop by themselves before."""
    seeds: Count | None = None
    """Of table1: how many times these hours are simulated, all drawn from the one seed of --seed, 10 by default."""
    preset: Literal["sean2"] | None = None
    """Whose conditions: this package's, or sean2 for those of SEAN 2.0. What is given besides wins."""
    speeds: Annotated[tuple[WalkingSpeed, ...], Field(min_length=1)] = (1.4, 1.2, 1.0, 0.8, 0.6, 0.4)
    """Of table1: who is faster counts as walking, V in m/s; the first is that of the table. With preset sean2 the
    slowest comes first by default."""
    crowds: tuple[People, ...] | None = None
    """Of table1: other numbers of people to try, 10, 20, 40 and 100 by default."""
    datasets: Count | None = None
    """Of figure4: datasets of demonstrations that each policy learns from, each by itself, 10 by default; 3 in
    learning_curve."""
    trainings: Count | None = None
    """Of figure4: networks that learn from each dataset, each with a seed of its own, 3 by default; 1 in
    learning_curve."""
    episodes: EpisodeCount | None = None
    """Of figure4: for each policy in each scenario, 12300 by default; its networks take equal shares of them. 4096 in
    learning_curve."""
    people: People | None = None
    """Number of people of random and graph; the environment's own by default (62 in the warehouse)."""
    robot: Part = Named(kind="kuri")
    """Robot: a name, or an MJCF file."""
    dynamics: Literal["mjx", "twin", "kinematic"] = "mjx"
    """How the robot moves: mjx, its closed-form twin, faster, or kinematic, without inertia as in SEAN 2.0."""
    time_limit: TimeLimit = 120.0
    """Longest duration of an episode in seconds."""
    epochs: Count | None = None
    """Of figure4 and learning_curve: most epochs of training, 1000 by default."""
    seed: Seed = 0
    """The same seed gives the same results."""
    out: Annotated[Path | None, Incidental()] = None
    """Folder for the results, runs/EXPERIMENT by default. If it holds a part of the same options, that is continued."""
    quiet: Annotated[bool, Incidental()] = False
    """Print nothing but errors."""

    @property
    def folder(self) -> Path:
        """Where the results go."""
        return self.out or Path("runs") / (self.which + ("-quick" if self.quick else ""))

    def decisive(self) -> dict[str, Any]:
        """All that decides the results; further drivers do not, so that they can be added to a finished experiment."""
        return {name: value for name, value in super().decisive().items() if name != "others"}

    def complete(self) -> "ExperimentConfig":
        """The description with numbers for what was left open."""
        full: dict[str, object] = dict(hours=1.0, seeds=10, epochs=1000, crowds=(10, 20, 40, 100))
        full |= dict(datasets=10, trainings=3, episodes=12_300, others="move_base,ppo,ppo_depth,sensing_expert")
        quick: dict[str, object] = dict(
            hours=0.05, seeds=2, epochs=30, crowds=(), datasets=1, trainings=1, episodes=12, others="none"
        )
        if self.which == "learning_curve":
            full |= dict(amounts=(1.0, 10.0, 100.0), rates=(10,), updates=20_000)
            full |= dict(datasets=3, trainings=1, episodes=4096)
            quick |= dict(amounts=(0.05, 0.2), rates=(10,), updates=20_000)
        missing = {k: v for k, v in (quick if self.quick else full).items() if getattr(self, k) is None}
        if self.preset == "sean2" and "speeds" not in self.model_fields_set:
            missing["speeds"] = self.speeds[::-1]
        return self.replace(**missing)


class BenchmarkConfig(Config):
    """Compare a driver with all others on fixed tracks: a table by social situation and a result with a checksum. A
    folder that has a part is continued."""

    policy: Annotated[Text, Positional()]
    """Who drives: a name, the folder that `sean train` or `sean export agent` has written, or FILE.py:NAME."""
    quick: bool = False
    """So few episodes that a CPU needs minutes; such a result tells whether a driver works, and ranks nobody."""
    episodes: EpisodeCount | None = None
    """Episodes of each track, those of the protocol by default; a result with fewer ranks nobody."""
    out: Annotated[Path | None, Incidental()] = None
    """Folder for the result, runs/benchmark-POLICY by default. If it holds a part of the same options, that is
    continued."""
    quiet: Annotated[bool, Incidental()] = False
    """Print nothing but errors."""

    @property
    def folder(self) -> Path:
        """Where the result goes."""
        name = Path(self.policy.replace(":", "-")).name
        return self.out or Path("runs") / f"benchmark-{name}{'-quick' if self.quick else ''}"


class BenchConfig(Config):
    """Measure speed on this machine and write it as a table, as JSON and as a picture."""

    environment: Text = "warehouse"
    """Physical environment: a name, or the folder of your own."""
    people: People | None = None
    """Number of people; the environment's own number by default (62 in the warehouse)."""
    robot: Part = Named(kind="kuri")
    """Robot: a name, or an MJCF file."""
    dynamics: Literal["mjx", "twin", "kinematic"] = "mjx"
    """How the robot moves: mjx, its closed-form twin, faster, or kinematic, without inertia as in SEAN 2.0."""
    only: Names = "step,depth,images,pictures,crowd,compile,devices"
    """Parts to measure, separated by commas."""
    batches: tuple[BatchSize, ...] = ()
    """Numbers of scenarios at once; by default 1 to 256 on a CPU and 1 to 65536 on a GPU."""
    repeats: Count = 5
    """Times that each is timed, of which the median counts."""
    seconds: TimingSeconds = 1.0
    """About how long one timing takes."""
    out: Annotated[Path | None, Incidental()] = None
    """Folder to write, by default sean-bench-DATE-TIME."""
    quiet: Annotated[bool, Incidental()] = False
    """Print nothing but errors."""

    @pydantic.field_validator("only")
    @classmethod
    def _known(cls, value: str) -> str:
        known = listed(cls.model_fields["only"].default)
        for part in listed(value) or ["nothing"]:
            if part not in known:
                raise ValueError(f"{part!r} is not one of {', '.join(known)}{suggest(part, known)}")
        return value

    @property
    def parts(self) -> list[str]:
        """The names in ``only``."""
        return listed(self.only)

    def folder(self) -> Path:
        """Where the results go."""
        return self.out or Path(f"sean-bench-{datetime.datetime.now():%Y%m%d-%H%M%S}")


class ValidateConfig(Config):
    """Check the people against what is known of real ones: standards, measured diagrams, recordings."""

    quick: bool = False
    """Small enough for a CPU and five minutes: fewer seeds, and without the checks of a thousand people."""
    only: Names | None = None
    """Checks, separated by commas; rimea-* stands for all whose names begin so. All by default."""
    models: Names | None = None
    """Who moves people, separated by commas: presets of forces, files of constants, models, or FILE.py:NAME; the
    default forces if none is named."""
    data: Path | None = None
    """Folder of recordings; checks that need them are skipped without."""
    strict: Annotated[bool, Incidental()] = False
    """Exit code 1 if a check fails."""
    out: Annotated[Path | None, Incidental()] = None
    """Folder for the results, runs/validate by default. What it holds of the same checks and models is kept."""
    quiet: Annotated[bool, Incidental()] = False
    """Print nothing but errors."""

    @property
    def folder(self) -> Path:
        """Where the results go."""
        return self.out or Path("runs") / ("validate-quick" if self.quick else "validate")


class CalibrateConfig(Config):
    """Fit the constants of the social forces to recorded people, by gradient. A fit that was stopped is continued."""

    data: Path
    """Folder of recordings: scenes of ETH and UCY, runs of Juelich's corridors."""
    forces: Text = DEFAULT_FORCES
    """Where the fit begins: a preset of social forces, or a YAML file of constants."""
    fit: Names | None = None
    """Constants to fit, separated by commas, such as repulsion.range; by default all that have bounds."""
    leave_out: Names | None = None
    """Scenes of prediction, separated by commas, each left out by a fit of its own that is judged by it; all by
    default, or none."""
    steps: Count = 60
    """Steps of the descent."""
    starts: Count = 1
    """Starts of each fit, side by side: the first from the constants given. On a GPU try 64."""
    batch: Count = 8
    """Windows of each scene of prediction in a step; of corridors a sixteenth of that, at least one."""
    seed: Seed = 0
    """The same seed gives the same constants."""
    out: Annotated[Path | None, Incidental()] = None
    """Folder for the results, runs/calibration by default."""
    quiet: Annotated[bool, Incidental()] = False
    """Print nothing but errors."""

    @property
    def folder(self) -> Path:
        """Where the results go."""
        return self.out or Path("runs") / "calibration"


class FitGraphConfig(Config):
    """Propose a behavior graph for an environment, or fit one to recorded or simulated people."""

    environment: Annotated[Text, Positional()]
    """Physical environment: a name, or the folder of your own."""
    recording: Path | None = None
    """People to fit to: a CSV file with the columns frame, id, x and y in metres."""
    recording_format: Literal["eth_ucy", "juelich", "groups", "csv"] | None = None
    """Format of the recording; recognised by default if it tells velocities."""
    frame_rate: FrameRate | None = None
    """Frames a second of the recording; those of its format by default."""
    simulate: bool = False
    """Fit to people simulated on the environment's own graph, to see whether it is found again."""
    propose: bool = False
    """Propose nodes and edges even if the environment has a graph; without people to fit to, nothing else is done."""
    graph: Path | None = None
    """A graph.yaml whose nodes and edges are taken; the environment's own by default."""
    people: People | None = None
    """Number of simulated people; the environment's own number by default."""
    routing: Literal["whole", "edge"] = "whole"
    """Of simulated people: as in sean run."""
    minutes: Minutes = 20.0
    """Minutes to simulate for the fit; as many others judge it."""
    temperature: Temperature = 0.25
    """How strictly people take the cheapest way: ways that cost so many metres more are taken e times less often."""
    seed: Seed = 0
    """The same seed gives the same results."""
    out: Annotated[Path | None, Incidental()] = None
    """Folder to write, runs/graph-ENVIRONMENT by default; it must be new or empty. It is an environment of its own."""
    quiet: Annotated[bool, Incidental()] = False
    """Print nothing but errors."""

    @pydantic.model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.recording is not None and self.simulate:
            raise ValueError("simulate: a recording is given as well; leave one of them out")
        return self

    @property
    def folder(self) -> Path:
        """The folder to write."""
        return self.out or Path("runs") / f"graph-{Path(self.environment).name}"


class DrawConfig(Config):
    """Draw what people do in the environments: their behavior graphs, or their handcrafted sets."""

    graph: bool = False
    """The behavior graph, with its groups seated."""
    handcrafted: bool = False
    """The handcrafted sets, one panel each."""
    sets: Text = "all"
    """Which handcrafted sets, as in sean run."""
    environment: Text | None = None
    """Environment: a name, or the folder of your own; all that come with the package by default."""
    out: Path | None = None
    """File to write, such as sheet.png or sheet.svg; of several environments, each adds its name."""


class ReplayConfig(Config):
    """Write a page that plays episodes of a run, a dataset or a training, or tests of a validation: they are simulated
    again, by what the folder tells."""

    folder: Annotated[Path, Positional()]
    """Folder that `sean run`, `collect`, `train` or `validate` has written."""
    episodes: Annotated[tuple[EpisodeNumber, ...], Field(min_length=1)] = (0,)
    """Their numbers from 0 on: of a run as in episodes.csv, of a dataset as they were recorded, of a training those of
    its evaluations, which take turns in its environments."""
    only: Names | None = None
    """Tests of a validation, separated by commas, such as rimea-6,imo-1; its first by default."""
    out: Path | None = None
    """File to write, replay.html in the folder by default."""
    quiet: bool = False
    """Print nothing but errors."""


class CompareConfig(Config):
    """Compare two runs: differences in the episodes that both have, with intervals, and their replays side by side."""

    first: Annotated[Path, Positional()]
    """Folder that `sean run` has written."""
    second: Annotated[Path, Positional()]
    """Folder of the other run."""
    out: Path | None = None
    """Page to write, compare-FIRST-SECOND.html by default."""
    quiet: bool = False
    """Print nothing but errors."""


class DoctorConfig(Config):
    """Versions, devices and folders of this machine, and what is slow or missing."""


class ImportMapConfig(Config):
    """Make an environment of a ROS map, the YAML file of a map_server with its image."""

    map: Annotated[Path, Positional()]
    """YAML file of the map."""
    out: Path
    """Folder to write; it must be new or empty. Its path then serves as --environment."""
    people: People | None = None
    """Default number of people; one for each 25 m2 of free floor by default."""
    height: Height = 2.0
    """Height of all obstacles in metres, for a map has none."""
    unknown: Literal["obstacle", "free"] = "obstacle"
    """What cells are that the map does not know."""


class ListConfig(Config):
    """What there is to choose from for each option."""


class SchemaConfig(Config):
    """Print the JSON Schema of config.yaml, by which editors complete and check it."""


COMMANDS: dict[str, type[Config]] = {
    "run": RunConfig,
    "collect": CollectConfig,
    "train": TrainConfig,
    "experiment": ExperimentConfig,
    "export": ExportConfig,
    "fit-graph": FitGraphConfig,
    "calibrate": CalibrateConfig,
    "draw": DrawConfig,
    "replay": ReplayConfig,
    "compare": CompareConfig,
    "import-map": ImportMapConfig,
    "benchmark": BenchmarkConfig,
    "bench": BenchConfig,
    "validate": ValidateConfig,
    "doctor": DoctorConfig,
    "list": ListConfig,
    "schema": SchemaConfig,
}
"""Word of the command line -> what it is told."""


# ------------------------------------------------------------------ what is wrong with a description


def family_of(field: FieldInfo) -> Family | None:
    """The components that can stand in a field.

    Returns:
        Their family; None if it holds no component.
    """
    found = [each for each in field.metadata if isinstance(each, Family)]
    for kind in typing.get_args(field.annotation):  # such as Tasks | None
        found += [each for each in getattr(kind, "__metadata__", ()) if isinstance(each, Family)]
    return found[0] if found else None


def gather(
    model: type[Config],
    values: Mapping[str, object],
    base: Mapping[str, object] | None = None,
    named: Callable[[str], str] = str,
) -> dict[str, Any]:
    """Fields of a description from values among which options of components stand beside them.

    So ``behavior="graph", routing="edge"`` is ``behavior={"kind": "graph", "routing": "edge"}``, as for the commands.

    Args:
        values: field or option -> value.
        base: fields for what is not given.
        named: field or option -> how messages name it.

    Raises:
        InputError: an option does not belong to the chosen component.
    """
    data, values = dict(base or {}), dict(values)
    for name, field in model.model_fields.items():
        family = family_of(field)
        owners = {} if family is None else family.options()
        options = {
            option: values.pop(option) for option in owners if option in values and option not in model.model_fields
        }
        if name in values:
            data[name] = values.pop(name)
        if options and family is not None:
            data[name] = _with_options(name, data.get(name), field.get_default(), options, family, named)
    return data | values


def _given(description: Config) -> dict[str, Any]:
    """The fields of a description that were given, as values."""
    return {name: getattr(description, name) for name in description.model_fields_set}


def fill(model: type[Config], data: Mapping[str, Any], options: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of a description with options that were not given. Those of a component hold where it is chosen."""
    full = dict(data)
    behavior = _as_mapping(full.get("behavior")) or {}
    for option, value in options.items():
        if option == "warm_up" and behavior.get("kind") == "playback":
            continue  # a recording begins with its own people
        if option in model.model_fields:
            full.setdefault(option, value)
            continue
        for name, field in model.model_fields.items():
            family = family_of(field)
            part = _as_mapping(full.get(name, field.get_default()))
            if family is None or part is None or not isinstance(part.get("kind"), str) or is_own_part(part["kind"]):
                continue
            variant = family.variant(part["kind"])
            if variant is not None and option in variant.model_fields:
                full[name] = {option: value, **part}
    return full


def _as_mapping(part: Any) -> dict[str, Any] | None:
    """What was said of a component; None if that is no component, or a value."""
    if isinstance(part, Component) and not isinstance(part, Value):
        return {**_given(part), "kind": part.kind}
    if isinstance(part, str):
        return {"kind": part}
    return dict(part) if isinstance(part, Mapping) else None


def _with_options(
    name: str, chosen: Any, default: object, options: dict[str, object], family: Family, named: Callable[[str], str]
) -> Any:
    """A component together with options that stand beside it."""
    if isinstance(chosen, OwnPart):
        return chosen.model_copy(update=options)
    if family.several:
        chosen = chosen[0] if isinstance(chosen, list | tuple) and len(chosen) == 1 else chosen
        if chosen is None and len(options) == len(family.options()):
            chosen = family.kinds[0]
    elif chosen is None:
        chosen = default
    chosen = _as_mapping(chosen) or chosen
    kind = chosen.get("kind") if isinstance(chosen, Mapping) else None
    owners = family.options()
    variant = family.variant(kind) if isinstance(kind, str) else None
    for option in options:
        if is_own_part(kind) or (variant is not None and variant in owners[option]) or variant is None and kind:
            continue
        kinds = " or ".join(f"'{owner.model_fields['kind'].default}'" for owner in owners[option])
        what = f"{name} '{kind}'" if kind else f"the default {name}" if chosen is None else f"a {name} of your own"
        raise InputError(f"{named(option)}: {what} has no such option; choose {name} {kinds}.")
    assert isinstance(chosen, Mapping)  # else an option was refused above
    return {**chosen, **options}


def validate(
    model: type[Described],
    data: Mapping[str, object],
    named: Callable[[str], str] = str,
    source: Path | None = None,
) -> Described:
    """The description, checked.

    Args:
        source: the file that holds the values, whose own parts run if the user trusts it (``components.trust``); None
            for values that the user has given. A component that is there already stays whose it is.

    Raises:
        InputError: one sentence for the first thing that is wrong: field, value, cure.
    """
    try:
        return model.model_validate(dict(data), context=source)
    except pydantic.ValidationError as error:
        raise InputError(sentence(model, error.errors(include_url=False)[0], named)) from None


_TYPES = {  # of pydantic's errors -> what the value should be
    "string_type": "a text",
    "tuple_type": "a list",
    "dict_type": "a mapping",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "path_type": "a path",
}


def sentence(model: type[Config], error: ErrorDetails, named: Callable[[str], str] = str) -> str:
    """pydantic's error as one sentence.

    Args:
        error: one of ``ValidationError.errors()``.
    """
    classes = {each.__name__: each for each in _component_classes(model)}
    path = [part for part in error["loc"] if part not in classes]
    owner = next((classes[part] for part in reversed(error["loc"]) if part in classes), model)
    kind, context = error["type"], error.get("ctx", {})
    place = ".".join(str(part) for part in path[1:] if isinstance(part, str))
    head = named(str(path[0])) if path else ""
    if place and place in owner.model_fields and named is not str:
        head, place = named(place), ""  # an option of a component is a flag of its own
    value = short(error["input"])
    if kind == "value_error":
        text = str(context["error"])
        if not path:
            first, _, rest = text.partition(": ")
            return f"{named(first)}: {rest}."
    elif kind == "extra_forbidden":
        known = list(owner.model_fields)
        word = str(error["loc"][-1])
        text = f"{short(word)} is not a known key{meant(word, known) or '; there are ' + ', '.join(known)}"
        head, place = ("", "") if len(path) == 1 else (head, ".".join(map(str, path[1:-1])))
    elif kind == "missing":
        text = "is missing; add it"
    elif kind == "literal_error":
        choices = [str(each) for each in _choices(owner, error["loc"][-1])]
        text = f"{value} is not one of {', '.join(choices)}{suggest(str(error['input']), choices)}"
    elif kind == "too_short":
        text = "names nothing; `sean list` shows what there is"
    elif kind == "invalid_key":
        head = "" if len(path) == 1 else head
        text = f"the key {short(error['loc'][-1])} is not a text; put it in quotes"
    elif kind in _TYPES:
        text = f"{value} is not {_TYPES[kind]}"
    elif kind in ("too_long", "string_too_long"):
        text = f"{value} is too long; {context['max_length']:,} are the most"
    else:
        text = f"{value} cannot be; {error['msg'][0].lower()}{error['msg'][1:]}"
    start = ": ".join(part for part in (f"{head}{'.' if head and place else ''}{place}",) if part)
    end = "" if text.endswith(("?", ".")) else "."
    return f"{start}: {text}{end}" if start else f"{text}{end}"


def _component_classes(model: type[Config]) -> list[type[Component]]:
    found: list[type[Component]] = [OwnPart, Value]
    for field in model.model_fields.values():
        family = family_of(field)
        found += family.variants if family is not None else ()
    return found


def _choices(owner: type[Config], name: str | int) -> tuple[object, ...]:
    field = owner.model_fields.get(str(name))
    kinds = [field.annotation, *typing.get_args(field.annotation)] if field is not None else []
    return next((typing.get_args(kind) for kind in kinds if typing.get_origin(kind) is Literal), ())
