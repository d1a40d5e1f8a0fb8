"""Tasks with random starts and goals (section IV-E): Join and Leave Group, Random and Busy A-B Navigation.

Starts and goals are free and clear of people, a walk within ``scenario.task_distance`` apart.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from sean_jax.core.data_types import Array, Groups, PathsToGoal, Pedestrians, RobotTask, Scenario
from sean_jax.core.geometry import unit_vectors
from sean_jax.tasks.task import build_task, requires
from sean_jax.world import navigation as paths
from sean_jax.world.environment import clearance

RING = 5.0  # m, from the person in the middle of the largest cluster (SEAN 2.0)
SNAP = 1.0  # m, by which a place may be off the ring (SEAN 2.0)
GOALS = 4  # goals for which starts are rated
ROOM = 0.1  # m, to obstacles in addition to the robot's radius
CANDIDATES = 64
CLUSTERS, ITERATIONS = 3, 10  # of k-means
CLEAR = 1.0  # m from the nearest person
DETOUR = 10.0  # cost of a metre of excess or missing path over a metre of distance from the drawn place


@requires("groups")
def join_group(scenario: Scenario, pedestrians: Pedestrians, groups: Groups, memory: Any, key: Array) -> RobotTask:
    """The robot goes to the open place of a random group, from a random place within ``scenario.task_distance``."""
    group, opening, inward, away, facing = _group_poses(scenario, pedestrians, groups, key)
    return build_task(scenario, away, opening, start_heading=facing, goal_heading=inward, goal_group=group)


@requires("groups")
def leave_group(scenario: Scenario, pedestrians: Pedestrians, groups: Groups, memory: Any, key: Array) -> RobotTask:
    """The robot goes from the open place of a random group to a random place within ``scenario.task_distance``."""
    group, opening, inward, away, facing = _group_poses(scenario, pedestrians, groups, key)
    return build_task(scenario, opening, away, start_heading=inward, goal_heading=facing, start_group=group)


def _group_poses(
    scenario: Scenario, pedestrians: Pedestrians, groups: Groups, key: Array
) -> tuple[Int[Array, ""], Float[Array, "2"], Float[Array, "2"], Float[Array, "2"], Float[Array, "2"]]:
    """A group's index, its opening [m] with the heading into it, and a far place [m] with a random heading."""
    group_key, place_key, turn_key = jax.random.split(key, 3)
    chance = jax.random.uniform(group_key, groups.radius.shape, float)  # (G,)
    chance = jnp.where(groups.present, chance, -1.0)
    group = jnp.argmax(chance).astype(jnp.int32)

    opening = groups.opening[group]
    along_x = jnp.asarray([1.0, 0.0], float)
    inward = unit_vectors(groups.center[group] - opening, along_x)

    angle = jax.random.uniform(turn_key, (), float, 0.0, 2 * jnp.pi)
    away = far_place(scenario, pedestrians, opening, place_key)
    facing = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
    return group, opening, inward, away, facing


def random_ab_nav(scenario: Scenario, pedestrians: Pedestrians, groups: Groups, memory: Any, key: Array) -> RobotTask:
    """The robot goes from anywhere to anywhere within ``scenario.task_distance``, with random headings."""
    navigation = scenario.navigation
    draw_key, choice_key, turn_key = jax.random.split(key, 3)
    drawn = paths.draw_places(navigation, draw_key, GOALS + CANDIDATES)
    spots = navigation.places[drawn]  # (GOALS + CANDIDATES, 2) m
    goals = spots[:GOALS]
    starts = spots[GOALS:]

    no_goal_cost = jnp.zeros(GOALS, float)
    no_start_cost = jnp.zeros(CANDIDATES, float)
    pair = choose_pair(scenario, pedestrians, goals, starts, no_goal_cost, no_start_cost, choice_key)
    return _task(scenario, pair, turn_key)


def busy_ab_nav(scenario: Scenario, pedestrians: Pedestrians, groups: Groups, memory: Any, key: Array) -> RobotTask:
    """The robot starts and ends 5 m around the person in the middle of the largest of three clusters of people.

    Clusters are from k-means. If too little of the ring is free, the robot starts and ends near it. Without people
    the ring is around any free place.
    """
    navigation = scenario.navigation
    cluster_key, ring_key, draw_key, goal_key, choice_key, turn_key = jax.random.split(key, 6)
    drawn = paths.draw_uniform_places(navigation, draw_key, CANDIDATES)
    anywhere = navigation.places[drawn]  # (CANDIDATES, 2) m
    middle = anywhere[0]

    # A crowd of size 0 is known when tracing, one of absent people is not: both leave the random place.
    if pedestrians.present.shape[0]:
        person = busiest(pedestrians.position, pedestrians.present, cluster_key)
        busy = pedestrians.position[person]
        middle = jnp.where(pedestrians.present.any(), busy, middle)

    # Candidates are on the ring and anywhere, as walls or a small floor may leave little of the ring.
    around = _places_on_ring(middle, ring_key)
    spots = jnp.concatenate([around, anywhere])  # (2 * CANDIDATES, 2)
    cost = _cost_off_ring(middle, spots)
    free = clearance(scenario.environment, spots) > navigation.radius + ROOM  # (2 * CANDIDATES,)
    cost = jnp.where(free, cost, jnp.inf)

    # Paths to a goal are costly, so few are rated; noise below a centimetre draws among equals.
    chance = jax.random.uniform(goal_key, cost.shape, float)
    _, best = jax.lax.top_k(-cost + 0.01 * chance, GOALS)  # (GOALS,)
    pair = choose_pair(scenario, pedestrians, spots[best], spots, cost[best], cost, choice_key)
    return _task(scenario, pair, turn_key)


def _places_on_ring(middle: Float[Array, "2"], key: Array) -> Float[Array, "C 2"]:
    """Random places [m] within ``SNAP`` of the ring around a place [m]."""
    share = jax.random.uniform(key, (2, CANDIDATES), float)
    angle = 2.0 * jnp.pi * share[0]
    off_ring = SNAP * (2.0 * share[1] - 1.0)
    radius = RING + off_ring
    direction = jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1)  # (C, 2)
    return middle[None, :] + radius[:, None] * direction


def _cost_off_ring(middle: Float[Array, "2"], spots: Float[Array, "C 2"]) -> Float[Array, "C"]:
    """The distance [m] of places from the ring around a place [m]; 0 within ``SNAP`` of it, as in SEAN 2.0."""
    gap = spots - middle[None, :]  # (C, 2)
    square = (gap * gap).sum(-1)
    distance = jnp.sqrt(square)
    off_ring = jnp.abs(distance - RING)
    return jnp.maximum(off_ring - SNAP - 1e-4, 0.0)  # 1e-4 m is for rounding


def _task(
    scenario: Scenario,
    pair: tuple[Float[Array, "2"], Float[Array, "2"], PathsToGoal, Float[Array, ""]],
    key: Array,
) -> RobotTask:
    """The task of a pair, with random headings."""
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


def far_place(scenario: Scenario, pedestrians: Pedestrians, other: Float[Array, "2"], key: Array) -> Float[Array, "2"]:
    """A random free place [m] from which the walk to another place [m] is within ``scenario.task_distance``.

    It is one of 64 random places and 1 m clear of everybody. If none fits, as on a large floor with a short walk, it is
    the place with the smallest errors of walk and clearance. Lengths of walks have the resolution of the navigation's
    cells.
    """
    navigation = scenario.navigation
    draw_key, choice_key = jax.random.split(key)
    drawn = paths.draw_places(navigation, draw_key, CANDIDATES)
    spots = navigation.places[drawn]  # (CANDIDATES, 2) m

    to_other = paths.build_paths_to_goal(navigation, other)
    over_spots = jax.vmap(paths.geodesic_approx, in_axes=(None, 0, None, None))
    walk = over_spots(navigation, spots, other, to_other)  # (CANDIDATES,) m

    # Of places without a cost any, otherwise the one of the lowest cost.
    cost = _walk_cost(scenario, walk) + _crowded(pedestrians, spots)
    chance = jax.random.uniform(choice_key, (CANDIDATES,), float)
    rating = jnp.where(cost == 0.0, 1.0 + chance, -cost)
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
    """A start [m] and a goal [m] of a random fitting pair of candidates, the paths to the goal and the geodesic [m].

    A pair fits if it has no cost, its walk is within ``scenario.task_distance``, and both places are 1 m clear of
    everybody. If none fits, it is the reachable pair of the lowest cost.

    Args:
        goal_cost: m, inf where a robot cannot be.
        start_cost: m, likewise.
    """
    navigation = scenario.navigation
    rows = jax.vmap(paths.build_paths_to_goal, in_axes=(None, 0))(navigation, goals)
    over_starts = jax.vmap(paths.geodesic_approx, in_axes=(None, 0, None, None))
    walk = jax.vmap(over_starts, in_axes=(None, None, 0, 0))(navigation, starts, goals, rows)  # (D, C)
    goal_cost = goal_cost + _crowded(pedestrians, goals)
    start_cost = start_cost + _crowded(pedestrians, starts)
    walk_cost = _walk_cost(scenario, walk)
    cost = walk_cost + goal_cost[:, None] + start_cost[None, :]

    # Of pairs without a cost any, otherwise the one of the lowest cost.
    chance = jax.random.uniform(key, cost.shape, float)
    rating = jnp.where(cost == 0.0, 1.0 + chance, -cost)
    best = jnp.argmax(rating).astype(jnp.int32)
    goal_index = best // len(starts)
    start_index = best % len(starts)
    paths_to_goal = jax.tree.map(lambda leaf: leaf[goal_index], rows)
    start = starts[start_index]
    goal = goals[goal_index]
    length = paths.geodesic(navigation, start, goal, paths_to_goal)
    return start, goal, paths_to_goal, length


def _walk_cost(scenario: Scenario, walk: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """The cost of walks [m] that are too short or too long; inf if there is no path."""
    lower = scenario.task_distance[0]
    upper = scenario.task_distance[1]
    reachable = jnp.isfinite(walk)
    finite = jnp.where(reachable, walk, 0.0)  # the upper limit may be inf as well
    missing = jnp.maximum(lower - finite, 0.0)
    excess = jnp.maximum(finite - upper, 0.0)
    return jnp.where(reachable, DETOUR * (missing + excess), jnp.inf)


def _crowded(pedestrians: Pedestrians, spots: Float[Array, "C 2"]) -> Float[Array, "C"]:
    """The distance [m] by which spots are nearer than ``CLEAR`` to the nearest person."""
    gaps = spots[:, None, :] - pedestrians.position[None, :, :]  # (C, N, 2)
    square = (gaps * gaps).sum(-1)
    square = jnp.where(pedestrians.present, square, jnp.inf)
    nearest = square.min(axis=1, initial=jnp.inf)
    return jnp.maximum(CLEAR - jnp.sqrt(nearest), 0.0)


def k_means(
    points: Float[Array, "N 2"], counted: Bool[Array, "N"], start: Float[Array, "K 2"]
) -> tuple[Float[Array, "K 2"], Int[Array, "N"]]:
    """Centres [m] of clusters by Lloyd's ``ITERATIONS``, and the labels of their last step, -1 for points not counted.

    Each point is labelled by the nearest centre, the first of equally near ones. Then each centre moves to the mean of
    its points; a centre without points stays. ``start`` [m] are the first centres.
    """

    def iterate(centers: Array, _) -> tuple[Array, None]:
        label = _labels(points, centers)
        member = _is_member(label, len(start)) & counted[:, None]
        size = member.sum(0, dtype=float)  # (K,)
        of_cluster = jnp.where(member[:, :, None], points[:, None, :], 0.0)  # (N, K, 2)
        total = of_cluster.sum(0)
        divisor = jnp.maximum(size, 1.0)
        mean = total / divisor[:, None]
        return jnp.where(size[:, None] > 0.0, mean, centers), None

    before, _ = jax.lax.scan(iterate, start, length=ITERATIONS - 1)
    after, _ = iterate(before, None)
    label = jnp.where(counted, _labels(points, before), -1)
    return after, label


def _is_member(label: Int[Array, "N"], clusters: int) -> Bool[Array, "N K"]:
    """Whether each point is in each cluster."""
    index = jnp.arange(clusters, dtype=jnp.int32)
    return label[:, None] == index[None, :]


def busiest(points: Float[Array, "N 2"], counted: Bool[Array, "N"], key: Array) -> Int[Array, ""]:
    """The medoid of the largest cluster of people: the index of the one with the smallest sum of distances in it.

    The first centres are random people. If nobody is counted, it is any index. Source: section IV-E.
    """
    chance = jax.random.uniform(key, counted.shape, float)
    chance = jnp.where(counted, chance, -1.0)

    # With fewer points than clusters, the last point is the first centre of several, which then stay empty.
    order = jnp.argsort(-chance)
    first = jnp.minimum(jnp.arange(CLUSTERS), len(counted) - 1)
    _, label = k_means(points, counted, points[order[first]])

    # The largest cluster.
    size = _is_member(label, CLUSTERS).sum(0, dtype=jnp.int32)
    largest = jnp.argmax(size).astype(jnp.int32)
    member = label == largest

    # The sum of the distances to its members.
    gaps = points[:, None, :] - points[None, :, :]  # (N, N, 2)
    square = (gaps * gaps).sum(-1)
    distance = jnp.sqrt(square)
    distance = jnp.where(member[None, :], distance, 0.0)
    total = distance.sum(1)
    total = jnp.where(member, total, jnp.inf)
    return jnp.argmin(total).astype(jnp.int32)


def _labels(points: Float[Array, "N 2"], centers: Float[Array, "K 2"]) -> Int[Array, "N"]:
    """The index of the nearest centre of each point."""
    gaps = points[:, None, :] - centers[None, :, :]  # (N, K, 2)
    square = (gaps * gaps).sum(-1)
    return jnp.argmin(square, axis=1).astype(jnp.int32)
