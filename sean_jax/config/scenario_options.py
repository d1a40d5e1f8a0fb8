"""Options of a scenario (section IV-B), which many commands embed."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import pydantic

from sean_jax.config import option_types
from sean_jax.config.components import Component, Config, Family, Named, OwnPart, Value, compact, with_defaults
from sean_jax.config.option_types import HelpTopic, Option
from sean_jax.core.messages import listed

USUAL_TASKS = {"graph": ("join_group", "leave_group"), "handcrafted": ("handcrafted",)}
"""behavior -> its robot tasks in the paper's protocol (section V-B); with other behaviors it is random_ab_nav."""

DEFAULT_FORCES = "calibrated"
"""The social forces of people, where none are named."""


@dataclass(frozen=True)
class Preset:
    """The conditions of another simulator, for options that the user leaves out."""

    summary: str  # for ``sean list``
    options: dict[str, Any]  # option -> value; one of a component holds where that component is chosen


PRESETS: dict[str, Preset] = {
    "sean2": Preset(
        "The world of SEAN 2.0 as its public files have it, in place of this package's defaults.",
        {
            "routing": "edge",  # INavigable.cs: people choose again at each node
            "group_membership": "permanent",  # GroupNavNode.cs: members at the start stay
            "forces": "sean2",  # SFAgent.cs and Parameters.cs
            "situations": "sean2",  # SituationRuleBased.cs, with V = 0.4 m/s as in its prefab
            "goal_sampling": "mesh",  # Navmesh.cs
            "task_distance": (0.0, math.inf),  # RandomABNav.cs: independent start and goal
            "dynamics": "kinematic",  # VelocityController.cs
            "violation_distance": "surface",  # CountCollisions.cs: 0.2 m less than between the centers
            "warm_up": 120.0,  # one task after another in one lasting crowd, which is older than a task
            "goal_radius": 1.2,  # Tasks.prefab: completionDistance
            "hold_time": 5.0,  # Tasks.prefab: debounceTimeoutSec
            "time_limit": 120.0,  # Tasks.prefab
        },
    ),
}


def usual(name: object, option: str, default: Any) -> Any:
    """The default of an option under a preset; ``default`` if there is no such preset, or it lacks the option."""
    preset = PRESETS.get(name) if isinstance(name, str) else None
    return default if preset is None else preset.options.get(option, default)


class GraphBehavior(Component):
    """People walk, gather and disperse on the environment's behavior graph."""

    kind: Literal["graph"] = "graph"
    routing: option_types.Routing = "trips"
    group_membership: Literal["turnover", "permanent"] = "turnover"
    """turnover: people join and leave groups; permanent: members stay in their group, as in SEAN 2.0's code."""
    congestion_cost: option_types.Congestion = 0.0
    """How much people avoid crowded edges: an edge's cost is multiplied by 1 + congestion_cost * density (people/m2);
    try 10."""
    temperature: option_types.RouteTemperature = 0.0
    """Softmax temperature in metres over the lengths of routes; 0: always the shortest route."""
    taste: option_types.Taste = 0.1
    """How much people's costs of an edge differ on trips (standard deviation of the log); 0: all take the cheapest
    route."""
    walking_groups: option_types.WalkingGroups = (0.0, 0.0)


class RandomBehavior(Component):
    """People walk from one random place to another."""

    kind: Literal["random"] = "random"
    walking_groups: option_types.WalkingGroups = (0.0, 0.0)


class HandcraftedBehavior(Component):
    """People walk the environment's handcrafted sets."""

    kind: Literal["handcrafted"] = "handcrafted"
    sets: option_types.Text = "all"
    """Sets to draw from: all, the name of a set, a situation; or COLLECTION, COLLECTION_SITUATION or COLLECTION_SET for
    another collection of handcrafted.yaml, such as staged."""


class PlaybackBehavior(Component):
    """People walk as they were recorded."""

    kind: Literal["playback"] = "playback"
    recording: option_types.Text | None = None
    """A CSV file with the columns frame, id, x and y in metres."""
    recording_format: option_types.RecordingFormat = None
    frame_rate: option_types.RecordingRate = None


class CustomTask(Component):
    """From a start of your own to a goal of your own."""

    kind: Literal["custom"] = "custom"
    start: tuple[option_types.PoseNumber, ...] | None = None
    """x and y in metres, and optionally a heading in degrees."""
    goal: tuple[option_types.PoseNumber, ...] | None = None
    """x and y in metres, and optionally a heading in degrees."""

    @pydantic.field_validator("start", "goal")
    @classmethod
    def _pose(cls, value: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if value is not None and len(value) not in (2, 3):
            raise ValueError(f"has {len(value)} numbers; give x and y, and optionally a heading in degrees")
        return value


Forces = Annotated[tuple[Component, ...], Family((Named,), "force")]
Situations = Annotated[tuple[Component, ...], Family((Named,), "situation")]
Metrics = Annotated[tuple[Component, ...], Family((Named,), "metric")]
Sensors = Annotated[tuple[Component, ...], Family((Named,), "sensor")]
BehaviorPart = Annotated[
    GraphBehavior | RandomBehavior | HandcraftedBehavior | PlaybackBehavior | Named | OwnPart | Value,
    Family((GraphBehavior, RandomBehavior, HandcraftedBehavior, PlaybackBehavior, Named)),
]
Part = Annotated[Named | OwnPart | Value, Family((Named,))]
RobotPart = Annotated[Part, pydantic.Field(description="Robot: a name, or an MJCF file.")]
Tasks = Annotated[tuple[Component, ...], Family((CustomTask, Named), several=True)]


class ScenarioConfig(Config):
    """A physical environment, a pedestrian behavior and a robot task (section IV-B), and what belongs to them."""

    TOPIC: ClassVar = HelpTopic("scenario", "the scenario, such as --people 8 or environment=lab")

    environment: option_types.EnvironmentName = "warehouse"
    preset: Annotated[Literal["sean2"] | None, Option(affects_results=False)] = None
    """Preset for the options that you leave out: sean2, as in SEAN 2.0."""
    behavior: BehaviorPart = GraphBehavior()
    """Pedestrian behavior: which goals people have."""
    task: Tasks | None = None
    """Robot task; several, separated by commas, take turns. By default join_group,leave_group with behavior graph,
    handcrafted with handcrafted, custom if a start and a goal are set, else random_ab_nav."""
    robot: Annotated[Part, pydantic.BeforeValidator(option_types.join_names)] = Named(kind="kuri")
    """Robot: a name, or an MJCF file; in trainings several, separated by commas, take turns with the floors."""
    dynamics: option_types.Dynamics = "twin"
    people: option_types.PeopleOrDefault = None
    model: Part = Named(kind="social_forces")
    """Model of how people move."""
    forces: Forces = (Named(kind=DEFAULT_FORCES),)
    """Social forces: the terms of a preset, and your own."""
    situations: Situations = (Named(kind="paper"),)
    """Social situations to classify: a set, and your own."""
    thresholds: dict[str, option_types.Threshold] | None = None
    """Thresholds of the situation classifiers that differ from the set's."""
    metrics: Metrics = (Named(kind="all"),)
    """Metrics: all of the package, and your own; none for faster steps."""
    sensors: Sensors = ()
    """Sensors that a policy can read with sean_jax.sense."""
    time_step: option_types.TimeStep = 0.1
    """Control step in seconds."""
    time_limit: option_types.TimeLimit = 120.0
    """Longest duration of an episode in seconds."""
    goal_radius: option_types.Radius = 1.2
    """Distance in metres within which the goal counts as reached (SEAN 2.0: 1.2)."""
    hold_time: option_types.Duration = 5.0
    """Seconds that the robot must stay there to complete the task (SEAN 2.0: 5)."""
    task_distance: tuple[option_types.Distance, option_types.DistanceOrInfinity] = (4.0, 20.0)
    """Shortest and longest path in metres from start to goal; inf for no longest (SEAN 2.0: 0 inf)."""
    goal_sampling: Literal["uniform", "mesh"] = "uniform"
    """How free places are drawn, for goals of random people and for starts and goals of the robot: uniform over the
    floor, or mesh, as SEAN 2.0 draws points on its navigation mesh."""
    violation_distance: Literal["centers", "surface"] = "centers"
    """Violations of intimate and personal distance are measured between the centers of robot and person, or from the
    robot's center to the person's surface, as in SEAN 2.0."""
    substeps: option_types.Substeps | None = None
    """Steps of the social forces in a control step; by default as many as their stiffness needs."""
    warm_up: option_types.Duration = 0.0
    """Seconds for which people walk before a task begins, as in a lasting crowd with one task after another."""

    @pydantic.model_validator(mode="before")
    @classmethod
    def _apply_preset(cls, data: object) -> object:
        if isinstance(data, Mapping) and isinstance(data.get("preset"), str) and data["preset"] in PRESETS:
            rest = {name: value for name, value in data.items() if name != "preset"}
            return with_defaults(cls, rest, PRESETS[data["preset"]].options)
        return data

    @pydantic.field_validator("robot")
    @classmethod
    def _check_robots(cls, value: Component) -> Component:
        if isinstance(value, Named):
            option_types.check_once(listed(value.kind))
        return value

    @pydantic.field_validator("thresholds", mode="before")
    @classmethod
    def _as_dict(cls, value: object) -> object:
        if not hasattr(value, "__dataclass_fields__"):
            return value
        return {name: float(threshold) for name, threshold in vars(value).items() if threshold is not None}

    @pydantic.model_validator(mode="after")
    def _check(self) -> "ScenarioConfig":
        if not self.task_distance[0] < self.task_distance[1]:
            raise ValueError(f"task_distance: {self.task_distance} must be a shorter and a longer distance in metres")
        if self.time_limit < self.time_step:
            raise ValueError(f"time_limit: {self.time_limit:g} must be at least the time step of {self.time_step:g} s")
        return self

    @property
    def tasks(self) -> tuple[Component, ...]:
        """The tasks; by default the paper's tasks for this behavior."""
        if self.task is not None:
            return self.task
        return tuple(Named(kind=name) for name in USUAL_TASKS.get(self.behavior.kind, ("random_ab_nav",)))

    @property
    def robot_parts(self) -> tuple[Component, ...]:
        """The robots that take turns, one or more."""
        if isinstance(self.robot, Named):
            return tuple(Named(kind=name) for name in listed(self.robot.kind))
        return (self.robot,)

    def identity(self) -> dict[str, Any]:
        """As in ``Config``, with the default tasks filled in."""
        return super().identity() | {"task": [compact(task.model_dump(mode="json")) for task in self.tasks]}
