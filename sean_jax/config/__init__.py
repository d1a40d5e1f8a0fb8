"""The options of every command, as pydantic models; those of the small commands stand here."""

import datetime
from pathlib import Path
from typing import Annotated, Literal

import pydantic

from sean_jax.config import option_types
from sean_jax.config.components import (
    Bounds,
    Component,
    Config,
    Family,
    Named,
    OwnPart,
    Value,
    aliases,
    family_of,
    gather,
    is_own_part,
    validate,
    with_defaults,
)
from sean_jax.config.learning_options import (
    EXPORTS,
    METHODS,
    OBSERVED,
    APGConfig,
    CollectConfig,
    DaggerConfig,
    EnvConfig,
    ExportBagConfig,
    ExportConfig,
    ExportMapConfig,
    ImitationConfig,
    PPOConfig,
    ReinforcementConfig,
)
from sean_jax.config.option_types import (
    MAX_HOURS,
    MAX_PIXELS,
    MAX_RATE,
    MAX_SHARD,
    MAX_SIDE,
    Number,
    Option,
    Range,
    Text,
)
from sean_jax.config.scenario_options import (
    DEFAULT_FORCES,
    PRESETS,
    TRANSPORTS,
    USUAL_TASKS,
    BridgeConfig,
    CompareConfig,
    CustomTask,
    GraphBehavior,
    HandcraftedBehavior,
    PlaybackBehavior,
    RandomBehavior,
    ReplayConfig,
    RobotPart,
    RunConfig,
    ScenarioConfig,
    StudioConfig,
    SurveyExportConfig,
    SurveyRatingsConfig,
    SurveyReportConfig,
    outside,
)
from sean_jax.config.study_options import (
    EXPERIMENTS,
    AblationConfig,
    BenchmarkConfig,
    BenchmarkRankConfig,
    BenchmarkVerifyConfig,
    CalibrateConfig,
    ExperimentConfig,
    Figure4Config,
    FitGraphConfig,
    LearnedConfig,
    LearningCurveConfig,
    SituationConfig,
    Table1Config,
    ValidateConfig,
)
from sean_jax.core.messages import listed, suggest


class BenchConfig(Config):
    """Measure speed on this machine and write it as a table, as JSON and as a picture."""

    environment: option_types.EnvironmentName = "warehouse"
    people: option_types.PeopleOrDefault = None
    robot: RobotPart = Named(kind="kuri")
    dynamics: option_types.Dynamics = "twin"
    only: option_types.Names = "step,depth,images,pictures,crowd,compile,devices"
    """Measurements, separated by commas."""
    batches: tuple[option_types.BatchSize, ...] = ()
    """Numbers of scenarios at once; by default 1 to 256 on a CPU and 1 to 65536 on a GPU."""
    repeats: option_types.Count = 5
    """Timings of each measurement, of which the median counts."""
    seconds: option_types.TimingSeconds = 1.0
    """Approximate duration of one timing."""
    out: option_types.Out = None
    """Folder to write, by default sean-bench-DATE-TIME."""
    quiet: option_types.Quiet = False

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
        """The folder of the results."""
        return self.out or Path(f"sean-bench-{datetime.datetime.now():%Y%m%d-%H%M%S}")


class DrawConfig(Config):
    """Draw the behavior graphs of the environments, or their handcrafted sets."""

    graph: bool = False
    """The behavior graph, with its groups seated."""
    handcrafted: bool = False
    """The handcrafted sets, one panel each."""
    sets: option_types.Text = "all"
    """Which handcrafted sets, as in sean run."""
    environment: option_types.Text | None = None
    """Environment: a name, or the folder of your own; by default all of the package."""
    out: Path | None = None
    """File to write, such as sheet.png or sheet.svg; with several environments, the name of each is added."""


class ImportMapConfig(Config):
    """Make an environment of a ROS map, the YAML file of a map_server with its image."""

    map: Annotated[Path, Option(positional=True)]
    """YAML file of the map."""
    out: Path
    """Folder to write; it must be new or empty. Its path then serves as --environment."""
    people: option_types.People | None = None
    """Default number of people; by default one for each 25 m2 of free floor."""
    height: option_types.Height = 2.0
    """Height of all obstacles in metres, which a map does not have."""
    unknown: Literal["obstacle", "free"] = "obstacle"
    """Meaning of the map's unknown cells."""


class ImportBagConfig(Config):
    """Take people and the robot out of a ROS bag, as a recording and a trajectory."""

    bag: Annotated[Path, Option(positional=True)]
    """File of rosbag 1, or folder of rosbag2."""
    out: Path
    """Folder to write; it must be new or empty."""
    time_step: Annotated[float, option_types.Number(0.001, 10.0, "s")] = 0.1
    """Seconds between rows; positions of the bag are interpolated."""
    people_topic: option_types.Text | None = None
    """Topic of the people; by default the first one with people."""
    robot_topic: option_types.Text | None = None
    """Topic of the robot's pose; by default odometry, else transforms, else a pose with covariance."""


class ImportRobotConfig(Config):
    """Make a robot file of the URDF file, or of the MJCF file with a freejoint, of a robot."""

    file: Annotated[Path, Option(positional=True)]
    """URDF or MJCF file of the robot."""
    out: Path
    """Robot file to write, such as robot.xml, with a picture beside it. Its path then serves as --robot."""
    drive: Literal["differential", "omnidirectional", "ackermann"] | None = None
    """Drive; by default by the places and axes of the wheels."""
    wheels: option_types.Names | None = None
    """Joints of the driven wheels, separated by commas; by default the wheels on the floor."""
    wheel_radius: option_types.Radius | None = None
    """Radius of the wheels in metres; by default of their shapes."""
    wheel_separation: option_types.Radius | None = None
    """Distance in metres of the left and right wheels, as odometry uses it; by default of their joints."""
    mass: option_types.Mass | None = None
    """Mass in kilograms; by default of all links."""
    radius: option_types.Radius | None = None
    """Radius in metres of the disc that touches people and obstacles; by default around base and wheels."""
    max_speed: option_types.RobotSpeed | None = None
    """Top speed in m/s; by default by the velocity limit of the wheels' joints."""
    max_turn_rate: option_types.RobotTurnRate | None = None
    """Top turn rate in rad/s; by default that of a turn in place at the top speed of the wheels."""
    max_acceleration: option_types.RobotAcceleration | None = None
    """Greatest acceleration in m/s2; by default by the effort limit of the wheels' joints and the grip of tyres."""


class WorldsConfig(Config):
    """Make floors of a family, with Behavior Graphs and people, as environment folders."""

    family: Annotated[str, Option(positional=True)]
    """Family: aisles, clutter, lobby, office, passages, rooms or square."""
    out: Path
    """Folder to write; it must be new or empty. A folder in it then serves as --environment."""
    number: option_types.Count = 12
    """Number of floors."""
    seed: option_types.Seed = 0
    """Seed of the first floor; the others follow it."""
    words: Text | None = None
    """Words of the family, separated by commas: values, or ranges to draw from, such as width=16,door=1.0:1.2."""


class DoctorConfig(Config):
    """Show versions, devices and folders of this machine, and cures for slow or missing parts."""


class ListConfig(Config):
    """List the choices of each option."""


class SchemaConfig(Config):
    """Print the JSON Schema of config.yaml, by which editors complete and check it."""


GROUPS = {
    "train": "Train a network, by imitation or by reinforcement learning.",
    "experiment": "Reproduce Table I or Figure 4 of the paper, or vary them.",
    "export": "Write datasets, agents, episodes and environments in the formats of other projects.",
    "benchmark": "Drive fixed tracks with a policy, rank such results, or verify them.",
    "survey": "Export or report the answers of a study that `sean studio --survey` has run, or published ratings.",
}
"""Word of the command line that needs a second word -> its summary."""

COMMANDS: dict[str, type[Config]] = {
    "run": RunConfig,
    "collect": CollectConfig,
    **{f"train {name}": options for name, options in METHODS.items()},
    **{f"experiment {name}": options for name, options in EXPERIMENTS.items()},
    **{f"export {name}": options for name, options in EXPORTS.items()},
    "fit-graph": FitGraphConfig,
    "calibrate": CalibrateConfig,
    "draw": DrawConfig,
    "replay": ReplayConfig,
    "studio": StudioConfig,
    "bridge": BridgeConfig,
    "survey export": SurveyExportConfig,
    "survey report": SurveyReportConfig,
    "survey ratings": SurveyRatingsConfig,
    "compare": CompareConfig,
    "import-map": ImportMapConfig,
    "import-bag": ImportBagConfig,
    "import-robot": ImportRobotConfig,
    "worlds": WorldsConfig,
    "benchmark run": BenchmarkConfig,
    "benchmark rank": BenchmarkRankConfig,
    "benchmark verify": BenchmarkVerifyConfig,
    "bench": BenchConfig,
    "validate": ValidateConfig,
    "doctor": DoctorConfig,
    "list": ListConfig,
    "schema": SchemaConfig,
}
"""Words of the command line -> their options."""
