"""Sums over other people and over obstacles on a GPU, in one kernel each (Pallas, Mosaic GPU).

Each thread has one person. The others are all people, or in a large crowd the person's neighbors. A first loop sets a
bit for each of them within reach; a second loop evaluates the law for the set bits. Threads of a warp wait for the
person with the most neighbors.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr
from jaxtyping import Float

from sean_jax.core import gpu_kernels
from sean_jax.core.data_types import FAR, Array, ObstacleGrid
from sean_jax.core.geometry import obstacle_cells

BITS = 32
UNROLL = 8  # others whose distance is tested in one turn
MOST = 256  # people of a crowd without known neighbors
WORDS = 2  # in which the neighbors are tested at once
COLUMNS = 6  # of an obstacle

Rows = tuple[Array, ...]


class _Shape(NamedTuple):
    """Static parameters of a kernel."""

    law: ClosedJaxpr
    people: int
    own: int  # rows of a person
    other: int
    shared: int  # numbers


def trace(law: Callable, near: Any, shared: Array, own: Rows, other: Rows) -> ClosedJaxpr | None:
    """The law of a pair as a program, if the kernel can sum it: in single precision, elementwise functions.

    The crowd has 1 to 256 people, or known neighbors. The law takes the shared numbers as a sequence of scalars.
    """
    people = own[0].shape[0]
    if not people or (near is None and people > MOST) or not gpu_kernels.available():
        return None
    if any(leaf.dtype != np.float32 for leaf in (shared, *own, *other)):
        return None
    scalar = jax.ShapeDtypeStruct((), shared.dtype)
    program = jax.make_jaxpr(law)(*((scalar,) * len(rows) for rows in (shared, own, other)))
    return program if gpu_kernels.elementwise(program) else None


def sum_pairs(
    program: ClosedJaxpr, near: Any, reach: Array, shared: Float[Array, "P"], own: Rows, other: Rows
) -> Float[Array, "C N"]:
    """The numbers of the law, summed over the others within reach [m]. The first two rows are x and y [m]."""
    shape = _Shape(program, len(own[0]), len(own), len(other), len(shared))
    operands = [jnp.concatenate([(reach * reach)[None], shared])]
    if near is not None:
        places = jnp.stack(other[:2])[:, near.order]
        operands += [near.order, near.first.T.reshape(-1), near.last.T.reshape(-1), *places]
    (sums,) = gpu_kernels.batch(partial(_call, shape), 1)(*(each[None] for each in (*operands, *own, *other)))
    return sums.reshape(-1, shape.people)


class _All(NamedTuple):
    """The others of a person: everybody."""

    itself: Any  # () int32, the person's number among them
    people: int

    @property
    def words(self) -> int:
        """In which they are tested at once."""
        return -(-self.people // BITS)

    def column(self, number: Any) -> Any:
        """Where among the places one is."""
        return number

    person = column

    def valid(self, number: Any, near: Any) -> Any:
        """Whether one is near, and there."""
        return near

    def turns(self, at: int) -> tuple[int, range]:
        """Turns of ``UNROLL`` in the word that begins there, and the rest."""
        count = min(BITS, self.people - at)
        return count // UNROLL, range(count // UNROLL * UNROLL, count)

    def over_parts(self, part: Callable, sums: tuple) -> tuple:
        """The sums after ``part(at, sums)`` for each part."""
        return part(0, sums)


class _Runs:
    """The others of a person in a large crowd: three runs of the sorted people."""

    words = WORDS

    def __init__(self, first: list, last: list, place: Any, people: int, person_at: Callable) -> None:
        below, own, above = (end - begin for begin, end in zip(first, last, strict=True))
        self.bounds, self.count = (below, below + own), below + own + above
        self.starts = first[0], first[1] - below, first[2] - below - own
        self.itself, self.people, self.person_at = below + place - first[1], people, person_at

    def column(self, number: Any) -> Any:
        """Where in the sorted crowd one is."""
        start = jnp.where(number < self.bounds[1], self.starts[1], self.starts[2])
        start = jnp.where(number < self.bounds[0], self.starts[0], start)
        return jnp.minimum(number + start, self.people - 1)

    def person(self, number: Any) -> Any:
        """Where in the rows one is."""
        return self.person_at(self.column(number))

    def valid(self, number: Any, near: Any) -> Any:
        """Whether one is near, and there."""
        return near & (number < self.count)

    def turns(self, at: Any) -> tuple[Any, tuple]:
        """Turns of ``UNROLL`` in the word that begins there."""
        left = jax.lax.div(self.count - at + (UNROLL - 1), np.int32(UNROLL))
        return jnp.minimum(left, BITS // UNROLL), ()

    def over_parts(self, part: Callable, sums: tuple) -> tuple:
        """The sums after ``part(at, sums)`` for each part."""

        def turn(carry: tuple) -> tuple:
            at, sums = carry
            return at + self.words * BITS, part(at, sums)

        return jax.lax.while_loop(lambda carry: carry[0] < self.count, turn, (np.int32(0), sums))[1]


def _call(shape: _Shape, *operands: Array, interpret: bool = False) -> tuple[Array, ...]:
    """The kernel, for operands of ``kernels.Call``."""
    scenarios = max(operand.shape[0] for operand in operands)
    columns = len(shape.law.out_avals) * shape.people
    out = (jax.ShapeDtypeStruct((scenarios, columns), operands[0].dtype),)
    threads = scenarios * shape.people
    return gpu_kernels.launch_threads(partial(_kernel, shape), "pairs", threads, out, *operands, interpret=interpret)


def _kernel(shape: _Shape, number: Any, *references: Any) -> None:
    """One thread: the sums of one person."""
    people = shape.people
    scenario, place = jax.lax.div(number, np.int32(people)), jax.lax.rem(number, np.int32(people))
    *inputs, result = references
    inputs = [(each, gpu_kernels.row(each, scenario, result.shape[0])) for each in inputs]
    (numbers_of, numbers_at), *runs_of = inputs[: -shape.own - shape.other]
    square, *shared = (numbers_of[numbers_at, i] for i in range(shape.shared + 1))
    own_of, other_of = inputs[-shape.own - shape.other : -shape.other], inputs[-shape.other :]
    if runs_of:
        (order, order_at), *ends = runs_of[:3]
        person = order[order_at, place]
        first, last = ([each[each_at, run * people + place] for run in range(3)] for each, each_at in ends)
        others = _Runs(first, last, place, people, lambda column: order[order_at, column])
    else:
        person, others = place, _All(place, people)
    (x, x_at), (y, y_at) = runs_of[3:] or other_of[:2]
    own = [row[row_at, person] for row, row_at in own_of]

    def bit(at: Any, j: Any) -> Any:
        column = others.column(at + j)
        dx, dy = own[0] - x[x_at, column], own[1] - y[y_at, column]
        inside = others.valid(at + j, dx * dx + dy * dy < square)
        return jnp.where(inside, jax.lax.shift_left(np.int32(1), jnp.int32(j)), np.int32(0))

    def word(at: Any) -> Any:
        def turn(k: Any, bits: Any) -> Any:
            for j in range(UNROLL):
                bits = bits | bit(at, k * UNROLL + j)
            return bits

        turns, rest = others.turns(at)
        bits = np.int32(0)
        if not isinstance(turns, int) or turns:
            bits = jax.lax.fori_loop(0, turns, turn, bits)
        for j in rest:
            bits = bits | bit(at, j)
        itself = others.itself - at
        mine = jax.lax.shift_left(np.int32(1), itself & (BITS - 1))
        return bits & ~jnp.where((itself >= 0) & (itself < BITS), mine, np.int32(0))

    def some(carry: tuple) -> Any:
        words, _ = carry
        left = words[0]
        for each in words[1:]:
            left = left | each
        return left != 0

    def add(at: Any, carry: tuple) -> tuple:
        words, sums = carry
        current, which = words[-1], np.int32(len(words) - 1)
        for i, each in reversed(list(enumerate(words[:-1]))):
            current, which = jnp.where(each != 0, each, current), jnp.where(each != 0, np.int32(i), which)
        rest = [jnp.where(which == i, current & (current - 1), each) for i, each in enumerate(words)]
        one = others.person(at + which * BITS + (BITS - 1) - jax.lax.clz(current & -current))
        other = [row[row_at, one] for row, row_at in other_of]
        pushes = gpu_kernels.evaluate(shape.law, *shared, *own, *other)
        return tuple(rest), tuple(map(jnp.add, sums, pushes))

    def part(at: Any, sums: tuple) -> tuple:
        words = tuple(word(at + i * BITS) for i in range(others.words))
        with jax.named_scope("within_reach"):
            return jax.lax.while_loop(some, partial(add, at), (words, sums))[1]

    zero = square.dtype.type(0.0)  # zeros_like is an array, which Mosaic refuses
    sums = others.over_parts(part, (zero,) * len(shape.law.out_avals))
    for row, value in enumerate(sums):
        result[scenario, row * people + person] = value


def search(row: Float[Array, "N"], low: Float[Array, "..."], high: Float[Array, "..."]) -> tuple[Array, Array]:
    """Where in a sorted row the values begin that are at least ``low``, and end that are at most ``high``."""
    operands = (each.reshape(1, -1) for each in (row, low, high))
    first, last = gpu_kernels.batch(_call_search, 2)(*operands)
    return first.reshape(low.shape), last.reshape(low.shape)


def _call_search(*operands: Array, interpret: bool = False) -> tuple[Array, ...]:
    """The kernel, for operands of ``kernels.Call``."""
    shape = max(operand.shape[0] for operand in operands), operands[1].shape[1]
    out = (jax.ShapeDtypeStruct(shape, jnp.int32),) * 2
    return gpu_kernels.launch_threads(_search, "search", math.prod(shape), out, *operands, interpret=interpret)


def _search(number: Any, *references: Any) -> None:
    """One thread: both ends of one run."""
    queries = np.int32(references[1].shape[1])
    scenario, query = jax.lax.div(number, queries), jax.lax.rem(number, queries)
    scenarios = references[3].shape[0]
    (row, row_at), *bounds = ((each, gpu_kernels.row(each, scenario, scenarios)) for each in references[:3])
    length = row.shape[1]
    for (bound, bound_at), result, before in zip(bounds, references[3:], (jax.lax.lt, jax.lax.le), strict=True):
        value = bound[bound_at, query]

        def halve(_: Any, ends: tuple, value: Any = value, before: Callable = before) -> tuple:
            low, high = ends
            middle = jax.lax.div(low + high, np.int32(2))
            later = before(row[row_at, jnp.minimum(middle, length - 1)], value) & (low < high)
            return jnp.where(later, middle + 1, low), jnp.where(later, high, middle)

        ends = jax.lax.fori_loop(0, length.bit_length(), halve, (np.int32(0), np.int32(length)))
        result[scenario, query] = ends[0]


def at_obstacles(function: Callable, px: Array, py: Array, grid: ObstacleGrid, *arguments: Any) -> tuple[Array, ...]:
    """(N,) the results of ``function(over, px, py, *arguments)``, in scalars of one person.

    ``over(step, start)`` gives the total after ``total = step(total, row)`` for the rows of the obstacles of the
    person's cell. Arguments are (N,) or for all people.
    """
    leaves, structure = jax.tree.flatten(arguments)
    rows = px, py, *(leaf for leaf in leaves if jnp.ndim(leaf))
    shared = [leaf for leaf in leaves if not jnp.ndim(leaf)]
    own = tuple(bool(jnp.ndim(leaf)) for leaf in leaves)
    cells = jnp.ravel_multi_index(obstacle_cells(grid, px, py), grid.rows.shape[:2], mode="clip").astype(jnp.int32)
    operands = grid.rows.reshape(-1), jnp.stack([px.dtype.type(0.0), *shared]), cells, *rows
    call = partial(_call_obstacles, function, structure, own, grid.rows.shape[2])
    (results,) = gpu_kernels.batch(call, 1)(*(each[None] for each in operands))
    return tuple(results.reshape(-1, len(px)))


def _call_obstacles(
    function: Callable, structure: Any, own: tuple[bool, ...], count: int, *operands: Array, interpret: bool = False
) -> tuple[Array, ...]:
    """The kernel, for operands of ``kernels.Call``."""
    scenarios, people = max(operand.shape[0] for operand in operands), operands[2].shape[1]
    out = (jax.ShapeDtypeStruct((scenarios, 2 * people), operands[0].dtype),)
    kernel = partial(_obstacles, function, structure, own, count, people)
    return gpu_kernels.launch_threads(kernel, "obstacles", scenarios * people, out, *operands, interpret=interpret)


def _obstacles(
    function: Callable, structure: Any, own: tuple[bool, ...], count: int, people: int, number: Any, *references: Any
) -> None:
    """One thread: the function of one person."""
    scenario, person = jax.lax.div(number, np.int32(people)), jax.lax.rem(number, np.int32(people))
    *inputs, result = references
    (table, table_at), (shared, shared_at), (cells, cells_at), *rows = (
        (each, gpu_kernels.row(each, scenario, result.shape[0])) for each in inputs
    )
    px, py, *each = (row[row_at, person] for row, row_at in rows)
    numbers, each = (shared[shared_at, 1 + i] for i in range(len(own) - sum(own))), iter(each)
    arguments = structure.unflatten([next(each if one else numbers) for one in own])
    first, columns = cells[cells_at, person] * (count * COLUMNS), range(COLUMNS)

    def over(step: Callable, start: Any) -> Any:
        def some(carry: tuple) -> Any:
            return (carry[0] < count) & (table[table_at, first + jnp.minimum(carry[0], count - 1) * COLUMNS] != FAR)

        def turn(carry: tuple) -> tuple:
            k, total = carry
            return k + 1, step(total, tuple(table[table_at, first + k * COLUMNS + column] for column in columns))

        return jax.lax.while_loop(some, turn, (np.int32(0), start))[1]

    for part, value in enumerate(function(over, px, py, *arguments)):
        result[scenario, part * people + person] = value
