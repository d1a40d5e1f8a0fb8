"""Who is near whom in a large crowd: people sorted into strips of floor, so that a force is summed over few pairs.

A strip is as high as the distance within which people feel one another. Those whom somebody feels then stand in three
runs of the sorted people: one in the own strip and one in each of the two beside it. Sums go along all three at once,
in parts of ``PART`` people. Those with as long runs are summed for together, in as many parts as the longest of them
needs: so no crowd is too dense, and a throng in one place makes nobody wait elsewhere.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from sean_jax.base import Array
from sean_jax.social_forces.linear import linear_call

MANY = 256  # from as many people on this pays
PART = 8  # people of each run who are looked at together, a power of two
BLOCKS = 4  # of people who are summed for together


@struct.dataclass
class Neighbors:
    """Where in the sorted crowd everybody's neighbors stand."""

    order: Array  # (N,) int32 the people, strip by strip, in each from left to right
    fullest: Array  # (N,) int32 the people, whose runs have the most parts first
    rank: Array  # (N,) int32 where among those each person is
    first: (
        Array  # (N, 3) int32 of the fullest: where in ``order`` the runs begin in the strip below, the own, that above
    )
    last: Array  # (N, 3) int32 where they end, exclusively


def find(position: Array, present: Array, within: Array) -> Neighbors:
    """Those who are within a distance [m] of each other, and some more, of people at (N, 2) [m], ``present`` (N,)."""
    # Who is absent may be anywhere; far away they would cost the others' places their digits.
    x, y = (_from_least(part, present) for part in jax.lax.stop_gradient(position).T)
    within = jax.lax.stop_gradient(within)
    within = jnp.minimum(within, 2.0 * (jnp.max(x) + jnp.max(y)) + 1.0)
    strip = jnp.floor(y / within)
    rounding = 1e-6 * (jnp.max(x) + 2.0 * within + 1.0) * (jnp.max(strip) + 2.0)
    up = y - strip * within  # from the own strip's lower edge
    below, above = (_half_chord(within, apart - rounding) + rounding for apart in (up, within - up))
    within = within + rounding
    width = jnp.max(x) + 2.0 * within + 1.0
    along = strip * width + x
    numbers = jnp.arange(x.shape[0], dtype=jnp.int32)
    along, order, below, above = jax.lax.sort((along, numbers, below, above), num_keys=1)
    middle = jnp.stack([along - width, along, along + width], 1)
    half = jnp.stack([below, jnp.full_like(below, within), above], 1)
    where = partial(jnp.searchsorted, along, method="scan_unrolled")
    first, last = (
        where(query, side=side).astype(jnp.int32) for query, side in ((middle - half, "left"), (middle + half, "right"))
    )
    _, place = jax.lax.sort((-_parts(first, last), numbers), num_keys=1)
    fullest = order[place]
    rank = jnp.zeros_like(fullest).at[fullest].set(numbers, unique_indices=True)
    return Neighbors(order, fullest, rank, first[place], last[place])


def _half_chord(radius: Array, apart: Array) -> Array:
    """Half of what a circle cuts off a line at that distance from its middle."""
    return jnp.sqrt(jnp.maximum(radius * radius - jnp.maximum(apart, 0.0) ** 2, 0.0))


def _from_least(values: Array, present: Array) -> Array:
    """(N,) how much greater they are than the least of those present; 0 for who is absent."""
    least = jnp.min(jnp.where(present, values, jnp.inf))
    return jnp.where(present, values - least, 0.0)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def sum_pairs(law: Callable, near: Neighbors, shared: Any, own: Array, other: Array) -> tuple[Array, Array]:
    """(N,) x and y: sums over the others near each person of ``law(shared, own (A,), other (B,)) -> (x, y)``.

    Args:
        law: of one pair, whose rows come as a sequence; zero for a person with itself, for who is absent, and beyond
            the distance of ``near``.
        shared: a pytree of floats, such as the parameters of the law.
        own: (A, N) floats, of those who feel.
        other: (B, N) floats, of those who are felt.

    Derivatives, forward and reverse, go along the same runs: who feels somebody stands among those whom that one feels.
    """
    return _sum(law, near, shared, own, other)


def _sum(law: Callable, near: Neighbors, shared: Any, own: Array, other: Array) -> tuple[Array, Array]:
    there = other[:, near.order]

    def block(runs: Runs, own: Array) -> tuple:
        def add(part: Array, sums: tuple) -> tuple:
            x, y = _part(law, shared, own, *_window(runs, there, part))
            return sums[0] + x, sums[1] + y

        return _over_parts(runs, add, (jnp.zeros_like(own[0]), jnp.zeros_like(own[0]))), None

    (x, y), _ = _over_blocks(near, block, own)
    return x[near.rank], y[near.rank]


@sum_pairs.defjvp
def _move(law: Callable, primals: tuple, tangents: tuple) -> tuple:
    sums = sum_pairs(law, *primals)
    change = linear_call(partial(_forward, law), partial(_backward, law), primals, tangents[1:], sums)
    return sums, change


def _forward(law: Callable, at: tuple, changes: tuple) -> tuple[Array, Array]:
    return jax.jvp(partial(_sum, law, at[0]), at[1:], changes)[1]


def _backward(law: Callable, at: tuple, given: tuple[Array, Array]) -> tuple:
    near, shared, own, other = at
    feeling, felt = len(own), len(other)
    pulls = jnp.stack(given)
    there, felt_by = other[:, near.order], jnp.concatenate([own, pulls])[:, near.order]

    def back(shared: Any, felt: Array, feels: tuple) -> tuple[Array, Array]:
        x, y = law(shared, feels[:-2], felt)
        return x * feels[-2] + y * feels[-1], jnp.zeros_like(x)

    def block(runs: Runs, rows: Array) -> tuple:
        own, other, pulls = rows[:feeling], rows[feeling : feeling + felt], rows[feeling + felt :]

        def add(part: Array, sums: tuple) -> tuple:
            those, any_there = _window(runs, there, part)
            _, pull = jax.vjp(lambda shared, own: _part(law, shared, own, those, any_there), shared, own)
            d_shared, d_own = pull((pulls[0], pulls[1]))
            feels, any_there = _window(runs, felt_by, part)
            _, pull = jax.vjp(lambda other: _part(back, shared, other, feels, any_there), other)
            (d_other,) = pull((jnp.ones_like(pulls[0]), jnp.zeros_like(pulls[0])))
            return jax.tree.map(jnp.add, sums, ((*d_own, *d_other), d_shared))

        return _over_parts(runs, add, jax.tree.map(jnp.zeros_like, ((*own, *other), shared)))

    d_rows, d_shared = _over_blocks(near, block, jnp.concatenate([own, other, pulls]))
    d_rows = jnp.stack([row[near.rank] for row in d_rows])
    return d_shared, d_rows[:feeling], d_rows[feeling:]


class Runs(NamedTuple):
    """Those of the people of a block."""

    first: Array  # (N, 3) int32
    last: Array  # (N, 3) int32


def _over_blocks(near: Neighbors, block: Callable, rows: Array) -> tuple:
    """What ``block(runs, rows) -> (of each person, in all)`` gives for all people, those with most neighbors first.

    Of rows (R, N) a block gets (R, n), and gives a tuple of (n,), which become (N,), and what the blocks' sum is of.
    """
    number = near.fullest.shape[0]
    size = -(-number // BLOCKS)

    def split(values: Array) -> Array:  # (N, ...) to (BLOCKS, n, ...), with nobody at the end
        filled = jnp.pad(values, [(0, BLOCKS * size - number)] + [(0, 0)] * (values.ndim - 1))
        return filled.reshape(BLOCKS, size, *values.shape[1:])

    blocks = Runs(split(near.first), split(near.last)), split(rows[:, near.fullest].T)
    each, total = jax.lax.map(lambda one: block(one[0], one[1].T), blocks)
    return tuple(row.reshape(-1)[:number] for row in each), jax.tree.map(lambda leaf: leaf.sum(0), total)


def _over_parts(runs: Runs, add: Callable, sums: Any) -> Any:
    """The sums after ``add(part, sums)`` for as many parts as there are for whoever has the most."""
    parts = jnp.max(_parts(runs.first, runs.last))
    turn = lambda carry: (carry[0] + 1, add(*carry))  # noqa: E731
    return jax.lax.while_loop(lambda carry: carry[0] < parts, turn, (jnp.int32(0), sums))[1]


def _parts(first: Array, last: Array) -> Array:
    """(N,) int32: how many parts the longest of each person's runs (N, 3) has."""
    return (jnp.max(last - first, 1) + PART - 1) // PART


def _window(runs: Runs, rows: Array, part: Array) -> tuple[tuple[Array, ...], Array]:
    """For each of the rows (R, N) those (N, 3 PART) in that part of everybody's runs; (N, 3 PART) bool who is any."""
    begin = runs.first + PART * part
    there = begin[:, :, None] + jnp.arange(PART, dtype=jnp.int32)[None, None, :] < runs.last[:, :, None]
    padded = jnp.pad(rows, ((0, 0), (0, PART)))

    def cut(row: Array) -> Array:  # a processor does it once and for all, a GPU where it needs them
        those = jax.vmap(jax.vmap(lambda at: jax.lax.dynamic_slice(row, (at,), (PART,))))(begin)
        return jax.lax.platform_dependent(those, cpu=jax.lax.optimization_barrier, default=lambda those: those)

    return tuple(cut(row).reshape(-1, 3 * PART) for row in padded), there.reshape(-1, 3 * PART)


def _part(law: Callable, shared: Any, own: Array, window: tuple[Array, ...], there: Array) -> tuple[Array, Array]:
    """(N,) x and y: the law summed over a part of everybody's runs."""
    others = jax.vmap(law, in_axes=(None, None, 0))
    x, y = jax.vmap(others, in_axes=(None, 1, 0))(shared, own, window)
    pushes = jax.lax.complex(jnp.where(there, x, 0.0), jnp.where(there, y, 0.0))
    total = jax.lax.platform_dependent(pushes, cpu=_by_halves, default=lambda pushes: pushes.sum(1))
    return total.real, total.imag


def _by_halves(pushes: Array) -> Array:
    """(N,) the sums of (N, 3 PART), which XLA for a CPU adds up three times slower by itself, one after the other."""
    pushes = jax.lax.optimization_barrier(pushes)
    pushes = pushes[:, :PART] + pushes[:, PART : 2 * PART] + pushes[:, 2 * PART :]
    while pushes.shape[1] > 1:
        half = pushes.shape[1] // 2
        pushes = pushes[:, :half] + pushes[:, half:]
    return pushes[:, 0]
