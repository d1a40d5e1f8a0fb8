"""What a builder of a pedestrian behavior is given of the world (section IV-D)."""

from dataclasses import dataclass
from pathlib import Path

from sean_jax import environment as environments
from sean_jax.base import Environment
from sean_jax.navigation import Navigation


@dataclass(frozen=True)
class Place:
    """An environment in which people shall move, and how time passes there."""

    folder: Path  # of the environment, with graph.yaml, handcrafted.yaml and what else a behavior reads
    environment: Environment
    navigation: Navigation  # for a person's radius
    time_step: float = 0.1  # s, of control

    @property
    def default_people(self) -> int:
        """How many people ``environment.yaml`` says there are, unless somebody asks for another number."""
        return environments.default_people(self.folder)
