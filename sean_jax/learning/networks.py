"""The network of agents, an actor and a critic, and its encoders.

``ActorCritic`` normalizes the numbers of an observation by their running mean and deviation. Images are cut into
squares and go through dense layers, after distances have become nearness. Its memory is a gated recurrent unit. An
encoder, one of ``NETWORKS``, ``PlanningEncoder`` or the user's own, may take the place of all before the memory.

``PlanningEncoder`` is the network of imitation (section V-C, after [50]). The paper states no layer sizes; these were
chosen small enough for one CPU: at 64 x 48 pixels and width 64 there are 139,892 parameters, 152,758 with situations.

[50] A. Pokle et al., "Deep Local Trajectory Replanning and Control for Robot Navigation", ICRA 2019.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import linen as nn
from flax import struct
from flax.typing import VariableDict
from jaxtyping import Bool, Float, Int

from sean_jax.config import MAX_PIXELS, METHODS
from sean_jax.core import user_calls
from sean_jax.core.data_types import Array
from sean_jax.core.errors import FileError
from sean_jax.io import files
from sean_jax.learning import examples
from sean_jax.learning.dataset import Keys, Names, Side
from sean_jax.learning.examples import DEPTH_IMAGES, PLAN, SECONDS, SITUATIONS
from sean_jax.mdp import observations
from sean_jax.mdp.spaces import Box

CONFIG = "config.json"  # the configuration of a network, in the folder of its checkpoints


class NetworkConfig(Keys):
    """What config.json says about an agent that imitates, beside the options of its training."""

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


def squares(values: Float[Array, "*batch H W C"], side: int) -> Float[Array, "*batch rows columns features"]:
    """Images cut into squares of ``side`` pixels, filled up with zeros at the far edges:
    (..., ceil(H / side), ceil(W / side), side * side * C).

    A dense layer over the squares is a convolution without overlap, as a product of matrices. Inside a scan, such as an
    epoch, convolutions ran 5 times slower on a CPU for small images, and an epoch of larger ones took minutes.
    """
    *lead, height, width, channels = values.shape
    rows = -(-height // side)
    columns = -(-width // side)
    below = 0, rows * side - height
    beside = 0, columns * side - width
    padded = jnp.pad(values, [(0, 0)] * len(lead) + [below, beside, (0, 0)])

    # The pixels of a square come last.
    parts = padded.reshape(*lead, rows, side, columns, side, channels)
    parts = jnp.moveaxis(parts, -4, -3)
    return parts.reshape(*lead, rows, columns, side * side * channels)


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

    @nn.compact
    def __call__(self, encodings: Float[Array, "K F"]) -> tuple[Float[Array, "F"], Float[Array, "K"]]:
        """The weighted sum (F,) of encodings (K, F), and the shares (K,)."""
        sources, width = encodings.shape
        normalized = nn.LayerNorm()(encodings)  # (K, F)
        hidden = nn.tanh(nn.Dense(width)(normalized.reshape(-1)))
        shares = nn.softmax(nn.Dense(sources)(hidden))  # (K,)
        return shares @ normalized, shares


CLIP = 10.0  # deviations, at which normalized numbers are clipped
INITIAL_LOG_STD = -0.7  # of actions from -1 to 1
FAR_LOCATION = 4.0  # tanh of it is 0.9993: nearer to 1, 32 bits do not tell actions apart
MAX_ACTION = 1.0 - 1e-6  # of squashed actions
NODES, NODE_WEIGHTS = np.polynomial.hermite_e.hermegauss(16)  # of an integral over a normal distribution
EMBEDDING, HEADS = 64, 4  # of attention over people
CONVOLUTIONS = ((5, 16), (3, 32), (3, 32), (3, 32))  # side of the kernel, and features of each, at a stride of 2


# ------------------------------------------------------------------ actor and critic


class NetworkOutput(NamedTuple):
    """The output of the actor and the critic."""

    mean: Float[Array, "*batch 2"]  # of the action; of squashed actions the median
    log_std: Float[Array, "*batch 2"]  # of the action; of squashed actions before tanh
    value: Float[Array, "*batch"]  # expected return
    memory: Float[Array, "*batch M"]  # for the next step; M = 0 without a memory
    location: Float[Array, "*batch 2"] | None = None  # mean of squashed actions before tanh; None: they are Gaussian
    auxiliary: dict[str, Array] = {}  # further outputs of the encoder, such as local_plan (..., 5, 2)


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
        # The encoder sees what the robot sees; the critic's own numbers bypass it.
        shared = vector.shape[-1] - self.private
        vector, private = vector[..., :shared], vector[..., shared:]
        features, auxiliary = self._encode(vector, images)

        if self.recurrent:
            memory = jnp.where(start[..., None], 0.0, memory)
            features = nn.tanh(_dense(self.width)(features))
            memory, features = nn.GRUCell(self.width)(memory, features)

        # The layers of actor and critic alternate, by which ``owners`` tells them apart.
        actor = features
        critic = jnp.concatenate([features, private], -1)
        for _ in range(self.layers):
            actor = nn.tanh(_dense(self.width)(actor))
            critic = nn.tanh(_dense(self.width)(critic))
        mean = _dense(2, 0.01)(actor)
        value = _dense(1, 1.0)(critic)[..., 0]

        initial = nn.initializers.constant(INITIAL_LOG_STD)
        log_std = jnp.broadcast_to(self.param("log_std", initial, (2,)), mean.shape)
        if not self.squashed:
            return NetworkOutput(mean, log_std, value, memory, None, auxiliary)
        location = FAR_LOCATION * nn.tanh(mean / FAR_LOCATION)
        return NetworkOutput(nn.tanh(location), log_std, value, memory, location, auxiliary)

    def _encode(self, vector: Array, images: dict[str, Array]) -> tuple[Array, dict[str, Array]]:
        """Features (..., K) of the actor's part of the vector and of images, and the encoder's further outputs."""
        if self.encoder is None:
            encodings = [_Images(self.width, self.image_dtype)(images[name]) for name in self.images]
            return jnp.concatenate([vector, *encodings], -1), {}

        # The encoder sees one observation, as a dict of its parts.
        lead = vector.shape[:-1]
        sizes = np.cumsum([np.prod(shape, dtype=int) for _, shape in self.parts])
        numbers = jnp.split(vector, sizes[:-1], -1)
        observation = {}
        for (name, shape), part in zip(self.parts, numbers, strict=True):
            observation[name] = part.reshape(-1, *shape)
        for name in self.images:
            image = images[name].astype(jnp.float32)
            observation[name] = image.reshape(-1, *image.shape[len(lead) :])

        encode = nn.vmap(_call, variable_axes={"params": None}, split_rngs={"params": False})
        result = encode(self.encoder, observation)
        features, auxiliary = result if isinstance(result, tuple) else (result, {})
        auxiliary = {name: output.reshape(*lead, *output.shape[1:]) for name, output in auxiliary.items()}
        return features.reshape(*lead, -1), auxiliary


class _Images(nn.Module):
    """(..., H, W) m or (..., H, W, C) to (..., width)."""

    width: int
    dtype: Any

    @nn.compact
    def __call__(self, image: Array) -> Array:
        values = _nearness(image)
        for side, features in PATCHES:
            layer = _dense(features, dtype=self.dtype)
            values = nn.relu(layer(squares(values, side)))
        values = values.reshape(*values.shape[:-3], -1)
        output = _dense(self.width, dtype=self.dtype)(values)
        return nn.relu(output).astype(jnp.float32)


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
            # Readings of other times are attended to each by itself.
            people = observation[name]
            rows = people.reshape(-1, *people.shape[-2:])
            axes: Any = (0, None)
            attend = nn.vmap(_attend, in_axes=axes, variable_axes={"params": None}, split_rngs={"params": False})
            crowds.append(attend(PeopleAttention(), rows, query).reshape(-1))
        encodings = []
        for name in self.images:
            image = observation[name].astype(self.dtype)
            encodings.append(_Images(self.width, self.dtype)(image))
        return jnp.concatenate([query, *crowds, *encodings])


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
        scores = (keys * queries).sum(-1) / math.sqrt(heads[1])  # (N, HEADS)
        scores = jnp.where(present[:, None], scores, -jnp.inf)
        anybody = present.any()
        shares = nn.softmax(jnp.where(anybody, scores, 0.0), 0)
        attended = (shares[..., None] * values).sum(0)  # (HEADS, EMBEDDING // HEADS)
        return jnp.where(anybody, attended, 0.0).reshape(-1)


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
                layer = nn.Conv(channels, (side, side), strides=2, dtype=self.dtype, kernel_init=start)
                values = nn.relu(layer(values))
            output = _dense(self.width, dtype=self.dtype)(values.reshape(-1))
            features.append(nn.relu(output).astype(jnp.float32))
        return jnp.concatenate(features)


class PlanningEncoder(nn.Module):
    """A local planner and the first layers of a velocity controller, with soft attention (section V-C, after [50]).

    Encoders of five depth images, of the global plan and, if they are observed, of the situations give vectors of one
    width. The planner attends to them and predicts where the robot will be in 1 to 5 s. Another encoder encodes that
    plan, and the controller attends to all encodings.
    """

    width: int  # of encodings and hidden layers

    @nn.compact
    def __call__(self, observation: dict[str, Array]) -> tuple[Float[Array, "F"], dict[str, Array]]:
        """The features of one observation; the local plan (5, 2) m, and the shares of attention (K,)."""

        def encode(name: str, values: Array) -> Float[Array, "F"]:
            return Perceptron(self.width, self.width, name=f"{name}_encoder")(values.reshape(-1))

        encodings = _Images(self.width, jnp.float32)(observation[DEPTH_IMAGES])  # (5, F), newest first
        image = encode("image", encodings[::-1])
        plan = encode(PLAN, observation[PLAN])
        situations = [encode(SITUATIONS, observation[SITUATIONS])] if SITUATIONS in observation else []

        # The local plan is a prediction of the robot's places, with a loss of its own.
        context, planner_attention = Attention(name="planner_attention")(jnp.stack([image, plan, *situations]))
        local_plan = Perceptron(self.width, 2 * SECONDS, name="planner")(nn.relu(context)).reshape(SECONDS, 2)

        local = encode("local_plan", local_plan)
        everything = jnp.stack([image, local, plan, *situations])
        context, controller_attention = Attention(name="controller_attention")(everything)
        features = nn.relu(nn.Dense(self.width, name="controller")(nn.relu(context)))
        attention = {"planner_attention": planner_attention, "controller_attention": controller_attention}
        return features, {"local_plan": local_plan, **attention}


def attention_sources(situations: bool) -> dict[str, list[str]]:
    """The names of the shares of planner and controller, with or without the situations as an input."""
    last = [SITUATIONS] if situations else []
    return {"planner": ["image", "global_plan", *last], "controller": ["image", "local_plan", "global_plan", *last]}


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
        actual = user_calls.describe(result)
        expected = "float32 (features,)"
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
    """The variables of a network. The field names are the names in checkpoints and packed agents."""

    parameters: VariableDict
    statistics: Statistics
    command_scale: Float[Array, "2"] | None = None  # m/s, rad/s: the unit of actions; None: the robot's limits


@struct.dataclass
class Best:
    """The agents that did best so far."""

    agent: Agent  # (A, ...)
    value: Float[Array, "A"]  # return in an evaluation, or minus the loss in validation
    update: Int[Array, "A"]  # after which it was


class AgentDescription(NamedTuple):
    """A network and what it observes, from which agents are made."""

    network: ActorCritic
    terms: observations.Terms  # of the actor
    private: observations.Terms  # the critic's further ones
    space: dict[str, Box]  # of both
    has_scale: bool = False  # whether actions have the unit of the agent's demonstrations

    def init(self, key: Array) -> Agent:
        """The agent before training, with a scale of 1."""
        agent = init_agent(self.network, (*self.terms, *self.private), self.space, key)
        return replace(agent, command_scale=jnp.ones(2, jnp.float32)) if self.has_scale else agent


def describe_imitation(config: NetworkConfig, time_step: float) -> AgentDescription:
    """The agent that imitates demonstrations (section V-C), for control steps of ``time_step`` s."""
    terms = examples.observation_terms(config.image, config.flags, time_step)
    shapes = {
        DEPTH_IMAGES: (SECONDS, *config.image),
        PLAN: (observations.PLAN_POINTS, 2),
        SITUATIONS: (len(config.situations),),
    }
    space = {name: Box(term.low, term.high, shapes[name]) for name, term in terms}
    vectors = tuple((name, shapes[name]) for name, term in terms if not term.image)
    network = ActorCritic(
        width=config.width,
        layers=0,  # the encoder has the controller's hidden layer
        images=(DEPTH_IMAGES,),
        encoder=PlanningEncoder(config.width),
        parts=vectors,
        raw=tuple(name for name, _ in vectors),
    )
    return AgentDescription(network, terms, (), space, has_scale=True)


def init_agent(network: ActorCritic, terms: observations.Terms, space: dict[str, Box], key: Array) -> Agent:
    """The agent before training."""
    empty = {name: jnp.zeros(box.shape, jnp.float32) for name, box in space.items()}
    vector = observations.flatten(terms, empty).astype(jnp.float32)
    images = {name: empty[name] for name in network.images}
    memory = jnp.zeros(network.memory_size, jnp.float32)
    parameters = network.init(key, vector, images, memory, jnp.ones((), bool))
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
    layers = dict(agent.parameters["params"])
    layers["log_std"] = jnp.full_like(layers["log_std"], np.log(deviation))
    return replace(agent, parameters={**agent.parameters, "params": layers})


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
    mean = vectors.mean(batch)
    variance = vectors.var(batch)
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
    center = output.mean
    wide = jnp.zeros_like(action)
    if output.location is not None:
        action = jnp.arctanh(jnp.clip(action, -MAX_ACTION, MAX_ACTION))
        center = output.location
        wide = _log_slope(action)
    gap = (action - center) * jnp.exp(-output.log_std)
    return -(0.5 * gap * gap + output.log_std + 0.5 * np.log(2.0 * np.pi) + wide).sum(-1)


def entropy(output: NetworkOutput) -> Float[Array, "*batch"]:
    """Entropy of the actions; of squashed ones by Gauss-Hermite quadrature, so it needs no samples."""
    each = output.log_std + 0.5 * np.log(2.0 * np.pi * np.e)
    if output.location is not None:
        nodes, weights = (jnp.asarray(part, each.dtype) for part in (NODES, NODE_WEIGHTS / NODE_WEIGHTS.sum()))
        location = output.location
        deviation = jnp.exp(output.log_std)
        slopes = jax.vmap(lambda node: _log_slope(location + node * deviation))(nodes)
        each = each + jnp.tensordot(weights, slopes, 1)
    return each.sum(-1)


def _log_slope(value: Array) -> Array:
    """Logarithm of the derivative of tanh, 1 - tanh(value)^2, finite for all values."""
    return 2.0 * (math.log(2.0) - value - nn.softplus(-2.0 * value))
