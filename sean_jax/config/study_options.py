"""Options of ``sean experiment``, ``benchmark``, ``validate``, ``calibrate`` and ``fit-graph``."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import pydantic

from sean_jax.config import option_types
from sean_jax.config.components import Config, Named
from sean_jax.config.option_types import Number, Option
from sean_jax.config.scenario_options import DEFAULT_FORCES, RobotPart

Preset = Annotated[
    Literal["sean2"] | None,
    pydantic.Field(description="Experimental conditions: sean2 for SEAN 2.0. Explicit options override it."),
]
Demonstrations = Annotated[tuple[Path, ...], Option(affects_results=False)]  # their content does
SPEEDS = (1.4, 1.2, 1.0, 0.8, 0.6, 0.4)  # m/s


class ExperimentConfig(Config):
    """Options of all experiments of the paper."""

    QUICK: ClassVar[dict[str, Any]] = {}
    """Defaults with ``quick``."""

    which: Annotated[str, Option(positional=True)]
    """Experiment."""
    quick: bool = False
    """Ten minutes on a CPU: less time, fewer seeds and episodes, smaller images."""
    environment: option_types.EnvironmentName = "warehouse"
    people: option_types.PeopleOrDefault = None
    robot: RobotPart = Named(kind="kuri")
    dynamics: option_types.Dynamics = "twin"
    time_limit: option_types.TimeLimit = 120.0
    """Longest duration of an episode in seconds."""
    seed: option_types.Seed = 0
    """The same seed gives the same results."""
    out: option_types.Out = None
    """Folder for the results, runs/EXPERIMENT by default. An unfinished experiment of the same options is resumed."""
    quiet: option_types.Quiet = False

    @pydantic.model_validator(mode="before")
    @classmethod
    def _fill(cls, data: object) -> object:
        return {**cls.defaults(data), **data} if isinstance(data, Mapping) else data

    @classmethod
    def defaults(cls, data: Mapping[str, Any]) -> dict[str, Any]:
        """Defaults that depend on other options."""
        return cls.QUICK if data.get("quick") else {}

    @property
    def folder(self) -> Path:
        """The folder of the results."""
        return self.out or Path("runs") / (self.which + ("-quick" if self.quick else ""))


class SituationConfig(ExperimentConfig):
    """Options of experiments on the share of time in each social situation."""

    QUICK = dict(hours=0.05, seeds=2)

    policies: option_types.Names = "go_to_goal,social_costmap,expert"
    """Policies of the robot, separated by commas."""
    hours: option_types.HoursOfMinutes = 1.0
    """Hours for each behavior and each of --seeds."""
    seeds: option_types.Count = 10
    """Simulations of these hours, with --seed and the next seeds."""
    speeds: Annotated[tuple[option_types.WalkingSpeed, ...], pydantic.Field(min_length=1)] = SPEEDS
    """Walking thresholds V in m/s; the table uses the first."""

    @pydantic.model_validator(mode="after")
    def _check_seeds(self) -> Self:
        if self.seed + self.seeds > 2**32:
            text = f"{self.seeds} consecutive seeds from {self.seed} go beyond {2**32 - 1}"
            raise ValueError(f"seed: {text}; choose a smaller seed or fewer seeds.")
        return self


class Table1Config(SituationConfig):
    """Table I of the paper, with the paper's numbers: the robot's share of time in each social situation. An
    unfinished folder is resumed."""

    QUICK = {**SituationConfig.QUICK, "crowds": ()}

    which: Annotated[Literal["table1"], Option(positional=True)] = "table1"  # pyright: ignore
    """Table I."""
    policies: option_types.Names = "go_to_goal,social_costmap,expert"
    """Policies of the robot, separated by commas; none for recordings alone."""
    preset: Preset = None
    speeds: Annotated[tuple[option_types.WalkingSpeed, ...], pydantic.Field(min_length=1)] = SPEEDS
    """Walking thresholds V in m/s; the table uses the first. With preset sean2 the slowest comes first by default."""
    crowds: tuple[option_types.People, ...] = (10, 20, 40, 100)
    """Other numbers of people to try."""
    recordings: option_types.Names | None = None
    """CSV files of recorded people, separated by commas; each person in turn takes the place of the robot."""
    frame_rate: option_types.FrameRate | None = None
    """Frames per second of the recordings; by default the clocks of their formats."""
    demonstrations: Demonstrations = ()
    """Folders of demonstrations, of `sean studio --record`, `sean collect` or a `learning.Recorder`: rows of the
    table."""

    @classmethod
    def defaults(cls, data: Mapping[str, Any]) -> dict[str, Any]:
        """The slowest threshold comes first with preset sean2."""
        return super().defaults(data) | ({"speeds": SPEEDS[::-1]} if data.get("preset") == "sean2" else {})


class AblationConfig(SituationConfig):
    """Table I with the conditions of SEAN 2.0 one by one. An unfinished folder is resumed."""

    which: Annotated[Literal["ablation"], Option(positional=True)] = "ablation"  # pyright: ignore
    """Table I with the conditions of SEAN 2.0 one by one."""


class LearnedConfig(ExperimentConfig):
    """Options of experiments that train networks on demonstrations."""

    demonstrator: option_types.Text = "expert"
    """Policy that demonstrates."""
    preset: Preset = None
    datasets: option_types.Count = 10
    """Datasets of demonstrations, each with its own networks."""
    trainings: option_types.Count = 3
    """Networks for each dataset, each with its own seed."""
    episodes: option_types.EpisodeCount = 12_300
    """Episodes of each policy in each scenario, in equal shares for its networks."""
    epochs: option_types.Count = 1000
    """Largest number of epochs of a training."""


class Figure4Config(LearnedConfig):
    """Figure 4 of the paper, with its numbers: four learned policies in three scenarios. An unfinished folder is
    resumed."""

    QUICK = dict(hours=0.05, datasets=1, trainings=1, episodes=12, epochs=30, baselines="none")

    which: Annotated[Literal["figure4"], Option(positional=True)] = "figure4"  # pyright: ignore
    """Figure 4."""
    hours: option_types.HoursOfMinutes = 1.0
    """Hours of demonstrations for each behavior."""
    baselines: Annotated[option_types.Names, Option(affects_results=False)] = "move_base,ppo,ppo_lidar,sensing_expert"
    """Other policies in the same episodes, separated by commas, or none: names, folders of `sean train`, such as
    runs/dagger or runs/apg, or FILE.py:NAME. They can be added to a finished figure."""
    demonstrations: Demonstrations = ()
    """Folders of demonstrations, of `sean studio --record`, `sean collect` or a `learning.Recorder`, in place of those
    of the demonstrator; all with one behavior of people are one dataset."""

    @classmethod
    def defaults(cls, data: Mapping[str, Any]) -> dict[str, Any]:
        """One dataset of each behavior with demonstrations."""
        return super().defaults(data) | ({"datasets": 1} if data.get("demonstrations") else {})


class LearningCurveConfig(LearnedConfig):
    """Policy G of Figure 4 with more demonstrations, with more examples per second, and with social situations as an
    input. An unfinished folder is resumed."""

    QUICK = dict(demonstration_hours=(0.05, 0.2), datasets=1, episodes=12, epochs=30)

    which: Annotated[Literal["learning_curve"], Option(positional=True)] = "learning_curve"  # pyright: ignore
    """Learning curve of policy G."""
    demonstration_hours: Annotated[tuple[option_types.HoursOfMinutes, ...], pydantic.Field(min_length=1)] = (
        1.0,
        10.0,
        100.0,
    )
    """Hours of demonstrations. Networks of the first are compared with networks of other rates, and with networks that
    have the situations as an input."""
    rates: tuple[option_types.Rate, ...] = (10,)
    """Examples per second, besides one per second."""
    updates: option_types.Count = 20_000
    """Largest number of steps of a network's optimizer; reached with 100 hours of data, smaller datasets stop early."""
    datasets: option_types.Count = 3
    """Datasets of demonstrations, each with its own networks."""
    trainings: option_types.Count = 1
    """Networks for each dataset, each with its own seed."""
    episodes: option_types.EpisodeCount = 4096
    """Episodes of each policy in each scenario, in equal shares for its networks."""


EXPERIMENTS: dict[str, type[ExperimentConfig]] = {
    "table1": Table1Config,
    "ablation": AblationConfig,
    "figure4": Figure4Config,
    "learning_curve": LearningCurveConfig,
}
"""Word after ``sean experiment`` -> its options."""


class BenchmarkConfig(Config):
    """Drive the fixed tracks of the benchmark with a policy: tables by track and social situation, and a result for the
    ranking. An unfinished folder is resumed."""

    which: Annotated[Literal["run"], Option(positional=True)] = "run"
    """Result of a policy."""
    policy: Annotated[option_types.Text, Option(positional=True)]
    """Policy: a name, a folder of `sean train` or `sean export agent`, or FILE.py:NAME."""
    quick: bool = False
    """Minutes on a CPU, with few episodes: such a result shows whether a policy works, and is not ranked."""
    episodes: option_types.EpisodeCount | None = None
    """Episodes of each track, by default the protocol's number; a result with fewer is not ranked."""
    recordings: Annotated[Path | None, Option(affects_results=False)] = None  # their content does
    """Folder with the recorded people of the tracks eth and zara01, eth.csv and zara01.csv, which are skipped without
    it."""
    sensing: Literal["all-knowing", "tracks", "raw"] | None = None
    """Class of a policy of your own or of a controller outside: all-knowing, tracks (of visible people) or raw
    (sensors). By default the policy's attribute sensing, else all-knowing; policies of the package and agents have
    theirs."""
    name: Annotated[option_types.Text | None, Option(affects_results=False)] = None
    """Entry of the ranking, the policy by default. Results of one name are the training seeds of one agent."""
    out: option_types.Out = None
    """Folder for the result, runs/benchmark-POLICY by default. An unfinished benchmark of the same options is
    resumed."""
    quiet: option_types.Quiet = False

    @property
    def folder(self) -> Path:
        """The folder of the result."""
        name = Path(self.policy.replace(":", "-")).name
        return self.out or Path("runs") / f"benchmark-{name}{'-quick' if self.quick else ''}"


class BenchmarkRankConfig(Config):
    """Rank results of the benchmark by class of sensing, with ties."""

    which: Annotated[Literal["rank"], Option(positional=True)] = "rank"
    """Ranking of results."""
    results: Annotated[tuple[Path, ...], Option(positional=True), pydantic.Field(min_length=1)]
    """Folders of `sean benchmark run`; folders of one --name are one entry."""
    out: option_types.Out = None
    """Folder for the ranking, runs/ranking by default; files of the same names are replaced."""
    quiet: option_types.Quiet = False

    @property
    def folder(self) -> Path:
        """The folder of the ranking."""
        return self.out or Path("runs") / "ranking"


class BenchmarkVerifyConfig(Config):
    """Simulate a random sample of a result's episodes again, and compare each measure."""

    which: Annotated[Literal["verify"], Option(positional=True)] = "verify"
    """Check of a result."""
    result: Annotated[Path, Option(positional=True)]
    """Folder of `sean benchmark run`."""
    policy: option_types.Text | None = None
    """The result's policy, where it has another place here; its digest must be that of the result."""
    recordings: Path | None = None
    """Folder with the result's recordings; without it, tracks of recorded people are not in the sample."""
    tracks: Annotated[int, Number(1, 1_000)] = 4
    """Number of tracks in the sample, with a batch of episodes of each."""
    seed: option_types.Seed | None = None
    """Seed of the sample; by default it is drawn, and printed."""
    quiet: option_types.Quiet = False


class ValidateConfig(Config):
    """Compare simulated people with measurements: standards, measured diagrams, recordings."""

    quick: bool = False
    """Five minutes on a CPU: fewer seeds, and without the checks of a thousand people."""
    only: option_types.Names | None = None
    """Checks, separated by commas; rimea-* selects all with this prefix. All by default."""
    models: option_types.Names | None = None
    """Models of people, separated by commas: presets of forces, files of constants, pedestrian models, or FILE.py:NAME;
    by default the default forces."""
    data: Path | None = None
    """Folder of recordings; without it, checks that need them are skipped."""
    strict: Annotated[bool, Option(affects_results=False)] = False
    """Exit code 1 if a check fails."""
    out: option_types.Out = None
    """Folder for the results, runs/validate by default. Existing results of the same checks and models are kept."""
    quiet: option_types.Quiet = False

    @property
    def folder(self) -> Path:
        """The folder of the results."""
        return self.out or Path("runs") / ("validate-quick" if self.quick else "validate")


class CalibrateConfig(Config):
    """Fit the constants of the social forces to crowds and to recorded people. An unfinished fit is resumed."""

    data: Path
    """Folder of recordings: scenes of ETH and UCY, runs of Juelich's corridors."""
    forces: option_types.Text = DEFAULT_FORCES
    """Start of the fit: a preset of social forces, or a YAML file of constants."""
    fit: option_types.Names | None = None
    """Constants to fit, separated by commas, such as repulsion.range; by default all that have bounds. none: the habits
    of prediction alone, without crowds."""
    leave_out: option_types.Names | None = None
    """Scenes of prediction, separated by commas, for leave-one-out fits, each judged by the scene that it lacks; all by
    default, or none."""
    generations: option_types.Count = 60
    """Generations of the search (CMA-ES)."""
    population: Annotated[int, Number(4, 4096)] = 32
    """Candidates in a generation of each fit."""
    draws: Annotated[int, Number(1, 100)] = 2
    """Draws of people in each corridor, file and mix; half as many at each door."""
    quick: bool = False
    """A minute on a CPU: few crowds and windows, to try the command."""
    seed: option_types.Seed = 0
    """The same seed gives the same constants."""
    out: option_types.Out = None
    """Folder for the results, runs/calibration or runs/calibration-quick by default."""
    quiet: option_types.Quiet = False

    @property
    def folder(self) -> Path:
        """The folder of the results."""
        return self.out or Path("runs") / ("calibration-quick" if self.quick else "calibration")


class FitGraphConfig(Config):
    """Propose a behavior graph for an environment, or fit one to recorded or simulated people."""

    environment: Annotated[option_types.EnvironmentName, Option(positional=True)]
    recording: Path | None = None
    """People to fit to: a CSV file with the columns frame, id, x and y in metres."""
    recording_format: option_types.RecordingFormat = None
    frame_rate: option_types.RecordingRate = None
    simulate: bool = False
    """Fit to people simulated on the environment's own graph, to test whether the fit recovers it."""
    propose: bool = False
    """Propose nodes and edges even if the environment has a graph; without people to fit to, do only that."""
    graph: Path | None = None
    """A graph.yaml with the nodes and edges; the environment's own by default."""
    people: option_types.People | None = None
    """Number of simulated people; the environment's own number by default."""
    routing: option_types.Routing = "whole"
    minutes: option_types.Minutes = 20.0
    """Minutes to simulate for the fit, and again for its test."""
    temperature: option_types.Temperature = 0.25
    """Softmax temperature in metres over the costs of routes."""
    seed: option_types.Seed = 0
    """The same seed gives the same results."""
    out: option_types.Out = None
    """Folder to write, runs/graph-ENVIRONMENT by default; it must be new or empty. The folder is an environment."""
    quiet: option_types.Quiet = False

    @pydantic.model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.recording is not None and self.simulate:
            raise ValueError("simulate: --simulate and --recording exclude each other; choose one")
        return self

    @property
    def folder(self) -> Path:
        """The folder to write."""
        return self.out or Path("runs") / f"graph-{Path(self.environment).name}"
