"""Options of a scenario (section IV-B), and of ``sean run``, ``replay`` and ``compare``."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic

from sean_jax.config import option_types
from sean_jax.config.components import Component, Config, Family, Named, OwnPart, Value, compact, with_defaults
from sean_jax.config.option_types import Option
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
    routing: option_types.Routing = "whole"
    group_membership: Literal["turnover", "permanent"] = "turnover"
    """turnover: people join and leave groups; permanent: members stay in their group, as in SEAN 2.0's code."""
    congestion_cost: option_types.Congestion = 0.0
    """How much people avoid crowded edges: an edge's cost is multiplied by 1 + congestion_cost * density (people/m2);
    try 10."""
    temperature: option_types.RouteTemperature = 0.0
    """Softmax temperature in metres over the lengths of routes; 0: always the shortest route."""
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

    environment: option_types.EnvironmentName = "warehouse"
    preset: Annotated[Literal["sean2"] | None, Option(affects_results=False)] = None
    """Preset for the options that you leave out: sean2, as in SEAN 2.0."""
    behavior: BehaviorPart = GraphBehavior()
    """Pedestrian behavior: which goals people have."""
    task: Tasks | None = None
    """Robot task; several, separated by commas, take turns. By default join_group,leave_group with behavior graph,
    handcrafted with handcrafted, custom if a start and a goal are set, else random_ab_nav."""
    robot: Part = Named(kind="kuri")
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

    @pydantic.field_validator("robot", mode="before")
    @classmethod
    def _join(cls, value: object) -> object:
        several = isinstance(value, list | tuple) and all(isinstance(each, str | Path) for each in value)
        return ",".join(map(str, value)) if several else value  # pyright: ignore[reportArgumentType]

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


class RunConfig(ScenarioConfig):
    """Simulate a batch of episodes and write a table, a report and an animation. `sean list` names the choices."""

    policy: Part = Named(kind="go_to_goal")
    """Policy of the robot: a name, or a folder of `sean train` or `sean export agent`."""
    robots: option_types.Text | None = None
    """Several robots at once, each with its own task, separated by commas, such as kuri,kuri; without it, one robot.
    The policy is that of all, or as many policies, separated by commas."""
    episodes: option_types.EpisodeCount = 64
    """Number of episodes."""
    seed: option_types.Seed = 0
    """The same seed gives the same episodes."""
    batch: option_types.BatchSize = 1024
    """Largest number of episodes per batch."""
    camera: Annotated[option_types.Text | None, Option(affects_results=False)] = None
    """Also write camera.gif, the first episode as first_person, third_person, overhead or depth sees it."""
    trajectories: Literal["csv", "parquet"] | None = None
    """Also write the frames of all episodes, robot and people, as trajectories.csv or .parquet."""
    baseline: Annotated[Path | None, Option(affects_results=False)] = None
    """Folder of another run, with which the report compares its headline figures."""
    live: Annotated[bool, Option(affects_results=False)] = False
    """Serve a page on this computer that plays the first episode during its simulation."""
    name: Annotated[str, Option(affects_results=False)] = ""
    """Name of the run, the end of the folder's name; by default the environment and the behavior."""
    out: option_types.Out = None
    """Folder to write, runs/<date>-<time>-<name> by default: new, empty, or with an unfinished run of the same options,
    which is resumed."""
    quiet: option_types.Quiet = False

    @pydantic.field_validator("robots", mode="before")
    @classmethod
    def _join_robots(cls, value: object) -> object:
        return ScenarioConfig._join(value)

    @property
    def team(self) -> list[str]:
        """The robots of a team; empty without one."""
        return [] if self.robots is None else listed(self.robots)

    @property
    def policies(self) -> list[Component]:
        """The policies of the robots, or the one of all."""
        several = self.team and isinstance(self.policy, Named) and "," in self.policy.kind
        return [Named(kind=name) for name in listed(self.policy.kind)] if several else [self.policy]

    @pydantic.model_validator(mode="after")
    def _check_team(self) -> "RunConfig":
        if self.robots is None:
            return self
        if "robot" in self.model_fields_set and self.robot != Named(kind="kuri"):
            raise ValueError("robots: a robot is given as well; leave one of the two out")
        if not self.team:
            raise ValueError("robots: there is none; give names, separated by commas, such as kuri,kuri")
        if len(self.policies) not in (1, len(self.team)):
            number = len(self.policies)
            raise ValueError(f"policy: {number} policies for {len(self.team)} robots; give one of all, or one for each")
        for name, value in (("live", self.live), ("camera", self.camera), ("trajectories", self.trajectories)):
            if value:
                raise ValueError(f"{name}: is for one robot, not for a team; leave it out")
        return self

    @pydantic.model_validator(mode="after")
    def _check_live(self) -> "RunConfig":
        if self.live and self.quiet:
            raise ValueError("live: its address is printed, which --quiet forbids; leave one of the two out")
        return self

    def folder(self, now: str) -> Path:
        """The folder to write: ``out``, or one in runs/ whose name begins with ``now``."""
        name = self.name or f"{Path(self.environment).name}-{Path(self.behavior.kind).stem}"
        label = "".join(c if c.isalnum() or c in "-_." else "-" for c in name)
        return self.out or Path("runs") / f"{now}-{label}"


class StudioConfig(ScenarioConfig):
    """Serve a page on this computer for driving the robot among the people of a scenario, and for recording drives."""

    policy: Part = Named(kind="go_to_goal")
    """Policy that drives while no person does: a name, or a folder of `sean train` or `sean export agent`."""
    seed: option_types.Seed = 0
    """The same seed gives the same episodes."""
    warm_up: option_types.Duration = 5.0
    """Seconds for which people walk before a task begins."""
    record: Annotated[Path | None, Option(affects_results=False)] = None
    """Folder for recorded drives: their commands in trials/, and demonstrations for `sean train imitation`."""
    demonstrations: Annotated[Literal["person", "all"], Option(affects_results=False)] = "person"
    """Steps of recorded drives that become demonstrations: those that a person drove in completed drives, or `all`,
    which has those of the policy and of drives that were stopped, too."""
    port: Annotated[int, option_types.Number(0, 65535), Option(affects_results=False)] = 0
    """Port of the page on 127.0.0.1; 0 for a free one."""
    survey: Annotated[Path | None, Option(affects_results=False)] = None
    """Study to run with participants: a study.yaml, which has all options of its episodes. Needs --out."""
    out: option_types.Out = None
    """Folder for the answers to --survey: new, or with the same study, which goes on."""

    @pydantic.model_validator(mode="after")
    def _check_survey(self) -> "StudioConfig":
        if (self.survey is None) != (self.out is None):
            missing, there = ("survey", "out") if self.survey is None else ("out", "survey")
            raise ValueError(f"{missing}: {there} needs it, too; add --{missing}")
        others = sorted(self.model_fields_set - {"survey", "out", "port"}) if self.survey is not None else []
        if others:
            raise ValueError(f"{others[0]}: a study has its own options; write it into {self.survey}")
        return self


TRANSPORTS = ("ros1", "rosbridge", "dds")
"""Ways to a robot's controller outside of this program."""


ROS_NAME = re.compile(r"[A-Za-z](_?[A-Za-z0-9]){0,62}", re.ASCII)
"""A name in ROS 1 and ROS 2: a letter, then letters, digits and single underscores."""


def outside(policy: Component) -> tuple[str, str] | None:
    """Transport and place of a controller outside of this program: "rosbridge:127.0.0.1:9090", "ros1:", "dds:0"."""
    transport, colon, place = policy.kind.partition(":")
    return (transport, place) if colon and transport in TRANSPORTS else None


class BridgeConfig(ScenarioConfig):
    """Let a controller outside of this program drive the robot: over ROS 1, a rosbridge websocket, or DDS."""

    ros1: Annotated[bool, Option(affects_results=False)] = False
    """Connect to the ROS 1 master of ROS_MASTER_URI, by rospy."""
    rosbridge: Annotated[bool, Option(affects_results=False)] = False
    """Serve the rosbridge protocol, version 2, on a websocket."""
    dds: Annotated[bool, Option(affects_results=False)] = False
    """Join a DDS domain with the types and topic names of ROS 2, by Cyclone DDS."""
    address: Annotated[option_types.Text, Option(affects_results=False)] = "127.0.0.1:9090"
    """For rosbridge: address and port. If other computers reach it, clients need the token that is printed."""
    domain: Annotated[int, option_types.Number(0, 230), Option(affects_results=False)] = 0
    """For DDS: its domain, as ROS_DOMAIN_ID."""
    node_name: Annotated[option_types.Text, Option(affects_results=False)] = "sean_jax"
    """Name of the node and of its services. On a master of ROS 1 two bridges need two names."""
    namespace: Annotated[option_types.Text | None, Option(affects_results=False)] = None
    """Namespace of the robot's topics and frames, such as robot1; /clock, /map, /tf and /tf_static are in none."""
    naming: Annotated[Literal["ros", "sean"], Option(affects_results=False)] = "ros"
    """Names of topics: ros as in Nav2 and move_base; sean as in SEAN 2.0, with its own topics."""
    pace: Literal["real", "fast", "lockstep", "service"] = "real"
    """Advance of time: by the clock; as fast as possible; after each command; or by the service step alone."""
    factor: Annotated[float, option_types.Number(0.01, 1000.0)] = 1.0
    """For pace real: simulated seconds per second."""
    patience: option_types.Duration = 0.5
    """For pace lockstep: seconds of waiting for a command; without one the robot's command timeout acts."""
    episodes: option_types.EpisodeCount | None = None
    """Number of episodes; by default they go on until Ctrl-C."""
    seed: option_types.Seed = 0
    """The same seed gives the same episodes, which are the episodes of sean run."""
    quiet: option_types.Quiet = False

    @pydantic.field_validator("node_name")
    @classmethod
    def _check_node_name(cls, value: str) -> str:
        if not ROS_NAME.fullmatch(value):
            raise ValueError(f"is {value[:40]!r}, and no name of ROS; give one such as robot1_bridge")
        return value

    @pydantic.field_validator("namespace")
    @classmethod
    def _check_namespace(cls, value: str | None) -> str | None:
        if value is not None and not all(ROS_NAME.fullmatch(part) for part in value.split("/")):
            raise ValueError(f"is {value[:40]!r}, and no namespace of ROS; give names with / between, such as robot1")
        return value

    @pydantic.field_validator("sensors", mode="before")
    @classmethod
    def _no_sensors(cls, value: object) -> object:
        return () if value in ("none", ["none"], ("none",)) else value

    @pydantic.model_validator(mode="after")
    def _check_transport(self) -> "BridgeConfig":
        if sum((self.ros1, self.rosbridge, self.dds)) != 1:
            raise ValueError("ros1: a bridge has one transport; give one of --ros1, --rosbridge and --dds")
        return self

    @property
    def place(self) -> tuple[str, str]:
        """The transport and its place, as of ``outside``."""
        if self.ros1:
            return "ros1", ""
        return ("rosbridge", self.address) if self.rosbridge else ("dds", str(self.domain))


class ReplayConfig(Config):
    """Write a page that plays episodes of a run, a dataset or a training, or tests of a validation. They are simulated
    again with the options in the folder."""

    folder: Annotated[Path, Option(positional=True)]
    """Folder of `sean run`, `collect`, `train` or `validate`."""
    episodes: Annotated[tuple[option_types.EpisodeNumber, ...], pydantic.Field(min_length=1)] = (0,)
    """Numbers of episodes, from 0: of a run as in episodes.csv, of a dataset in the order of their recording, of a
    training the episodes of its evaluations, which alternate between its environments."""
    only: option_types.Names | None = None
    """Tests of a validation, separated by commas, such as rimea-6,imo-1; by default its first."""
    out: Path | None = None
    """File to write, replay.html in the folder by default."""
    quiet: option_types.Quiet = False


class SurveyExportConfig(Config):
    """Write the answers of a study as CSV files, and its drives as pages that replay them."""

    what: Annotated[Literal["export"], Option(positional=True)] = "export"
    """Tables and replays."""
    folder: Annotated[Path, Option(positional=True)]
    """Folder of `sean studio --survey`."""
    out: Path | None = None
    """Folder to write, tables in the study's folder by default; files of the same names are replaced."""


class SurveyReportConfig(Config):
    """Compare the ratings of a study with the metrics of its episodes: correlations and means, with intervals."""

    what: Annotated[Literal["report"], Option(positional=True)] = "report"
    """Correlations and means."""
    folder: Annotated[Path, Option(positional=True)]
    """Folder of `sean studio --survey`."""
    out: Path | None = None
    """Page to write, report.html in the study's folder by default."""
    quiet: option_types.Quiet = False


class SurveyRatingsConfig(Config):
    """Compare ratings of recorded robots, in the format of SocNav3, with the metrics of their trajectories."""

    what: Annotated[Literal["ratings"], Option(positional=True)] = "ratings"
    """Correlations of ratings from elsewhere."""
    trajectories: Annotated[Path, Option(positional=True)]
    """Folder of trajectories, one JSON file each."""
    ratings: Annotated[Path, Option(positional=True)]
    """Folder of ratings, a JSON file for each rater."""
    out: Path
    """Folder to write; it must be new or empty."""
    quiet: option_types.Quiet = False


class CompareConfig(Config):
    """Compare runs with the first of them: differences of all figures, and replays on one clock."""

    runs: Annotated[tuple[Path, ...], Option(positional=True)]
    """Folders of two or more runs."""
    situation: option_types.Text = "overall"
    """Situation whose table is printed; the page has all of them."""
    out: Path | None = None
    """Page to write, compare-FIRST-SECOND.html by default."""
    quiet: option_types.Quiet = False
