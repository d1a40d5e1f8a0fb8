"""The network (section V-C, after [50]): a local planner and a velocity controller, each with soft attention.

Encoders (of 5 depth images, of the global plan and, optionally, of the situations) give vectors of one width. The local
planner attends to them and predicts where the robot will be in 1 to 5 s. Another encoder encodes that plan, and the
controller attends to all encodings and gives the command. The paper states no layer sizes; these were chosen small
enough for one CPU: at 64 x 48 pixels and width 64 there are 139,825 parameters, 152,691 with situations.

[50] A. Pokle et al., "Deep Local Trajectory Replanning and Control for Robot Navigation", ICRA 2019.
"""

import os
from pathlib import Path

import jax.numpy as jnp
from flax import linen as nn
from flax import struct
from flax.typing import VariableDict
from jaxtyping import Bool, Float, UInt16

from sean_jax.base import Array
from sean_jax.errors import FileError, InputError
from sean_jax.learning.examples import MILLIMETRES, POINTS, SECONDS
from sean_jax.learning.manifests import CONFIG, read_network_config

PATCHES = ((4, 32), (2, 64), (2, 64))  # side of the squares that each layer merges, and its features


@struct.dataclass
class Decision:
    """The answer of the network and the attention behind it."""

    local_plan: Array  # (5, 2) m, where the robot should be in 1 to 5 s, in its frame
    command: Array  # (2,) m/s, rad/s; from ``Network`` itself, in units of ``Weights.scale``
    planner_attention: Array  # (2,) or (3,) shares of image, global plan and, with flags, situations
    controller_attention: Array  # (3,) or (4,) shares of image, local plan, global plan and, with flags, situations


@struct.dataclass
class Weights:
    """What a training learns."""

    parameters: VariableDict  # of the network
    scale: Array  # (2,) m/s, rad/s: what a command of 1 from the network means


class Network(nn.Module):
    """The network for one example; ``vmap`` its ``apply`` for a batch.

    Networks of equal sizes are equal values, so compiled programs are reused.
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
        """Make the layers. Their names are those of the parameters in checkpoints."""
        self.merges = [nn.Dense(features) for _, features in PATCHES]
        self.seen = nn.Dense(self.width)
        self.image_encoder = Encoder(self.width)
        self.plan_encoder = Encoder(self.width)
        self.local_encoder = Encoder(self.width)
        self.flag_encoder = Encoder(self.width)
        self.planner_attention = Attention(len(self.planner_sources))
        self.controller_attention = Attention(len(self.controller_sources))
        self.planner = Head(self.width, 2 * SECONDS)
        self.controller = Head(self.width, 2)

    def encode(self, image: UInt16[Array, "*batch H W"]) -> Float[Array, "*batch F"]:
        """Encode depth images. A policy stores the encodings, so that it encodes each image once.

        Args:
            image: (..., H, W) uint16 mm.
        """
        nearness = 1.0 / (1.0 + image.astype(jnp.float32) / MILLIMETRES)  # near things matter most
        values = nearness[..., None]
        for (side, _), merge in zip(PATCHES, self.merges, strict=True):
            values = nn.relu(merge(squares(values, side)))
        return nn.relu(self.seen(values.reshape(*image.shape[:-2], -1)))

    def act(self, encodings: Float[Array, "5 F"], plan: Float[Array, "10 2"], situations: Bool[Array, "S"]) -> Decision:
        """Decide where to go.

        Args:
            encodings: (5, F) of the images of 4, 3, 2, 1 and 0 s ago.
            plan: (10, 2) m, global plan in the robot's frame.
            situations: (S,) which social situations occur; ignored without ``flags``.

        Returns:
            The decision, with the command in units of ``Weights.scale``.
        """
        image, ahead = self.image_encoder(encodings.reshape(-1)), self.plan_encoder(plan.reshape(-1))
        flags = [self.flag_encoder(situations.astype(jnp.float32))] if self.flags else []
        context, planner_attention = self.planner_attention(jnp.stack([image, ahead, *flags]))
        local_plan = self.planner(context).reshape(SECONDS, 2)
        local = self.local_encoder(local_plan.reshape(-1))
        context, controller_attention = self.controller_attention(jnp.stack([image, local, ahead, *flags]))
        return Decision(local_plan, self.controller(context), planner_attention, controller_attention)

    def __call__(
        self, images: UInt16[Array, "5 H W"], plan: Float[Array, "10 2"], situations: Bool[Array, "S"]
    ) -> Decision:
        """Encode the images and decide.

        Args:
            images: (5, H, W) uint16 mm, oldest first.
            plan: as ``act``.
            situations: as ``act``.

        Returns:
            The decision, with the command in units of ``Weights.scale``.
        """
        return self.act(self.encode(images), plan, situations)


def squares(values: Float[Array, "*batch H W C"], side: int) -> Float[Array, "*batch rows columns features"]:
    """Cut images into squares, filled up with zeros at the far edges.

    A dense layer over the squares is a convolution without overlap, as a product of matrices. Inside a scan, such as an
    epoch, convolutions ran 5 times slower on a CPU for small images, and an epoch of larger ones took minutes.

    Args:
        side: of a square, in pixels.

    Returns:
        (..., ceil(H / side), ceil(W / side), side * side * C).
    """
    *lead, height, width, channels = values.shape
    rows, columns = -(-height // side), -(-width // side)
    spare = [(0, 0)] * len(lead) + [(0, rows * side - height), (0, columns * side - width), (0, 0)]
    parts = jnp.pad(values, spare).reshape(*lead, rows, side, columns, side, channels)
    return jnp.moveaxis(parts, -4, -3).reshape(*lead, rows, columns, side * side * channels)


class Encoder(nn.Module):
    """Two layers that map any vector to one of the width."""

    width: int

    @nn.compact
    def __call__(self, values: Float[Array, "K"]) -> Float[Array, "width"]:
        """Encode values (K,). Returns (width,)."""
        return nn.Dense(self.width)(nn.relu(nn.Dense(self.width)(values)))


class Attention(nn.Module):
    """Soft attention: shares that sum to 1 and depend on all encodings.

    Layer normalization brings the encodings to one length, so that a share says how much of the sum comes from its
    source.
    """

    sources: int

    @nn.compact
    def __call__(self, encodings: Float[Array, "K F"]) -> tuple[Float[Array, "F"], Float[Array, "K"]]:
        """Attend to encodings (K, F). Returns their weighted sum (F,) and the shares (K,)."""
        normalized = nn.LayerNorm()(encodings)
        hidden = nn.tanh(nn.Dense(encodings.shape[-1])(normalized.reshape(-1)))
        shares = nn.softmax(nn.Dense(self.sources)(hidden))
        return shares @ normalized, shares


class Head(nn.Module):
    """One hidden layer and a linear output."""

    width: int
    answers: int

    @nn.compact
    def __call__(self, values: Float[Array, "F"]) -> Float[Array, "answers"]:
        """Map values (F,) to the output. Returns (answers,)."""
        return nn.Dense(self.answers)(nn.relu(nn.Dense(self.width)(nn.relu(values))))


def init_weights(network: Network, situations: int, key: Array) -> Weights:
    """Draw the weights before training.

    Args:
        key: () PRNG key.

    Returns:
        Weights with a scale of 1.
    """
    shapes = ((SECONDS, *network.image), jnp.uint16), ((POINTS, 2), jnp.float32), ((situations,), bool)
    parameters = network.init(key, *(jnp.zeros(*shape) for shape in shapes))
    return Weights(parameters, jnp.ones(2, jnp.float32))


def read_network(folder: Path, situations: list[str]) -> tuple[Network, int]:
    """Read what network a training in a folder has made, without its weights.

    Args:
        folder: the folder that ``sean train`` has written.

    Returns:
        The network, and the number of situations of its training.

    Raises:
        InputError: there is none, or its input is the flags of other situations than these.
    """
    if not os.path.lexists(folder / CONFIG):
        raise InputError(f"{folder} has no trained network; make one with `sean train imitation`.")
    try:
        config = read_network_config(folder / CONFIG)
    except FileError as error:
        raise InputError(str(error)) from None
    network = Network(config.width, config.flags, config.image)
    if network.flags and situations != config.situations:
        here = ", ".join(situations)
        raise InputError(f"the network of {folder} knows other situations than {here}; give make the same situations.")
    return network, len(config.situations)
