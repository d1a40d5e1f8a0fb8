"""Who is near whom in a large crowd: people sorted into strips of floor, so that a force is summed over few pairs.

A strip is as high as the distance within which people feel one another. Those whom somebody feels then stand in three
runs of the sorted people: one in the own strip and one in each of the two beside it. Sums go along these runs in
parts of ``PART`` people, as many parts as the longest run has, so no crowd is too dense for them.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from sean_jax.base import Array

MANY = 256  # from as many people on this pays
PART = 16  # people of a run that are looked at together, a power of two


@struct.dataclass
class Neighbors:
    """Where in the sorted crowd everybody's neighbors stand."""

    order: Array  # (N,) int32 the people, strip by strip, in each from left to right
    place: Array  # (N,) int32 where in that order each person is
    first: Array  # (N, 3) int32 of the person at a place: where the runs begin in the strip below, the own, that above
    last: Array  # (N, 3) int32 where they end, exclusively


def find(position: Array, present: Array, within: Array) -> Neighbors:
    """Those who are within a distance [m] of each other, and some more, of people at (N, 2) [m], ``present`` (N,)."""
    # Who is absent may be anywhere; far away they would cost the others' places their digits.
    x, y = (_from_least(part, present) for part in jax.lax.stop_gradient(position).T)
    within = jax.lax.stop_gradient(within)
    within = jnp.minimum(within, 2.0 * (jnp.max(x) + jnp.max(y)) + 1.0)
    width = jnp.max(x) + 2.0 * within + 1.0
    strip = jnp.floor(y / within)
    within = within + 1e-6 * width * (jnp.max(strip) + 2.0)  # the rounding of what follows
    width = jnp.max(x) + 2.0 * within + 1.0
    along = strip * width + x
    along, order = jax.lax.sort((along, jnp.arange(x.shape[0], dtype=jnp.int32)), num_keys=1)
    place = jnp.zeros_like(order).at[order].set(jnp.arange(x.shape[0], dtype=jnp.int32), unique_indices=True)
    middle = jnp.stack([along - width, along, along + width], 1)
    where = partial(jnp.searchsorted, along, method="scan_unrolled")
    first, last = where(middle - within, side="left"), where(middle + within, side="right")
    return Neighbors(order, place, first.astype(jnp.int32), last.astype(jnp.int32))


def _from_least(values: Array, present: Array) -> Array:
    """(N,) how much greater they are than the least of those present; 0 for who is absent."""
    least = jnp.min(jnp.where(present, values, jnp.inf))
    return jnp.where(present, values - least, 0.0)


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def sum_pairs(law: Callable, near: Neighbors, shared: Any, own: Array, other: Array) -> tuple[Array, Array]:
    """(N,) x and y: sums over the others near each person of ``law(shared, own (A,), other (B,)) -> (x, y)``.

    Args:
        law: of one pair; zero for a person with itself, for who is absent, and beyond the distance of ``near``.
        shared: a pytree of floats, such as the parameters of the law.
        own: (A, N) floats, of those who feel.
        other: (B, N) floats, of those who are felt.

    Reverse mode goes along the same runs: who feels somebody stands among those whom that one feels. There is no
    forward mode.
    """
    own, other = own[:, near.order], other[:, near.order]

    def add(part: Array, sums: tuple) -> tuple:
        x, y = _part(law, shared, own, *_window(near, other, part))
        return sums[0] + x, sums[1] + y

    x, y = _over_parts(near, add, (jnp.zeros_like(own[0]), jnp.zeros_like(own[0])))
    return x[near.place], y[near.place]


def _forward(law: Callable, near: Neighbors, shared: Any, own: Array, other: Array) -> tuple:
    return sum_pairs(law, near, shared, own, other), (near, shared, own, other)


def _backward(law: Callable, kept: tuple, given: tuple[Array, Array]) -> tuple:
    near, shared, own, other = kept
    own, other = own[:, near.order], other[:, near.order]
    gx, gy = given[0][near.order], given[1][near.order]
    felt_by = jnp.concatenate([own, gx[None], gy[None]])

    def back(shared: Any, felt: Array, feels: Array) -> tuple[Array, Array]:
        x, y = law(shared, feels[:-2], felt)
        return x * feels[-2] + y * feels[-1], jnp.zeros_like(x)

    def add(part: Array, sums: tuple) -> tuple:
        window, there = _window(near, other, part)
        _, pull = jax.vjp(lambda shared, own: _part(law, shared, own, window, there), shared, own)
        d_shared, d_own = pull((gx, gy))
        window, there = _window(near, felt_by, part)
        _, pull = jax.vjp(lambda other: _part(back, shared, other, window, there), other)
        (d_other,) = pull((jnp.ones_like(gx), jnp.zeros_like(gx)))
        return jax.tree.map(jnp.add, sums, (d_shared, d_own, d_other))

    zeros = jax.tree.map(jnp.zeros_like, (shared, own, other))
    d_shared, d_own, d_other = _over_parts(near, add, zeros)
    nowhere = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, jax.dtypes.float0), near)
    return nowhere, d_shared, d_own[:, near.place], d_other[:, near.place]


sum_pairs.defvjp(_forward, _backward)


def _over_parts(near: Neighbors, add: Callable, sums: Any) -> Any:
    """The sums after ``add(part, sums)`` for as many parts as there are for whoever has the most."""
    parts = jnp.max(jnp.sum(_parts(near), 1))
    return jax.lax.while_loop(lambda so_far: so_far[0] < parts, lambda c: (c[0] + 1, add(*c)), (jnp.int32(0), sums))[1]


def _parts(near: Neighbors) -> Array:
    """(N, 3) int32: how many parts each run has."""
    return (near.last - near.first + PART - 1) // PART


def _window(near: Neighbors, rows: Array, part: Array) -> tuple[Array, Array]:
    """(N, R, PART) the rows (R, N) of those in that part of everybody's runs, and (N, PART) bool whether any is."""
    below, own, above = jnp.cumsum(_parts(near), 1).T
    run = (part >= below).astype(jnp.int32) + (part >= own).astype(jnp.int32)
    begin, end = (jnp.take_along_axis(side, run[:, None], 1)[:, 0] for side in (near.first, near.last))
    begin = begin + PART * (part - jnp.where(run == 0, 0, jnp.where(run == 1, below, own)))
    begin = jnp.where(part < above, begin, rows.shape[1])
    there = begin[:, None] + jnp.arange(PART, dtype=jnp.int32)[None, :] < end[:, None]
    padded = jnp.pad(rows, ((0, 0), (0, PART)))
    # Cut out first: a processor does that faster than it looks up one number after the other.
    cut = jax.vmap(lambda at: jax.lax.dynamic_slice(padded, (0, at), (rows.shape[0], PART)))(begin)
    return jax.lax.optimization_barrier(cut), there


def _part(law: Callable, shared: Any, own: Array, window: Array, there: Array) -> tuple[Array, Array]:
    """(N,) x and y: the law summed over a part of everybody's runs."""
    others = jax.vmap(law, in_axes=(None, None, 1))
    x, y = jax.vmap(others, in_axes=(None, 1, 0))(shared, own, window)
    pushes = jax.lax.complex(jnp.where(there, x, 0.0), jnp.where(there, y, 0.0))
    total = jax.lax.platform_dependent(pushes, cpu=_by_halves, default=lambda pushes: pushes.sum(1))
    return total.real, total.imag


def _by_halves(pushes: Array) -> Array:
    """(N,) the sums of (N, PART), which XLA for a CPU adds up three times slower by itself, one after the other."""
    pushes = jax.lax.optimization_barrier(pushes)
    while pushes.shape[1] > 1:
        half = pushes.shape[1] // 2
        pushes = pushes[:, :half] + pushes[:, half:]
    return pushes[:, 0]
