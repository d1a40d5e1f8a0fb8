"""Parties (section IV-D): pairs and triples who walk together, as one among several of a pedestrian behavior's ways.

The last people of a scenario are its parties, pairs before triples; whoever has the lowest index leads. The leader
decides where to go, the others follow with the same goal at the same preferred speed, and cohesion
(``social_forces.cohesion``) keeps them side by side.
"""

from numbers import Real
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import KDTree

from sean_jax import navigation as paths
from sean_jax.base import Array, Pedestrians, Scenario
from sean_jax.geometry import length, unit
from sean_jax.navigation import Navigation
from sean_jax.quantities import shown

NEAREST = 0.9  # m, at most, between the starts of those who walk together
TOGETHER = 1.5  # m from the leader, within which people go the leader's way ...
ABOUT = 0.5  # ... if theirs is within an angle of that cosine, or they would walk into the corner that the leader turns
SLOWEST = 0.2  # m/s, below which no party's preferred speed falls


class Parties(NamedTuple):
    """How many parties there are, and of whom each consists."""

    pairs: int
    triples: int

    @property
    def members(self) -> int:
        return 2 * self.pairs + 3 * self.triples

    @property
    def number(self) -> int:
        return self.pairs + self.triples

    def companions(self, people: int) -> Array | None:
        """(N, 2) int32 those that each of so many people walks with, -1 none; None if nobody walks with anybody."""
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


def parties(people: int, shares: tuple[float, float]) -> Parties:
    """Parties of so many people, of whom these shares walk in pairs and in triples, rounded down to whole parties.

    Raises:
        ValueError: a share is negative, or they add up to more than 1.
    """
    two = isinstance(shares, (tuple, list)) and len(shares) == 2 and all(isinstance(share, Real) for share in shares)
    if not two or not (min(shares) >= 0 and sum(shares) <= 1 + 1e-6):
        raise ValueError(f"parties: {shown(shares)} must be two shares, each 0 or more, together 1 at most.")
    in_pairs, in_triples = shares
    return Parties(int(people * in_pairs / 2 + 1e-6), int(people * in_triples / 3 + 1e-6))


def clumps(navigation: Navigation, start: np.ndarray, groups: Parties) -> np.ndarray:
    """(C, 3) int32 indices of starts (P, 2) [m] near one another, in sight of the first; none is in two clumps.

    On the host; none are looked for if there are no parties.

    Raises:
        ValueError: there are fewer than parties.
    """
    found: list[tuple[int, ...]] = []
    if groups.number:
        pairs = KDTree(start).query_pairs(NEAREST, output_type="ndarray")
        sees = jax.jit(jax.vmap(lambda p, q: paths.sees(navigation.obstacles, p, q, 0.0)))
        spots = jnp.asarray(start, float)
        clear = np.asarray(sees(spots[pairs[:, 0]], spots[pairs[:, 1]]))
        near: list[list[int]] = [[] for _ in start]
        for i, j in pairs[clear]:
            near[i].append(int(j))
            near[j].append(int(i))
        free = np.ones(len(start), bool)
        for i in sorted(range(len(start)), key=lambda i: len(near[i])):  # whoever has few neighbours chooses first
            with_it = sorted((j for j in near[i] if free[j]), key=lambda j: len(near[j]))[:2]
            if free[i] and len(with_it) == 2:
                free[[i, *with_it]] = False
                found.append((i, *with_it))
    if groups.number > len(found):
        raise ValueError(
            f"parties: {groups.number} do not fit here; the most that do is {len(found)}, so give smaller shares."
        )
    return np.array(found, np.int32).reshape(-1, 3)


def places(chance: Array, clumps: Array, walkers: int, groups: Parties) -> Array:
    """(walkers,) int32 starts of so many people, of whom the last are parties, by the greatest chance (P,)."""
    alone = walkers - groups.members
    if not groups.number:
        return jax.lax.top_k(chance, alone)[1]
    chosen = clumps[jax.lax.top_k(chance[clumps[:, 0]], groups.number)[1]]
    together = jnp.concatenate([chosen[: groups.pairs, :2].ravel(), chosen[groups.pairs :].ravel()])
    return jnp.concatenate([jax.lax.top_k(chance.at[together].set(-jnp.inf), alone)[1], together])


def leaders(companions: Array | None, people: int) -> Array:
    """(N,) int32 index of whoever leads each person's party, -1 for those who walk alone."""
    if companions is None:
        return jnp.full(people, -1, jnp.int32)
    own = jnp.arange(people, dtype=jnp.int32)
    lowest = jnp.minimum(own, jnp.where(companions >= 0, companions, people).min(1))
    return jnp.where((companions >= 0).any(1), lowest, -1)


def follow(party: Array, *values: Array) -> tuple[Array, ...]:
    """Each of the values (N, ...) with the leader's own for all members of a party (N,)."""
    own = jnp.arange(party.shape[0], dtype=jnp.int32)
    leader = jnp.where(party >= 0, party, own)
    return tuple(value[leader] for value in values)


def speeds(scenario: Scenario, party: Array, preferred: Array) -> Array:
    """(N,) m/s: for members of a party the leader's, less what each companion takes off."""
    companions = scenario.behavior.companions
    if companions is None:
        return preferred
    slower = scenario.forces.party_slowness * (companions >= 0).sum(1, dtype=jnp.int32).astype(float)
    (shared,) = follow(party, preferred)
    return jnp.where(party >= 0, jnp.maximum(shared - slower, SLOWEST), preferred)


def abreast(people: Pedestrians, velocity: Array) -> Array:
    """(N, 2) m/s: desired velocities in the leader's direction, for who is near the leader and goes about that way.

    Each way to one and the same point would have a party meet there in single file.
    """
    position, ahead = follow(people.party, people.position, velocity)
    gap = position - people.position
    x, y = unit(velocity[:, 0], velocity[:, 1])
    leader_x, leader_y = unit(ahead[:, 0], ahead[:, 1])
    near = length(gap[:, 0], gap[:, 1]) < TOGETHER
    turns = (people.party >= 0) & near & (x * leader_x + y * leader_y > ABOUT)
    speed = length(velocity[:, 0], velocity[:, 1])
    return jnp.where(turns[:, None], jnp.stack([speed * leader_x, speed * leader_y], -1), velocity)
