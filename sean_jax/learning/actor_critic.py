"""The network of reinforcement learning: an actor and a critic, of vectors and images, with or without a memory.

Numbers of an observation are normalized by their running mean and deviation. Images are cut into squares and go through
dense layers, as in ``network``, after distances have become nearness. The memory is a gated recurrent unit.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import linen as nn
from flax import struct
from flax.typing import VariableDict
from jaxtyping import Bool, Float

from sean_jax.base import Array
from sean_jax.learning.network import PATCHES, squares
from sean_jax.mdp import observations
from sean_jax.mdp.spaces import Dict

CLIP = 10.0  # deviations, at which normalized numbers are clipped
INITIAL_LOG_STD = -0.7  # of actions from -1 to 1
LEAST_LOG_STD = -5.0  # where it depends on what is seen


class Answer(NamedTuple):
    """What the network says to an observation."""

    mean: Float[Array, "*batch 2"]  # of the action
    log_std: Float[Array, "*batch 2"]  # of the action
    value: Float[Array, "*batch"]  # expected return
    memory: Float[Array, "*batch M"]  # for the next step; M = 0 without a memory


class ActorCritic(nn.Module):
    """An actor and a critic. Networks of equal sizes are equal values, so compiled programs are reused."""

    width: int = 256  # of hidden layers
    layers: int = 2
    images: tuple[str, ...] = ()  # names of the parts of the observation that are images
    recurrent: bool = False
    private: int = 0  # numbers at the end of the vector that the critic alone sees
    bfloat16: bool = False  # of images
    careful: bool = False  # the noise of actions depends on what is seen

    @property
    def memory_size(self) -> int:
        """Numbers that the network remembers."""
        return self.width if self.recurrent else 0

    @property
    def image_dtype(self) -> Any:
        """In which images are kept and encoded."""
        return jnp.bfloat16 if self.bfloat16 else jnp.float32

    @nn.compact
    def __call__(
        self,
        vector: Float[Array, "*batch F"],
        images: dict[str, Array],
        memory: Float[Array, "*batch M"],
        start: Bool[Array, "*batch"],
    ) -> Answer:
        """Answer to observations.

        Args:
            vector: (..., F) normalized numbers, the last of which may be for the critic alone.
            images: name -> (..., H, W) m, or (..., H, W, C).
            start: (...) whether an episode begins here, so that what is remembered is of another.
        """
        shared = vector.shape[-1] - self.private
        vector, private = vector[..., :shared], vector[..., shared:]
        features = jnp.concatenate(
            [vector, *(_Images(self.width, self.image_dtype)(images[name]) for name in self.images)], -1
        )
        if self.recurrent:
            memory = jnp.where(start[..., None], 0.0, memory)
            features = nn.tanh(_dense(self.width)(features))
            memory, features = nn.GRUCell(self.width)(memory, features)
        actor, critic = features, jnp.concatenate([features, private], -1)
        for _ in range(self.layers):
            actor, critic = nn.tanh(_dense(self.width)(actor)), nn.tanh(_dense(self.width)(critic))
        mean, value = _dense(2, 0.01)(actor), _dense(1, 1.0)(critic)
        start_value = nn.initializers.constant(INITIAL_LOG_STD)
        if self.careful:
            layer = nn.Dense(2, kernel_init=nn.initializers.orthogonal(0.01), bias_init=start_value, name="log_std")
            log_std = jnp.clip(layer(actor), LEAST_LOG_STD, 0.0)
        else:
            log_std = jnp.broadcast_to(self.param("log_std", start_value, (2,)), mean.shape)
        return Answer(mean, log_std, value[..., 0], memory)


class _Images(nn.Module):
    """(..., H, W) m or (..., H, W, C) to (..., width)."""

    width: int
    dtype: Any

    @nn.compact
    def __call__(self, image: Array) -> Array:
        values = 1.0 / (1.0 + image[..., None]) if image.shape[-1] > 4 else image  # near things matter most
        for side, features in PATCHES:
            values = nn.relu(_dense(features, dtype=self.dtype)(squares(values, side)))
        return nn.relu(_dense(self.width, dtype=self.dtype)(values.reshape(*values.shape[:-3], -1))).astype(jnp.float32)


def _dense(features: int, gain: float = np.sqrt(2.0), dtype: Any = jnp.float32) -> nn.Dense:
    return nn.Dense(features, dtype=dtype, kernel_init=nn.initializers.orthogonal(gain))


@struct.dataclass
class Statistics:
    """Running mean and variance of the numbers of an observation."""

    mean: Float[Array, "F"]
    variance: Float[Array, "F"]
    count: Float[Array, ""]


@struct.dataclass
class Agent:
    """What a training learns."""

    parameters: VariableDict
    statistics: Statistics


def init_agent(network: ActorCritic, terms: observations.Terms, space: Dict, key: Array) -> Agent:
    """The agent before training.

    Args:
        key: () typed PRNG key.
    """
    empty = {name: jnp.zeros(box.shape, jnp.float32) for name, box in space.items()}
    vector = observations.flatten(terms, empty).astype(jnp.float32)
    start = jnp.ones((), bool)
    memory = jnp.zeros(network.memory_size, jnp.float32)
    parameters = network.init(key, vector, {name: empty[name] for name in network.images}, memory, start)
    statistics = Statistics(jnp.zeros_like(vector), jnp.ones_like(vector), jnp.full((), 1e-4, jnp.float32))
    return Agent(parameters, statistics)


def init_agents(network: ActorCritic, terms: observations.Terms, space: Dict, keys: Array) -> Agent:
    """Several agents before training, one after another.

    Under ``vmap`` their orthogonal matrices would be factorized in batches, and on a CPU of two cores jaxlib deadlocks
    where two batches of factorizations run at once.

    Args:
        keys: (A,) typed PRNG keys.

    Returns:
        The agents, (A, ...).
    """
    return jax.lax.map(lambda key: init_agent(network, terms, space, key), keys)


def with_noise(agent: Agent, deviation: float) -> Agent:
    """The agent with other noise of its actions.

    Args:
        deviation: standard deviation of actions from -1 to 1; where it depends on what is seen, that of its bias.
    """
    inner = dict(agent.parameters["params"])
    value, old = np.log(deviation), inner["log_std"]
    inner["log_std"] = (
        {**old, "bias": jnp.full_like(old["bias"], value)} if isinstance(old, Mapping) else jnp.full_like(old, value)
    )
    return Agent({**agent.parameters, "params": inner}, agent.statistics)


def answer(
    network: ActorCritic,
    agent: Agent,
    vector: Float[Array, "*batch F"],
    images: dict[str, Array],
    memory: Float[Array, "*batch M"],
    start: Bool[Array, "*batch"],
) -> Answer:
    """What the agent says to observations.

    Args:
        agent: its parameters, and the statistics by which numbers are normalized.
        vector: (..., F) of ``observations.flatten``.
    """
    mean, variance = (jnp.broadcast_to(row, vector.shape) for row in (agent.statistics.mean, agent.statistics.variance))
    scaled = (vector - mean) * jax.lax.rsqrt(variance + 1e-8)
    call: Callable = network.apply
    return call(agent.parameters, jnp.clip(scaled, -CLIP, CLIP), images, memory, start)


def update_statistics(before: Statistics, vectors: Float[Array, "K F"]) -> Statistics:
    """Statistics with further observations.

    Returns:
        Of all together.
    Source: T. Chan et al., "Updating formulae and a pairwise algorithm for computing sample variances", 1979.
    """
    number = jnp.asarray(vectors.shape[0], jnp.float32)
    mean, variance = vectors.mean(0), vectors.var(0)
    total = before.count + number
    gap = mean - before.mean
    squares_sum = before.variance * before.count + variance * number + gap * gap * before.count * number / total
    return Statistics(before.mean + gap * number / total, squares_sum / total, total)


def draw_action(answered: Answer, key: Array) -> Float[Array, "*batch 2"]:
    """An action with its noise.

    Args:
        key: () typed PRNG key.
    """
    noise = jax.random.normal(key, answered.mean.shape, answered.mean.dtype)
    return answered.mean + jnp.exp(answered.log_std) * noise


def log_density(answered: Answer, action: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
    """Logarithm of the density with which an action is taken."""
    gap = (action - answered.mean) * jnp.exp(-answered.log_std)
    return -(0.5 * gap * gap + answered.log_std + 0.5 * np.log(2.0 * np.pi)).sum(-1)


def entropy(answered: Answer) -> Float[Array, "*batch"]:
    """Entropy of the actions."""
    return (answered.log_std + 0.5 * np.log(2.0 * np.pi * np.e)).sum(-1)
