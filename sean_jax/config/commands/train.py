"""The options of ``sean train``."""

import math
import re
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import pydantic

from sean_jax.config import option_types
from sean_jax.config.commands.run import RunConfig
from sean_jax.config.components import Component, Config, Family, Named
from sean_jax.config.mdp_options import EnvConfig
from sean_jax.config.option_types import NO_EFFECT, Option
from sean_jax.config.scenario_options import Part, ScenarioConfig
from sean_jax.core.messages import listed

METHOD = Option(positional=True, affects_results=False)


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


WORLDS = re.compile(r"worlds:[^:]*(?::\d+)+")  # sets of worlds in a list: families have commas between them


class ReinforcementConfig(EnvConfig):
    """Options of all methods of reinforcement learning."""

    SWEPT: ClassVar[tuple[str, ...]] = ("learning_rate", "discount", "advantage_decay")
    """Parameters that may differ between agents trained in parallel."""

    method: Annotated[str, METHOD]
    """Method."""
    environment: Annotated[option_types.Names, pydantic.BeforeValidator(option_types.join_names)] = "warehouse"
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
    def _check_sizes(self) -> Self:
        if self.scenarios % self.minibatches:
            raise ValueError(
                f"minibatches: {self.scenarios} scenarios do not make {self.minibatches} minibatches of equal size; "
                "choose a divisor"
            )
        if self.imitate is not None and self.pretrained is not None:
            raise ValueError(
                f"imitate: {self.imitate.kind} and --pretrained {self.pretrained} exclude each other; choose one"
            )
        return self

    @pydantic.model_validator(mode="after")
    def _check_environments(self) -> Self:
        options = type(self).model_fields
        chosen = [name for name in ("model", "forces") if getattr(self, name) != options[name].get_default()]
        if self.laws is not None and chosen:
            raise ValueError(f"laws: {self.laws} would replace the option {chosen[0]}; leave one of the two out")

        # Environments and laws share the scenarios; a curriculum needs all of them.
        law_count = max(1, len(listed(self.laws)))
        count = len(self.environments) * law_count
        if self.scenarios % count:
            if law_count > 1:
                raise ValueError(
                    f"scenarios: {self.scenarios} do not divide equally among {count} environments with their laws; "
                    "take a multiple"
                )
            raise ValueError(
                f"scenarios: {self.scenarios} do not divide equally among {count} environments; take a multiple"
            )
        if self.curriculum != "none" and count > 1:
            if law_count > 1:
                raise ValueError(
                    f"curriculum: {self.curriculum} samples the starts of one environment, not of the laws "
                    f"{self.laws}; choose one of the two"
                )
            raise ValueError(
                f"curriculum: {self.curriculum} samples the starts of one environment, not of {self.environment}; "
                "choose one of the two"
            )
        return self

    @pydantic.model_validator(mode="after")
    def _check_agents(self) -> Self:
        if self.updates >= 2**31:
            raise ValueError(
                f"steps: {self.steps} make {self.updates:,} updates, more than {2**31 - 1:,}; "
                "take more scenarios or a longer horizon"
            )
        swept = {text.partition("=")[0] for text in self.sweep}
        for name in self.cost_limits:
            if f"rewards.{name}" in swept:
                raise ValueError(f"sweep: the weight of the cost {name} is learned; leave rewards.{name} out")
        if self.seed + self.seeds > 2**32:
            raise ValueError(
                f"seeds: {self.seeds} consecutive seeds from {self.seed} go beyond {2**32 - 1}; take a lesser seed"
            )
        _ = self.agents
        return self

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
        for text, (name, limit) in zip(costs, option_types.named_values(costs).items(), strict=True):
            if not 0.0 < option_types.float_or_nan(limit) < math.inf:
                raise ValueError(f"{text} has no limit above 0 per minute; write {name}=0.1")
        return costs

    @property
    def cost_limits(self) -> dict[str, float]:
        """Cost -> its limit per minute."""
        return {name: float(limit) for name, limit in option_types.named_values(self.costs).items()}

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
            numbers = self._swept_numbers(name, values)
            agents = [{**agent, name: number} for agent in agents for number in numbers]
        return [{"seed": self.seed + index, **agent} for agent in agents for index in range(self.seeds)]

    def _swept_numbers(self, name: str, values: str) -> list[float]:
        """The numbers of a sweep, within the range of their option."""
        limits = type(self).model_fields[name].metadata if name in self.SWEPT else [pydantic.AllowInfNan(False)]
        option = pydantic.TypeAdapter(Annotated[float, *limits])
        try:
            numbers = [option.validate_python(float(text)) for text in values.split(",")]
        except ValueError:
            raise ValueError(f"sweep: {name}={values} must be numbers within the range of --{name}") from None
        if len({*numbers}) < len(numbers):
            raise ValueError(f"sweep: {name}={values} has a number twice; list it once")
        return numbers

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
