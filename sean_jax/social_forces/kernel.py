"""Sums over other people and over obstacles on a GPU, in one kernel each (Pallas, Mosaic GPU).

Each thread has one person. The others are all people, or in a large crowd the person's neighbors. A first loop sets a
bit for each of them within reach; a second loop evaluates the law for the set bits. Threads of a warp wait for the
person with the most neighbors.
"""

from collections.abc import Callable, Iterable, Sequence
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


class _PairsShape(NamedTuple):
    """Static parameters of a kernel."""

    law: ClosedJaxpr
    people: int
    own: int  # rows of a person
    other: int
    shared: int  # numbers


class _Row(NamedTuple):
    """The row of a scenario in an operand."""

    reference: Any
    index: Any  # () int32

    def at(self, column: Any) -> Any:
        """The scalar in a column."""
        return self.reference[self.index, column]


def _rows(operands: Sequence[Any], scenario: Any, scenarios: int) -> list[_Row]:
    """The row of a scenario in each of the operands."""
    rows = []
    for operand in operands:
        index = gpu_kernels.row(operand, scenario, scenarios)
        rows.append(_Row(operand, index))
    return rows


def _scenarios(operands: Sequence[Array]) -> int:
    """The number of scenarios, for which an operand has rows unless it is shared."""
    return max(operand.shape[0] for operand in operands)


def _split(number: Any, size: int) -> tuple[Any, Any]:
    """The scenario of a thread, and its number in the scenario, which has ``size`` threads."""
    divisor = np.int32(size)
    scenario = jax.lax.div(number, divisor)
    place = jax.lax.rem(number, divisor)
    return scenario, place


def trace(law: Callable, near: Any, shared: Array, own: Rows, other: Rows) -> ClosedJaxpr | None:
    """The law of a pair as a program, if the kernel can sum it: in single precision, elementwise functions.

    The crowd has 1 to 256 people, or known neighbors. The law takes the shared numbers as a sequence of scalars.
    """
    people = own[0].shape[0]
    too_many = near is None and people > MOST
    if not people or too_many or not gpu_kernels.available():
        return None
    if any(leaf.dtype != np.float32 for leaf in (shared, *own, *other)):
        return None

    scalar = jax.ShapeDtypeStruct((), shared.dtype)
    arguments = [(scalar,) * len(numbers) for numbers in (shared, own, other)]
    program = jax.make_jaxpr(law)(*arguments)
    if not gpu_kernels.elementwise(program):
        return None
    return program


def sum_pairs(
    program: ClosedJaxpr, near: Any, reach: Array, shared: Float[Array, "P"], own: Rows, other: Rows
) -> Float[Array, "C N"]:
    """The numbers of the law, summed over the others within reach [m]. The first two rows are x and y [m]."""
    people = len(own[0])
    shape = _PairsShape(program, people, len(own), len(other), len(shared))
    square = reach * reach
    operands = [jnp.concatenate([square[None], shared])]
    if near is not None:
        position = jnp.stack(other[:2])  # (2, N) m
        sorted_x, sorted_y = position[:, near.order]
        first = near.first.T.reshape(-1)  # (3 N,)
        last = near.last.T.reshape(-1)
        operands += [near.order, first, last, sorted_x, sorted_y]

    # Operands have an axis of scenarios, here of one.
    operands = [operand[None] for operand in (*operands, *own, *other)]
    call = gpu_kernels.batch(partial(_call, shape), 1)
    (sums,) = call(*operands)
    return sums.reshape(-1, people)


class _All(NamedTuple):
    """The others of a person: everybody."""

    itself: Any  # () int32, the person's number among them
    people: int

    @property
    def words(self) -> int:
        """The number of words in which they are tested at once."""
        return -(-self.people // BITS)

    def column(self, number: Any) -> Any:
        """Where among the places one is."""
        return number

    person = column

    def valid(self, number: Any, near: Any) -> Any:
        """Whether one is near, and there."""
        return near

    def turns(self, begin: int) -> tuple[int, range]:
        """Turns of ``UNROLL`` in the word that begins there, and the rest."""
        count = min(BITS, self.people - begin)
        turns = count // UNROLL
        rest = range(turns * UNROLL, count)
        return turns, rest

    def over_parts(self, add_part: Callable, sums: tuple) -> tuple:
        """The sums after ``add_part(begin, sums)`` for each part."""
        return add_part(0, sums)


class _Runs:
    """The others of a person in a large crowd: three runs of the sorted people."""

    words = WORDS

    def __init__(self, first: list, last: list, place: Any, people: int, person_at: Callable) -> None:
        below = last[0] - first[0]
        own = last[1] - first[1]
        above = last[2] - first[2]
        self.begin_own = below  # the number of the first other of the own run
        self.begin_above = below + own
        self.count = below + own + above

        # From the number of an other to the column in the sorted crowd, for each run.
        self.shift_below = first[0]
        self.shift_own = first[1] - below
        self.shift_above = first[2] - below - own
        self.itself = below + place - first[1]
        self.people = people
        self.person_at = person_at

    def column(self, number: Any) -> Any:
        """Where in the sorted crowd one is."""
        shift = jnp.where(number < self.begin_above, self.shift_own, self.shift_above)
        shift = jnp.where(number < self.begin_own, self.shift_below, shift)
        return jnp.minimum(number + shift, self.people - 1)

    def person(self, number: Any) -> Any:
        """Where in the rows one is."""
        return self.person_at(self.column(number))

    def valid(self, number: Any, near: Any) -> Any:
        """Whether one is near, and there."""
        return near & (number < self.count)

    def turns(self, begin: Any) -> tuple[Any, tuple]:
        """Turns of ``UNROLL`` in the word that begins there."""
        rounded_up = self.count - begin + (UNROLL - 1)
        turns = jax.lax.div(rounded_up, np.int32(UNROLL))
        turns = jnp.minimum(turns, BITS // UNROLL)
        return turns, ()

    def over_parts(self, add_part: Callable, sums: tuple) -> tuple:
        """The sums after ``add_part(begin, sums)`` for each part."""

        def has_others(carry: tuple) -> Any:
            begin, _ = carry
            return begin < self.count

        def add_next(carry: tuple) -> tuple:
            begin, sums = carry
            return begin + self.words * BITS, add_part(begin, sums)

        _, sums = jax.lax.while_loop(has_others, add_next, (np.int32(0), sums))
        return sums


def _call(shape: _PairsShape, *operands: Array, interpret: bool = False) -> tuple[Array, ...]:
    """A ``gpu_kernels.Call``: the sums of all people of all scenarios."""
    scenarios = _scenarios(operands)
    columns = len(shape.law.out_avals) * shape.people
    sums = jax.ShapeDtypeStruct((scenarios, columns), operands[0].dtype)
    threads = scenarios * shape.people
    kernel = partial(_kernel, shape)
    return gpu_kernels.launch_threads(kernel, "pairs", threads, (sums,), *operands, interpret=interpret)


class _Thread(NamedTuple):
    """What the thread of one person reads."""

    others: Any  # _All or _Runs
    shared: list  # numbers of the law
    square: Any  # m2, of the reach
    own: list  # rows of the person, the first two are x and y [m]
    other: list[_Row]  # rows of the others, by person
    x: _Row  # m, of the others, by column
    y: _Row


def _kernel(shape: _PairsShape, number: Any, *references: Any) -> None:
    """One thread: the sums of one person."""
    people = shape.people

    # The batch axes of vmap are scenarios: their people are threads of one launch.
    scenario, place = _split(number, people)
    *inputs, result = references

    # Operands are the shared numbers, five arrays of runs in a large crowd, own rows and rows of the others.
    rows = _rows(inputs, scenario, result.shape[0])
    first_own = len(rows) - shape.own - shape.other
    first_other = len(rows) - shape.other
    numbers, *runs = rows[:first_own]
    own = rows[first_own:first_other]
    other = rows[first_other:]
    square, *shared = (numbers.at(i) for i in range(shape.shared + 1))

    # Threads of a large crowd go in its sorted order: those of a warp have much the same neighbors.
    if runs:
        order, first, last, x, y = runs
        person = order.at(place)
        columns = [run * people + place for run in range(3)]
        begins = [first.at(column) for column in columns]
        ends = [last.at(column) for column in columns]
        others = _Runs(begins, ends, place, people, order.at)
    else:
        person = place
        others = _All(place, people)
        x, y = other[:2]
    own_row = [row.at(person) for row in own]
    thread = _Thread(others, shared, square, own_row, other, x, y)

    zero = square.dtype.type(0.0)  # zeros_like is an array, which Mosaic refuses
    zeros = (zero,) * len(shape.law.out_avals)
    add_part = partial(_add_part, shape.law, thread)
    sums = others.over_parts(add_part, zeros)

    # Results are by person again, sum after sum.
    for index, value in enumerate(sums):
        result[scenario, index * people + person] = value


def _add_part(law: ClosedJaxpr, thread: _Thread, begin: Any, sums: tuple) -> tuple:
    """The sums, with the others within reach among the words of bits that begin there."""
    words = tuple(_word_within_reach(thread, begin + i * BITS) for i in range(thread.others.words))
    add_next = partial(_add_next, law, thread, begin)
    with jax.named_scope("within_reach"):
        _, sums = jax.lax.while_loop(_any_bit, add_next, (words, sums))
    return sums


def _word_within_reach(thread: _Thread, begin: Any) -> Any:
    """A word with the bits of the others from ``begin`` on that are within reach, without the person itself."""

    def unrolled(turn: Any, bits: Any) -> Any:
        for j in range(UNROLL):
            bits = bits | _bit_within_reach(thread, begin, turn * UNROLL + j)
        return bits

    turns, rest = thread.others.turns(begin)
    bits = np.int32(0)
    if not isinstance(turns, int) or turns:
        bits = jax.lax.fori_loop(0, turns, unrolled, bits)
    for j in rest:
        bits = bits | _bit_within_reach(thread, begin, j)

    # A shift by the size of a word or more is undefined, so it is masked where the person is in no bit of this word.
    itself = thread.others.itself - begin
    own_bit = jax.lax.shift_left(np.int32(1), itself & (BITS - 1))
    in_word = (itself >= 0) & (itself < BITS)
    own_bit = jnp.where(in_word, own_bit, np.int32(0))
    return bits & ~own_bit


def _bit_within_reach(thread: _Thread, begin: Any, j: Any) -> Any:
    """The j-th bit of a word, if that other is within reach."""
    others = thread.others
    column = others.column(begin + j)
    px, py = thread.own[:2]
    dx = px - thread.x.at(column)
    dy = py - thread.y.at(column)
    near = dx * dx + dy * dy < thread.square
    valid = others.valid(begin + j, near)
    bit = jax.lax.shift_left(np.int32(1), jnp.int32(j))
    return jnp.where(valid, bit, np.int32(0))


def _any_bit(carry: tuple) -> Any:
    """Whether a bit of a word is set."""
    words, _ = carry
    bits = words[0]
    for word in words[1:]:
        bits = bits | word
    return bits != 0


def _add_next(law: ClosedJaxpr, thread: _Thread, begin: Any, carry: tuple) -> tuple:
    """Add the law of the other of the first set bit to the sums, and clear the bit."""
    words, sums = carry

    # The first word that is not zero.
    last = len(words) - 1
    current = words[last]
    which = np.int32(last)
    for i in reversed(range(last)):
        is_set = words[i] != 0
        current = jnp.where(is_set, words[i], current)
        which = jnp.where(is_set, np.int32(i), which)

    # Its lowest bit: 31 less its leading zeros.
    cleared = [jnp.where(which == i, current & (current - 1), word) for i, word in enumerate(words)]
    lowest = current & -current
    number = begin + which * BITS + (BITS - 1) - jax.lax.clz(lowest)

    person = thread.others.person(number)
    other = [row.at(person) for row in thread.other]
    numbers = gpu_kernels.evaluate(law, *thread.shared, *thread.own, *other)
    sums = tuple(map(jnp.add, sums, numbers))
    return tuple(cleared), sums


# --- where in a sorted row values begin and end ---


def search(row: Float[Array, "N"], low: Float[Array, "..."], high: Float[Array, "..."]) -> tuple[Array, Array]:
    """Where in a sorted row the values begin that are at least ``low``, and end that are at most ``high``."""
    operands = [values.reshape(1, -1) for values in (row, low, high)]
    call = gpu_kernels.batch(_call_search, 2)
    first, last = call(*operands)
    return first.reshape(low.shape), last.reshape(low.shape)


def _call_search(*operands: Array, interpret: bool = False) -> tuple[Array, ...]:
    """A ``gpu_kernels.Call``: both ends of all runs of all scenarios."""
    scenarios = _scenarios(operands)
    queries = operands[1].shape[1]
    ends = jax.ShapeDtypeStruct((scenarios, queries), jnp.int32)
    threads = scenarios * queries
    return gpu_kernels.launch_threads(_search, "search", threads, (ends, ends), *operands, interpret=interpret)


def _search(number: Any, *references: Any) -> None:
    """One thread: both ends of one run."""
    *inputs, first, last = references
    queries = inputs[1].shape[1]
    scenario, query = _split(number, queries)
    row, low, high = _rows(inputs, scenario, first.shape[0])
    first[scenario, query] = _bisect(row, low.at(query), jax.lax.lt)
    last[scenario, query] = _bisect(row, high.at(query), jax.lax.le)


def _bisect(row: _Row, value: Any, before: Callable) -> Any:
    """The number of scalars in a sorted row that are ``before`` the value."""
    length = row.reference.shape[1]

    def halve(_: Any, ends: tuple) -> tuple:
        low, high = ends
        middle = jax.lax.div(low + high, np.int32(2))
        scalar = row.at(jnp.minimum(middle, length - 1))
        later = before(scalar, value) & (low < high)
        new_low = jnp.where(later, middle + 1, low)
        new_high = jnp.where(later, high, middle)
        return new_low, new_high

    low, _ = jax.lax.fori_loop(0, length.bit_length(), halve, (np.int32(0), np.int32(length)))
    return low


# --- sums over obstacles ---


class _Arguments(NamedTuple):
    """How the arguments of ``at_obstacles`` become operands."""

    structure: Any  # of the arguments, a pytree
    own: tuple[bool, ...]  # of each leaf, whether it is a row (N,), or a number for all people

    def from_scalars(self, numbers: Iterable, own: Iterable) -> Any:
        """The arguments of one person."""
        numbers = iter(numbers)
        own = iter(own)
        leaves = []
        for is_own in self.own:
            source = own if is_own else numbers
            leaves.append(next(source))
        return self.structure.unflatten(leaves)


def at_obstacles(function: Callable, px: Array, py: Array, grid: ObstacleGrid, *arguments: Any) -> tuple[Array, ...]:
    """(N,) the results of ``function(over, px, py, *arguments)``, in scalars of one person.

    ``over(step, start)`` gives the total after ``total = step(total, row)`` for the rows of the obstacles of the
    person's cell. Arguments are (N,) or for all people.
    """
    leaves, structure = jax.tree.flatten(arguments)
    is_own = tuple(bool(jnp.ndim(leaf)) for leaf in leaves)
    layout = _Arguments(structure, is_own)

    # Numbers for all people are one array, which begins with a zero: it exists without numbers, too.
    rows = [px, py]
    numbers = [px.dtype.type(0.0)]
    for leaf, own in zip(leaves, is_own, strict=True):
        destination = rows if own else numbers
        destination.append(leaf)
    numbers = jnp.stack(numbers)

    index = obstacle_cells(grid, px, py)
    cells = jnp.ravel_multi_index(index, grid.rows.shape[:2], mode="clip")  # (N,)
    cells = cells.astype(jnp.int32)
    table = grid.rows.reshape(-1)
    operands = [operand[None] for operand in (table, numbers, cells, *rows)]
    count = grid.rows.shape[2]
    call = gpu_kernels.batch(partial(_call_obstacles, function, layout, count), 1)
    (results,) = call(*operands)
    return tuple(results.reshape(-1, len(px)))


def _call_obstacles(
    function: Callable, layout: _Arguments, count: int, *operands: Array, interpret: bool = False
) -> tuple[Array, ...]:
    """A ``gpu_kernels.Call``: the function of all people, in cells of ``count`` obstacles."""
    scenarios = _scenarios(operands)
    people = operands[2].shape[1]
    results = jax.ShapeDtypeStruct((scenarios, 2 * people), operands[0].dtype)
    threads = scenarios * people
    kernel = partial(_obstacles, function, layout, count, people)
    return gpu_kernels.launch_threads(kernel, "obstacles", threads, (results,), *operands, interpret=interpret)


def _obstacles(function: Callable, layout: _Arguments, count: int, people: int, number: Any, *references: Any) -> None:
    """One thread: the function of one person."""
    scenario, person = _split(number, people)
    *inputs, result = references
    table, numbers, cells, *rows = _rows(inputs, scenario, result.shape[0])
    px, py, *own = (row.at(person) for row in rows)
    n_shared = len(layout.own) - sum(layout.own)
    shared = [numbers.at(1 + i) for i in range(n_shared)]
    arguments = layout.from_scalars(shared, own)
    first = cells.at(person) * (count * COLUMNS)

    def over(step: Callable, start: Any) -> Any:
        def is_obstacle(carry: tuple) -> Any:
            k, _ = carry
            within_cell = k < count
            last = jnp.minimum(k, count - 1)
            center_x = table.at(first + last * COLUMNS)
            return within_cell & (center_x != FAR)

        def take_step(carry: tuple) -> tuple:
            k, total = carry
            row = tuple(table.at(first + k * COLUMNS + column) for column in range(COLUMNS))
            return k + 1, step(total, row)

        _, total = jax.lax.while_loop(is_obstacle, take_step, (np.int32(0), start))
        return total

    for index, value in enumerate(function(over, px, py, *arguments)):
        result[scenario, index * people + person] = value
