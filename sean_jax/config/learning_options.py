"""Options of ``sean collect``, ``train`` and ``export``, and of environments of reinforcement learning."""

import math
import re
from collections.abc import Iterable, Mapping
from numbers import Integral
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import pydantic

from sean_jax.config import option_types
from sean_jax.config.components import Bounds, Component, Config, Family, Named, OwnPart, Value
from sean_jax.config.option_types import Number, Option
from sean_jax.config.scenario_options import Part, RunConfig, ScenarioConfig
from sean_jax.core.messages import listed
from sean_jax.io import files

OBSERVED = ("goal", "goal_heading", "path", "distance", "speeds", "hold", "obstacles", "people")
"""The terms of an agent's observation, where none are named."""

NO_EFFECT = Option(affects_results=False)
METHOD = Option(positional=True, affects_results=False)

Observations = Annotated[tuple[Component, ...], Family((Named,), "observation")]
Rewards = Annotated[tuple[Component, ...], Family((Named,), "reward")]
RandomizationPart = Annotated[Bounds | Named | OwnPart | Value, Family((Bounds, Named))]
Terminations = Annotated[tuple[Component, ...], Family((Named,), "termination")]


class CollectConfig(ScenarioConfig):
    """Record demonstrations: observations and commands of a policy. An unfinished folder is resumed."""

    metrics: Annotated[tuple[Named, ...], NO_EFFECT] = ()
    """Nothing is measured while demonstrations are recorded."""
    policy: Part = Named(kind="expert")
    """Policy of the robot: a name, or a folder of `sean train`."""
    labels: Part | None = None
    """Policy whose commands are recorded instead of the driving policy's commands."""
    noise: option_types.Noise | None = None
    """Standard deviation of noise on the executed commands, as a share of the robot's limits, so that demonstrations
    show recovery from deviations. Commands are recorded without it."""
    hours: Annotated[option_types.Hours, NO_EFFECT] = 1.0
    """Hours of demonstrations, divided equally among tasks, or among the five situations of handcrafted people."""
    rate: option_types.Rate = 1
    """Examples per second: 1, or another divisor of the control steps per second. Images and positions
    within an example are a second apart at any rate."""
    width: option_types.Side = 64
    """Width of the depth images in pixels."""
    height: option_types.Side = 48
    """Height of the depth images in pixels."""
    batch: Annotated[option_types.ShardSize | None, NO_EFFECT] = None
    """Episodes per batch, which is stored in one file; by default chosen for the device and the hours."""
    seed: option_types.Seed = 0
    """The same seed gives the same demonstrations."""
    out: option_types.Out = None
    """Folder of the dataset, runs/demonstrations-<environment>-<behavior>-<policy>-<seed> by default. A dataset of the
    same options is resumed."""
    quiet: option_types.Quiet = False

    @pydantic.model_validator(mode="after")
    def _check_recorded(self) -> "CollectConfig":
        if self.width * self.height > option_types.MAX_PIXELS:
            size = f"{self.width} times {self.height} are more than {option_types.MAX_PIXELS:,} pixels"
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
        paths = Path(self.environment), Path(self.policy.kind)
        names = paths[0].name, Path(self.behavior.kind).stem, paths[1].stem, str(self.seed)
        return self.out or Path("runs") / "-".join(("demonstrations", *names))


class ImitationConfig(Config):
    """Train a network to imitate the demonstrations of a dataset. An unfinished folder is resumed."""

    method: Annotated[Literal["imitation"], METHOD] = "imitation"
    """Imitation of demonstrations."""
    dataset: Annotated[Path, Option(positional=True, affects_results=False)]
    """Folder of `sean collect`."""
    datasets: Annotated[tuple[Path, ...], NO_EFFECT] = ()
    """Folders of more datasets for the training."""
    part: tuple[option_types.Count, option_types.Count] = (1, 1)
    """Part of the dataset's episodes for the training, and number of equal parts: 3 10 for the third of ten."""
    pretrained: Path | None = None
    """Folder of a training; its best network is the initial network."""
    flags: bool = False
    """Give the network the current social situations as an input."""
    balance: bool = False
    """Sample examples so that all social situations are equally frequent."""
    width: option_types.Width = 64
    """Width of the encodings and hidden layers."""
    batch: option_types.BatchSize = 1024
    """Examples per minibatch."""
    learning_rate: option_types.LearningRate = 1e-3
    """Learning rate of AdamW."""
    weight_decay: option_types.Share = 0.01
    """Weight decay of AdamW."""
    patience: Annotated[option_types.Count, NO_EFFECT] = 50
    """Epochs without a smaller validation loss after which training stops."""
    epochs: Annotated[option_types.Count, NO_EFFECT] = 1000
    """Largest number of epochs."""
    validation: option_types.OpenShare = 0.1
    """Share of the episodes for validation."""
    device_memory_fraction: Annotated[option_types.Share, NO_EFFECT] = 0.6
    """Share of the device's memory for a dataset; a larger dataset is read from disk in each epoch."""
    seed: option_types.Seed = 0
    """The same seed gives the same network."""
    out: option_types.Out = None
    """Folder for checkpoints and metrics, runs/imitation-<dataset>-<seed> by default. A training of the same options is
    resumed."""
    quiet: option_types.Quiet = False

    @pydantic.model_validator(mode="after")
    def _check_part(self) -> Self:
        which, parts = self.part
        if which > parts:
            raise ValueError(f"part: {which} {parts}, but there are only {parts} parts; give a smaller first number")
        return self

    @property
    def folder(self) -> Path:
        """The folder for checkpoints and metrics."""
        return self.out or Path("runs") / f"{self.method}-{self.dataset.resolve().name}-{self.seed}"


class DaggerConfig(ImitationConfig):
    """Train networks with DAgger: each drives, an expert labels its states, and the next network learns from them.
    An unfinished folder is resumed."""

    method: Annotated[Literal["dagger"], METHOD] = "dagger"  # pyright: ignore
    """Imitation of an expert in the network's own states."""
    expert: Part = Named(kind="expert")
    """Policy that labels the states: a name, or FILE.py:NAME."""
    rounds: option_types.Count = 5
    """Rounds of DAgger after the network of the dataset alone."""
    hours: option_types.Hours = 0.25
    """Hours that each network drives."""


def _is_weight(part: Component) -> bool:
    return isinstance(part, Named) and "=" in part.kind


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


Delays = Annotated[
    tuple[option_types.Delay, option_types.Delay],
    pydantic.BeforeValidator(lambda value: (value, value) if isinstance(value, Integral) else value),
]


WORLDS = re.compile(r"worlds:[^:]*(?::\d+)+")  # sets of worlds in a list: families have commas between them


class EnvConfig(ScenarioConfig):
    """A scenario as an environment of reinforcement learning: observations, rewards and terminations."""

    observations: Observations = tuple(Named(kind=name) for name in OBSERVED)
    """Observations of the agent: terms of `sean list`, and your own."""
    rewards: Rewards = (Named(kind="default"),)
    """Rewards: default, terms of `sean list`, and your own; progress=2,time=-0.2 changes weights of the default."""
    terminations: Terminations = ()
    """Terminations besides completion and the time limit: collision, obstacle, intimate, and your own."""
    randomization: RandomizationPart | None = None
    """Randomization of each episode: behavior, for people's behavior; a .yaml file with bounds of numbers of people,
    robot and sensors; or a function (key, scenario) -> scenario."""
    action_delay: Delays = (0, 0)
    """Least and largest delay of commands in control steps; drawn for each episode."""
    observation_delay: tuple[option_types.Text, ...] = ()
    """Least and largest delays of observations in control steps, such as people=0:3 lidar=1; drawn for each episode."""

    @pydantic.field_validator("rewards")
    @classmethod
    def _weights(cls, parts: tuple[Component, ...]) -> tuple[Component, ...]:
        weights = [part.kind.partition("=") for part in parts if _is_weight(part)]
        option_types.check_once([name for name, _, _ in weights])
        for name, _, weight in weights:
            if not _is_number(weight):
                raise ValueError(f"{name}={weight} has no number as the weight; write {name}=2")
        return parts

    @property
    def reward_weights(self) -> dict[str, float]:
        """Weights of terms of the reward: name -> number, of NAME=NUMBER."""
        pairs = (part.kind.partition("=") for part in self.rewards if _is_weight(part))
        return {name: float(weight) for name, _, weight in pairs}

    @property
    def reward_parts(self) -> tuple[Component, ...]:
        """The terms of the reward without those that only have a weight; default if no other term is named."""
        parts = tuple(part for part in self.rewards if not _is_weight(part))
        named = any(isinstance(part, Named) for part in parts)
        return parts if named or len(parts) == len(self.rewards) else (Named(kind="default"), *parts)

    @pydantic.field_validator("action_delay")
    @classmethod
    def _in_order(cls, value: tuple[int, int]) -> tuple[int, int]:
        if value[0] > value[1]:
            raise ValueError(f"{value[0]} is more than {value[1]}; give the least steps first")
        return value

    @pydantic.field_validator("randomization", mode="before")
    @classmethod
    def _as_bounds(cls, value: object) -> object:
        """A mapping without a kind, as files of bounds have it."""
        bounds = isinstance(value, Mapping) and "kind" not in value
        return {"kind": "bounds", **value} if bounds else value  # pyright: ignore

    @pydantic.field_validator("observation_delay")
    @classmethod
    def _check_delays(cls, delays: tuple[str, ...]) -> tuple[str, ...]:
        option_types.check_once([text.partition("=")[0] for text in delays])
        for text in delays:
            name, _, steps = text.partition("=")
            least, _, most = steps.partition(":")
            if not (least.isdecimal() and (most or least).isdecimal() and int(least) <= int(most or least) <= 1_000):
                raise ValueError(f"{text} has no steps from 0 to 1,000; write {name}=0:3, the least first, or {name}=2")
        return delays

    @property
    def observation_delays(self) -> dict[str, tuple[int, int]]:
        """Observation -> least and largest delay in control steps."""
        pairs = (text.partition("=") for text in self.observation_delay)
        parts = {name: steps.partition(":") for name, _, steps in pairs}
        return {name: (int(least), int(most or least)) for name, (least, _, most) in parts.items()}

    def identity(self) -> dict[str, Any]:
        """As of ``Config``, with the bounds of a randomization in place of the name of their file."""
        part = self.randomization
        if isinstance(part, Named) and Path(part.kind).suffix in (".yaml", ".yml"):
            return self.replace(randomization=files.read_yaml(Path(part.kind))[1]).identity()
        return super().identity()


class ReinforcementConfig(EnvConfig):
    """Options of all methods of reinforcement learning."""

    SWEPT: ClassVar[tuple[str, ...]] = ("learning_rate", "discount", "advantage_decay")
    """Parameters that may differ between agents trained in parallel."""

    method: Annotated[str, METHOD]
    """Method."""
    environment: option_types.Names = "warehouse"
    """Physical environment: a name, the folder of your own or of many, or generated floors such as
    worlds:rooms,aisles:512; several, separated by commas, share the scenarios, and one agent learns in all of them."""
    critic: Annotated[tuple[Component, ...], Family((Named,), "critic_term")] = ()
    """Observations of the critic alone, such as people: it does not drive, so they may be privileged."""
    scenarios: option_types.BatchSize = 64
    """Scenarios that step in parallel, for each agent; on a GPU try 8192."""
    steps: option_types.StepCount = 2_000_000
    """Scenario-steps of the whole training of an agent."""
    horizon: option_types.Count = 32
    """Steps of each scenario between two updates."""
    minibatches: option_types.Count = 8
    """Minibatches of the collected transitions, one per optimizer step."""
    learning_rate: option_types.LearningRate = 5e-4
    """Initial learning rate of Adam."""
    learning_rate_schedule: Literal["linear", "constant"] = "linear"
    """linear: the learning rate falls to 0 over the steps; constant: it stays, and a training goes on with more
    steps."""
    discount: option_types.Share = 0.99
    """Discount factor per step."""
    advantage_decay: option_types.Share = 0.95
    """Lambda of the generalized advantage estimate."""
    width: option_types.Width = 256
    """Width of the hidden layers."""
    layers: option_types.Count = 2
    """Hidden layers of the actor and of the critic."""
    recurrent: bool = False
    """Give the network a memory, a gated recurrent unit."""
    bfloat16: bool = False
    """Store and encode images in half precision: faster on a GPU, slower on a CPU."""
    noise: option_types.Noise | None = None
    """Initial standard deviation of actions, which are from -1 to 1; 0.5, or the pretrained agent's, by
    default."""
    pool: option_types.BatchSize = 1024
    """Starts of episodes that are drawn in advance, in each environment."""
    curriculum: Literal["none", "situations", "regret"] = "none"
    """Sampling of starts: none, uniform; situations, more of the situations in which the agent costs people most;
    regret, more of the starts with room for improvement, with people's behavior randomized in each episode."""
    curriculum_every: option_types.Count = 20
    """Updates between two replacements of the least useful starts by a curriculum."""
    pretrained: Path | None = None
    """Folder of a training, or an agent of the package; the initial agent."""
    imitate: Part | None = None
    """Policy to imitate at first: a name, or the folder of a training, such as one of sean train dagger."""
    seeds: option_types.Count = 1
    """Agents trained in parallel, with consecutive seeds."""
    sweep: tuple[option_types.Text, ...] = ()
    """Numbers in which agents differ, such as learning_rate=0.001,0.0003 or rewards.time=-0.1,-0.2; all combinations
    are trained in parallel."""
    evaluate_every: Annotated[option_types.Count, NO_EFFECT] = 50
    """Updates between two evaluations, each with a checkpoint."""
    evaluation_episodes: Annotated[option_types.EpisodeCount, NO_EFFECT] = 64
    """Episodes of an evaluation, in each environment; the agent takes the mean of its actions."""
    seed: option_types.Seed = 0
    """The same seed gives the same agent."""
    callbacks: Annotated[tuple[Component, ...], Family((Named,), "callback"), NO_EFFECT] = ()
    """Functions that are called with each line of metrics.jsonl, a dict: FILE.py:NAME."""
    out: option_types.Out = None
    """Folder for checkpoints and metrics, runs/METHOD-<environment>-<behavior>-<seed> by default. A training of the
    same options is resumed."""
    distributed: Annotated[bool, NO_EFFECT] = False
    """Join the other processes of this training, on one or more hosts, as SLURM and MPI start them."""
    quiet: option_types.Quiet = False
    network: Part = Named(kind="mlp")
    """Network: mlp, layers alone; attention, over people; conv, strided convolutions of images; or FILE.py:NAME, a
    flax module that gives the features of an observation."""
    distribution: Literal["gaussian", "squashed"] = "gaussian"
    """Distribution of actions: gaussian, clipped to the robot's limits; or squashed, tanh of a Gaussian, which never
    exceeds them."""
    laws: option_types.Names | None = None
    """Laws of people's motion in place of model and forces: models and presets of forces, such as
    calibrated,sean2,orca; several share the scenarios, and one agent learns among people of all of them."""
    costs: tuple[option_types.Text, ...] = ()
    """Costs with a limit per minute, such as intimate_robot_on_person=0.1: terms of the reward, whose weights are
    learned so that the limits are kept."""

    @pydantic.model_validator(mode="after")
    def _check_numbers(self) -> Self:
        for problem in self._problems():
            raise ValueError(problem)
        _ = self.agents
        return self

    def _problems(self) -> Iterable[str]:
        if self.scenarios % self.minibatches:
            text = f"{self.scenarios} scenarios do not make {self.minibatches} minibatches of equal size"
            yield f"minibatches: {text}; choose a divisor"
        if self.imitate is not None and self.pretrained is not None:
            yield f"imitate: {self.imitate.kind} and --pretrained {self.pretrained} exclude each other; choose one"
        options = type(self).model_fields
        other = [name for name in ("model", "forces") if getattr(self, name) != options[name].get_default()]
        if self.laws is not None and other:
            yield f"laws: {self.laws} would replace the option {other[0]}; leave one of the two out"
        laws = max(1, len(listed(self.laws)))
        if self.scenarios % (count := len(self.environments) * laws):
            text = f"{self.scenarios} do not divide equally among {count} environments"
            yield f"scenarios: {text}{' with their laws' if laws > 1 else ''}; take a multiple"
        if self.curriculum != "none" and laws > 1:
            text = f"{self.curriculum} samples the starts of one environment, not of the laws {self.laws}"
            yield f"curriculum: {text}; choose one of the two"
        if self.curriculum != "none" and len(self.environments) > 1:
            text = f"{self.curriculum} samples the starts of one environment, not of {self.environment}"
            yield f"curriculum: {text}; choose one of the two"
        if self.updates >= 2**31:
            text = f"{self.steps} make {self.updates:,} updates, more than {2**31 - 1:,}"
            yield f"steps: {text}; take more scenarios or a longer horizon"
        if both := [
            name for name in self.cost_limits if any(text.startswith(f"rewards.{name}=") for text in self.sweep)
        ]:
            yield f"sweep: the weight of the cost {both[0]} is learned; leave rewards.{both[0]} out"
        if self.seed + self.seeds > 2**32:
            text = f"{self.seeds} consecutive seeds from {self.seed} go beyond {2**32 - 1}"
            yield f"seeds: {text}; take a lesser seed"

    def identity(self) -> dict[str, Any]:
        """As of ``Config``; a training of a constant learning rate may go on with more steps."""
        constant = self.learning_rate_schedule == "constant"
        return {name: value for name, value in super().identity().items() if name != "steps" or not constant}

    @property
    def updates(self) -> int:
        """The number of updates of a training."""
        return max(1, -(-self.steps // (self.scenarios * self.horizon)))

    @pydantic.field_validator("costs")
    @classmethod
    def _check_costs(cls, costs: tuple[str, ...]) -> tuple[str, ...]:
        option_types.check_once([text.partition("=")[0] for text in costs])
        for text in costs:
            name, _, limit = text.partition("=")
            try:
                possible = 0.0 < float(limit) < math.inf
            except ValueError:
                possible = False
            if not possible:
                raise ValueError(f"{text} has no limit above 0 per minute; write {name}=0.1")
        return costs

    @property
    def cost_limits(self) -> dict[str, float]:
        """Cost -> its limit per minute."""
        return {name: float(limit) for name, _, limit in (text.partition("=") for text in self.costs)}

    @property
    def environments(self) -> list[str]:
        """The environments in which one agent learns."""
        parts = WORLDS.findall(self.environment) + listed(WORLDS.sub("", self.environment))
        return parts or [self.environment]

    @property
    def per_environment(self) -> list[Self]:
        """The same options for each environment alone."""
        return [self.replace(environment=name) for name in self.environments]

    def as_run(self) -> RunConfig:
        """The options of a run in the first environment of the training, with its first robot."""
        first = self.per_environment[0]
        shared = ScenarioConfig.model_fields.keys() & first.model_fields_set - {"metrics", "preset"}
        chosen = {name: getattr(first, name) for name in shared}
        if isinstance(part := chosen.get("robot"), Named):
            chosen["robot"] = part.model_copy(update={"kind": part.kind.partition(",")[0]})
        return RunConfig(**chosen)

    @property
    def agents(self) -> list[dict[str, float]]:
        """Numbers of each agent: its seed, one for each name in ``SWEPT``, and weights of rewards.

        Raises:
            ValueError: the sweep names something else, or an impossible number.
        """
        agents = [{name: float(getattr(self, name)) for name in self.SWEPT}]
        names = [text.partition("=")[0] for text in self.sweep]
        for text in self.sweep:
            name, _, values = text.partition("=")
            if name not in self.SWEPT and not name.startswith("rewards."):
                known = ", ".join((*self.SWEPT, "rewards.NAME"))
                raise ValueError(f"sweep: '{name}' cannot be swept; {known} can, as in {self.SWEPT[0]}=0.1,0.2")
            if names.count(name) > 1:
                raise ValueError(f"sweep: '{name}' is listed twice; list it once, with all of its numbers")
            limits = type(self).model_fields[name].metadata if name in self.SWEPT else [pydantic.AllowInfNan(False)]
            possible = pydantic.TypeAdapter(Annotated[float, *limits])
            try:
                numbers = [possible.validate_python(float(part)) for part in values.split(",")]
            except ValueError:
                raise ValueError(f"sweep: {name}={values} must be numbers within the range of --{name}") from None
            if len({*numbers}) < len(numbers):
                raise ValueError(f"sweep: {name}={values} has a number twice; list it once")
            agents = [{**agent, name: number} for agent in agents for number in numbers]
        return [{"seed": self.seed + more, **agent} for agent in agents for more in range(self.seeds)]

    @property
    def folder(self) -> Path:
        """The folder for checkpoints and metrics."""
        environments = (Path(name).name.replace(":", "-") for name in self.environments)
        names = self.method, *environments, Path(self.behavior.kind).stem, str(self.seed)
        return self.out or Path("runs") / "-".join(names)


class PPOConfig(ReinforcementConfig):
    """Train a network by reinforcement learning with proximal policy optimization. An unfinished folder is resumed."""

    SWEPT = (*ReinforcementConfig.SWEPT, "clip", "entropy")

    method: Annotated[Literal["ppo"], METHOD] = "ppo"  # pyright: ignore
    """Proximal policy optimization."""
    epochs: option_types.Count = 4
    """Passes of an update through the collected transitions."""
    clip: option_types.Share = 0.2
    """Largest change of an action's probability by an update."""
    entropy: option_types.Share = 0.002
    """Weight of the entropy of actions."""


class APGConfig(ReinforcementConfig):
    """Train a network with analytic policy gradients over short horizons, and a critic for the rest (SHAC). An
    unfinished folder is resumed."""

    method: Annotated[Literal["apg"], METHOD] = "apg"  # pyright: ignore
    """Analytic policy gradients over short horizons."""
    horizon: option_types.Count = 16
    """Steps of each scenario between two updates, through which gradients are taken."""
    critic_epochs: option_types.Count = 4
    """Passes of the critic through the collected transitions."""
    through_people: bool = False
    """Also take gradients through people, who give way to the robot."""
    target_share: option_types.Share = 0.2
    """Step of the target critic towards the learned one in each update."""


METHODS: dict[str, type[Config]] = {
    "imitation": ImitationConfig,
    "dagger": DaggerConfig,
    "ppo": PPOConfig,
    "apg": APGConfig,
}
"""Word after ``sean train`` -> its options."""


class ExportConfig(Config):
    """Options of exports of datasets and agents."""

    format: Annotated[str, Option(positional=True)]
    """Format."""
    source: Annotated[Path, Option(positional=True)]
    """Folder of `sean train ppo`."""
    out: Path
    """Folder to write, which must be new or empty."""
    quiet: option_types.Quiet = False

    @property
    def folder(self) -> Path:
        """The folder to write."""
        return self.out


class ExportLeRobotConfig(ExportConfig):
    """Write a dataset as LeRobotDataset v3.0."""

    format: Annotated[Literal["lerobot"], Option(positional=True)] = "lerobot"  # pyright: ignore
    """A dataset as LeRobotDataset v3.0."""
    source: Annotated[Path, Option(positional=True)]
    """Folder of `sean collect`."""


class ExportAgentConfig(ExportConfig):
    """Write the best agent of a training as two small files."""

    format: Annotated[Literal["agent"], Option(positional=True)] = "agent"  # pyright: ignore
    """A trained agent in two small files."""


class ExportOnnxConfig(ExportConfig):
    """Write the best agent of a training as an ONNX model, which needs neither jax nor this package."""

    format: Annotated[Literal["onnx"], Option(positional=True)] = "onnx"  # pyright: ignore
    """A trained agent as an ONNX model."""
    source: Annotated[Path, Option(positional=True)]
    """Folder of `sean train ppo`, or the name of an agent."""
    out: Path
    """File to write, which ends in .onnx."""


class ExportBagConfig(ExportConfig):
    """Write episodes of a run, a dataset or a training as bags of ROS messages. They are simulated again."""

    format: Annotated[Literal["bag"], Option(positional=True)] = "bag"  # pyright: ignore
    """Bags of ROS messages."""
    source: Annotated[Path, Option(positional=True)]
    """Folder of `sean run`, `collect` or `train`."""
    episodes: Annotated[tuple[option_types.EpisodeNumber, ...], pydantic.Field(min_length=1)] = (0,)
    """Numbers of episodes, as of `sean replay`; each becomes a bag."""
    ros: Literal["both", "1", "2"] = "both"
    """1: files of rosbag 1 (Noetic); 2: folders of rosbag2 with MCAP (Jazzy)."""
    naming: Literal["ros", "sean"] = "ros"
    """Names of topics: ros as in Nav2 and move_base; sean as in SEAN 2.0, with its own topics."""
    sensors: option_types.Names | None = None
    """Sensors to add to those of the run, separated by commas: names or YAML files; by default the robot's lidar, with
    none nothing."""


class ExportMapConfig(ExportConfig):
    """Write the map of an environment for a ROS map_server: a YAML file and its image."""

    format: Annotated[Literal["map"], Option(positional=True)] = "map"  # pyright: ignore
    """A map of map_server."""
    source: Annotated[Path, Option(positional=True)]
    """Environment: a name, or a folder."""
    out: Path
    """File to write, which ends in .yaml; the image lies beside it."""
    resolution: Annotated[float, Number(0.001, 0.5, "m")] = 0.05
    """Side of a cell in metres."""
    height: Annotated[float, Number(0.0, 100.0, "m")] = 0.0
    """Least height in metres of the obstacles on the map. SEAN's short map has all, its tall map those of 1 m."""


EXPORTS: dict[str, type[ExportConfig]] = {
    "lerobot": ExportLeRobotConfig,
    "agent": ExportAgentConfig,
    "onnx": ExportOnnxConfig,
    "bag": ExportBagConfig,
    "map": ExportMapConfig,
}
"""Word after ``sean export`` -> its options."""
