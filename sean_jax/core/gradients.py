"""Gradients over long horizons: truncate, damp or clip the derivative that a state carries from step to step.

Crowds are chaotic: on which side people pass depends on centimetres, and derivatives grow with the horizon. These
functions return the same state and change the derivative of its moving parts: positions, velocities and headings of
people, and the robot. Use them as ``between`` of rollouts, or in your own scan. Traits of people, goals and constants
outside of the state keep their derivatives. docs/gradients.md measures the effect of each. ``linear_call`` is a linear
function with its own transpose.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Float, PyTree

from sean_jax.core.data_types import Array, State

MOVING = ("position", "velocity", "heading", "desired_velocity")  # of people


def truncate(state: State, every: int) -> State:
    """Ends the derivative at each ``every``-th step: truncated backpropagation through blocks of steps."""
    ends = state.tick % every == 0
    return damp(state, jnp.where(ends, 0.0, 1.0))


def damp(state: State, factor: Float[Array, ""] | float) -> State:
    """Multiplies the derivative by a factor from 0 to 1: n steps back it is ``factor ** n``; 0 ends it here."""

    def scale(leaf: Array) -> Array:
        return _scaled(leaf, jnp.asarray(factor, leaf.dtype))

    moving = jax.tree.map(scale, _moving(state))
    return _with_moving(state, moving)


def clip(state: State, limit: Float[Array, ""] | float) -> State:
    """Shortens the cotangent of each person and of the robot, in reverse mode; forward mode is unchanged.

    Args:
        limit: maximum length of the cotangent of all moving parts of a body, in units of the loss per metre.
    """
    moving = _moving(state)
    limit = jnp.asarray(limit, float)
    return _with_moving(state, linear_call(_same, _clipped, limit, moving, moving))


def _moving(state: State) -> tuple[list[Array], list[Array]]:
    """The moving leaves (N, ...) of people and (...) of the robot."""
    people = [getattr(state.pedestrians, name) for name in MOVING]
    robot = [leaf for leaf in jax.tree.leaves(state.robot) if _is_float(leaf)]
    return people, robot


def _with_moving(state: State, moving: tuple[list[Array], list[Array]]) -> State:
    """The state with other moving leaves."""
    people, robot = moving
    fields = dict(zip(MOVING, people, strict=True))
    floats = iter(robot)
    leaves, structure = jax.tree.flatten(state.robot)
    leaves = [next(floats) if _is_float(leaf) else leaf for leaf in leaves]
    pedestrians = replace(state.pedestrians, **fields)
    return replace(state, pedestrians=pedestrians, robot=structure.unflatten(leaves))


def _is_float(leaf: Array) -> bool:
    return jnp.issubdtype(leaf.dtype, jnp.floating)


@jax.custom_jvp
def _scaled(leaf: Array, factor: Array) -> Array:
    return leaf


@_scaled.defjvp
def _(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    leaf, factor = primals
    change, _ = tangents
    return leaf, jnp.where(factor == 0.0, 0.0, factor * change)  # infinity ends too


def _same(limit: Array, moving: PyTree) -> PyTree:
    return moving


def _clipped(limit: Array, cotangents: tuple[list[Array], list[Array]]) -> tuple[list[Array], list[Array]]:
    """The cotangents of people and of the robot, each body's shortened to the limit."""
    people, robot = cotangents
    squares = [jnp.square(leaf).reshape(leaf.shape[0], -1).sum(1) for leaf in people]  # (N,) each
    scale = _shorter(squares, limit)
    people = [leaf * scale.reshape(-1, *[1] * (leaf.ndim - 1)) for leaf in people]

    squares = [jnp.square(leaf).sum() for leaf in robot]
    scale = _shorter(squares, limit)
    robot = [leaf * scale for leaf in robot]
    return people, robot


def _shorter(squares: list[Array], limit: Array) -> Array:
    """The factor that shortens vectors, whose squared lengths have these parts, to the limit; 0 for infinite ones."""
    square = jnp.stack(squares).sum(0)
    over = square > limit * limit
    inverse = jax.lax.rsqrt(jnp.where(over, square, 1.0))
    return jnp.where(over, limit * inverse, 1.0)


# --- a linear function with its own transpose ---
# ``jax.custom_derivatives.linear_call`` with support for ``jax.vmap``, which JAX's lacks (0.10 to 0.12).


class Direction(NamedTuple):
    """The function or its transpose."""

    function: Callable  # (list of constants, list of arguments) -> list of results
    results: tuple[ShapedArray, ...]


def linear_call(function: Callable, transpose: Callable, constant: PyTree, argument: PyTree, result: PyTree) -> PyTree:
    """``function(constant, argument)``, linear in the argument; reverse mode calls ``transpose(constant, cotangent)``.

    For code that JAX cannot transpose, such as a while loop.

    Args:
        function: closes over nothing that is traced, nor does ``transpose``. Both keep derivatives in forward mode.
        result: a pytree of arrays with the shapes and types of the function's result.
    """
    constants, constant_tree = jax.tree.flatten(constant)
    arguments, argument_tree = jax.tree.flatten(argument)
    results, result_tree = jax.tree.flatten(result)

    def direction(linear: Callable, tree: PyTree, out: list) -> Direction:
        def flat(constants: list, values: list) -> list:
            results = linear(constant_tree.unflatten(constants), tree.unflatten(values))
            return jax.tree.leaves(results)

        shapes = tuple(ShapedArray(value.shape, value.dtype) for value in out)
        return Direction(flat, shapes)

    forward = direction(function, argument_tree, results)
    backward = direction(transpose, result_tree, arguments)
    outputs = _linear.bind(*constants, *arguments, forward=forward, backward=backward, number=len(constants))
    return result_tree.unflatten(outputs)


def _compute(*values: PyTree, forward: Direction, backward: Direction, number: int) -> list:
    constants = list(values[:number])
    arguments = list(values[number:])
    return forward.function(constants, arguments)


def _jvp(values: tuple, tangents: tuple, *, forward: Direction, backward: Direction, number: int) -> tuple:
    constants = values[:number]
    arguments = values[number:]
    changes = [ad.instantiate_zeros(tangent) for tangent in tangents]
    directions = {"forward": forward, "backward": backward, "number": number}
    results = _linear.bind(*values, **directions)
    change = _linear.bind(*constants, *changes[number:], **directions)
    if all(isinstance(tangent, ad.Zero) for tangent in tangents[:number]):
        return results, change

    # In the derivative of a derivative the constants change, too, and the function need not be linear in them.
    def function(*constants: Array) -> list:
        return forward.function(list(constants), list(arguments))

    _, by_constants = jax.jvp(function, constants, tuple(changes[:number]))
    return results, [term + other for term, other in zip(change, by_constants, strict=True)]


def _transpose(cotangents: list, *values: PyTree, forward: Direction, backward: Direction, number: int) -> list:
    outputs = [ad.instantiate_zeros(cotangent) for cotangent in cotangents]
    constants = values[:number]
    changes = _linear.bind(*constants, *outputs, forward=backward, backward=forward, number=number)
    return [None] * number + changes


def _batch(values: tuple, axes: tuple, *, forward: Direction, backward: Direction, number: int) -> tuple:
    sizes = [value.shape[axis] for value, axis in zip(values, axes, strict=True) if axis is not None]
    size = sizes[0]
    constants = values[:number]
    axes_of_constants = list(axes[:number])
    pairs = zip(values[number:], axes[number:], strict=True)
    arguments = [batching.bdim_at_front(value, axis, size) for value, axis in pairs]

    def batched(direction: Direction) -> Direction:
        results = tuple(ShapedArray((size, *result.shape), result.dtype) for result in direction.results)
        return Direction(jax.vmap(direction.function, (axes_of_constants, 0)), results)

    directions = {"forward": batched(forward), "backward": batched(backward), "number": number}
    outputs = _linear.bind(*constants, *arguments, **directions)
    return outputs, [0] * len(forward.results)


_linear = Primitive("linear")
_linear.multiple_results = True
_linear.def_impl(_compute)
_linear.def_abstract_eval(lambda *values, forward, backward, number: forward.results)
ad.primitive_jvps[_linear] = _jvp
ad.primitive_transposes[_linear] = _transpose
batching.primitive_batchers[_linear] = _batch
mlir.register_lowering(_linear, mlir.lower_fun(_compute, multiple_results=True))
