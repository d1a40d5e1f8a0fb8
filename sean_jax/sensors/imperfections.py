"""What is wrong with real sensors (section IV-F): noise, drop-outs, latency and a rate below that of control.

Functions on images or scans of any shape; chance comes from a key.
"""

import jax
import jax.numpy as jnp
from flax import struct

from sean_jax import clock
from sean_jax.base import Array


def noise(
    key: Array,
    distance: Array,
    *,
    far: float,
    least: float = 0.0012,
    growth: float = 0.0019,
    start: float = 0.4,
) -> Array:
    """Distances [m] with normal noise whose standard deviation is least + growth (distance - start)2 [m].

    The form and the constants are those that Nguyen, Izadi & Lovell (2012, "Modeling Kinect sensor noise for improved
    3D reconstruction and tracking") measured for a depth camera. ``growth=0`` suits a lidar. What is not seen, which is
    ``far`` [m] away, stays so, and nothing gets farther or nearer than 0.
    """
    deviation = least + growth * jnp.square(distance - start)
    noisy = distance + deviation * jax.random.normal(key, distance.shape, distance.dtype)
    return jnp.where(distance < far, jnp.clip(noisy, 0.0, far), distance)


def drop_outs(key: Array, distance: Array, share: float, lost: Array | float) -> Array:
    """Distances [m] of which a random ``share``, from 0 to 1, is replaced by ``lost`` [m], such as the sensor's far."""
    return jnp.where(jax.random.uniform(key, distance.shape) < share, lost, distance)


@struct.dataclass
class Delay:
    """The last images of a sensor, the newest first: carry it beside the state."""

    images: Array  # (L + 1, ...) of which the last is what the robot knows


def delay(image: Array, steps: int) -> Delay:
    """A delay line of so many steps, filled with the first image. Raises ValueError for less than 0 steps."""
    if steps < 0:
        raise ValueError(f"delay: {steps} steps would show the future; give 0 or more.")
    return Delay(jnp.broadcast_to(image[None], (steps + 1, *image.shape)))


def push(line: Delay, image: Array) -> tuple[Delay, Array]:
    """The line with a new image, and the image that has come through."""
    images = jnp.concatenate([image[None], line.images[:-1]])
    return Delay(images), images[-1]


def due(tick: Array, time_step: float, rate: float) -> Array:
    """() bool: a sensor of ``rate`` [1/s] takes an image at this tick of control, the first of which is 0.

    Where the rate does not divide that of control, an image that is due between two ticks is taken at the second. A
    sensor that is faster than control, such as one of 15 Hz with steps of 0.1 s, is due at each tick and no oftener.
    """
    over, under = clock.per_tick(time_step, rate)
    now = tick % under  # whole turns apart, what is due is the same
    return (tick == 0) | (now * over // under > (now - 1) * over // under)
