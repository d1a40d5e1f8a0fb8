"""Sums of a law of one pair: over all others or, in a large crowd, over neighbors.

Reverse mode would keep some hundred numbers for each pair and step. Here it keeps only the rows of each person, and
computes the law again while it goes along the pairs on the way back.

Neighbors: people are sorted into strips of floor, as high as the distance within which people interact. The
neighbors of a person then form three runs of the sorted people: one in the same strip and one in each of the two beside
it. Sums go along all three at once, in parts of ``PART`` people. People are summed in blocks of similar run length,
each in as many parts as its longest run needs. So no crowd is too dense, and a throng in one place does not slow down
the sums elsewhere.
"""

from collections.abc import Callable, Sequence
from functools import partial, reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax.flatten_util import ravel_pytree
from jaxtyping import Bool, Float, Int, PyTree

from sean_jax.core import gpu_kernels
from sean_jax.core.data_types import Array
from sean_jax.core.devices import by_platform
from sean_jax.core.geometry import sum_in_pairs
from sean_jax.core.gradients import linear_call
from sean_jax.social_forces import kernel

ABSENT = 1e7  # all rows of an absent person: far from everybody, and of no group
TURNS = 4  # others over whom each thread of a GPU sums first, if the law gives more than two numbers
MIN_PEOPLE = 256  # in smaller crowds it is quicker to sum all pairs
PART = 8  # people of a run that are summed together, a power of two
BLOCKS = 4  # into which people are divided by the length of their runs


@struct.dataclass
class Neighbors:
    """The neighbors of each person, as runs of the sorted crowd."""

    order: Int[Array, "N"]  # the people, strip by strip, in each from left to right
    first: Int[Array, "N 3"]  # in that order: where the runs of each in the strips below, own and above begin ...
    last: Int[Array, "N 3"]  # ... and end, exclusively
    by_parts: Int[Array, "N"]  # places in that order, sorted by number of parts of the runs, the most first
    rank: Int[Array, "N"]  # where among those each person is


def find(position: Float[Array, "N 2"], present: Bool[Array, "N"], within: Float[Array, ""] | float) -> Neighbors:
    """The pairs of people ``within`` a distance [m] of each other, and some more; positions [m]."""
    # Absent people may be anywhere. Far away they would cost the others' coordinates their precision.
    x, y = (_from_min(part, present) for part in jax.lax.stop_gradient(position).T)
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
    along, order = jax.lax.sort((along, numbers), num_keys=1)
    middle = jnp.stack([along - width, along, along + width], 1)
    half = jnp.stack([below[order], jnp.full_like(below, within), above[order]], 1)
    in_kernel = gpu_kernels.available() and along.dtype == np.float32
    first, last = by_platform(_search, kernel.search if in_kernel else _search)(along, middle - half, middle + half)
    _, by_parts = jax.lax.sort((-_parts(first, last), numbers), num_keys=1)
    rank = jnp.zeros_like(order).at[order[by_parts]].set(numbers, unique_indices=True)
    return Neighbors(order, first, last, by_parts, rank)


def _search(row: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Where in a sorted row the values begin that are at least ``low``, and end that are at most ``high``."""
    where = partial(jnp.searchsorted, row, method="scan_unrolled")
    return where(low, side="left").astype(jnp.int32), where(high, side="right").astype(jnp.int32)


def _half_chord(radius: Array, apart: Array) -> Array:
    """Half the length of a circle's chord at that distance from its middle."""
    return jnp.sqrt(jnp.maximum(radius * radius - jnp.maximum(apart, 0.0) ** 2, 0.0))


def _from_min(values: Array, present: Array) -> Array:
    """(N,) the values above the minimum of the people present; 0 for absent people."""
    minimum = jnp.min(jnp.where(present, values, jnp.inf))
    return jnp.where(present, values - minimum, 0.0)


def sum_near(
    law: Callable, near: Neighbors, shared: PyTree, own: Float[Array, "A N"], other: Float[Array, "B N"]
) -> PyTree:
    """``sum_pairs`` over neighbors, with rows and shared numbers as arrays. Reverse mode needs ``pull_back_near``."""
    sorted_other = other[:, near.order]
    numbers, structure = jax.tree.flatten(jax.eval_shape(law, shared, own[:, 0], other[:, 0]))

    def block(runs: Runs, own: Array) -> tuple:
        def add(part: Array, sums: tuple) -> tuple:
            return jax.tree.map(jnp.add, sums, _sum_part(law, shared, own, *_window(runs, sorted_other, part)))

        return _over_parts(runs, add, tuple(jnp.zeros_like(own[0]) for _ in numbers)), None

    rows, _ = _over_blocks(near, block, own)
    return structure.unflatten([row[near.rank] for row in rows])


def pull_back_near(
    law: Callable,
    near: Neighbors,
    shared: PyTree,
    own: Float[Array, "A N"],
    other: Float[Array, "B N"],
    pulls: Float[Array, "C N"],
) -> tuple[PyTree, Float[Array, "A N"], Float[Array, "B N"]]:
    """The transpose of the derivative of ``sum_near``: cotangents of shared, own and other.

    It goes along the same runs, for neighbors are mutual: the forces of a person on others are a sum over the person's
    neighbors as well.
    """
    own_rows, other_rows = len(own), len(other)
    sorted_other, sorted_own = other[:, near.order], jnp.concatenate([own, pulls])[:, near.order]

    def pulled_back(shared: PyTree, other: Array, own: tuple) -> Array:
        numbers = jax.tree.leaves(law(shared, own[:own_rows], other))
        return reduce(jnp.add, map(jnp.multiply, numbers, own[own_rows:]))

    def block(runs: Runs, rows: Array) -> tuple:
        own, other, pulls = rows[:own_rows], rows[own_rows : own_rows + other_rows], rows[own_rows + other_rows :]

        def add(part: Array, sums: tuple) -> tuple:
            others, valid = _window(runs, sorted_other, part)
            _, pull = jax.vjp(lambda shared, own: _sum_part(law, shared, own, others, valid), shared, own)
            d_shared, d_own = pull(tuple(pulls))
            owns, valid = _window(runs, sorted_own, part)
            _, pull = jax.vjp(lambda other: _sum_part(pulled_back, shared, other, owns, valid), other)
            (d_other,) = pull((jnp.ones_like(pulls[0]),))
            return jax.tree.map(jnp.add, sums, ((*d_own, *d_other), d_shared))

        return _over_parts(runs, add, jax.tree.map(jnp.zeros_like, ((*own, *other), shared)))

    d_rows, d_shared = _over_blocks(near, block, jnp.concatenate([own, other, pulls]))
    d_rows = jnp.stack([row[near.rank] for row in d_rows])
    return d_shared, d_rows[:own_rows], d_rows[own_rows:]


class Runs(NamedTuple):
    """The runs of the people of a block."""

    first: Array  # (N, 3) int32
    last: Array  # (N, 3) int32


def _over_blocks(near: Neighbors, block: Callable, rows: Array) -> tuple:
    """Applies ``block(runs, rows (R, n)) -> (tuple of (n,), totals)`` to all blocks of people.

    The result is the tuple of (N,), by number of parts as ``near.by_parts``, and the sum of the totals.
    """
    number = near.by_parts.shape[0]
    size = -(-number // BLOCKS)

    def split(values: Array) -> Array:  # (N, ...) to (BLOCKS, n, ...), padded with zeros, that is with empty runs
        filled = jnp.pad(values, [(0, BLOCKS * size - number)] + [(0, 0)] * (values.ndim - 1))
        return filled.reshape(BLOCKS, size, *values.shape[1:])

    people = near.order[near.by_parts]
    blocks = Runs(split(near.first[near.by_parts]), split(near.last[near.by_parts])), split(rows[:, people].T)
    each, total = jax.lax.map(lambda one: block(one[0], one[1].T), blocks)
    return tuple(row.reshape(-1)[:number] for row in each), jax.tree.map(lambda leaf: leaf.sum(0), total)


@jax.named_scope("neighbors")
def _over_parts(runs: Runs, add: Callable, sums: PyTree) -> PyTree:
    """The sums after ``add(part, sums)`` for as many parts as the longest run has."""
    parts = jnp.max(_parts(runs.first, runs.last))
    turn = lambda carry: (carry[0] + 1, add(*carry))  # noqa: E731
    return jax.lax.while_loop(lambda carry: carry[0] < parts, turn, (jnp.int32(0), sums))[1]


def _parts(first: Array, last: Array) -> Array:
    """(N,) int32: number of parts of the longest of each person's runs (N, 3)."""
    return (jnp.max(last - first, 1) + PART - 1) // PART


def _window(runs: Runs, rows: Array, part: Array) -> tuple[tuple[Array, ...], Array]:
    """For each of the rows (R, N) the values (N, 3 PART) in that part of everybody's runs, and which are valid."""
    begin = runs.first + PART * part
    valid = begin[:, :, None] + jnp.arange(PART, dtype=jnp.int32)[None, None, :] < runs.last[:, :, None]
    padded = jnp.pad(rows, ((0, 0), (0, PART)))

    def cut(row: Array) -> Array:  # a CPU cuts once, a GPU where it needs the values
        values = jax.vmap(jax.vmap(lambda at: jax.lax.dynamic_slice(row, (at,), (PART,))))(begin)
        return jax.lax.platform_dependent(values, cpu=jax.lax.optimization_barrier, default=lambda values: values)

    return tuple(cut(row).reshape(-1, 3 * PART) for row in padded), valid.reshape(-1, 3 * PART)


def _sum_part(law: Callable, shared: PyTree, own: Array, window: tuple[Array, ...], valid: Array) -> tuple[Array, ...]:
    """(N,) each number of the law, summed over a part of everybody's runs."""
    others = jax.vmap(law, in_axes=(None, None, 0))
    numbers = jax.tree.leaves(jax.vmap(others, in_axes=(None, 1, 0))(shared, own, window))
    numbers = tuple(jnp.where(valid, number, 0.0) for number in numbers)

    def sum_by_halves(numbers: tuple[Array, ...]) -> tuple[Array, ...]:
        pairs = [jax.lax.complex(*numbers[i : i + 2]) for i in range(0, len(numbers) - 1, 2)]
        totals = [part for pair in pairs for total in [_sum_by_halves(pair)] for part in (total.real, total.imag)]
        return (*totals, *([_sum_by_halves(numbers[-1])] if len(numbers) % 2 else []))

    return jax.lax.platform_dependent(numbers, cpu=sum_by_halves, default=lambda numbers: sum_in_pairs(numbers, 1))


def _sum_by_halves(pushes: Array) -> Array:
    """(N,) the sums of (N, 3 PART); XLA for a CPU adds them up one after the other, which takes three times as long."""
    pushes = jax.lax.optimization_barrier(pushes)
    pushes = pushes[:, :PART] + pushes[:, PART : 2 * PART] + pushes[:, 2 * PART :]
    while pushes.shape[1] > 1:
        half = pushes.shape[1] // 2
        pushes = pushes[:, :half] + pushes[:, half:]
    return pushes[:, 0]


Rows = tuple[Float[Array, "N"], ...]


def sum_pairs(
    law: Callable, near: Neighbors | None, reach: Float[Array, ""], shared: PyTree, own: Rows, other: Rows
) -> PyTree:
    """Sums a law of one pair over the others, for each person: the numbers of the law as arrays (N,).

    Args:
        law: ``law(shared, own, other) -> numbers``, of one pair in scalars; a pytree of numbers, zero for a person with
            itself, for absent people, and beyond ``reach``. It closes over nothing that is traced.
        near: the neighbors of each person within reach; None: not known.
        reach: m.
        shared: a pytree of floats, such as the parameters of the law.
        own: rows of the persons on whom the law acts; the first two are x and y [m].
        other: rows of the others, ``ABSENT`` for absent people; the first two are x and y [m].
    """
    # One array: reverse mode would sum the cotangent of each number over people and scenarios in a kernel of its own.
    numbers, unravel = ravel_pytree(shared)
    leaves, structure = jax.tree.flatten(shared)
    scalars = not any(map(jnp.ndim, leaves))

    def law_of_numbers(numbers: Sequence[Array], own: Rows, other: Rows) -> PyTree:
        return law(structure.unflatten(numbers) if scalars else unravel(jnp.stack(numbers)), own, other)

    return _sum_pairs(law_of_numbers, near, reach, numbers, own, other)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _sum_pairs(law: Callable, near: Neighbors | None, reach: Array, shared: Array, own: Rows, other: Rows) -> PyTree:
    """``sum_pairs``, of a law that takes the numbers of the vector ``shared`` as a sequence."""
    program = kernel.trace(law, near, shared, own, other)

    def on_cpu(near: Neighbors | None, shared: Array, own: Rows, other: Rows) -> PyTree:
        numbers = jnp.unstack(shared)
        if near is not None:
            return sum_near(law, near, numbers, jnp.stack(own), jnp.stack(other))
        return _sum_all(law, 1, numbers, own, other)

    def default(near: Neighbors | None, shared: Array, own: Rows, other: Rows) -> PyTree:
        if program is not None:
            sums = kernel.sum_pairs(program, near, reach, shared, own, other)
            return jax.tree.unflatten(_structure(law, jnp.unstack(shared), own, other), list(sums))
        if near is not None:
            return on_cpu(near, shared, own, other)
        return _sum_by_two(law, jnp.unstack(shared), own, other)

    return by_platform(on_cpu, default)(near, shared, own, other)


@_sum_pairs.defjvp
def _jvp(law: Callable, primals: tuple, tangents: tuple) -> tuple:
    sums = _sum_pairs(law, *primals)
    change = linear_call(partial(_forward, law), partial(_backward, law), primals, tangents[2:], sums)
    return sums, change


def _structure(law: Callable, shared: PyTree, own: Rows, other: Rows) -> Any:
    """The structure of the numbers of the law."""
    one = (tuple(jax.ShapeDtypeStruct((), row.dtype) for row in rows) for rows in (own, other))
    return jax.tree.structure(jax.eval_shape(law, shared, *one))


def _forward(law: Callable, primals: tuple, tangents: tuple) -> PyTree:
    """The derivative of the sums: the sums of the derivative of the law."""
    near, reach, *values = primals
    shared, own, other = zip(values, tangents, strict=True)

    def derivative(*rows: Sequence[Array]) -> PyTree:
        values, changes = zip(*((each[: len(each) // 2], each[len(each) // 2 :]) for each in rows), strict=True)
        return jax.jvp(law, values, changes)[1]

    return _sum_pairs(derivative, near, reach, jnp.concatenate(shared), (*own[0], *own[1]), (*other[0], *other[1]))


def _backward(law: Callable, primals: tuple, cotangents: PyTree) -> tuple:
    """Cotangents of shared, own and other."""
    near, reach, shared, own, other = primals
    pulls, structure = jax.tree.flatten(cotangents)
    rows = *own, *other, *pulls
    first, second = len(own), len(own) + len(other)

    def of_pair(shared: Sequence[Array], person: Rows, another: Rows) -> tuple:
        """What each person does to the other, and the other to the person."""

        def pull_back(person: Rows, another: Rows) -> tuple:
            pulls = structure.unflatten(person[second:])
            return jax.vjp(law, shared, person[:first], another[first:second])[1](pulls)

        return *pull_back(person, another)[:2], pull_back(another, person)[2]

    program = kernel.trace(of_pair, near, shared, rows, rows)

    def on_cpu(near: Neighbors | None, shared: Array, own: Rows, other: Rows, pulls: Rows) -> tuple:
        numbers = jnp.unstack(shared)
        if near is None:
            d_shared, d_own, d_other = _pull_back_at_once(law, numbers, own, other, structure.unflatten(pulls))
        else:
            d_shared, d_own, d_other = pull_back_near(law, near, numbers, *map(jnp.stack, (own, other, pulls)))
        return jnp.stack(d_shared), tuple(d_own), tuple(d_other)

    def default(near: Neighbors | None, shared: Array, own: Rows, other: Rows, pulls: Rows) -> tuple:
        if program is not None:
            rows = *own, *other, *pulls
            sums = kernel.sum_pairs(program, near, reach, shared, rows, rows)
            d_shared, d_own, d_other = jnp.split(sums, (len(shared), len(shared) + first))
            return d_shared.sum(1), tuple(d_own), tuple(d_other)
        if near is not None:
            return on_cpu(near, shared, own, other, pulls)
        d_shared, *d_rows = _pull_back_in_two(law, jnp.unstack(shared), own, other, structure.unflatten(pulls))
        return jnp.stack(d_shared), *d_rows

    return by_platform(on_cpu, default)(near, shared, own, other, tuple(pulls))


def _sum_all(law: Callable, turns: int, shared: PyTree, own: Rows, other: Rows) -> PyTree:
    """The sums over all others, ``turns`` at a time first."""
    nobody = (0, -len(other[0]) % turns)
    other = tuple(jnp.pad(row, nobody, constant_values=ABSENT).reshape(turns, -1) for row in other)

    def sum_turns(shared: PyTree, own: Rows, others: Rows) -> PyTree:
        turn = lambda total, one: (jax.tree.map(jnp.add, total, law(shared, own, one)), None)  # noqa: E731
        shapes = jax.eval_shape(law, shared, own, tuple(row[0] for row in others))
        nothing = jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), shapes)
        return jax.lax.scan(turn, nothing, others, unroll=turns)[0]

    each = jax.vmap(jax.vmap(sum_turns, in_axes=(None, None, 1)), in_axes=(None, 0, None))
    numbers, structure = jax.tree.flatten(each(shared, own, other))
    return structure.unflatten(sum_in_pairs(numbers, 1))


def _sum_by_two(law: Callable, shared: PyTree, own: Rows, other: Rows) -> PyTree:
    """The sums over all others, for a GPU.

    Each thread takes two others, so it reads its person's rows half as often: a fifth less time. For a law of two
    numbers XLA makes one kernel of all pairs and their sums; more numbers it writes to memory for each pair. So every
    two numbers are a sum of their own behind a barrier, in which a thread takes ``TURNS`` others. XLA then makes one
    kernel of these sums as well, and writes no pair (``benchmarks/kernels.py`` shows it).
    """
    structure = _structure(law, shared, own, other)
    if structure.num_leaves <= 2:
        return _sum_all(law, 2, shared, own, other)
    sums = []
    for first in range(0, structure.num_leaves, 2):
        two = partial(_numbers, law, slice(first, first + 2))
        sums += _sum_all(two, TURNS, shared, *jax.lax.optimization_barrier((own, other)))
    return structure.unflatten(sums)


def _numbers(law: Callable, which: slice, *pair: PyTree) -> list[Array]:
    """Some of the numbers of the law, in a list."""
    return jax.tree.leaves(law(*pair))[which]


def _pull_back_at_once(law: Callable, shared: PyTree, own: Rows, other: Rows, pulls: PyTree) -> tuple:
    """JAX's own cotangents, from arrays of all pairs: quickest on a CPU."""
    return jax.vjp(partial(_sum_all, law, 1), shared, own, other)[1](pulls)


def _pull_back_in_two(law: Callable, shared: PyTree, own: Rows, other: Rows, pulls: PyTree) -> tuple:
    """The cotangents by two sums, over the others and over the persons, each in one reduction.

    XLA for a GPU writes fewer numbers of each pair than in ``_pull_back_at_once``: the numbers that both sums share.
    """

    def of_pair(own: Rows, other: Rows, pulls: PyTree) -> tuple:
        return jax.vjp(law, shared, own, other)[1](pulls)

    by_own = jax.vmap(jax.vmap(of_pair, (None, 0, None)), (0, None, 0))
    by_other = jax.vmap(jax.vmap(of_pair, (0, None, 0)), (None, 0, None))
    d_shared, d_own = _sum_leaves(by_own(own, other, pulls)[:2])
    return jax.tree.map(lambda leaf: leaf.sum(0), d_shared), d_own, _sum_leaves(by_other(own, other, pulls)[2])


def _sum_leaves(tree: PyTree) -> PyTree:
    """The sums over the last axis of all leaves, in one reduction."""
    leaves, structure = jax.tree.flatten(tree)
    add = lambda one, other: tuple(map(jnp.add, one, other))  # noqa: E731
    zeros = tuple(jnp.zeros((), leaf.dtype) for leaf in leaves)
    return structure.unflatten(jax.lax.reduce(tuple(leaves), zeros, add, (1,)))
