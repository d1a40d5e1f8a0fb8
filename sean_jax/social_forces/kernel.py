"""Sums of a law of one pair on a GPU, in one kernel (Pallas, Mosaic GPU).

Each thread has one person. A first loop sets a bit for each other person within reach; a second loop evaluates the law
for the set bits. Threads of a warp wait for the person with the most neighbors.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr
from jaxtyping import PyTree

from sean_jax import kernels
from sean_jax.base import Array

BITS = 32
UNROLL = 8  # others whose distance is tested in one turn
MOST = 256  # people of a crowd

Rows = tuple[Array, ...]


class _Shape(NamedTuple):
    """Static parameters of a kernel."""

    law: ClosedJaxpr
    people: int
    own: int  # rows of a person
    shared: int  # numbers
    outputs: int


def supports(law: Callable, shared: PyTree, own: Rows, other: Rows) -> bool:
    """Whether the kernel can sum the law: crowds of 1 to 256, in single precision, elementwise functions."""
    if not 0 < own[0].shape[0] <= MOST or not kernels.available():
        return False
    if any(jnp.shape(leaf) for leaf in jax.tree.leaves(shared)):
        return False
    if any(jnp.result_type(leaf) != np.float32 for leaf in jax.tree.leaves((shared, own, other))):
        return False
    return kernels.elementwise(_trace(law, shared, own, other))


def sum_pairs(law: Callable, reach: Array, shared: PyTree, own: Rows, other: Rows) -> PyTree:
    """The numbers of the law as (N,), summed over the others within reach [m]. The first two rows are x and y [m]."""
    leaves, structure = jax.tree.flatten(jax.eval_shape(law, shared, _one(own), _one(other)))
    numbers = jax.tree.leaves(shared)
    shape = _Shape(_trace(law, shared, own, other), len(own[0]), len(own), len(numbers), len(leaves))
    operands = jnp.stack([reach * reach, *numbers])[None], *(row[None] for row in (*own, *other))
    return structure.unflatten([each[0] for each in kernels.batch(partial(_call, shape), len(leaves))(*operands)])


def _one(rows: Rows) -> tuple:
    return tuple(jax.ShapeDtypeStruct((), row.dtype) for row in rows)


def _trace(law: Callable, shared: PyTree, own: Rows, other: Rows) -> ClosedJaxpr:
    return jax.make_jaxpr(law)(shared, _one(own), _one(other))


def _call(shape: _Shape, *operands: Array, interpret: bool = False) -> tuple[Array, ...]:
    """The kernel, for operands of (scenarios, ...) or, where all scenarios have the same, (1, ...)."""
    from jax.experimental import pallas
    from jax.experimental.pallas import mosaic_gpu

    scenarios = max(operand.shape[0] for operand in operands)
    out = tuple(jax.ShapeDtypeStruct((scenarios, shape.people), operands[0].dtype) for _ in range(shape.outputs))
    total = scenarios * shape.people
    if interpret:  # on a CPU, by XLA
        kernel = partial(_kernel, shape, lambda: pallas.program_id(0))
        return tuple(pallas.pallas_call(kernel, grid=(total,), out_shape=out, interpret=True)(*operands))

    def person() -> Any:
        return jnp.minimum(jax.lax.axis_index("program") * kernels.WIDTH + kernels.thread_number(), total - 1)

    return mosaic_gpu.kernel(
        partial(_kernel, shape, person),
        out_type=out,
        grid=(-(-total // kernels.WIDTH),),
        grid_names=("program",),
        compiler_params=mosaic_gpu.CompilerParams(unsafe_no_auto_barriers=True),  # a thread reads nothing written
        kernel_name="pairs",
    )(*operands)


def _kernel(shape: _Shape, number: Callable[[], Any], *references: Any) -> None:
    """One thread: the sums of one person."""
    numbers_of, *rows = references
    rows, results = rows[: -shape.outputs], rows[-shape.outputs :]
    index, people = number(), shape.people
    scenario, person = jax.lax.div(index, jnp.int32(people)), jax.lax.rem(index, jnp.int32(people))

    def scenario_of(reference: Any) -> Any:
        return 0 if reference.shape[0] == 1 else scenario

    numbers_at = scenario_of(numbers_of)
    square, *shared = (numbers_of[numbers_at, i] for i in range(shape.shared + 1))
    own = [row[scenario_of(row), person] for row in rows[: shape.own]]
    others = [(row, scenario_of(row)) for row in rows[shape.own :]]

    def bit(first: int, j: Any) -> Any:
        (x, x_at), (y, y_at) = others[:2]
        dx, dy = own[0] - x[x_at, first + j], own[1] - y[y_at, first + j]
        return jnp.where(dx * dx + dy * dy < square, jax.lax.shift_left(jnp.int32(1), jnp.int32(j)), jnp.int32(0))

    def word(first: int) -> Any:
        count = min(BITS, people - first)
        turns = count // UNROLL

        def turn(k: Any, bits: Any) -> Any:
            for j in range(UNROLL):
                bits = bits | bit(first, k * UNROLL + j)
            return bits

        bits = jax.lax.fori_loop(0, turns, turn, jnp.int32(0)) if turns else jnp.int32(0)
        for j in range(turns * UNROLL, count):
            bits = bits | bit(first, j)
        self = jnp.where(person // BITS == first // BITS, jax.lax.shift_left(jnp.int32(1), person % BITS), jnp.int32(0))
        return bits & ~self

    firsts = range(0, people, BITS)
    words = tuple(map(word, firsts))

    def some(carry: tuple) -> Any:
        words, _ = carry
        left = words[0]
        for each in words[1:]:
            left = left | each
        return left != 0

    def add(carry: tuple) -> tuple:
        words, sums = carry
        current, first, rest = words[-1], jnp.int32(firsts[-1]), []
        for each, start in zip(words[-2::-1], firsts[-2::-1], strict=True):
            current = jnp.where(each != 0, each, current)
            first = jnp.where(each != 0, jnp.int32(start), first)
        for each, start in zip(words, firsts, strict=True):
            rest.append(jnp.where(first == start, current & (current - 1), each))
        j = first + (BITS - 1) - jax.lax.clz(current & -current)
        other = [row[at, j] for row, at in others]
        pushes = kernels.evaluate(shape.law, *shared, *own, *other)
        return tuple(rest), tuple(map(jnp.add, sums, pushes))

    sums = (square.dtype.type(0.0),) * shape.outputs  # zeros_like is an array, which Mosaic refuses
    _, sums = jax.lax.while_loop(some, add, (words, sums))
    for result, value in zip(results, sums, strict=True):
        result[scenario, person] = value
