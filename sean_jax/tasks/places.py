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

    Of 64 drawn places, those count that are also 1 m clear of everybody. If there is none, the clearest of them that
    can be walked to is taken. The length of the walk is right to a cell of the navigation.

    Args:
        scenario: with the navigation of its robot.
        pedestrians: N people.
        other: (2,) m, the other place.
        key: of the draws.

    Returns:
        (2,) m
    """
    navigation = scenario.navigation
    draw_key, choice_key = jax.random.split(key)
    spots = navigation.places[paths.draw_places(navigation, draw_key, CANDIDATES)]
    to_other = paths.build_paths_to_goal(navigation, other)
    walk = jax.vmap(paths.geodesic_approx, in_axes=(None, 0, None, None))(navigation, spots, other, to_other)
    square = _to_people(pedestrians, spots)
    lower, upper = scenario.task_distance[0], scenario.task_distance[1]
    fits = (walk >= lower) & (walk <= upper) & jnp.isfinite(walk) & (square > CLEAR * CLEAR)
    chance = jax.random.uniform(choice_key, (CANDIDATES,), float)
    rating = jnp.where(fits, 1.0 + chance, jnp.where(jnp.isfinite(walk), -1.0 / (1.0 + square), -jnp.inf))
    return spots[jnp.argmax(rating)]


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
        scenario: with the navigation of its robot.
        pedestrians: N people.
        goals: (D, 2) m.
        starts: (C, 2) m.
        goal_cost: (D,) m, inf where a robot cannot be.
        start_cost: (C,) m, likewise.
        key: of the draw.

    Returns:
        Start (2,) m, goal (2,) m, the paths to the goal and the length () m of the shortest one.
    """
    navigation = scenario.navigation
    rows = jax.vmap(paths.build_paths_to_goal, in_axes=(None, 0))(navigation, goals)
    each_start = jax.vmap(paths.geodesic_approx, in_axes=(None, 0, None, None))
    walk = jax.vmap(each_start, in_axes=(None, None, 0, 0))(navigation, starts, goals, rows)  # (D, C)
    lower, upper = scenario.task_distance[0], scenario.task_distance[1]
    reached = jnp.isfinite(walk)
    finite = jnp.where(reached, walk, 0.0)  # where there may be no upper limit either
    off = jnp.maximum(lower - finite, 0.0) + jnp.maximum(finite - upper, 0.0)
    goal_cost = goal_cost + jnp.maximum(CLEAR - jnp.sqrt(_to_people(pedestrians, goals)), 0.0)
    start_cost = start_cost + jnp.maximum(CLEAR - jnp.sqrt(_to_people(pedestrians, starts)), 0.0)
    cost = jnp.where(reached, DETOUR * off, jnp.inf) + goal_cost[:, None] + start_cost[None, :]
    chance = jax.random.uniform(key, cost.shape, float)
    best = jnp.argmax(jnp.where(cost == 0.0, 1.0 + chance, -cost)).astype(jnp.int32)
    goal, start = best // starts.shape[0], best % starts.shape[0]
    paths_to_goal = jax.tree.map(lambda leaf: leaf[goal], rows)
    length = paths.geodesic(navigation, starts[start], goals[goal], paths_to_goal)
    return starts[start], goals[goal], paths_to_goal, length


def _to_people(pedestrians: Pedestrians, spots: Float[Array, "C 2"]) -> Float[Array, "C"]:
    """(C,) m2, square of the distance from each of the spots to the nearest person; inf if there is none."""
    gaps = spots[:, None, :] - pedestrians.position[None, :, :]
    return jnp.where(pedestrians.present, (gaps * gaps).sum(-1), jnp.inf).min(axis=1, initial=jnp.inf)
