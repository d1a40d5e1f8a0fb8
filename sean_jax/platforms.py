"""CPU and GPU: functions in two forms, for what is fast on one is slow on the other; and what is put there."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np


def by_platform(cpu: Callable, default: Callable) -> Callable:
    """The function ``cpu`` where it is compiled for a CPU, and ``default`` elsewhere.

    Where derivatives are taken it is ``cpu`` on all platforms: tracing those of both takes seconds.
    """

    @jax.custom_jvp
    def function(*arguments: Any) -> Any:
        return jax.lax.platform_dependent(*arguments, cpu=cpu, default=default)

    @function.defjvp
    def _(arguments: tuple, tangents: tuple) -> tuple:
        return jax.jvp(cpu, arguments, tangents)

    return function


def put(tree: Any) -> Any:
    """The numpy arrays of a pytree as arrays of jax, numbers in the precision that is in force.

    Nothing is compiled, as ``jnp.asarray`` does for each new shape.
    """

    def one(leaf: Any) -> np.ndarray:
        array = np.asarray(leaf)
        return array.astype(float) if np.issubdtype(array.dtype, np.floating) else array

    return jax.device_put(jax.tree.map(one, tree))
