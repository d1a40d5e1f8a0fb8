"""Places for a robot to start from or go to: free, clear of people, and a drawn walk away from another place."""

import jax
import jax.numpy as jnp

from sean_jax import navigation as paths
from sean_jax.base import Array, Pedestrians, Scenario

CANDIDATES = 64
CLEAR = 1.0  # m from the nearest person
DETOUR = 10.0  # how much worse a metre too little or too much to walk is than a metre off the wanted place


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
    square = _to_people(pedestrians, spots)
    least, greatest = scenario.task_distance[0], scenario.task_distance[1]
    fits = (walk >= least) & (walk <= greatest) & (square > CLEAR * CLEAR)
    chance = jax.random.uniform(choice_key, (CANDIDATES,), float)
    rating = jnp.where(fits, 1.0 + chance, jnp.where(jnp.isfinite(walk), -1.0 / (1.0 + square), -jnp.inf))
    return spots[jnp.argmax(rating)]


def choose_pair(
    scenario: Scenario,
    pedestrians: Pedestrians,
    goals: Array,
    starts: Array,
    goal_cost: Array,
    start_cost: Array,
    key: Array,
) -> tuple[Array, Array, Array, Array]:
    """A start (2,) and a goal (2,) [m] of starts (C, 2) and goals (D, 2), then ``to_goal`` (V,) and geodesic () [m].

    Any pair, all with the same chance, of those without a cost whose walk is within ``scenario.task_distance``
    and that are 1 m clear of everybody; if there is none, the pair that costs least of those that can be walked.
    ``goal_cost`` (D,) and ``start_cost`` (C,) are in metres, inf where a robot cannot be.
    """
    navigation = scenario.navigation
    rows = jax.vmap(paths.to_goal, in_axes=(None, 0))(navigation, goals)
    each_start = jax.vmap(paths.geodesic_roughly, in_axes=(None, 0, None, None))
    walk = jax.vmap(each_start, in_axes=(None, None, 0, 0))(navigation, starts, goals, rows)  # (D, C)
    least, greatest = scenario.task_distance[0], scenario.task_distance[1]
    off = jnp.maximum(least - walk, 0.0) + jnp.maximum(walk - greatest, 0.0)
    goal_cost = goal_cost + jnp.maximum(CLEAR - jnp.sqrt(_to_people(pedestrians, goals)), 0.0)
    start_cost = start_cost + jnp.maximum(CLEAR - jnp.sqrt(_to_people(pedestrians, starts)), 0.0)
    cost = jnp.where(jnp.isfinite(walk), DETOUR * off, jnp.inf) + goal_cost[:, None] + start_cost[None, :]
    chance = jax.random.uniform(key, cost.shape, float)
    best = jnp.argmax(jnp.where(cost == 0.0, 1.0 + chance, -cost)).astype(jnp.int32)
    goal, start = best // starts.shape[0], best % starts.shape[0]
    length = paths.geodesic(navigation, starts[start], goals[goal], rows[goal])
    return starts[start], goals[goal], rows[goal], length


def _to_people(pedestrians: Pedestrians, spots: Array) -> Array:
    """(C,) square [m2] of the distance from each of the spots (C, 2) to the nearest person; inf if there is none."""
    gaps = spots[:, None, :] - pedestrians.position[None, :, :]
    return jnp.where(pedestrians.present, (gaps * gaps).sum(-1), jnp.inf).min(axis=1, initial=jnp.inf)
