"""A linear function with a transpose of its own, where JAX cannot transpose what computes it, such as a while loop.

As ``jax.custom_derivatives.linear_call``, which cannot be batched by ``jax.vmap`` (jax 0.10 to 0.12).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir


class Way(NamedTuple):
    """One of the two: from arguments to results, or from cotangents of these back."""

    function: Callable  # (list of constants, list of arguments) -> list of results
    results: tuple[ShapedArray, ...]


def linear_call(function: Callable, transpose: Callable, constant: Any, argument: Any, result: Any) -> Any:
    """``function(constant, argument)``, linear in the argument; reverse mode calls ``transpose(constant, cotangent)``.

    Args:
        function: closes over nothing that is traced, no more than ``transpose``; both keep derivatives forward.
        constant: a pytree of arrays, of integers too.
        argument: a pytree of floats.
        result: a pytree of arrays like those that the function gives.
    """
    constants, constant_tree = jax.tree.flatten(constant)
    arguments, argument_tree = jax.tree.flatten(argument)
    results, result_tree = jax.tree.flatten(result)

    def way(linear: Callable, tree: Any, out: list) -> Way:
        def flat(given: list, values: list) -> list:
            return jax.tree.leaves(linear(constant_tree.unflatten(given), tree.unflatten(values)))

        return Way(flat, tuple(ShapedArray(value.shape, value.dtype) for value in out))

    there, back = way(function, argument_tree, results), way(transpose, result_tree, arguments)
    return result_tree.unflatten(_linear.bind(*constants, *arguments, there=there, back=back, number=len(constants)))


def _compute(*values: Any, there: Way, back: Way, number: int) -> list:
    return there.function(list(values[:number]), list(values[number:]))


def _move(values: tuple, changes: tuple, *, there: Way, back: Way, number: int) -> tuple:
    constants, arguments, ways = values[:number], values[number:], {"there": there, "back": back, "number": number}
    moved = [ad.instantiate_zeros(change) for change in changes]
    results, change = _linear.bind(*values, **ways), _linear.bind(*constants, *moved[number:], **ways)
    if not all(isinstance(one, ad.Zero) for one in changes[:number]):  # of a derivative
        further = jax.jvp(lambda *given: there.function(list(given), list(arguments)), constants, tuple(moved[:number]))
        change = [one + other for one, other in zip(change, further[1], strict=True)]
    return results, change


def _transpose(cotangents: list, *values: Any, there: Way, back: Way, number: int) -> list:
    given = [ad.instantiate_zeros(cotangent) for cotangent in cotangents]
    return [None] * number + _linear.bind(*values[:number], *given, there=back, back=there, number=number)


def _batch(values: tuple, axes: tuple, *, there: Way, back: Way, number: int) -> tuple:
    size = next(value.shape[axis] for value, axis in zip(values, axes, strict=True) if axis is not None)
    batched = [batching.bdim_at_front(*one, size) for one in zip(values[number:], axes[number:], strict=True)]

    def each(way: Way) -> Way:
        results = tuple(ShapedArray((size, *one.shape), one.dtype) for one in way.results)
        return Way(jax.vmap(way.function, (list(axes[:number]), 0)), results)

    given = *values[:number], *batched
    return _linear.bind(*given, there=each(there), back=each(back), number=number), [0] * len(there.results)


_linear = Primitive("linear")
_linear.multiple_results = True
_linear.def_impl(_compute)
_linear.def_abstract_eval(lambda *values, there, back, number: there.results)
ad.primitive_jvps[_linear] = _move
ad.primitive_transposes[_linear] = _transpose
batching.primitive_batchers[_linear] = _batch
mlir.register_lowering(_linear, mlir.lower_fun(_compute, multiple_results=True))
