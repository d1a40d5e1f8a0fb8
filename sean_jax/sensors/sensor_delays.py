"""Delays and rates of sensors, for images and scans of any shape."""

import jax.numpy as jnp
from flax import struct
from jaxtyping import Bool, Int, Shaped

from sean_jax.core import clock
from sean_jax.core.data_types import Array
from sean_jax.core.errors import InputError


@struct.dataclass
class Delay:
    """The last images of a sensor, the newest first. Callers carry it beside the state."""

    images: Shaped[Array, "L *shape"]  # the robot has received the last one


def delay(image: Shaped[Array, "*shape"], steps: int) -> Delay:
    """A delay line of some control steps, filled with the first image.

    Raises:
        InputError: ``steps`` is negative.
    """
    if steps < 0:
        raise InputError(f"delay: {steps} steps would show the future; give 0 or more.")
    return Delay(jnp.broadcast_to(image[None], (steps + 1, *image.shape)))


def push(line: Delay, image: Shaped[Array, "*shape"]) -> tuple[Delay, Shaped[Array, "*shape"]]:
    """Put the newest image into a delay line; the new line and the image that leaves it."""
    images = jnp.concatenate([image[None], line.images[:-1]])
    return Delay(images), images[-1]


def due(tick: Int[Array, ""], time_step: float, rate: float) -> Bool[Array, ""]:
    """Whether a sensor with a rate [1/s] takes an image at a tick of control of ``time_step`` [s].

    The first tick is 0. An image that is due between two ticks is taken at the second. A sensor that is faster than
    control, such as one of 15 Hz with steps of 0.1 s, takes one image at each tick.

    Raises:
        InputError: the rate is too low to be counted in ticks.
    """
    images, ticks = clock.events_per_tick(time_step, rate)
    phase = tick % ticks  # the pattern repeats after that many ticks
    return (tick == 0) | (phase * images // ticks > (phase - 1) * images // ticks)
