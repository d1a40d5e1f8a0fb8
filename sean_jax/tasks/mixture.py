"""Several robot tasks in one: each episode draws which (section V-B lets tasks take turns)."""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import PyTree

from sean_jax.base import Array, Groups, Pedestrians, RobotTask, Scenario


@dataclasses.dataclass(frozen=True)
class Mixture:
    """A task that is one of several, each as likely; equal for equal tasks, so nothing is compiled again."""

    tasks: tuple[Callable[..., RobotTask], ...]

    def __call__(
        self, scenario: Scenario, pedestrians: Pedestrians, groups: Groups, memory: PyTree, key: Array
    ) -> RobotTask:
        """The task of an episode.

        Args:
            key: () typed PRNG key.
        """
        choice_key, task_key = jax.random.split(key)
        which = jax.random.randint(choice_key, (), 0, len(self.tasks), jnp.int32)
        branches = [lambda key, task=task: task(scenario, pedestrians, groups, memory, key) for task in self.tasks]
        return jax.lax.switch(which, branches, task_key)
