"""The networks: of imitation (section V-C, after [50]), and actor and critic of reinforcement learning.

``Network`` has a local planner and a velocity controller, each with soft attention. Encoders (of 5 depth images, of the
global plan and, optionally, of the situations) give vectors of one width. The local planner attends to them and
predicts where the robot will be in 1 to 5 s. Another encoder encodes that plan, and the controller attends to all
encodings and gives the command. The paper states no layer sizes; these were chosen small enough for one CPU: at 64 x 48
pixels and width 64 there are 139,825 parameters, 152,691 with situations.

``ActorCritic`` normalizes the numbers of an observation by their running mean and deviation. Images are cut into
squares and go through dense layers, after distances have become nearness. Its memory is a gated recurrent unit. An
encoder, one of ``ENCODERS`` or the user's own, may take the place of all before the memory.

[50] A. Pokle et al., "Deep Local Trajectory Replanning and Control for Robot Navigation", ICRA 2019.
"""

import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import linen as nn
from flax import struct
from flax.typing import VariableDict
from jaxtyping import Bool, Float, UInt16

from sean_jax.config import MAX_PIXELS, METHODS
from sean_jax.core import user_calls
from sean_jax.core.data_types import Array
from sean_jax.core.errors import FileError, InputError
from sean_jax.io import files
from sean_jax.learning.dataset import Keys, Names, Side
from sean_jax.learning.examples import MILLIMETRES, SECONDS
from sean_jax.mdp import observations
from sean_jax.mdp.spaces import Box

CONFIG = "config.json"  # the configuration of a network, in the folder of its checkpoints


class NetworkConfig(Keys):
    """The content of config.json."""

    width: Side  # of encodings and hidden layers
    flags: bool  # whether the situations are an input
    image: tuple[Side, Side]  # pixels, height and width of a depth image
    situations: Names


def read_network_config(path: Path) -> NetworkConfig:
    """The configuration of a trained network.

    Raises:
        FileError: the file cannot be read or used.
    """

    def check_size(config: NetworkConfig) -> Iterator[files.Problem]:
        if config.image[0] * config.image[1] > MAX_PIXELS:
            yield ("image",), f"has more than {MAX_PIXELS:,} pixels"

    return files.check_json(path, files.read_json(path), NetworkConfig, check_size)


def named_leaves(tree: Any) -> dict[str, Any]:
    """The leaves of a pytree by their paths, such as statistics/mean."""
    leaves, _ = jax.tree.flatten_with_path(tree)
    return {jax.tree_util.keystr(path, simple=True, separator="/"): leaf for path, leaf in leaves}


def read_method(folder: Path) -> str:
    """The method of a folder of ``sean train``; imitation without an entry in its config.json.

    Raises:
        FileError: its config.json cannot be read, or names a method that is none.
    """
    path = folder / CONFIG
    if not path.is_file():
        return "imitation"
    data = files.read_json(path)
    method = data.get("method", "imitation") if isinstance(data, dict) else "imitation"
    if method not in METHODS:
        raise FileError(f"{path}: method: {str(method)[:40]!r} is not one of {', '.join(METHODS)}.")
    return method


PATCHES = ((4, 32), (2, 64), (2, 64))  # side of the squares that each layer merges, and its features


# ------------------------------------------------------------------ imitation


@struct.dataclass
class Decision:
    """The network's output and the attention behind it."""

    local_plan: Array  # (5, 2) m, where the robot should be in 1 to 5 s, in its frame
    command: Array  # (2,) m/s, rad/s; from ``Network`` itself, in units of ``Weights.scale``
    planner_attention: Array  # (2,) or (3,) shares of image, global plan and, with flags, situations
    controller_attention: Array  # (3,) or (4,) shares of image, local plan, global plan and, with flags, situations


@struct.dataclass
class Weights:
    """The variables of a training."""

    parameters: VariableDict  # of the network
    scale: Array  # (2,) m/s, rad/s: the unit of the network's commands


class Network(nn.Module):
    """The network for one example; ``vmap`` its ``apply`` for a batch. Networks of equal sizes are equal values, so
    compiled programs are reused.
    """

    width: int = 64  # of encodings and hidden layers
    flags: bool = False  # whether the situations are an input
    image: tuple[int, int] = (48, 64)  # pixels, height and width of a depth image

    @property
    def planner_sources(self) -> tuple[str, ...]:
        """Names of the shares in ``Decision.planner_attention``."""
        return ("image", "global_plan", *(("situations",) if self.flags else ()))

    @property
    def controller_sources(self) -> tuple[str, ...]:
        """Names of the shares in ``Decision.controller_attention``."""
        return ("image", "local_plan", "global_plan", *(("situations",) if self.flags else ()))

    def setup(self) -> None:
        """Make the layers. Their names are the names of parameters in checkpoints."""
        self.merges = [nn.Dense(features) for _, features in PATCHES]
        self.seen = nn.Dense(self.width)
        self.image_encoder = Perceptron(self.width, self.width)
        self.plan_encoder = Perceptron(self.width, self.width)
        self.local_encoder = Perceptron(self.width, self.width)
        self.flag_encoder = Perceptron(self.width, self.width)
        self.planner_attention = Attention(len(self.planner_sources))
        self.controller_attention = Attention(len(self.controller_sources))
        self.planner = Perceptron(self.width, 2 * SECONDS)
        self.controller = Perceptron(self.width, 2)

    def encode(self, image: UInt16[Array, "*batch H W"]) -> Float[Array, "*batch F"]:
        """Encodings of depth images (..., H, W) uint16 mm; a policy keeps them, so each image is encoded once."""
        nearness = 1.0 / (1.0 + image.astype(jnp.float32) / MILLIMETRES)  # near things matter most
        values = nearness[..., None]
        for (side, _), merge in zip(PATCHES, self.merges, strict=True):
            values = nn.relu(merge(squares(values, side)))
        return nn.relu(self.seen(values.reshape(*image.shape[:-2], -1)))

    def act(self, encodings: Float[Array, "5 F"], plan: Float[Array, "10 2"], situations: Bool[Array, "S"]) -> Decision:
        """The decision, with the command in units of ``Weights.scale``.

        Args:
            encodings: (5, F) of the images of 4, 3, 2, 1 and 0 s ago.
            plan: (10, 2) m, global plan in the robot's frame.
            situations: (S,) which social situations occur; ignored without ``flags``.
        """
        image, ahead = self.image_encoder(encodings.reshape(-1)), self.plan_encoder(plan.reshape(-1))
        flags = [self.flag_encoder(situations.astype(jnp.float32))] if self.flags else []
        context, planner_attention = self.planner_attention(jnp.stack([image, ahead, *flags]))
        local_plan = self.planner(nn.relu(context)).reshape(SECONDS, 2)
        local = self.local_encoder(local_plan.reshape(-1))
        context, controller_attention = self.controller_attention(jnp.stack([image, local, ahead, *flags]))
        return Decision(local_plan, self.controller(nn.relu(context)), planner_attention, controller_attention)

    def __call__(
        self, images: UInt16[Array, "5 H W"], plan: Float[Array, "10 2"], situations: Bool[Array, "S"]
    ) -> Decision:
        """``act`` on images (5, H, W) uint16 mm, oldest first."""
        return self.act(self.encode(images), plan, situations)


def squares(values: Float[Array, "*batch H W C"], side: int) -> Float[Array, "*batch rows columns features"]:
    """Images cut into squares of ``side`` pixels, filled up with zeros at the far edges:
    (..., ceil(H / side), ceil(W / side), side * side * C).

    A dense layer over the squares is a convolution without overlap, as a product of matrices. Inside a scan, such as an
    epoch, convolutions ran 5 times slower on a CPU for small images, and an epoch of larger ones took minutes.
    """
    *lead, height, width, channels = values.shape
    rows, columns = -(-height // side), -(-width // side)
    spare = [(0, 0)] * len(lead) + [(0, rows * side - height), (0, columns * side - width), (0, 0)]
    parts = jnp.pad(values, spare).reshape(*lead, rows, side, columns, side, channels)
    return jnp.moveaxis(parts, -4, -3).reshape(*lead, rows, columns, side * side * channels)


class Perceptron(nn.Module):
    """One hidden layer and a linear output."""

    width: int
    size: int

    @nn.compact
    def __call__(self, values: Float[Array, "K"]) -> Float[Array, "size"]:
        """The output (size,) of values (K,)."""
        return nn.Dense(self.size)(nn.relu(nn.Dense(self.width)(values)))


class Attention(nn.Module):
    """Soft attention: shares that sum to 1 and depend on all encodings. Layer normalization brings these to one length,
    so that a share is the part of the sum from its source.
    """

    sources: int

    @nn.compact
    def __call__(self, encodings: Float[Array, "K F"]) -> tuple[Float[Array, "F"], Float[Array, "K"]]:
        """The weighted sum (F,) of encodings (K, F), and the shares (K,)."""
        normalized = nn.LayerNorm()(encodings)
        hidden = nn.tanh(nn.Dense(encodings.shape[-1])(normalized.reshape(-1)))
        shares = nn.softmax(nn.Dense(self.sources)(hidden))
        return shares @ normalized, shares


def init_weights(network: Network, situations: int, key: Array) -> Weights:
    """Weights before training, with a scale of 1."""
    shapes = (
        ((SECONDS, *network.image), jnp.uint16),
        ((observations.PLAN_POINTS, 2), jnp.float32),
        ((situations,), bool),
    )
    parameters = network.init(key, *(jnp.zeros(*shape) for shape in shapes))
    return Weights(parameters, jnp.ones(2, jnp.float32))


def read_network(folder: Path, situations: list[str]) -> tuple[Network, int]:
    """The network of a training in a folder, without its weights, and the number of situations of its training.

    Raises:
        InputError: there is none, or its input is the flags of other situations than these.
    """
    if not os.path.lexists(folder / CONFIG):
        raise InputError(f"{folder} has no trained network; make one with `sean train imitation`.")
    config = read_network_config(folder / CONFIG)
    network = Network(config.width, config.flags, config.image)
    if network.flags and situations != config.situations:
        here = ", ".join(situations)
        raise InputError(f"the network of {folder} knows other situations than {here}; give make the same situations.")
    return network, len(config.situations)


CLIP = 10.0  # deviations, at which normalized numbers are clipped
INITIAL_LOG_STD = -0.7  # of actions from -1 to 1
FAR_LOCATION = 4.0  # tanh of it is 0.9993: nearer to 1, 32 bits do not tell actions apart
MAX_ACTION = 1.0 - 1e-6  # of squashed actions
NODES, NODE_WEIGHTS = np.polynomial.hermite_e.hermegauss(16)  # of an integral over a normal distribution
EMBEDDING, HEADS = 64, 4  # of attention over people
CONVOLUTIONS = ((5, 16), (3, 32), (3, 32), (3, 32))  # side of the kernel, and features of each, at a stride of 2


# ------------------------------------------------------------------ reinforcement learning


class NetworkOutput(NamedTuple):
    """The output of the actor and the critic."""

    mean: Float[Array, "*batch 2"]  # of the action; of squashed actions the median
    log_std: Float[Array, "*batch 2"]  # of the action; of squashed actions before tanh
    value: Float[Array, "*batch"]  # expected return
    memory: Float[Array, "*batch M"]  # for the next step; M = 0 without a memory
    location: Float[Array, "*batch 2"] | None = None  # mean of squashed actions before tanh; None: they are Gaussian


class ActorCritic(nn.Module):
    """An actor and a critic. Networks of equal sizes are equal values, so compiled programs are reused."""

    width: int = 256  # of hidden layers
    layers: int = 2
    images: tuple[str, ...] = ()  # names of the parts of the observation that are images
    recurrent: bool = False
    private: int = 0  # numbers at the end of the vector, for the critic alone
    bfloat16: bool = False  # of images
    squashed: bool = False  # whether actions are tanh of a Gaussian
    encoder: nn.Module | None = None  # dict of one observation -> features; None: numbers, and squares of images
    parts: tuple[tuple[str, tuple[int, ...]], ...] = ()  # name and shape of each part of the vector, for an encoder
    raw: tuple[str, ...] = ()  # names of parts that an encoder gets without normalization

    @property
    def memory_size(self) -> int:
        """Numbers that the network remembers."""
        return self.width if self.recurrent else 0

    @property
    def image_dtype(self) -> Any:
        """The type of stored and encoded images."""
        return jnp.bfloat16 if self.bfloat16 else jnp.float32

    @nn.compact
    def __call__(
        self,
        vector: Float[Array, "*batch F"],
        images: dict[str, Array],
        memory: Float[Array, "*batch M"],
        start: Bool[Array, "*batch"],
    ) -> NetworkOutput:
        """The output for observations.

        Args:
            vector: (..., F) normalized numbers; the last ``private`` ones are for the critic alone.
            images: name -> (..., H, W) m, or (..., H, W, C).
            start: (...) whether an episode begins here, which clears the memory.
        """
        shared = vector.shape[-1] - self.private
        vector, private = vector[..., :shared], vector[..., shared:]
        if self.encoder is None:
            seen = [_Images(self.width, self.image_dtype)(images[name]) for name in self.images]
            features = jnp.concatenate([vector, *seen], -1)
        else:
            features = self._encode(self.encoder, vector, images)
        if self.recurrent:
            memory = jnp.where(start[..., None], 0.0, memory)
            features = nn.tanh(_dense(self.width)(features))
            memory, features = nn.GRUCell(self.width)(memory, features)
        actor, critic = features, jnp.concatenate([features, private], -1)
        for _ in range(self.layers):
            actor, critic = nn.tanh(_dense(self.width)(actor)), nn.tanh(_dense(self.width)(critic))
        mean, value = _dense(2, 0.01)(actor), _dense(1, 1.0)(critic)
        start_value = nn.initializers.constant(INITIAL_LOG_STD)
        log_std = jnp.broadcast_to(self.param("log_std", start_value, (2,)), mean.shape)
        if not self.squashed:
            return NetworkOutput(mean, log_std, value[..., 0], memory)
        location = FAR_LOCATION * nn.tanh(mean / FAR_LOCATION)
        return NetworkOutput(nn.tanh(location), log_std, value[..., 0], memory, location)

    def _encode(self, encoder: nn.Module, vector: Array, images: dict[str, Array]) -> Array:
        """Features (..., K) of the actor's part of the vector and of images; the encoder sees one observation."""
        lead = vector.shape[:-1]
        sizes = np.cumsum([np.prod(shape, dtype=int) for _, shape in self.parts])
        numbers = jnp.split(vector, sizes[:-1], -1)
        seen = {name: part.reshape(-1, *shape) for (name, shape), part in zip(self.parts, numbers, strict=True)}
        for name in self.images:
            seen[name] = images[name].astype(jnp.float32).reshape(-1, *images[name].shape[len(lead) :])
        each = nn.vmap(_call, variable_axes={"params": None}, split_rngs={"params": False})
        return each(encoder, seen).reshape(*lead, -1)


class _Images(nn.Module):
    """(..., H, W) m or (..., H, W, C) to (..., width)."""

    width: int
    dtype: Any

    @nn.compact
    def __call__(self, image: Array) -> Array:
        values = _nearness(image)
        for side, features in PATCHES:
            values = nn.relu(_dense(features, dtype=self.dtype)(squares(values, side)))
        return nn.relu(_dense(self.width, dtype=self.dtype)(values.reshape(*values.shape[:-3], -1))).astype(jnp.float32)


def _call(encoder: nn.Module, observation: dict[str, Array]) -> Array:
    call: Callable = encoder
    return call(observation)


class AttentionEncoder(nn.Module):
    """The numbers, squares of images, and people: of all who are present, weighted by attention, so that their order
    and number do not matter. The other numbers ask.

    Source: C. Chen et al., "Crowd-robot interaction: crowd-aware robot navigation with attention-based deep
    reinforcement learning", ICRA 2019.
    """

    width: int  # of images
    images: tuple[str, ...]
    people: tuple[str, ...]  # names of parts with rows of people
    dtype: Any  # of images

    @nn.compact
    def __call__(self, observation: dict[str, Array]) -> Float[Array, "F"]:
        """The features of one observation."""
        others = [name for name in observation if name not in (*self.people, *self.images)]
        query = jnp.concatenate([observation[name].reshape(-1) for name in others])
        crowds = []
        for name in self.people:
            *earlier, _, columns = observation[name].shape  # readings of other times, attended to each by itself
            axes: Any = (0, None)
            each = nn.vmap(_attend, in_axes=axes, variable_axes={"params": None}, split_rngs={"params": False})
            rows = observation[name].reshape(-1, observation[name].shape[-2], columns)
            crowds.append(each(PeopleAttention(), rows, query).reshape(-1))
        seen = [_Images(self.width, self.dtype)(observation[name].astype(self.dtype)) for name in self.images]
        return jnp.concatenate([query, *crowds, *seen])


class PeopleAttention(nn.Module):
    """Attention of several heads over people, whose last column is 1 if there is one."""

    @nn.compact
    def __call__(self, rows: Float[Array, "N C"], query: Float[Array, "F"]) -> Float[Array, "E"]:
        """(EMBEDDING,), 0 if nobody is present. Absent people have no effect, whatever their numbers are."""
        present = rows[:, -1] > 0.5
        hidden = jnp.where(present[:, None], rows, 0.0) / observations.REACH
        for _ in range(2):
            hidden = nn.relu(_dense(EMBEDDING)(hidden))
        heads = HEADS, EMBEDDING // HEADS
        keys, values = (_dense(EMBEDDING, 1.0)(hidden).reshape(-1, *heads) for _ in range(2))
        queries = _dense(EMBEDDING, 1.0)(query).reshape(1, *heads)
        scores = jnp.where(present[:, None], (keys * queries).sum(-1) / math.sqrt(heads[1]), -jnp.inf)  # (N, HEADS)
        anybody = present.any()
        shares = nn.softmax(jnp.where(anybody, scores, 0.0), 0)
        return jnp.where(anybody, (shares[..., None] * values).sum(0), 0.0).reshape(-1)


def _attend(attention: PeopleAttention, rows: Array, query: Array) -> Array:
    return attention(rows, query)


class ConvEncoder(nn.Module):
    """The numbers, and images through strided convolutions."""

    width: int  # of the encoding of an image
    images: tuple[str, ...]
    dtype: Any  # of images

    @nn.compact
    def __call__(self, observation: dict[str, Array]) -> Float[Array, "F"]:
        """The features of one observation."""
        features = [part.reshape(-1) for name, part in observation.items() if name not in self.images]
        for name in self.images:
            values = _nearness(observation[name].astype(self.dtype))
            for side, channels in CONVOLUTIONS:
                start = nn.initializers.orthogonal(np.sqrt(2.0))
                values = nn.Conv(channels, (side, side), strides=2, dtype=self.dtype, kernel_init=start)(values)
                values = nn.relu(values)
            features.append(nn.relu(_dense(self.width, dtype=self.dtype)(values.reshape(-1))).astype(jnp.float32))
        return jnp.concatenate(features)


NETWORKS: dict[str, Callable[..., nn.Module] | None] = {
    "mlp": None,
    "attention": AttentionEncoder,
    "conv": lambda width, images, people, dtype: ConvEncoder(width, images, dtype),
}
"""name -> encoder of (width, names of images, names of people, type of images); None: the network's own"""


class _Checked(NamedTuple):
    """The call of a user's encoder, for sentences about its mistakes."""

    function: nn.Module

    def __call__(self, observation: dict[str, Array]) -> tuple[Array, VariableDict]:
        return self.function.init_with_output(jax.random.key(0), observation)  # pyright: ignore


def check_encoder(encoder: nn.Module, observation: dict[str, tuple[int, ...]]) -> None:
    """Refuse an encoder of the user's own that does not take an observation of these shapes, or gives no features.

    Raises:
        PartError: in one sentence with its class, file and line.
    """

    def check(observation: dict[str, Array]) -> None:
        result, variables = user_calls.call("network", _Checked(encoder), "observation", observation)
        actual, expected = user_calls.describe(result), "float32 (features,)"
        if not (isinstance(result, jax.Array) and result.ndim == 1 and result.dtype == jnp.float32):
            cure = "give the features of one observation, as by x.reshape(-1); the trainer adds batch and outputs"
            raise user_calls.wrong("network", encoder, actual, expected, cure)
        if others := sorted(variables.keys() - {"params"}):
            cure = "leave out layers with a state, such as BatchNorm"
            raise user_calls.wrong("network", encoder, f"{', '.join(others)}", "parameters alone", cure)

    jax.eval_shape(check, {name: jax.ShapeDtypeStruct(shape, jnp.float32) for name, shape in observation.items()})


def _nearness(image: Array) -> Array:
    """Distances (..., H, W) m as (..., H, W, 1), 1 for near, since near things matter most; colors as they are."""
    return 1.0 / (1.0 + image[..., None]) if image.shape[-1] > 4 else image


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
    """The variables of a training."""

    parameters: VariableDict
    statistics: Statistics


def init_agent(network: ActorCritic, terms: observations.Terms, space: dict[str, Box], key: Array) -> Agent:
    """The agent before training."""
    empty = {name: jnp.zeros(box.shape, jnp.float32) for name, box in space.items()}
    vector = observations.flatten(terms, empty).astype(jnp.float32)
    start = jnp.ones((), bool)
    memory = jnp.zeros(network.memory_size, jnp.float32)
    parameters = network.init(key, vector, {name: empty[name] for name in network.images}, memory, start)
    return Agent(parameters, init_statistics(vector))


def init_statistics(vector: Float[Array, "F"]) -> Statistics:
    """Statistics before the first vector."""
    return Statistics(jnp.zeros_like(vector), jnp.ones_like(vector), jnp.full((), 1e-4, jnp.float32))


def init_agents(network: ActorCritic, terms: observations.Terms, space: dict[str, Box], keys: Array) -> Agent:
    """Agents (A, ...) before training, of keys (A,), one after another.

    Under ``vmap`` their orthogonal matrices would be factorized in batches, and on a CPU of two cores jaxlib deadlocks
    when two batches of factorizations run at once.
    """
    return jax.lax.map(lambda key: init_agent(network, terms, space, key), keys)


def with_noise(agent: Agent, deviation: float) -> Agent:
    """The agent with another standard deviation of its actions, which are from -1 to 1."""
    inner = dict(agent.parameters["params"])
    inner["log_std"] = jnp.full_like(inner["log_std"], np.log(deviation))
    return Agent({**agent.parameters, "params": inner}, agent.statistics)


def owners(parameters: VariableDict) -> VariableDict:
    """Of each parameter "critic" if the value alone depends on it, else "actor": also of what both share."""
    first = int("GRUCell_0" in parameters["params"])  # dense layers before the two trunks, whose layers alternate

    def owner(path: tuple, _: Any) -> str:
        kind, _, number = path[1].key.rpartition("_")
        return "critic" if kind == "Dense" and int(number) >= first and (int(number) - first) % 2 else "actor"

    return jax.tree_util.tree_map_with_path(owner, parameters)


def scale_value(parameters: VariableDict, factor: Float[Array, ""]) -> VariableDict:
    """The parameters of a network whose value is that many times as large, by its last layer."""
    layers = dict(parameters["params"])
    last = max((name for name in layers if name.startswith("Dense_")), key=lambda name: int(name[6:]))
    layers[last] = jax.tree.map(lambda leaf: factor * leaf, layers[last])
    return {**parameters, "params": layers}


def apply(
    network: ActorCritic,
    agent: Agent,
    vector: Float[Array, "*batch F"],
    images: dict[str, Array],
    memory: Float[Array, "*batch M"],
    start: Bool[Array, "*batch"],
) -> NetworkOutput:
    """The network's output for vectors (..., F) of ``observations.flatten``, normalized by the agent's statistics, and
    images.
    """
    mean, variance = (jnp.broadcast_to(row, vector.shape) for row in (agent.statistics.mean, agent.statistics.variance))
    scaled = jnp.clip((vector - mean) * jax.lax.rsqrt(variance + 1e-8), -CLIP, CLIP)
    if network.raw:
        own = [np.full(np.prod(shape, dtype=int), name in network.raw) for name, shape in network.parts]
        scaled = jnp.where(np.concatenate([*own, np.zeros(network.private, bool)]), vector, scaled)
    call: Callable = network.apply
    return call(agent.parameters, scaled, images, memory, start)


def update_statistics(before: Statistics, vectors: Float[Array, "*batch F"]) -> Statistics:
    """Statistics with further observations.

    Source: T. Chan et al., "Updating formulae and a pairwise algorithm for computing sample variances", 1979.
    """
    batch = tuple(range(vectors.ndim - 1))  # not flattened, which would collect what several devices share
    number = jnp.asarray(math.prod(vectors.shape[:-1]), jnp.float32)
    mean, variance = vectors.mean(batch), vectors.var(batch)
    total = before.count + number
    gap = mean - before.mean
    squares_sum = before.variance * before.count + variance * number + gap * gap * before.count * number / total
    return Statistics(before.mean + gap * number / total, squares_sum / total, total)


def draw_action(output: NetworkOutput, key: Array) -> Float[Array, "*batch 2"]:
    """An action with its noise."""
    noise = jax.random.normal(key, output.mean.shape, output.mean.dtype)
    if output.location is None:
        return output.mean + jnp.exp(output.log_std) * noise
    return jnp.clip(jnp.tanh(output.location + jnp.exp(output.log_std) * noise), -MAX_ACTION, MAX_ACTION)


def log_density(output: NetworkOutput, action: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
    """Logarithm of the density with which an action is taken.

    Source, of squashed actions: T. Haarnoja et al., "Soft actor-critic", ICML 2018, appendix C.
    """
    center, wide = output.mean, jnp.zeros_like(action)
    if output.location is not None:
        action = jnp.arctanh(jnp.clip(action, -MAX_ACTION, MAX_ACTION))
        center, wide = output.location, _log_slope(action)
    gap = (action - center) * jnp.exp(-output.log_std)
    return -(0.5 * gap * gap + output.log_std + 0.5 * np.log(2.0 * np.pi) + wide).sum(-1)


def entropy(output: NetworkOutput) -> Float[Array, "*batch"]:
    """Entropy of the actions; of squashed ones by Gauss-Hermite quadrature, so it needs no samples."""
    each = output.log_std + 0.5 * np.log(2.0 * np.pi * np.e)
    if output.location is not None:
        nodes, weights = (jnp.asarray(part, each.dtype) for part in (NODES, NODE_WEIGHTS / NODE_WEIGHTS.sum()))
        location, deviation = output.location, jnp.exp(output.log_std)
        slopes = jax.vmap(lambda node: _log_slope(location + node * deviation))(nodes)
        each = each + jnp.tensordot(weights, slopes, 1)
    return each.sum(-1)


def _log_slope(value: Array) -> Array:
    """Logarithm of the derivative of tanh, 1 - tanh(value)^2, finite for all values."""
    return 2.0 * (math.log(2.0) - value - nn.softplus(-2.0 * value))
