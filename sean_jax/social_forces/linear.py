"""A linear function with its own transpose, for code that JAX cannot transpose, such as a while loop.

It is ``jax.custom_derivatives.linear_call`` with support for ``jax.vmap``, which JAX's lacks (0.10 to 0.12).
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import PyTree


class Direction(NamedTuple):
    """The function or its transpose."""

    function: Callable  # (list of constants, list of arguments) -> list of results
    results: tuple[ShapedArray, ...]


def linear_call(function: Callable, transpose: Callable, constant: PyTree, argument: PyTree, result: PyTree) -> PyTree:
    """``function(constant, argument)``, linear in the argument; reverse mode calls ``transpose(constant, cotangent)``.

    Args:
        function: closes over nothing that is traced, nor does ``transpose``. Both keep derivatives in forward mode.
        result: a pytree of arrays with the shapes and types of the function's result.
    """
    constants, constant_tree = jax.tree.flatten(constant)
    arguments, argument_tree = jax.tree.flatten(argument)
    results, result_tree = jax.tree.flatten(result)

    def direction(linear: Callable, tree: PyTree, out: list) -> Direction:
        def flat(constants: list, values: list) -> list:
            return jax.tree.leaves(linear(constant_tree.unflatten(constants), tree.unflatten(values)))

        return Direction(flat, tuple(ShapedArray(value.shape, value.dtype) for value in out))

    forward = direction(function, argument_tree, results)
    backward = direction(transpose, result_tree, arguments)
    outputs = _linear.bind(*constants, *arguments, forward=forward, backward=backward, number=len(constants))
    return result_tree.unflatten(outputs)


def _compute(*values: PyTree, forward: Direction, backward: Direction, number: int) -> list:
    return forward.function(list(values[:number]), list(values[number:]))


def _jvp(values: tuple, tangents: tuple, *, forward: Direction, backward: Direction, number: int) -> tuple:
    directions = {"forward": forward, "backward": backward, "number": number}
    constants, arguments = values[:number], values[number:]
    changes = [ad.instantiate_zeros(tangent) for tangent in tangents]
    results, change = _linear.bind(*values, **directions), _linear.bind(*constants, *changes[number:], **directions)
    if not all(isinstance(tangent, ad.Zero) for tangent in tangents[:number]):  # of a derivative
        by_constants = lambda *constants: forward.function(list(constants), list(arguments))  # noqa: E731
        _, by_constant = jax.jvp(by_constants, constants, tuple(changes[:number]))
        change = [one + other for one, other in zip(change, by_constant, strict=True)]
    return results, change


def _transpose(cotangents: list, *values: PyTree, forward: Direction, backward: Direction, number: int) -> list:
    outputs = [ad.instantiate_zeros(cotangent) for cotangent in cotangents]
    constants = values[:number]
    return [None] * number + _linear.bind(*constants, *outputs, forward=backward, backward=forward, number=number)


def _batch(values: tuple, axes: tuple, *, forward: Direction, backward: Direction, number: int) -> tuple:
    size = next(value.shape[axis] for value, axis in zip(values, axes, strict=True) if axis is not None)
    arguments = [batching.bdim_at_front(*one, size) for one in zip(values[number:], axes[number:], strict=True)]

    def batched(direction: Direction) -> Direction:
        results = tuple(ShapedArray((size, *one.shape), one.dtype) for one in direction.results)
        return Direction(jax.vmap(direction.function, (list(axes[:number]), 0)), results)

    directions = {"forward": batched(forward), "backward": batched(backward), "number": number}
    return _linear.bind(*values[:number], *arguments, **directions), [0] * len(forward.results)


_linear = Primitive("linear")
_linear.multiple_results = True
_linear.def_impl(_compute)
_linear.def_abstract_eval(lambda *values, forward, backward, number: forward.results)
ad.primitive_jvps[_linear] = _jvp
ad.primitive_transposes[_linear] = _transpose
batching.primitive_batchers[_linear] = _batch
mlir.register_lowering(_linear, mlir.lower_fun(_compute, multiple_results=True))
