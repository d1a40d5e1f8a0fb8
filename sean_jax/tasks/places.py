"""Places for a robot to start from or go to: free, clear of people, and a drawn walk away from another place."""

import jax
import jax.numpy as jnp
from jaxtyping import Float

from sean_jax import navigation as paths
from sean_jax.base import Array, PathsToGoal, Pedestrians, Scenario

CANDIDATES = 64
CLEAR = 1.0  # m from the nearest person
DETOUR = 10.0  # how much worse a metre too little or too much to walk is than a metre off the wanted place


def far_place(scenario: Scenario, pedestrians: Pedestrians, other: Float[Array, "2"], key: Array) -> Float[Array, "2"]:
    """A random free place from which the walk to another place is as long as ``scenario.task_distance`` says.

    Of 64 drawn places, those count that are also 1 m clear of everybody. If there is none, as on a large floor with
    a short walk, that one is taken whose walk and clearance are the least off. The length of the walk is right to a
    cell of the navigation.

    Args:
        other: (2,) m, the other place.
    """
    navigation = scenario.navigation
    draw_key, choice_key = jax.random.split(key)
    spots = navigation.places[paths.draw_places(navigation, draw_key, CANDIDATES)]
    to_other = paths.build_paths_to_goal(navigation, other)
    walk = jax.vmap(paths.geodesic_approx, in_axes=(None, 0, None, None))(navigation, spots, other, to_other)
    cost = _off(scenario, walk) + _crowded(pedestrians, spots)
    chance = jax.random.uniform(choice_key, (CANDIDATES,), float)
    return spots[jnp.argmax(jnp.where(cost == 0.0, 1.0 + chance, -cost))]


def choose_pair(
    scenario: Scenario,
    pedestrians: Pedestrians,
    goals: Float[Array, "D 2"],
    starts: Float[Array, "C 2"],
    goal_cost: Float[Array, "D"],
    start_cost: Float[Array, "C"],
    key: Array,
) -> tuple[Float[Array, "2"], Float[Array, "2"], PathsToGoal, Float[Array, ""]]:
    """A start and a goal, drawn from all pairs of candidates that fit.

    A pair fits if it has no cost, its walk is within ``scenario.task_distance``, and both places are 1 m clear of
    everybody. If none fits, the pair of the lowest cost is taken of those that can be walked.

    Args:
        goals: (D, 2) m.
        starts: (C, 2) m.
        goal_cost: (D,) m, inf where a robot cannot be.
        start_cost: (C,) m, likewise.

    Returns:
        Start (2,) m, goal (2,) m, the paths to the goal and the length () m of the shortest one.
    """
    navigation = scenario.navigation
    rows = jax.vmap(paths.build_paths_to_goal, in_axes=(None, 0))(navigation, goals)
    each_start = jax.vmap(paths.geodesic_approx, in_axes=(None, 0, None, None))
    walk = jax.vmap(each_start, in_axes=(None, None, 0, 0))(navigation, starts, goals, rows)  # (D, C)
    goal_cost = goal_cost + _crowded(pedestrians, goals)
    start_cost = start_cost + _crowded(pedestrians, starts)
    cost = _off(scenario, walk) + goal_cost[:, None] + start_cost[None, :]
    chance = jax.random.uniform(key, cost.shape, float)
    best = jnp.argmax(jnp.where(cost == 0.0, 1.0 + chance, -cost)).astype(jnp.int32)
    goal, start = best // starts.shape[0], best % starts.shape[0]
    paths_to_goal = jax.tree.map(lambda leaf: leaf[goal], rows)
    length = paths.geodesic(navigation, starts[start], goals[goal], paths_to_goal)
    return starts[start], goals[goal], paths_to_goal, length


def _off(scenario: Scenario, walk: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """What it costs that walks [m] are too short or too long; inf for one that cannot be walked."""
    lower, upper = scenario.task_distance[0], scenario.task_distance[1]
    reached = jnp.isfinite(walk)
    finite = jnp.where(reached, walk, 0.0)  # where there may be no upper limit either
    off = jnp.maximum(lower - finite, 0.0) + jnp.maximum(finite - upper, 0.0)
    return jnp.where(reached, DETOUR * off, jnp.inf)


def _crowded(pedestrians: Pedestrians, spots: Float[Array, "C 2"]) -> Float[Array, "C"]:
    """(C,) m, by which spots are nearer than ``CLEAR`` to the nearest person."""
    gaps = spots[:, None, :] - pedestrians.position[None, :, :]
    square = jnp.where(pedestrians.present, (gaps * gaps).sum(-1), jnp.inf).min(axis=1, initial=jnp.inf)
    return jnp.maximum(CLEAR - jnp.sqrt(square), 0.0)
