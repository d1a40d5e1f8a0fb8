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
    # Who is a neighbor has no derivative. Absent people may be anywhere; far off they would cost all precision.
    position = jax.lax.stop_gradient(position)
    within = jax.lax.stop_gradient(within)
    x, y = (_from_min(values, present) for values in position.T)  # (N,) m

    # An infinite reach becomes a length, as 0 * inf is no number.
    size_x = jnp.max(x)
    size_y = jnp.max(y)
    within = jnp.minimum(within, 2.0 * (size_x + size_y) + 1.0)

    # At least ``up`` of the distance is across strips, so the rest along one is half a chord of a circle.
    strip = jnp.floor(y / within)  # (N,)
    n_strips = jnp.max(strip) + 2.0
    rounding = 1e-6 * (size_x + 2.0 * within + 1.0) * n_strips
    up = y - strip * within  # from the own strip's lower edge
    down = within - up
    below = _half_chord(within, up - rounding) + rounding
    above = _half_chord(within, down - rounding) + rounding

    # Strips lie one behind the other on a line, so one sort orders people by strip and x; its rounding widens runs.
    within = within + rounding
    width = size_x + 2.0 * within + 1.0
    people = jnp.arange(x.shape[0], dtype=jnp.int32)
    along = strip * width + x
    along, order = jax.lax.sort((along, people), num_keys=1)

    # Neighbors in a strip are one run of the sorted line, so two searches give its begin and end.
    middle = jnp.stack([along - width, along, along + width], 1)  # (N, 3)
    half = jnp.stack([below[order], jnp.full_like(below, within), above[order]], 1)
    first, last = _search_lines(along, middle - half, middle + half)

    # Blocks wait for their longest run, so people with runs of similar length share a block.
    most_first = -_parts(first, last)
    _, by_parts = jax.lax.sort((most_first, people), num_keys=1)
    rank = jnp.zeros_like(order)
    rank = rank.at[order[by_parts]].set(people, unique_indices=True)
    return Neighbors(order, first, last, by_parts, rank)


def _search_lines(row: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """``_search``, on a GPU in a kernel if there is one."""
    in_kernel = gpu_kernels.available() and row.dtype == np.float32
    default = kernel.search if in_kernel else _search
    search = by_platform(_search, default)
    return search(row, low, high)


def _search(row: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Where in a sorted row the values begin that are at least ``low``, and end that are at most ``high``."""
    find_in_row = partial(jnp.searchsorted, row, method="scan_unrolled")
    first = find_in_row(low, side="left").astype(jnp.int32)
    last = find_in_row(high, side="right").astype(jnp.int32)
    return first, last


def _half_chord(radius: Array, apart: Array) -> Array:
    """Half the length of a circle's chord at that distance from its middle."""
    square = radius * radius - jnp.maximum(apart, 0.0) ** 2
    return jnp.sqrt(jnp.maximum(square, 0.0))


def _from_min(values: Array, present: Array) -> Array:
    """(N,) the values above the minimum of the people present; 0 for absent people."""
    minimum = jnp.min(jnp.where(present, values, jnp.inf))
    return jnp.where(present, values - minimum, 0.0)


def sum_near(
    law: Callable, near: Neighbors, shared: PyTree, own: Float[Array, "A N"], other: Float[Array, "B N"]
) -> PyTree:
    """``sum_pairs`` over neighbors, with rows and shared numbers as arrays. Reverse mode needs ``pull_back_near``."""
    sorted_other = other[:, near.order]  # (B, N)
    shapes = jax.eval_shape(law, shared, own[:, 0], other[:, 0])
    numbers, structure = jax.tree.flatten(shapes)

    def block(runs: Runs, own: Array) -> tuple:
        def add(part: Array, sums: tuple) -> tuple:
            others, valid = _window(runs, sorted_other, part)
            part_sums = _sum_part(law, shared, own, others, valid)
            return jax.tree.map(jnp.add, sums, part_sums)

        zeros = tuple(jnp.zeros_like(own[0]) for _ in numbers)
        sums = _over_parts(runs, add, zeros)
        return sums, None

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
    # The pulls travel with a person's rows: on the way back a neighbor is also the one that is acted on.
    n_own = len(own)
    n_rows = n_own + len(other)
    sorted_other = other[:, near.order]  # (B, N)
    sorted_own = jnp.concatenate([own, pulls])[:, near.order]  # (A + C, N)

    def pulled_law(shared: PyTree, other: Array, own: tuple) -> Array:
        """The numbers of the law times the pulls on them, with the other as the person."""
        numbers = jax.tree.leaves(law(shared, own[:n_own], other))
        products = map(jnp.multiply, numbers, own[n_own:])
        return reduce(jnp.add, products)

    def block(runs: Runs, rows: Array) -> tuple:
        own = rows[:n_own]
        other = rows[n_own:n_rows]
        pulls = rows[n_rows:]

        def add(part: Array, sums: tuple) -> tuple:
            # What others do to the person ...
            others, valid = _window(runs, sorted_other, part)
            by_others = partial(_sum_part, law, others=others, valid=valid)
            _, pull = jax.vjp(by_others, shared, own)
            d_shared, d_own = pull(tuple(pulls))

            # ... and what the person does to them.
            persons, valid = _window(runs, sorted_own, part)
            by_persons = partial(_sum_part, pulled_law, shared, others=persons, valid=valid)
            _, pull = jax.vjp(by_persons, other)
            one = jnp.ones_like(pulls[0])
            (d_other,) = pull((one,))
            cotangents = (*d_own, *d_other), d_shared
            return jax.tree.map(jnp.add, sums, cotangents)

        # Shared numbers act in all pairs, so their cotangent is one sum over people and blocks.
        zeros = jax.tree.map(jnp.zeros_like, ((*own, *other), shared))
        return _over_parts(runs, add, zeros)

    # Blocks are sorted by length of runs; rows go back into the order of the people.
    rows = jnp.concatenate([own, other, pulls])
    d_rows, d_shared = _over_blocks(near, block, rows)
    d_rows = jnp.stack([row[near.rank] for row in d_rows])
    return d_shared, d_rows[:n_own], d_rows[n_own:]


class Runs(NamedTuple):
    """The runs of the people of a block."""

    first: Array  # (N, 3) int32
    last: Array  # (N, 3) int32


def _over_blocks(near: Neighbors, block: Callable, rows: Array) -> tuple:
    """Applies ``block(runs, rows (R, n)) -> (tuple of (n,), totals)`` to all blocks of people.

    The result is the tuple of (N,), by number of parts as ``near.by_parts``, and the sum of the totals.
    """
    n_people = near.by_parts.shape[0]
    size = -(-n_people // BLOCKS)

    def split(values: Array) -> Array:  # (N, ...) to (BLOCKS, n, ...), padded with zeros, that is with empty runs
        padding = [(0, 0)] * values.ndim
        padding[0] = (0, BLOCKS * size - n_people)
        padded = jnp.pad(values, padding)
        return padded.reshape(BLOCKS, size, *values.shape[1:])

    def apply(arguments: tuple[Runs, Array]) -> tuple:
        runs, rows = arguments
        return block(runs, rows.T)

    people = near.order[near.by_parts]
    first = split(near.first[near.by_parts])
    last = split(near.last[near.by_parts])
    rows = split(rows[:, people].T)
    results, totals = jax.lax.map(apply, (Runs(first, last), rows))
    results = tuple(row.reshape(-1)[:n_people] for row in results)
    return results, _sum_first(totals)


@jax.named_scope("neighbors")
def _over_parts(runs: Runs, add: Callable, sums: PyTree) -> PyTree:
    """The sums after ``add(part, sums)`` for as many parts as the longest run has."""
    n_parts = jnp.max(_parts(runs.first, runs.last))

    def has_part(carry: tuple[Array, PyTree]) -> Array:
        part, _ = carry
        return part < n_parts

    def add_next(carry: tuple[Array, PyTree]) -> tuple[Array, PyTree]:
        part, sums = carry
        return part + 1, add(part, sums)

    _, sums = jax.lax.while_loop(has_part, add_next, (jnp.int32(0), sums))
    return sums


def _parts(first: Array, last: Array) -> Array:
    """(N,) int32: number of parts of the longest of each person's runs (N, 3)."""
    longest = jnp.max(last - first, 1)
    return (longest + PART - 1) // PART


def _window(runs: Runs, rows: Array, part: Array) -> tuple[tuple[Array, ...], Array]:
    """For each of the rows (R, N) the values (N, 3 PART) in that part of everybody's runs, and which are valid."""
    begin = runs.first + PART * part  # (N, 3)
    step = jnp.arange(PART, dtype=jnp.int32)
    place = begin[:, :, None] + step[None, None, :]  # (N, 3, PART)
    valid = place < runs.last[:, :, None]
    padded = jnp.pad(rows, ((0, 0), (0, PART)))

    def cut(row: Array) -> Array:
        def cut_at(start: Array) -> Array:
            return jax.lax.dynamic_slice(row, (start,), (PART,))

        # A CPU cuts once, a GPU where it needs the values.
        values = jax.vmap(jax.vmap(cut_at))(begin)  # (N, 3, PART)
        values = jax.lax.platform_dependent(values, cpu=jax.lax.optimization_barrier, default=lambda values: values)
        return values.reshape(-1, 3 * PART)

    windows = tuple(cut(row) for row in padded)
    return windows, valid.reshape(-1, 3 * PART)


def _sum_part(law: Callable, shared: PyTree, own: Array, others: tuple[Array, ...], valid: Array) -> tuple[Array, ...]:
    """(N,) each number of the law, summed over a part of everybody's runs."""
    by_others = jax.vmap(law, in_axes=(None, None, 0))
    on_people = jax.vmap(by_others, in_axes=(None, 1, 0))
    numbers = jax.tree.leaves(on_people(shared, own, others))  # (N, 3 PART) each
    numbers = tuple(jnp.where(valid, values, 0.0) for values in numbers)
    return jax.lax.platform_dependent(numbers, cpu=_sum_each_by_halves, default=partial(sum_in_pairs, axis=1))


def _sum_each_by_halves(numbers: tuple[Array, ...]) -> tuple[Array, ...]:
    """``_sum_by_halves`` of each, two at a time as complex numbers."""
    sums = []
    for i in range(0, len(numbers) - 1, 2):
        both = jax.lax.complex(numbers[i], numbers[i + 1])
        total = _sum_by_halves(both)
        sums += [total.real, total.imag]
    if len(numbers) % 2:
        sums.append(_sum_by_halves(numbers[-1]))
    return tuple(sums)


def _sum_by_halves(pushes: Array) -> Array:
    """(N,) the sums of (N, 3 PART); XLA for a CPU adds them up one after the other, which takes three times as long."""
    pushes = jax.lax.optimization_barrier(pushes)
    below = pushes[:, :PART]
    own = pushes[:, PART : 2 * PART]
    above = pushes[:, 2 * PART :]
    pushes = below + own + above
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
        if scalars:
            shared = structure.unflatten(numbers)
        else:
            shared = unravel(jnp.stack(numbers))
        return law(shared, own, other)

    return _sum_pairs(law_of_numbers, near, reach, numbers, own, other)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _sum_pairs(law: Callable, near: Neighbors | None, reach: Array, shared: Array, own: Rows, other: Rows) -> PyTree:
    """``sum_pairs``, of a law that takes the numbers of the vector ``shared`` as a sequence."""
    program = kernel.trace(law, near, shared, own, other)

    def on_cpu(near: Neighbors | None, shared: Array, own: Rows, other: Rows) -> PyTree:
        numbers = jnp.unstack(shared)
        if near is None:
            return _sum_all(law, 1, numbers, own, other)
        own_rows = jnp.stack(own)  # (A, N)
        other_rows = jnp.stack(other)  # (B, N)
        return sum_near(law, near, numbers, own_rows, other_rows)

    def default(near: Neighbors | None, shared: Array, own: Rows, other: Rows) -> PyTree:
        if near is not None and program is None:
            return on_cpu(near, shared, own, other)
        numbers = jnp.unstack(shared)
        if program is None:
            return _sum_by_two(law, numbers, own, other)
        sums = kernel.sum_pairs(program, near, reach, shared, own, other)
        structure = _structure(law, numbers, own, other)
        return structure.unflatten(list(sums))

    return by_platform(on_cpu, default)(near, shared, own, other)


@_sum_pairs.defjvp
def _jvp(law: Callable, primals: tuple, tangents: tuple) -> tuple:
    sums = _sum_pairs(law, *primals)
    forward = partial(_forward, law)
    backward = partial(_backward, law)
    change = linear_call(forward, backward, primals, tangents[2:], sums)  # near and reach have no tangents
    return sums, change


def _structure(law: Callable, shared: PyTree, own: Rows, other: Rows) -> Any:
    """The structure of the numbers of the law."""
    own_scalars = [jax.ShapeDtypeStruct((), row.dtype) for row in own]
    other_scalars = [jax.ShapeDtypeStruct((), row.dtype) for row in other]
    numbers = jax.eval_shape(law, shared, own_scalars, other_scalars)
    return jax.tree.structure(numbers)


def _forward(law: Callable, primals: tuple, tangents: tuple) -> PyTree:
    """The derivative of the sums: the sums of the derivative of the law."""
    near, reach, shared, own, other = primals
    d_shared, d_own, d_other = tangents

    def derivative(*rows: Sequence[Array]) -> PyTree:
        values, tangents = zip(*map(_halves, rows), strict=True)
        _, changes = jax.jvp(law, values, tangents)
        return changes

    # Tangents are further rows, behind the values.
    shared = jnp.concatenate([shared, d_shared])
    own = *own, *d_own
    other = *other, *d_other
    return _sum_pairs(derivative, near, reach, shared, own, other)


def _halves(rows: Sequence[Array]) -> tuple[Sequence[Array], Sequence[Array]]:
    """Values, and the tangents behind them."""
    middle = len(rows) // 2
    return rows[:middle], rows[middle:]


def _backward(law: Callable, primals: tuple, cotangents: PyTree) -> tuple:
    """Cotangents of shared, own and other."""
    near, reach, shared, own, other = primals
    pulls, structure = jax.tree.flatten(cotangents)

    # In a kernel both bodies of a pair have the same rows, for each of them is the person once.
    rows = *own, *other, *pulls
    pull_law = partial(_pull_back_pair, law, structure, len(own), len(other))
    program = kernel.trace(pull_law, near, shared, rows, rows)

    # Small crowds keep arrays of all pairs; large ones compute the law again along the runs.
    def on_cpu(near: Neighbors | None, shared: Array, own: Rows, other: Rows, pulls: Rows) -> tuple:
        numbers = jnp.unstack(shared)
        if near is None:
            pull_tree = structure.unflatten(pulls)
            d_shared, d_own, d_other = _pull_back_at_once(law, numbers, own, other, pull_tree)
        else:
            own_rows, other_rows, pull_rows = map(jnp.stack, (own, other, pulls))
            d_shared, d_own, d_other = pull_back_near(law, near, numbers, own_rows, other_rows, pull_rows)
        return jnp.stack(d_shared), tuple(d_own), tuple(d_other)

    def default(near: Neighbors | None, shared: Array, own: Rows, other: Rows, pulls: Rows) -> tuple:
        if near is not None and program is None:
            return on_cpu(near, shared, own, other, pulls)
        if program is None:
            numbers = jnp.unstack(shared)
            pull_tree = structure.unflatten(pulls)
            d_shared, d_own, d_other = _pull_back_in_two(law, numbers, own, other, pull_tree)
            return jnp.stack(d_shared), d_own, d_other

        # The sums are the cotangents of shared numbers, of own rows and of other rows, in this order.
        rows = *own, *other, *pulls
        sums = kernel.sum_pairs(program, near, reach, shared, rows, rows)
        n_shared = len(shared)
        d_shared, d_own, d_other = jnp.split(sums, (n_shared, n_shared + len(own)))
        return d_shared.sum(1), tuple(d_own), tuple(d_other)

    return by_platform(on_cpu, default)(near, shared, own, other, tuple(pulls))


def _pull_back_pair(
    law: Callable, structure: Any, n_own: int, n_other: int, shared: Sequence[Array], person: Rows, another: Rows
) -> tuple:
    """The cotangents of a pair: of what the other does to the person, and of what the person does to the other.

    Both have rows of a person, of an other, and the pulls on the numbers of the law.
    """
    n_rows = n_own + n_other

    def pull_back(person: Rows, another: Rows) -> tuple:
        own = person[:n_own]
        other = another[n_own:n_rows]
        pulls = structure.unflatten(person[n_rows:])
        _, pull = jax.vjp(law, shared, own, other)
        return pull(pulls)

    d_shared, d_own, _ = pull_back(person, another)
    _, _, d_other = pull_back(another, person)
    return d_shared, d_own, d_other


def _sum_all(law: Callable, turns: int, shared: PyTree, own: Rows, other: Rows) -> PyTree:
    """The sums over all others, ``turns`` at a time first."""
    missing = -len(other[0]) % turns
    padded = [jnp.pad(row, (0, missing), constant_values=ABSENT) for row in other]
    other = tuple(row.reshape(turns, -1) for row in padded)

    def sum_turns(shared: PyTree, own: Rows, others: Rows) -> PyTree:
        def add(total: PyTree, other: Rows) -> tuple[PyTree, None]:
            numbers = law(shared, own, other)
            total = jax.tree.map(jnp.add, total, numbers)
            return total, None

        first = tuple(row[0] for row in others)
        shapes = jax.eval_shape(law, shared, own, first)
        zeros = jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), shapes)
        total, _ = jax.lax.scan(add, zeros, others, unroll=turns)
        return total

    by_others = jax.vmap(sum_turns, in_axes=(None, None, 1))
    on_people = jax.vmap(by_others, in_axes=(None, 0, None))
    numbers, structure = jax.tree.flatten(on_people(shared, own, other))
    sums = sum_in_pairs(numbers, 1)
    return structure.unflatten(sums)


def _sum_by_two(law: Callable, shared: PyTree, own: Rows, other: Rows) -> PyTree:
    """The sums over all others, for a GPU.

    Each thread takes two others, so it reads its person's rows half as often: a fifth less time. For a law of two
    numbers XLA makes one kernel of all pairs and their sums; more numbers it writes to memory for each pair. So every
    two numbers are a sum of their own behind a barrier, in which a thread takes ``TURNS`` others. XLA then makes one
    kernel of these sums as well, and writes no pair (``benchmarks/kernels.py`` shows it).
    """
    structure = _structure(law, shared, own, other)
    n_numbers = structure.num_leaves
    if n_numbers <= 2:
        return _sum_all(law, 2, shared, own, other)
    sums = []
    for first in range(0, n_numbers, 2):
        pair_of_numbers = slice(first, first + 2)
        law_of_two = partial(_numbers, law, pair_of_numbers)
        own_rows, other_rows = jax.lax.optimization_barrier((own, other))
        sums += _sum_all(law_of_two, TURNS, shared, own_rows, other_rows)
    return structure.unflatten(sums)


def _numbers(law: Callable, which: slice, *pair: PyTree) -> list[Array]:
    """Some of the numbers of the law, in a list."""
    numbers = jax.tree.leaves(law(*pair))
    return numbers[which]


def _pull_back_at_once(law: Callable, shared: PyTree, own: Rows, other: Rows, pulls: PyTree) -> tuple:
    """JAX's own cotangents, from arrays of all pairs: quickest on a CPU."""
    _, pull = jax.vjp(partial(_sum_all, law, 1), shared, own, other)
    return pull(pulls)


def _pull_back_in_two(law: Callable, shared: PyTree, own: Rows, other: Rows, pulls: PyTree) -> tuple:
    """The cotangents by two sums, over the others and over the persons, each in one reduction.

    XLA for a GPU writes fewer numbers of each pair than in ``_pull_back_at_once``: the numbers that both sums share.
    """

    def pull_back(own: Rows, other: Rows, pulls: PyTree) -> tuple:
        _, pull = jax.vjp(law, shared, own, other)
        return pull(pulls)

    on_others = jax.vmap(pull_back, (None, 0, None))
    on_persons = jax.vmap(pull_back, (0, None, 0))
    by_own = jax.vmap(on_others, (0, None, 0))
    by_other = jax.vmap(on_persons, (None, 0, None))
    d_shared, d_own, _ = by_own(own, other, pulls)
    d_shared, d_own = _sum_leaves((d_shared, d_own))
    d_shared = _sum_first(d_shared)
    _, _, d_other = by_other(own, other, pulls)
    d_other = _sum_leaves(d_other)
    return d_shared, d_own, d_other


def _sum_first(tree: PyTree) -> PyTree:
    """The sums over the first axis of all leaves."""
    return jax.tree.map(lambda leaf: leaf.sum(0), tree)


def _sum_leaves(tree: PyTree) -> PyTree:
    """The sums over the last axis of all leaves, in one reduction."""
    leaves, structure = jax.tree.flatten(tree)

    def add(one: tuple, other: tuple) -> tuple:
        return tuple(map(jnp.add, one, other))

    zeros = tuple(jnp.zeros((), leaf.dtype) for leaf in leaves)
    sums = jax.lax.reduce(tuple(leaves), zeros, add, (1,))
    return structure.unflatten(sums)
