"""The best agent of a training, from its folder."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Float, Int

from sean_jax.base import Array, Scenario
from sean_jax.learning import agents
from sean_jax.learning.actor_critic import ActorCritic, Agent
from sean_jax.learning.checkpoints import Checkpoints
from sean_jax.mdp import observations


@struct.dataclass
class Best:
    """The agents that did best in an evaluation so far."""

    agent: Agent  # (A, ...)
    value: Float[Array, "A"]  # return in that evaluation
    update: Int[Array, "A"]  # after which it was


def load(folder: Path, scenario: Scenario) -> tuple[ActorCritic, Agent, observations.Terms]:
    """The best agent of a training.

    Returns:
        The network, the agent, and the terms of its observation.

    Raises:
        InputError: there is no checkpoint, or the agent learned from observations of another size.
        IncompleteError: the checkpoint cannot be read.
    """
    options, checkpoints = agents.read_options(folder), Checkpoints(folder)
    network, one, seen = agents.outline(options, scenario)
    count = len(options.agents)
    saved = {name: shape for name, shape in checkpoints.shapes("best").items() if name.startswith("agent/")}
    agents.check_sizes(folder, options, {name[6:]: shape[1:] for name, shape in saved.items()}, one)
    shape = jax.ShapeDtypeStruct
    several = jax.tree.map(lambda leaf: shape((count, *leaf.shape), leaf.dtype), one)
    best = checkpoints.best("best", Best(several, shape((count,), jnp.float32), shape((count,), jnp.int32)))  # pyright: ignore
    chosen = int(np.argmax(best.value))
    return network, jax.tree.map(lambda part: part[chosen], best.agent), seen
