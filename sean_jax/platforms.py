"""CPU and GPU: functions in two forms, since what is fast on one is slow on the other; and arrays put on a device."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jaxtyping import PyTree


def by_platform(cpu: Callable, default: Callable) -> Callable:
    """One function with two forms, of which the platform that it is compiled for chooses one.

    Where derivatives are taken it is ``cpu`` on all platforms: tracing those of both takes seconds.

    Args:
        default: the form for all other platforms, with the same arguments and results.
    """

    @jax.custom_jvp
    def function(*arguments: PyTree) -> PyTree:
        return jax.lax.platform_dependent(*arguments, cpu=cpu, default=default)

    @function.defjvp
    def _(arguments: tuple, tangents: tuple) -> tuple:
        return jax.jvp(cpu, arguments, tangents)

    return function


def to_device(tree: PyTree) -> PyTree:
    """Place the numpy arrays of a pytree on the default device, numbers in the current precision.

    Nothing is compiled, while ``jnp.asarray`` compiles a copy for each new shape.

    Returns:
        The same tree of arrays of jax.
    """

    def convert(leaf: Any) -> np.ndarray:
        array = np.asarray(leaf)
        return array.astype(float) if np.issubdtype(array.dtype, np.floating) else array

    return jax.device_put(jax.tree.map(convert, tree))


def scalar(value: float) -> Any:  # a numpy array, for the fields of dataclasses whose arrays are those of jax
    """A parameter made at import, before the precision is known.

    Returns:
        () float; becomes an array of the default precision where a program uses it.
    """
    return np.asarray(value, float)
