"""Random A-B and Busy A-B Navigation (section IV-E): from one place to another, anywhere or where it is busy."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Float

from sean_jax import navigation as paths
from sean_jax.base import Array, Groups, PathsToGoal, Pedestrians, RobotTask, Scenario
from sean_jax.environment import clearance
from sean_jax.tasks.clusters import busiest
from sean_jax.tasks.places import CANDIDATES, choose_pair
from sean_jax.tasks.task import build_task

RING = 5.0  # m, from the person in the middle of the largest cluster (SEAN 2.0)
SNAP = 1.0  # m, by which a place may be off the ring (SEAN 2.0)
GOALS = 4  # goals that starts are rated for
ROOM = 0.1  # m, to obstacles beside the robot's radius


def random_ab_nav(scenario: Scenario, pedestrians: Pedestrians, groups: Groups, memory: Any, key: Array) -> RobotTask:
    """The robot goes from anywhere to anywhere, as far as ``scenario.task_distance`` asks, with random headings."""
    navigation = scenario.navigation
    draw_key, choice_key, turn_key = jax.random.split(key, 3)
    spots = navigation.places[paths.draw_places(navigation, draw_key, GOALS + CANDIDATES)]
    goals, starts = spots[:GOALS], spots[GOALS:]
    nothing = jnp.zeros(GOALS, float), jnp.zeros(CANDIDATES, float)
    return _task(scenario, choose_pair(scenario, pedestrians, goals, starts, *nothing, choice_key), turn_key)


def busy_ab_nav(scenario: Scenario, pedestrians: Pedestrians, groups: Groups, memory: Any, key: Array) -> RobotTask:
    """The robot starts and ends 5 m around the person in the middle of the largest of three clusters of people.

    Clusters are found by k-means. Where too little of the ring is free, the places nearest to it are taken. With nobody
    there, the ring is around any free place.
    """
    navigation = scenario.navigation
    cluster_key, ring_key, draw_key, goal_key, choice_key, turn_key = jax.random.split(key, 6)
    index = jax.random.randint(draw_key, (CANDIDATES,), 0, navigation.places.shape[0], jnp.int32)
    anywhere = navigation.places[index]
    middle = anywhere[0]
    if pedestrians.present.shape[0]:
        busy = pedestrians.position[busiest(pedestrians.position, pedestrians.present, cluster_key)]
        middle = jnp.where(pedestrians.present.any(), busy, middle)
    share = jax.random.uniform(ring_key, (2, CANDIDATES), float)
    angle, off = 2.0 * jnp.pi * share[0], RING + SNAP * (2.0 * share[1] - 1.0)
    around = middle[None, :] + off[:, None] * jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1)
    spots = jnp.concatenate([around, anywhere])
    gap = spots - middle[None, :]
    cost = jnp.maximum(jnp.abs(jnp.sqrt((gap * gap).sum(-1)) - RING) - SNAP - 1e-4, 0.0)
    free = clearance(scenario.environment, spots) > navigation.radius + ROOM
    cost = jnp.where(free, cost, jnp.inf)
    chance = jax.random.uniform(goal_key, cost.shape, float)
    best = jax.lax.top_k(-cost + 0.01 * chance, GOALS)[1]
    return _task(
        scenario, choose_pair(scenario, pedestrians, spots[best], spots, cost[best], cost, choice_key), turn_key
    )


def _task(
    scenario: Scenario,
    pair: tuple[Float[Array, "2"], Float[Array, "2"], PathsToGoal, Float[Array, ""]],
    key: Array,
) -> RobotTask:
    """The task of a chosen pair, with random headings."""
    start, goal, paths_to_goal, geodesic = pair
    angle = jax.random.uniform(key, (2,), float, 0.0, 2 * jnp.pi)
    heading = jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1)
    return build_task(
        scenario,
        start,
        goal,
        start_heading=heading[0],
        goal_heading=heading[1],
        paths_to_goal=paths_to_goal,
        geodesic=geodesic,
    )
