"""Places for a robot to start from or go to: free, clear of people, and a drawn walk away from another place."""

import jax
import jax.numpy as jnp

from sean_jax import navigation as paths
from sean_jax.base import Array, Pedestrians, Scenario

CANDIDATES = 64
CLEAR = 1.0  # m from the nearest person


def far_place(scenario: Scenario, pedestrians: Pedestrians, other: Array, key: Array) -> Array:
    """(2,) [m] a random free place whose walk to the other place (2,) is, within a cell, as long as
    ``scenario.task_distance`` says.

    Of 64 drawn places, those count that are also 1 m clear of everybody; if none is, the clearest of them that
    can be walked to is taken.
    """
    navigation = scenario.navigation
    draw_key, choice_key = jax.random.split(key)
    index = jax.random.randint(draw_key, (CANDIDATES,), 0, navigation.places.shape[0], jnp.int32)
    spots = navigation.places[index]
    to_other = paths.to_goal(navigation, other)
    walk = jax.vmap(paths.geodesic_roughly, in_axes=(None, 0, None, None))(navigation, spots, other, to_other)
    gaps = spots[:, None, :] - pedestrians.position[None, :, :]
    square = jnp.where(pedestrians.present, (gaps * gaps).sum(-1), jnp.inf).min(axis=1, initial=jnp.inf)
    least, greatest = scenario.task_distance[0], scenario.task_distance[1]
    fits = (walk >= least) & (walk <= greatest) & (square > CLEAR * CLEAR)
    chance = jax.random.uniform(choice_key, (CANDIDATES,), jnp.float32)
    rating = jnp.where(fits, 1.0 + chance, jnp.where(jnp.isfinite(walk), -1.0 / (1.0 + square), -jnp.inf))
    return spots[jnp.argmax(rating)]
