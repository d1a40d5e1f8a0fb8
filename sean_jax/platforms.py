"""A function in two forms that give the same: what is fast on a CPU is slow on a GPU, and the other way round."""

from collections.abc import Callable
from typing import Any

import jax


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
