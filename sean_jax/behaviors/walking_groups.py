"""Walking groups (section IV-D): pairs and triples who walk together.

The last people of a scenario are its walking groups, pairs before triples. The member with the lowest index leads. The
leader decides where to go, the others follow with the same goal at the same preferred speed, and cohesion
(``social_forces.cohesion``) keeps them side by side.
"""

from numbers import Real
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, Shaped
from scipy.spatial import KDTree

from sean_jax import navigation as paths
from sean_jax.base import Array, Pedestrians, Scenario
from sean_jax.errors import InputError
from sean_jax.geometry import length, unit
from sean_jax.messages import shorten
from sean_jax.navigation import Navigation

MAX_SPAWN_DISTANCE = 0.9  # m, between the starts of those who walk together
NEAR_LEADER = 1.5  # m, within which people go in the leader's direction ...
MIN_COSINE = 0.5  # ... if their own direction is at most so far off, or they would walk into the leader's corner
MIN_SPEED = 0.2  # m/s, below which no walking group's preferred speed falls


class WalkingGroups(NamedTuple):
    """How many walking groups there are."""

    pairs: int
    triples: int

    @property
    def members(self) -> int:
        """How many people walk in a group."""
        return 2 * self.pairs + 3 * self.triples

    @property
    def number(self) -> int:
        """How many groups there are."""
        return self.pairs + self.triples

    def companions(self, people: int) -> Int[Array, "N 2"] | None:
        """Whom each person walks with.

        Args:
            people: N, how many there are.

        Returns:
            (N, 2) indices, -1 none; None if everybody walks alone.
        """
        if not self.number:
            return None
        first = people - self.members
        two = first + np.arange(2 * self.pairs).reshape(-1, 2)
        three = first + 2 * self.pairs + np.arange(3 * self.triples).reshape(-1, 3)
        table = np.full((people, 2), -1, np.int32)
        for k in range(2):
            table[two[:, k], 0] = two[:, 1 - k]
        for k in range(3):
            table[three[:, k]] = np.delete(three, k, axis=1)
        return jnp.asarray(table)


def count_walking_groups(people: int, shares: tuple[float, float]) -> WalkingGroups:
    """How many pairs and triples there are among so many people, rounded down to whole groups.

    Raises:
        InputError: a share is negative, or they add up to more than 1.
    """
    two = isinstance(shares, (tuple, list)) and len(shares) == 2 and all(isinstance(share, Real) for share in shares)
    if not two or not (min(shares) >= 0 and sum(shares) <= 1 + 1e-6):
        clause = "must be two shares, each 0 or more, together 1 at most"
        raise InputError(f"walking_groups: {shorten(repr(shares))} {clause}.")
    in_pairs, in_triples = shares
    return WalkingGroups(int(people * in_pairs / 2 + 1e-6), int(people * in_triples / 3 + 1e-6))


def find_spawn_clusters(navigation: Navigation, start: np.ndarray, groups: WalkingGroups) -> np.ndarray:
    """Triples of starts that lie beside one another, for groups to start at. Runs on the host.

    Args:
        start: (P, 2) m.
        groups: for which there must be clusters; none are searched for if there are no groups.

    Returns:
        (C, 3) int32 indices of starts, the second and third in sight of the first; no start is in two clusters.

    Raises:
        InputError: there are fewer clusters than groups.
    """
    clusters: list[tuple[int, ...]] = []
    if groups.number:
        pairs = KDTree(start).query_pairs(MAX_SPAWN_DISTANCE, output_type="ndarray")
        in_sight = jax.jit(jax.vmap(lambda p, q: paths.segment_is_free(navigation.obstacles, p, q, 0.0)))
        spots = jnp.asarray(start, float)
        clear = np.asarray(in_sight(spots[pairs[:, 0]], spots[pairs[:, 1]]))
        near: list[list[int]] = [[] for _ in start]
        for i, j in pairs[clear]:
            near[i].append(int(j))
            near[j].append(int(i))
        free = np.ones(len(start), bool)
        for i in sorted(range(len(start)), key=lambda i: len(near[i])):  # whoever has few neighbours chooses first
            with_it = sorted((j for j in near[i] if free[j]), key=lambda j: len(near[j]))[:2]
            if free[i] and len(with_it) == 2:
                free[[i, *with_it]] = False
                clusters.append((i, *with_it))
    if groups.number > len(clusters):
        raise InputError(
            f"walking_groups: {groups.number} do not fit here, {len(clusters)} at most; give smaller shares."
        )
    return np.array(clusters, np.int32).reshape(-1, 3)


def choose_starts(
    score: Float[Array, "P"], spawn_clusters: Int[Array, "C 3"], walkers: int, groups: WalkingGroups
) -> Int[Array, "N"]:
    """The starts with the highest scores, for walking groups among the spawn clusters.

    Args:
        walkers: N, how many people start.
    """
    alone = walkers - groups.members
    if not groups.number:
        return jax.lax.top_k(score, alone)[1]
    chosen = spawn_clusters[jax.lax.top_k(score[spawn_clusters[:, 0]], groups.number)[1]]
    together = jnp.concatenate([chosen[: groups.pairs, :2].ravel(), chosen[groups.pairs :].ravel()])
    return jnp.concatenate([jax.lax.top_k(score.at[together].set(-jnp.inf), alone)[1], together])


def leaders(companions: Int[Array, "N 2"] | None, people: int) -> Int[Array, "N"]:
    """Who leads each person's walking group.

    Args:
        companions: (N, 2) whom each person walks with, -1 none; None if everybody walks alone.
        people: N, how many there are.

    Returns:
        (N,) index of the leader, -1 for those who walk alone.
    """
    if companions is None:
        return jnp.full(people, -1, jnp.int32)
    own = jnp.arange(people, dtype=jnp.int32)
    lowest = jnp.minimum(own, jnp.where(companions >= 0, companions, people).min(1))
    return jnp.where((companions >= 0).any(1), lowest, -1)


def follow_leaders(walking_group: Int[Array, "N"], *values: Shaped[Array, "N ..."]) -> tuple[Array, ...]:
    """Values in which all members of a walking group have those of their leader.

    Args:
        walking_group: (N,) index of each person's leader, -1 none.
        *values: each (N, ...), one row a person.

    Returns:
        As many arrays (N, ...).
    """
    own = jnp.arange(walking_group.shape[0], dtype=jnp.int32)
    leader = jnp.where(walking_group >= 0, walking_group, own)
    return tuple(value[leader] for value in values)


def group_speeds(scenario: Scenario, walking_group: Int[Array, "N"], preferred: Float[Array, "N"]) -> Float[Array, "N"]:
    """Preferred speeds: members of a walking group have their leader's, less a constant for each companion.

    Args:
        walking_group: (N,) index of each person's leader, -1 none.
        preferred: (N,) m/s, of each person alone.

    Returns:
        (N,) m/s.
    Source: Moussaid et al., PLoS ONE 5(4), e10047 (2010).
    """
    companions = scenario.behavior.companions
    if companions is None:
        return preferred
    slower = scenario.forces.walking.companion_slowdown * (companions >= 0).sum(1, dtype=jnp.int32).astype(float)
    (shared,) = follow_leaders(walking_group, preferred)
    return jnp.where(walking_group >= 0, jnp.maximum(shared - slower, MIN_SPEED), preferred)


def walk_abreast(people: Pedestrians, velocity: Float[Array, "N 2"]) -> Float[Array, "N 2"]:
    """Desired velocities in the leader's direction, for members who are near the leader and go about that way.

    If all members headed for one and the same point, they would arrive there in single file.

    Args:
        velocity: (N, 2) m/s, desired by each person alone.

    Returns:
        (N, 2) m/s.
    """
    position, ahead = follow_leaders(people.walking_group, people.position, velocity)
    gap = position - people.position
    x, y = unit(velocity[:, 0], velocity[:, 1])
    leader_x, leader_y = unit(ahead[:, 0], ahead[:, 1])
    near = length(gap[:, 0], gap[:, 1]) < NEAR_LEADER
    turns = (people.walking_group >= 0) & near & (x * leader_x + y * leader_y > MIN_COSINE)
    speed = length(velocity[:, 0], velocity[:, 1])
    return jnp.where(turns[:, None], jnp.stack([speed * leader_x, speed * leader_y], -1), velocity)
