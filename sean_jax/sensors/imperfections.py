"""Imperfections of real sensors (section IV-F): noise, drop-outs, latency, and a rate below that of control.

The functions take images and scans of any shape.
"""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Bool, Float, Int, Shaped

from sean_jax import clock
from sean_jax.base import Array
from sean_jax.errors import InputError


def noise(
    key: Array,
    distance: Float[Array, "*shape"],
    *,
    far: Float[Array, ""] | float,
    min_deviation: Float[Array, ""] | float = 0.0012,
    growth: Float[Array, ""] | float = 0.0019,
    start: Float[Array, ""] | float = 0.4,
) -> Float[Array, "*shape"]:
    """Add normal noise whose standard deviation is min_deviation + growth (distance - start)².

    Args:
        distance: (...) m, of any shape.
        far: m, the range of the sensor. Values at or beyond it are misses and stay as they are.
        min_deviation: m, standard deviation at ``start``.
        growth: 1/m, how the deviation grows with the square of the distance; 0 suits a lidar.
        start: m, where the growth begins.

    Returns:
        (...) m, from 0 to ``far``.
    Source:
        C. V. Nguyen, S. Izadi & D. Lovell, "Modeling Kinect sensor noise for improved 3D reconstruction and tracking",
        3DIMPVT 2012; the defaults are theirs, for a depth camera.
    """
    deviation = min_deviation + growth * jnp.square(distance - start)
    noisy = distance + deviation * jax.random.normal(key, distance.shape, distance.dtype)
    return jnp.where(distance < far, jnp.clip(noisy, 0.0, far), distance)


def drop_outs(
    key: Array,
    distance: Float[Array, "*shape"],
    share: Float[Array, ""] | float,
    replacement: Float[Array, ""] | float,
) -> Float[Array, "*shape"]:
    """Replace a random share of the distances, as if these rays had missed.

    Args:
        distance: (...) m, of any shape.
        share: from 0 to 1.
        replacement: m, such as the sensor's ``far``.

    Returns:
        (...) m.
    """
    return jnp.where(jax.random.uniform(key, distance.shape) < share, replacement, distance)


@struct.dataclass
class Delay:
    """The last images of a sensor, the newest first. Callers carry it beside the state."""

    images: Shaped[Array, "L *shape"]  # the last one is what the robot has received


def delay(image: Shaped[Array, "*shape"], steps: int) -> Delay:
    """Make a delay line, filled with the first image.

    Args:
        image: (...) of any shape and type.

    Raises:
        InputError: ``steps`` is negative.
    """
    if steps < 0:
        raise InputError(f"delay: {steps} steps would show the future; give 0 or more.")
    return Delay(jnp.broadcast_to(image[None], (steps + 1, *image.shape)))


def push(line: Delay, image: Shaped[Array, "*shape"]) -> tuple[Delay, Shaped[Array, "*shape"]]:
    """Put a new image into a delay line.

    Args:
        image: (...) the newest image.

    Returns:
        The new delay line, and (...) the image that leaves it.
    """
    images = jnp.concatenate([image[None], line.images[:-1]])
    return Delay(images), images[-1]


def due(tick: Int[Array, ""], time_step: float, rate: float) -> Bool[Array, ""]:
    """Whether a sensor with its own rate takes an image at a tick of control.

    The first tick is 0. An image that is due between two ticks is taken at the second. A sensor that is faster than
    control, such as one of 15 Hz with steps of 0.1 s, takes one image at each tick.

    Args:
        time_step: s, of control.
        rate: 1/s, of the sensor.

    Returns:
        () bool.

    Raises:
        InputError: the rate is too low to be counted in ticks.
    """
    over, under = clock.events_per_tick(time_step, rate)
    now = tick % under  # the pattern repeats after that many ticks
    return (tick == 0) | (now * over // under > (now - 1) * over // under)
