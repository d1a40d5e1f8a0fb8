"""Sums of a law of one pair, over all others or over neighbors, whose derivatives compute all pairs anew.

Reverse mode would keep some hundred numbers for each pair and step. Here it keeps what is known of each person alone,
and on the way back it computes the law again while it goes along the pairs.
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Float, PyTree

from sean_jax.base import Array
from sean_jax.devices import by_platform
from sean_jax.geometry import sum_in_pairs
from sean_jax.social_forces.linear import linear_call
from sean_jax.social_forces.neighbors import Neighbors, pull_back_near, sum_near

ABSENT = 1e7  # what all rows of somebody who is felt hold where nobody is: far from everybody, and of no group
TURNS = 4  # others over whom each thread of a GPU sums first, if the law gives more than two numbers

Rows = tuple[Float[Array, "N"], ...]


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def sum_pairs(law: Callable, near: Neighbors | None, shared: PyTree, own: Rows, other: Rows) -> PyTree:
    """Sums a law of one pair for each person.

    Args:
        law: ``law(shared, own, other) -> numbers``, of one pair in scalars; a pytree of numbers, zero for a person with
            itself, for absent people, and beyond the distance of ``near``. It closes over nothing that is traced.
        near: who is near whom; None: all are.
        shared: a pytree of floats, such as the parameters of the law.
        own: (N,) each, of those who feel.
        other: (N,) each, of those who are felt.

    Returns:
        The numbers as arrays (N,).
    """
    return _sum(law, near, shared, own, other)


@sum_pairs.defjvp
def _jvp(law: Callable, primals: tuple, tangents: tuple) -> tuple:
    sums = sum_pairs(law, *primals)
    change = linear_call(partial(_forward, law), partial(_backward, law), primals, tangents[1:], sums)
    return sums, change


def _sum(law: Callable, near: Neighbors | None, shared: PyTree, own: Rows, other: Rows) -> PyTree:
    if near is not None:
        return sum_near(law, near, shared, jnp.stack(own), jnp.stack(other))
    return by_platform(partial(_sum_all, law, 1), partial(_sum_by_two, law))(shared, own, other)


def _forward(law: Callable, primals: tuple, tangents: tuple) -> PyTree:
    return jax.jvp(partial(_sum, law, primals[0]), primals[1:], tangents)[1]


def _backward(law: Callable, primals: tuple, cotangents: PyTree) -> tuple:
    """Cotangents of shared, own and other."""
    near, shared, own, other = primals
    if near is not None:
        pulls = jnp.stack(jax.tree.leaves(cotangents))
        d_shared, d_own, d_other = pull_back_near(law, near, shared, jnp.stack(own), jnp.stack(other), pulls)
        return d_shared, tuple(d_own), tuple(d_other)
    pull_back = by_platform(partial(_pull_back_at_once, law), partial(_pull_back_in_two, law))
    return pull_back(shared, own, other, cotangents)


def _sum_all(law: Callable, turns: int, shared: PyTree, own: Rows, other: Rows) -> PyTree:
    """The sums over all others, of whom ``turns`` at a time are summed first."""
    nobody = (0, -len(other[0]) % turns)
    other = tuple(jnp.pad(row, nobody, constant_values=ABSENT).reshape(turns, -1) for row in other)

    def several(shared: PyTree, own: Rows, others: Rows) -> PyTree:
        turn = lambda total, one: (jax.tree.map(jnp.add, total, law(shared, own, one)), None)  # noqa: E731
        shapes = jax.eval_shape(law, shared, own, tuple(row[0] for row in others))
        nothing = jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), shapes)
        return jax.lax.scan(turn, nothing, others, unroll=turns)[0]

    each = jax.vmap(jax.vmap(several, in_axes=(None, None, 1)), in_axes=(None, 0, None))
    numbers, structure = jax.tree.flatten(each(shared, own, other))
    return structure.unflatten(sum_in_pairs(numbers, 1))


def _sum_by_two(law: Callable, shared: PyTree, own: Rows, other: Rows) -> PyTree:
    """The sums over all others, for a GPU.

    Each thread takes two others, so it reads what is one's own half as often: a fifth less time. XLA makes one kernel
    of two numbers of all pairs and their sums, but writes more numbers to memory for each pair. So each two of them are
    a sum of its own behind a barrier, in which a thread takes ``TURNS`` others. XLA then makes one kernel of these sums
    as well, and writes no pair (``benchmarks/kernels.py`` shows it).
    """
    pair = [tuple(jax.ShapeDtypeStruct((), row.dtype) for row in rows) for rows in (own, other)]
    structure = jax.tree.structure(jax.eval_shape(law, shared, *pair))
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
    """The cotangents as JAX makes them, from arrays of all pairs: quickest on a CPU."""
    return jax.vjp(partial(_sum_all, law, 1), shared, own, other)[1](pulls)


def _pull_back_in_two(law: Callable, shared: PyTree, own: Rows, other: Rows, pulls: PyTree) -> tuple:
    """The cotangents by two sums, over those who are felt and over those who feel, each in one reduction.

    XLA for a GPU writes less of each pair than ``_pull_back_at_once`` has it write, but still what both sums share.
    """

    def of_pair(own: Rows, other: Rows, pulls: PyTree) -> tuple:
        return jax.vjp(law, shared, own, other)[1](pulls)

    by_own = jax.vmap(jax.vmap(of_pair, (None, 0, None)), (0, None, 0))
    by_other = jax.vmap(jax.vmap(of_pair, (0, None, 0)), (None, 0, None))
    d_shared, d_own = _sum_together(by_own(own, other, pulls)[:2])
    return jax.tree.map(lambda leaf: leaf.sum(0), d_shared), d_own, _sum_together(by_other(own, other, pulls)[2])


def _sum_together(parts: PyTree) -> PyTree:
    """The sums over the last axis of all parts, in one reduction."""
    leaves, structure = jax.tree.flatten(parts)
    add = lambda one, other: tuple(map(jnp.add, one, other))  # noqa: E731
    zeros = tuple(jnp.zeros((), leaf.dtype) for leaf in leaves)
    return structure.unflatten(jax.lax.reduce(tuple(leaves), zeros, add, (1,)))
