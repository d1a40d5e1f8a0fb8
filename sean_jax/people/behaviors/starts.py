"""Starts of people: the place, free points far enough apart for any choice of them to be valid, and walking groups.

Walking groups (section IV-D) are pairs and triples. The last people of a scenario are its walking groups, pairs before
triples. The member with the lowest index leads: the leader decides where to go, the others follow with the same goal at
the same preferred speed, and ``social_forces.Cohesion`` keeps them side by side.
"""

import itertools
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from scipy.spatial import KDTree

from sean_jax.core.data_types import Array, Environment, Groups, PathsToGoal, Pedestrians, Scenario
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import length, signed_distances_on_host, unit
from sean_jax.core.messages import shorten
from sean_jax.io import cache
from sean_jax.social_forces.forces import components
from sean_jax.world import environment as environments
from sean_jax.world.navigation import CODE, Navigation, build_paths_to_goal, geodesic, inputs, segment_is_free

MIN_DISTANCE = 0.55  # m between two starts: bodies of 0.2 m and some room
TRIES = 40  # candidates for each start that would fit
FLOOR_TRIES = 10  # likewise, where a whole floor is filled
MAX_TRIES = 500_000  # candidates in all
MAX_SPAWN_DISTANCE = 0.9  # m, between the starts of companions
NEAR_LEADER = 1.5  # m, within which people go in the leader's direction ...
MIN_COSINE = 0.5  # ... if their own direction is at most so far off, or they would walk into the leader's corner
MIN_SPEED = 0.2  # m/s, below which no walking group's preferred speed falls


@dataclass(frozen=True)
class Place:
    """The world for which a pedestrian behavior is built: an environment, and the time step."""

    folder: Path  # of the environment, with graph.yaml, handcrafted.yaml and other files of behaviors
    environment: Environment
    navigation: Navigation  # for a person's radius
    time_step: float = 0.1  # s, of control

    @property
    def default_people(self) -> int:
        """The number of people in ``environment.yaml``."""
        return environments.default_people(self.folder)


def no_groups() -> Groups:
    """Empty conversational groups (G = 0)."""
    points = jnp.zeros((0, 2), float)
    return Groups(center=points, radius=jnp.zeros(0, float), opening=points, present=jnp.zeros(0, bool))


def present_people(scenario: Scenario) -> Bool[Array, "N"]:
    """Whether each person is present: the first ``people_present``, or all if that is None."""
    if scenario.people_present is None:
        return jnp.ones(scenario.people, bool)
    return jnp.arange(scenario.people, dtype=jnp.int32) < scenario.people_present


def in_discs(
    environment: Environment,
    navigation: Navigation,
    center: Float[Array, "M 2"],
    radius: Float[Array, "M"],
    chance: Float[Array, "M"],
    avoid: list[tuple[np.ndarray, float]],
) -> tuple[np.ndarray, np.ndarray]:
    """Starts (P, 2) [m] in discs, no two nearer than 0.55 m, by dart throwing on the host; and the disc (P,) of each.

    Uniform candidates are accepted if they are farther from obstacles than the navigation's radius, outside the discs
    to avoid and not too near to another start.

    Args:
        center: m, of the discs.
        radius: m, of the discs.
        chance: of each disc; discs with 0 get no starts.
        avoid: centre (2,) m and radius m of discs without starts.
    """
    boxes = environment.obstacles
    shape = environment.floor, boxes.center, boxes.half_extent, boxes.yaw, navigation.radius
    avoided = np.reshape([np.append(middle, size) for middle, size in avoid], (-1, 3))
    key = *shape, center, radius, chance, avoided
    clearance = float(navigation.radius)

    def draw() -> dict[str, np.ndarray]:
        return _in_discs(environment, clearance, center, radius, chance, avoid)

    code = "people/behaviors/starts", "core/geometry"
    table = cache.load_or_build("starts", code, key, draw)
    return table["start"], table["disc"]


def _in_discs(
    environment: Environment,
    clearance: float,
    center: Array,
    radius: Array,
    chance: Array,
    avoid: list[tuple[np.ndarray, float]],
) -> dict[str, np.ndarray]:
    """The table of ``in_discs``: starts (P, 2) [m] and discs (P,)."""
    generator = np.random.default_rng(0)
    centers = np.asarray(center, float)
    radii = np.asarray(radius, float)
    chances = np.asarray(chance, float)

    # Candidates by the areas of the discs.
    tries = np.ceil(TRIES * radii**2 / MIN_DISTANCE**2).astype(int)  # (M,)
    tries = tries * (chances > 0)
    if tries.sum() > MAX_TRIES:
        share = MAX_TRIES / tries.sum()
        tries = np.ceil(tries * share).astype(int)
    disc = np.repeat(np.arange(len(radii)), tries)  # (C,) of each candidate

    # Uniform over a disc: the square of the distance is.
    distance = radii[disc] * np.sqrt(generator.uniform(size=len(disc)))
    angle = generator.uniform(0, 2 * np.pi, len(disc))
    direction = np.stack([np.cos(angle), np.sin(angle)], -1)
    spots = centers[disc] + distance[:, None] * direction  # (C, 2) m

    free = _is_free(environment, spots, clearance)
    for middle, size in avoid:
        free &= np.linalg.norm(spots - np.asarray(middle, float), axis=-1) > size
    spots = spots[free]
    disc = disc[free]
    chosen = choose_apart(spots, generator)
    return {"start": spots[chosen], "disc": disc[chosen]}


def _is_free(environment: Environment, spots: np.ndarray, clearance: float) -> np.ndarray:
    """(P,) bool: whether each spot (P, 2) [m] is farther than the clearance [m] from obstacles and the floor's edge."""
    to_box, to_edge = signed_distances_on_host(environment, spots)
    return np.minimum(to_box, to_edge) > clearance


def anywhere(environment: Environment, navigation: Navigation, people: int, dense: bool = False) -> np.ndarray:
    """Starts (P, 2) [m] all over the walkable floor, no two nearer than 0.55 m; one a person or more, if they fit.

    The navigation's free places are enough for most numbers of people. For more, the whole floor is filled.
    """
    generator = np.random.default_rng(0)
    spots = np.asarray(navigation.places)
    chosen = choose_apart(spots, generator)
    if len(chosen) >= people and not dense:
        return spots[chosen]

    floor = np.asarray(environment.floor, float)
    lower = floor[:2]
    upper = floor[2:]
    area = np.prod(upper - lower)
    tries = int(FLOOR_TRIES * area / MIN_DISTANCE**2)
    tries = min(tries, MAX_TRIES)
    spots = generator.uniform(lower, upper, (tries, 2)).astype(np.float32)
    free = _is_free(environment, spots, float(navigation.radius))
    spots = spots[free]

    code = *CODE, "people/behaviors/starts"
    key = [*inputs(navigation), spots]
    table = cache.load_or_build("reached", code, key, lambda: {"reachable": _reachable(navigation, spots)})
    spots = spots[table["reachable"]]
    chosen = choose_apart(spots, generator)
    return spots[chosen]


def _reachable(navigation: Navigation, spots: np.ndarray) -> np.ndarray:
    """(P,) bool: whether a path leads from each spot (P, 2) [m] to the navigation's places."""
    goal = navigation.places[0]
    paths_to_goal = build_paths_to_goal(navigation, goal)

    @jax.jit
    def walk(spots: Array, paths_to_goal: PathsToGoal) -> Array:
        return jax.lax.map(lambda spot: geodesic(navigation, spot, goal, paths_to_goal), spots, batch_size=1024)

    lengths = walk(jnp.asarray(spots, float), paths_to_goal)  # (P,) m
    return np.isfinite(np.asarray(lengths))


def choose_apart(spots: np.ndarray, generator: np.random.Generator) -> list[int]:
    """A random, maximal choice of the spots (P, 2) [m] of which no two are nearer than 0.55 m."""
    chosen: list[int] = []
    by_cell: dict[tuple[int, int], list[int]] = {}  # by cell of that size, so that only neighbours are compared
    for index in generator.permutation(len(spots)):
        i, j = np.floor(spots[index] / MIN_DISTANCE).astype(int).tolist()
        neighbors = []
        for cell in itertools.product((i - 1, i, i + 1), (j - 1, j, j + 1)):
            neighbors += by_cell.get(cell, [])
        if neighbors:
            distance = np.linalg.norm(spots[neighbors] - spots[index], axis=-1)
            if distance.min() < MIN_DISTANCE:
                continue
        by_cell.setdefault((i, j), []).append(index)
        chosen.append(index)
    return chosen


class WalkingGroups(NamedTuple):
    """The numbers of walking groups."""

    pairs: int
    triples: int

    @property
    def members(self) -> int:
        """The number of people in walking groups."""
        return 2 * self.pairs + 3 * self.triples

    @property
    def number(self) -> int:
        """The number of groups."""
        return self.pairs + self.triples

    def companions(self, people: int) -> Int[Array, "N 2"] | None:
        """Indices of each person's companions, -1 none; None if everybody walks alone."""
        if not self.number:
            return None

        # The last people: pairs, then triples.
        person = np.arange(people - self.members, people)
        pairs = person[: 2 * self.pairs].reshape(-1, 2)
        triples = person[2 * self.pairs :].reshape(-1, 3)
        table = np.full((people, 2), -1, np.int32)
        for k in range(2):
            table[pairs[:, k], 0] = pairs[:, 1 - k]
        for k in range(3):
            table[triples[:, k]] = np.delete(triples, k, axis=1)
        return jnp.asarray(table)


def count_walking_groups(people: int, shares: tuple[float, float]) -> WalkingGroups:
    """The pairs and triples among so many people, rounded down to whole groups.

    Raises:
        InputError: a share is negative, or they add up to more than 1.
    """
    are_two = isinstance(shares, (tuple, list)) and len(shares) == 2 and all(isinstance(x, Real) for x in shares)
    if not are_two or not (min(shares) >= 0 and sum(shares) <= 1 + 1e-6):
        raise InputError(
            f"walking_groups: {shorten(repr(shares))} must be two shares, each 0 or more, together 1 at most."
        )
    in_pairs, in_triples = shares
    pairs = int(people * in_pairs / 2 + 1e-6)
    triples = int(people * in_triples / 3 + 1e-6)
    return WalkingGroups(pairs, triples)


def find_spawn_clusters(navigation: Navigation, start: np.ndarray, groups: WalkingGroups) -> np.ndarray:
    """Clusters (C, 3) of starts (P, 2) [m] for groups: indices, the second and third near and in sight of the first.

    No start is in two clusters. Without groups no clusters are searched for. Runs on the host.

    Raises:
        InputError: there are fewer clusters than groups.
    """
    clusters = []
    if groups.number:
        clusters = _clusters_of_three(navigation, start)
    if groups.number > len(clusters):
        raise InputError(
            f"walking_groups: {groups.number} do not fit here, {len(clusters)} at most; give smaller shares."
        )
    return np.array(clusters, np.int32).reshape(-1, 3)


def _clusters_of_three(navigation: Navigation, start: np.ndarray) -> list[tuple[int, int, int]]:
    """Disjoint clusters of starts (P, 2) [m] of ``find_spawn_clusters``."""
    neighbors = _neighbors_in_sight(navigation, start)

    def n_neighbors(index: int) -> int:
        return len(neighbors[index])

    clusters = []
    free = np.ones(len(start), bool)
    for first in sorted(range(len(start)), key=n_neighbors):  # few neighbours first, or they would find none free
        free_neighbors = [index for index in neighbors[first] if free[index]]
        companions = sorted(free_neighbors, key=n_neighbors)[:2]
        if free[first] and len(companions) == 2:
            cluster = first, *companions
            free[list(cluster)] = False
            clusters.append(cluster)
    return clusters


def _neighbors_in_sight(navigation: Navigation, start: np.ndarray) -> list[list[int]]:
    """Indices of the starts (P, 2) [m] near and in sight of each start."""
    pairs = KDTree(start).query_pairs(MAX_SPAWN_DISTANCE, output_type="ndarray")  # (K, 2)
    see_each_other = jax.jit(jax.vmap(lambda p, q: segment_is_free(navigation.obstacles, p, q, 0.0)))
    spots = jnp.asarray(start, float)
    first = spots[pairs[:, 0]]
    second = spots[pairs[:, 1]]
    in_sight = np.asarray(see_each_other(first, second))
    neighbors: list[list[int]] = [[] for _ in start]
    for i, j in pairs[in_sight].tolist():
        neighbors[i].append(j)
        neighbors[j].append(i)
    return neighbors


def choose_starts(
    score: Float[Array, "P"], spawn_clusters: Int[Array, "C 3"], walkers: int, groups: WalkingGroups
) -> Int[Array, "N"]:
    """The starts of N = ``walkers`` people with the highest scores; walking groups start at spawn clusters."""
    alone = walkers - groups.members
    if not groups.number:
        _, single = jax.lax.top_k(score, alone)
        return single

    # A cluster has the score of its first start; a pair leaves the third start to others.
    first = spawn_clusters[:, 0]
    first_score = jnp.where(first >= 0, score[first], -jnp.inf)
    _, index = jax.lax.top_k(first_score, groups.number)
    clusters = spawn_clusters[index]  # (groups, 3)
    pairs = clusters[: groups.pairs, :2].ravel()
    triples = clusters[groups.pairs :].ravel()
    grouped = jnp.concatenate([pairs, triples])
    score = score.at[grouped].set(-jnp.inf)
    _, single = jax.lax.top_k(score, alone)
    return jnp.concatenate([single, grouped])


def leaders(companions: Int[Array, "N 2"] | None, people: int) -> Int[Array, "N"]:
    """The index of each person's leader, -1 for single people; ``companions`` as in ``WalkingGroups``."""
    if companions is None:
        return jnp.full(people, -1, jnp.int32)
    person = jnp.arange(people, dtype=jnp.int32)
    exists = companions >= 0  # (N, 2)
    lowest = jnp.where(exists, companions, people).min(1)
    lowest = jnp.minimum(person, lowest)
    return jnp.where(exists.any(1), lowest, -1)


def follow_leaders(walking_group: Int[Array, "N"], *values: Shaped[Array, "N ..."]) -> tuple[Array, ...]:
    """The values, with the leader's values for all members of a walking group.

    Args:
        walking_group: index of each person's leader, -1 none.
        *values: one row a person.
    """
    person = jnp.arange(walking_group.shape[0], dtype=jnp.int32)
    leader = jnp.where(walking_group >= 0, walking_group, person)
    return tuple(value[leader] for value in values)


def group_speeds(scenario: Scenario, walking_group: Int[Array, "N"], preferred: Float[Array, "N"]) -> Float[Array, "N"]:
    """Preferred speeds [m/s]: in a walking group the leader's, less a constant for each companion.

    Source: Moussaid et al., PLoS ONE 5(4), e10047 (2010).
    """
    companions = scenario.behavior.companions
    if companions is None:
        return preferred
    n_companions = (companions >= 0).sum(1, dtype=jnp.int32).astype(float)  # (N,)
    slower = scenario.forces.walking.companion_slowdown * n_companions
    (leader_speed,) = follow_leaders(walking_group, preferred)
    group_speed = jnp.maximum(leader_speed - slower, MIN_SPEED)
    return jnp.where(walking_group >= 0, group_speed, preferred)


def walk_abreast(people: Pedestrians, velocity: Float[Array, "N 2"]) -> Float[Array, "N 2"]:
    """Desired velocities [m/s] in the leader's direction, for members near the leader with a similar direction.

    If all members headed for the same point, they would arrive there in single file.
    """
    leader_position, leader_velocity = follow_leaders(people.walking_group, people.position, velocity)
    gap = leader_position - people.position
    x, y = unit(*components(velocity))
    leader_x, leader_y = unit(*components(leader_velocity))
    near = length(*components(gap)) < NEAR_LEADER
    similar = x * leader_x + y * leader_y > MIN_COSINE
    turns = (people.walking_group >= 0) & near & similar

    speed = length(*components(velocity))
    abreast = jnp.stack([speed * leader_x, speed * leader_y], -1)  # (N, 2)
    return jnp.where(turns[:, None], abreast, velocity)
