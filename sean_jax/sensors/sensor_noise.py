"""Errors of sensors that measure distances (section IV-F): noise and drop-outs, for images and scans of any shape."""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Float

from sean_jax.core.data_types import Array
from sean_jax.core.devices import to_device


@struct.dataclass
class DistanceErrors:
    """The errors of a sensor that measures distances. All fields are leaves."""

    min_deviation: Float[Array, ""]  # m, of ``sensors.noise``
    growth: Float[Array, ""]  # 1/m, of ``sensors.noise``
    drop_out: Float[Array, ""]  # share of the rays that miss, from 0 to 1


def distance_errors(min_deviation: float = 0.0012, growth: float = 0.0019, drop_out: float = 0.0) -> DistanceErrors:
    """Errors of a depth camera, or with ``growth=0`` of a lidar; the arguments are the fields of ``DistanceErrors``."""
    return DistanceErrors(*to_device((min_deviation, growth, drop_out)))


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

    The result is clipped to 0 and ``far``.

    Args:
        far: m, the range of the sensor. Values at or beyond it are misses and stay as they are.
        min_deviation: m, standard deviation at ``start``.
        growth: 1/m; 0 suits a lidar.
        start: m, where the growth begins.

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
    """Set a random share of the distances to a replacement [m], such as the sensor's ``far``: these rays miss."""
    return jnp.where(jax.random.uniform(key, distance.shape) < share, replacement, distance)
