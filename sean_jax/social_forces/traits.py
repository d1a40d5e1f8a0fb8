"""What differs from person to person (section IV-D): the speed they prefer, the distance they keep from a robot."""

import jax
import jax.numpy as jnp

from sean_jax.base import Array
from sean_jax.social_forces.parameters import Parameters


def draw_traits(parameters: Parameters, key: Array, people: int) -> tuple[Array, Array]:
    """(N,) preferred speeds [m/s], normal and truncated, and (N,) extra distances [m] kept from a moving robot.

    A uniformly drawn factor f of the robot's repulsion A exp(-b / B) [45] is a distance of B ln(f).
    """
    speed_key, robot_key = jax.random.split(key)
    deviation = jnp.maximum(parameters.speed_deviation, 1e-6)
    lower = jnp.minimum((parameters.speed_least - parameters.speed_mean) / deviation, -1e-3)
    upper = jnp.maximum((parameters.speed_greatest - parameters.speed_mean) / deviation, 1e-3)
    normal = jax.random.truncated_normal(speed_key, lower, upper, (people,), float)
    factor = jax.random.uniform(
        robot_key, (people,), float, parameters.robot_factor_least, parameters.robot_factor_greatest
    )
    return parameters.speed_mean + parameters.speed_deviation * normal, parameters.range * jnp.log(factor)
