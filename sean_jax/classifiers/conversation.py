"""Who stands in conversation with whom, from positions and facing alone (section III-A's Member, without a simulator).

Kendon's o-space, the empty middle that the members of a group face, is found by votes, as Cristani et al. (BMVC 2011)
and Setti et al. (PLoS ONE 2015) do: everybody votes for a place a stride ahead of them, and a partition of the votes
is as good as the sum of their squared distances from the group's mean is small, plus a price for each group (minimum
description length). Here groups are merged greedily, always the two that make that sum least, until no merger pays:
Ward's linkage, which has a fixed number of steps and so works under jit and vmap. A solitary person is a group of
one, and gets the index -1.
"""

import jax
import jax.numpy as jnp

from sean_jax.base import Array

STRIDE = 0.8  # m, that of Setti et al. for the Cocktail Party recording
PRICE = 1.5  # m2 for each group, the best on every second frame of it; Coffee Break wants 0.6 m and 0.6 m2
APART = 1e9  # m2, more than any merger costs


def o_space_votes(position: Array, heading: Array, stride: Array | float = STRIDE) -> Array:
    """(..., 2) m: the places ``stride`` [m] ahead of people at (..., 2) [m] with unit headings (..., 2)."""
    return position + stride * heading


def o_space_groups(votes: Array, present: Array, price: Array | float = PRICE) -> Array:
    """The group of each person, as an index below N, -1 for who is alone or absent.

    Args:
        votes: (N, 2) m, from ``o_space_votes``; mean votes over some frames are steadier where facing is noisy.
        present: (N,) bool.
        price: () m2, how much description a group costs: two people merge where their votes are nearer than
            sqrt(2 price) to each other.

    Returns:
        (N,) int32; members of a group have the index of the one among them who comes first.
    """
    number = votes.shape[0]
    everybody = jnp.arange(number, dtype=jnp.int32)

    def merge(_, clusters):
        label, center, size = clusters
        gap = center[:, None, :] - center[None, :, :]
        alive = size > 0
        pairs = alive[:, None] & alive[None, :] & (everybody[:, None] < everybody[None, :])
        together = jnp.where(pairs, size[:, None] + size[None, :], 1.0)
        cost = jnp.where(pairs, size[:, None] * size[None, :] / together * (gap * gap).sum(-1), APART)
        best = jnp.argmin(cost)
        first, second = (best // number).astype(jnp.int32), (best % number).astype(jnp.int32)
        pays = cost.reshape(-1)[best] < price
        total = jnp.where(pays, size[first] + size[second], 1.0)
        mean = (size[first] * center[first] + size[second] * center[second]) / total
        return (
            jnp.where(pays & (label == second), first, label),
            jnp.where(pays & (everybody == first)[:, None], mean[None, :], center),
            jnp.where(pays, jnp.where(everybody == first, total, jnp.where(everybody == second, 0.0, size)), size),
        )

    start = (everybody, votes, present.astype(votes.dtype))
    label, _, size = jax.lax.fori_loop(0, max(number - 1, 0), merge, start)
    return jnp.where(present & (size[label] > 1), label, -1)


def found_groups(estimated: Array, annotated: Array, present: Array, tolerance: float = 2 / 3) -> Array:
    """Counts for precision and recall, as in the literature: a group is found if enough of it is, and little else.

    A group of n is found by an estimated one that has at least ceil(T n) of its members and at most ceil((1 - T) n)
    people besides; each estimated group serves once.

    Args:
        estimated: (N,) int32 group of each person, -1 none; indices below N.
        annotated: (N,) int32 likewise.
        present: (N,) bool.
        tolerance: T; 2/3 is the usual one and 1 asks for the very group.

    Returns:
        (3,) int32: groups found, groups estimated, groups annotated; groups of one are none.
    """
    number = estimated.shape[0]
    everybody = jnp.arange(number, dtype=jnp.int32)
    first = (estimated[None, :] == everybody[:, None]) & present[None, :]  # (groups, people)
    second = (annotated[None, :] == everybody[:, None]) & present[None, :]
    common = (second[:, None, :] & first[None, :, :]).sum(-1, dtype=jnp.int32)
    size, true_size = first.sum(-1, dtype=jnp.int32), second.sum(-1, dtype=jnp.int32)
    real = true_size.astype(float)
    need = jnp.ceil(tolerance * real - 1e-4).astype(jnp.int32)
    spare = jnp.ceil((1 - tolerance) * real - 1e-4).astype(jnp.int32)
    match = (common >= need[:, None]) & (size[None, :] - common <= spare[:, None])
    match = match & (true_size > 1)[:, None] & (size > 1)[None, :]

    def take(free, row):
        hit = row & free
        chosen = jnp.argmax(hit)
        return free & ~(hit.any() & (everybody == chosen)), hit.any()

    _, hits = jax.lax.scan(take, jnp.ones(number, bool), match)
    return jnp.stack([hits.sum(dtype=jnp.int32), (size > 1).sum(dtype=jnp.int32),
                      (true_size > 1).sum(dtype=jnp.int32)])  # fmt: skip
