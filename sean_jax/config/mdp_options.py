"""Options of an environment of reinforcement learning, which ``sean train ppo`` and ``apg`` embed."""

import math
from collections.abc import Mapping
from numbers import Integral
from pathlib import Path
from typing import Annotated, Any, ClassVar

import pydantic

from sean_jax.config import option_types
from sean_jax.config.components import Bounds, Component, Family, Named, OwnPart, Value
from sean_jax.config.option_types import HelpTopic
from sean_jax.config.scenario_options import ScenarioConfig
from sean_jax.io import files

OBSERVED = ("goal", "goal_heading", "path", "distance", "speeds", "hold", "obstacles", "people")
"""The terms of an agent's observation, where none are named."""

Observations = Annotated[tuple[Component, ...], Family((Named,), "observation")]
Rewards = Annotated[tuple[Component, ...], Family((Named,), "reward")]
RandomizationPart = Annotated[Bounds | Named | OwnPart | Value, Family((Bounds, Named))]
Terminations = Annotated[tuple[Component, ...], Family((Named,), "termination")]


def _is_weight(term: Component) -> bool:
    return isinstance(term, Named) and "=" in term.kind


def _range_of(steps: str) -> tuple[str, str]:
    """The least and the largest of 0:3; of 3 alone both are 3."""
    least, _, largest = steps.partition(":")
    return least, largest or least


Delays = Annotated[
    tuple[option_types.Delay, option_types.Delay],
    pydantic.BeforeValidator(lambda value: (value, value) if isinstance(value, Integral) else value),
]


class EnvConfig(ScenarioConfig):
    """A scenario as an environment of reinforcement learning: observations, rewards and terminations."""

    TOPIC: ClassVar = HelpTopic("mdp", "observations, rewards, terminations, randomization and delays")

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
    def _weights(cls, terms: tuple[Component, ...]) -> tuple[Component, ...]:
        weights = option_types.named_values(term.kind for term in terms if _is_weight(term))
        for name, weight in weights.items():
            if not math.isfinite(option_types.float_or_nan(weight)):
                raise ValueError(f"{name}={weight} has no number as the weight; write {name}=2")
        return terms

    @property
    def reward_weights(self) -> dict[str, float]:
        """Weights of terms of the reward: name -> number, of NAME=NUMBER."""
        weights = option_types.named_values(term.kind for term in self.rewards if _is_weight(term))
        return {name: float(weight) for name, weight in weights.items()}

    @property
    def reward_parts(self) -> tuple[Component, ...]:
        """The terms of the reward without those that only have a weight; default if no other term is named."""
        terms = tuple(term for term in self.rewards if not _is_weight(term))
        named = any(isinstance(term, Named) for term in terms)
        return terms if named or len(terms) == len(self.rewards) else (Named(kind="default"), *terms)

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
        return {"kind": "bounds", **value} if isinstance(value, Mapping) and "kind" not in value else value

    @pydantic.field_validator("observation_delay")
    @classmethod
    def _check_delays(cls, delays: tuple[str, ...]) -> tuple[str, ...]:
        for text, (name, steps) in zip(delays, option_types.named_values(delays).items(), strict=True):
            least, largest = _range_of(steps)
            if not (least.isdecimal() and largest.isdecimal() and int(least) <= int(largest) <= 1_000):
                raise ValueError(f"{text} has no steps from 0 to 1,000; write {name}=0:3, the least first, or {name}=2")
        return delays

    @property
    def observation_delays(self) -> dict[str, tuple[int, int]]:
        """Observation -> least and largest delay in control steps."""
        ranges = {name: _range_of(steps) for name, steps in option_types.named_values(self.observation_delay).items()}
        return {name: (int(least), int(largest)) for name, (least, largest) in ranges.items()}

    def identity(self) -> dict[str, Any]:
        """As of ``Config``, with the bounds of a randomization in place of the name of their file."""
        part = self.randomization
        if isinstance(part, Named) and Path(part.kind).suffix in (".yaml", ".yml"):
            return self.replace(randomization=files.read_yaml(Path(part.kind))[1]).identity()
        return super().identity()
