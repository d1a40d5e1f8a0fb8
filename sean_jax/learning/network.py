"""The network (section V-C, after [50]): a local planner and a velocity controller, each with soft attention.

Three encoders (of 5 depth images, of the global plan and, if wanted, of the situations) give vectors of one width. The
local planner looks at them with attention and predicts where the robot will be in 1 to 5 s. That plan is encoded too,
and the controller looks at all of them, with attention of its own, and gives the command. The paper leaves sizes open;
these were chosen small enough for one CPU: at 64 x 48 pixels and width 64 there are 139,825 parameters, 152,691 with
situations.

[50] A. Pokle et al., "Deep Local Trajectory Replanning and Control for Robot Navigation", ICRA 2019.
"""

import jax.numpy as jnp
from flax import linen as nn
from flax import struct

from sean_jax.base import Array
from sean_jax.learning.examples import SECONDS
from sean_jax.learning.rows import MILLIMETRES

PATCHES = ((4, 32), (2, 64), (2, 64))  # side of the squares that each layer merges, and numbers that it makes of one


@struct.dataclass
class Decision:
    """What the network answers, and where it looked to find it."""

    local_plan: Array  # (5, 2) m, where the robot shall be in 1 to 5 s, in its frame
    command: Array  # (2,) m/s, rad/s; as the network gives it, in units of ``Weights.scale``
    planner_attention: Array  # (2,) or (3,) shares of image, global plan and, if it has them, situations
    controller_attention: Array  # (3,) or (4,) shares of image, local plan, global plan and, if so, situations


class Network(nn.Module):
    """For one example: ``vmap`` its ``apply`` for a batch. Equal networks are equal values, so programs are reused."""

    width: int = 64  # of encodings and hidden layers
    flags: bool = False  # whether it knows the situations
    image: tuple[int, int] = (48, 64)  # height and width of a depth image

    @property
    def planner_sources(self) -> tuple[str, ...]:
        """What the planner's attention is shared among."""
        return ("image", "global_plan", *(("situations",) if self.flags else ()))

    @property
    def controller_sources(self) -> tuple[str, ...]:
        """What the controller's attention is shared among."""
        return ("image", "local_plan", "global_plan", *(("situations",) if self.flags else ()))

    def setup(self) -> None:
        """The parts; linen makes their parameters."""
        self.merges = [nn.Dense(numbers) for _, numbers in PATCHES]
        self.seen = nn.Dense(self.width)
        self.image_encoder = Encoder(self.width)
        self.plan_encoder = Encoder(self.width)
        self.local_encoder = Encoder(self.width)
        self.flag_encoder = Encoder(self.width)
        self.planner_attention = Attention(len(self.planner_sources))
        self.controller_attention = Attention(len(self.controller_sources))
        self.planner = Head(self.width, 2 * SECONDS)
        self.controller = Head(self.width, 2)

    def see(self, image: Array) -> Array:
        """(..., F) what is in a depth image (..., H, W) uint16 mm. A driver keeps these, and sees each image once."""
        near = 1.0 / (1.0 + image.astype(jnp.float32) / MILLIMETRES)  # what is near matters most
        values = near[..., None]
        for (side, _), merge in zip(PATCHES, self.merges, strict=True):
            values = nn.relu(merge(squares(values, side)))
        return nn.relu(self.seen(values.reshape(*image.shape[:-2], -1)))

    def decide(self, seen: Array, plan: Array, situations: Array) -> Decision:
        """The answer for five images as ``see`` gives them (5, F), the plan (10, 2) m and the situations (S,) bool."""
        image, ahead = self.image_encoder(seen.reshape(-1)), self.plan_encoder(plan.reshape(-1))
        known = [self.flag_encoder(situations.astype(jnp.float32))] if self.flags else []
        context, planner_attention = self.planner_attention(jnp.stack([image, ahead, *known]))
        local_plan = self.planner(context).reshape(SECONDS, 2)
        local = self.local_encoder(local_plan.reshape(-1))
        context, controller_attention = self.controller_attention(jnp.stack([image, local, ahead, *known]))
        return Decision(local_plan, self.controller(context), planner_attention, controller_attention)

    def __call__(self, images: Array, plan: Array, situations: Array) -> Decision:
        """The answer for images (5, H, W), as ``decide``."""
        return self.decide(self.see(images), plan, situations)


def squares(values: Array, side: int) -> Array:
    """(..., H / side, W / side, side * side * C) squares of (..., H, W, C), filled up with zeros at the far edges.

    Merging them is a convolution without overlap, as a product of matrices: inside a scan, as an epoch is, convolutions
    ran 5 times slower on a CPU than outside it for small images, and for larger ones an epoch took minutes.
    """
    *lead, height, width, channels = values.shape
    rows, columns = -(-height // side), -(-width // side)
    spare = [(0, 0)] * len(lead) + [(0, rows * side - height), (0, columns * side - width), (0, 0)]
    parts = jnp.pad(values, spare).reshape(*lead, rows, side, columns, side, channels)
    return jnp.moveaxis(parts, -4, -3).reshape(*lead, rows, columns, side * side * channels)


class Encoder(nn.Module):
    """Two layers to a vector of that width."""

    width: int

    @nn.compact
    def __call__(self, values: Array) -> Array:
        """(width,)"""
        return nn.Dense(self.width)(nn.relu(nn.Dense(self.width)(values)))


class Attention(nn.Module):
    """Soft attention: a share of each encoding, all shares together 1, decided by looking at all encodings.

    Encodings are brought to one length before, so that a share says how much of the sum is of that source.
    """

    sources: int

    @nn.compact
    def __call__(self, encodings: Array) -> tuple[Array, Array]:
        """(F,) the weighted sum of the encodings (K, F), and (K,) the shares."""
        even = nn.LayerNorm()(encodings)
        hidden = nn.tanh(nn.Dense(encodings.shape[-1])(even.reshape(-1)))
        shares = nn.softmax(nn.Dense(self.sources)(hidden))
        return shares @ even, shares


class Head(nn.Module):
    """One hidden layer and the answer."""

    width: int
    answers: int

    @nn.compact
    def __call__(self, values: Array) -> Array:
        """(answers,)"""
        return nn.Dense(self.answers)(nn.relu(nn.Dense(self.width)(nn.relu(values))))
