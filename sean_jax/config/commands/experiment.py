"""The options of ``sean experiment``."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import pydantic

from sean_jax.config import option_types
from sean_jax.config.components import Config, Named
from sean_jax.config.option_types import Option
from sean_jax.config.scenario_options import RobotPart

PresetName = Annotated[
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
            raise ValueError(
                f"seed: {self.seeds} consecutive seeds from {self.seed} go beyond {2**32 - 1}; "
                "choose a smaller seed or fewer seeds."
            )
        return self


class Table1Config(SituationConfig):
    """Table I of the paper, with the paper's numbers: the robot's share of time in each social situation. An
    unfinished folder is resumed."""

    QUICK = {**SituationConfig.QUICK, "crowds": ()}

    which: Annotated[Literal["table1"], Option(positional=True)] = "table1"  # pyright: ignore
    """Table I."""
    policies: option_types.Names = "go_to_goal,social_costmap,expert"
    """Policies of the robot, separated by commas; none for recordings alone."""
    preset: PresetName = None
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
    preset: PresetName = None
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
