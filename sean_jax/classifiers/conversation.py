"""Conversational groups from positions and headings alone (section III-A's Member, without a simulator).

Kendon's o-space is the empty middle that the members of a group face. It is estimated by votes, as by Cristani et al.
(BMVC 2011) and Setti et al. (PLoS ONE 2015): each person votes for a place a stride ahead. The cost of a partition is
the sum of squared distances of the votes from the mean of their group, plus a price for each group (minimum description
length). Groups are merged greedily, the cheapest merger first, until no merger pays: Ward's linkage, which has a fixed
number of steps and so works under jit and vmap. A person alone has the index -1.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from sean_jax.core.data_types import Array

STRIDE = 0.8  # m, of Setti et al. for the Cocktail Party recording
PRICE = 1.5  # m2 for each group, the best on every second frame of it; for Coffee Break 0.6 m and 0.6 m2 are best
APART = 1e9  # m2, more than any merger costs


def o_space_votes(
    position: Float[Array, "*people 2"], heading: Float[Array, "*people 2"], stride: Float[Array, ""] | float = STRIDE
) -> Float[Array, "*people 2"]:
    """Votes [m] for the middle of a group: the place a stride [m] ahead of each person.

    Source: Cristani et al. (BMVC 2011).
    """
    return position + stride * heading


def o_space_groups(
    votes: Float[Array, "N 2"], present: Bool[Array, " N"], price: Float[Array, ""] | float = PRICE
) -> Int[Array, " N"]:
    """The group of each person: the index of its first member, -1 for people alone or absent.

    Args:
        votes: m, from ``o_space_votes``; mean votes over some frames are steadier if headings are noisy.
        price: m2, cost of a group: two people merge if their votes are nearer than sqrt(2 price) to each other.

    Source: Setti et al. (PLoS ONE 2015), with Ward's linkage as the search.
    """
    number = votes.shape[0]
    index = jnp.arange(number, dtype=jnp.int32)
    start = Clusters(index, votes, present.astype(votes.dtype))

    def merge(_: Array, clusters: Clusters) -> Clusters:
        return _merge(clusters, index, price)

    label, _, size = jax.lax.fori_loop(0, max(number - 1, 0), merge, start)
    in_group = present & (size[label] > 1)
    return jnp.where(in_group, label, -1)


class Clusters(NamedTuple):
    """A partition of N people; a cluster has the index of its first member."""

    label: Int[Array, " N"]  # the cluster of each person
    center: Float[Array, "N 2"]  # m, the mean vote of each cluster
    size: Float[Array, " N"]  # people in each cluster, 0 of those that have been merged


def _merge(clusters: Clusters, index: Int[Array, " N"], price: Float[Array, ""] | float) -> Clusters:
    """The clusters after the cheapest merger, if it pays."""
    label, center, size = clusters

    # A merger of two clusters adds n m / (n + m) |gap|^2 to the sum of squared distances (Ward 1963).
    gap = center[:, None, :] - center[None, :, :]  # (N, N, 2) m
    square = (gap * gap).sum(-1)
    size_1 = size[:, None]
    size_2 = size[None, :]
    alive = size > 0
    in_order = index[:, None] < index[None, :]
    pairs = alive[:, None] & alive[None, :] & in_order
    both_sizes = jnp.where(pairs, size_1 + size_2, 1.0)
    added = size_1 * size_2 / both_sizes * square  # (N, N) m2
    cost = jnp.where(pairs, added, APART)

    # A merger saves the price of one group, so even the cheapest one pays only below that price.
    best = jnp.argmin(cost)
    number = index.shape[0]
    first = (best // number).astype(jnp.int32)
    second = (best % number).astype(jnp.int32)
    least_cost = cost.reshape(-1)[best]
    pays = least_cost < price

    # The loop has a fixed length: a merger that does not pay is computed too, kept finite by 1, and discarded.
    total = jnp.where(pays, size[first] + size[second], 1.0)
    vote_sum = size[first] * center[first] + size[second] * center[second]
    mean = vote_sum / total  # (2,) m

    # ``first`` is the lower index, so a cluster keeps the index of its first member.
    is_first = index == first
    is_second = index == second
    joins = pays & (label == second)
    label = jnp.where(joins, first, label)
    moves = pays & is_first
    center = jnp.where(moves[:, None], mean[None, :], center)
    without_second = jnp.where(is_second, 0.0, size)
    merged_size = jnp.where(is_first, total, without_second)
    size = jnp.where(pays, merged_size, size)
    return Clusters(label, center, size)


def match_groups(
    estimated: Int[Array, " N"], annotated: Int[Array, " N"], present: Bool[Array, " N"], tolerance: float = 2 / 3
) -> Int[Array, "3"]:
    """Counts for precision and recall: numbers of matched, estimated and annotated groups of two or more people.

    An annotated group of n matches an estimated one with at least ceil(T n) of its members and at most ceil((1 - T) n)
    other people; each estimated group matches once.

    Args:
        estimated: group of each person, an index below N, -1 none.
        annotated: likewise.
        tolerance: T, usually 2/3; 1 demands equal groups.

    Source: Cristani et al. (BMVC 2011).
    """
    number = estimated.shape[0]
    index = jnp.arange(number, dtype=jnp.int32)

    # Numbers of groups mean nothing across the two partitions: groups are compared as sets of people.
    group = index[:, None]
    is_present = present[None, :]
    in_estimated = (estimated[None, :] == group) & is_present  # (groups, people)
    in_annotated = (annotated[None, :] == group) & is_present
    in_both = in_annotated[:, None, :] & in_estimated[None, :, :]
    common = in_both.sum(-1, dtype=jnp.int32)  # (annotated, estimated)
    size = in_estimated.sum(-1, dtype=jnp.int32)
    true_size = in_annotated.sum(-1, dtype=jnp.int32)

    # Rounding may lift T n just above a whole number, which ceil would raise by one person: hence 1e-4.
    real = true_size.astype(float)
    need = jnp.ceil(tolerance * real - 1e-4)
    need = need.astype(jnp.int32)
    spare = jnp.ceil((1 - tolerance) * real - 1e-4)
    spare = spare.astype(jnp.int32)
    others = size[None, :] - common
    enough = common >= need[:, None]
    few_others = others <= spare[:, None]
    match = enough & few_others  # (annotated, estimated)

    # A person alone is no group, or scenes of loners would raise both scores.
    is_group = size > 1
    is_true_group = true_size > 1
    match = match & is_true_group[:, None]
    match = match & is_group[None, :]

    # Each annotated group in turn takes the first estimated group that matches and is free.
    def take(free: Array, row: Array) -> tuple[Array, Array]:
        candidates = row & free
        chosen = jnp.argmax(candidates)
        exists = candidates.any()
        taken = exists & (index == chosen)
        return free & ~taken, exists

    _, hits = jax.lax.scan(take, jnp.ones(number, bool), match)

    # Counts add up over frames; precision and recall of one frame do not, and it may have no group at all.
    matched = hits.sum(dtype=jnp.int32)
    estimates = is_group.sum(dtype=jnp.int32)
    annotations = is_true_group.sum(dtype=jnp.int32)
    return jnp.stack([matched, estimates, annotations])
