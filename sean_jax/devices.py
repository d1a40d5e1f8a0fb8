"""Scenarios spread over devices: one CPU, some GPUs, or those of many hosts, with the same code.

The mesh has one axis, ``scenarios``. What a scenario draws comes from its number alone, so it does not depend on how
many devices or hosts there are. Scenarios never speak to one another: each device runs its share by itself, and loops
whose length depends on the data (rays) are as long as its own share needs.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

from sean_jax.base import Array

AXIS = "scenarios"


def mesh(devices: Sequence[Any] | None = None) -> Mesh:
    """All devices of all hosts, or those given, in a row."""
    chosen = jax.devices() if devices is None else list(devices)
    return jax.make_mesh((len(chosen),), (AXIS,), axis_types=(AxisType.Auto,), devices=chosen)


def keys(over: Mesh, key: Array, number: int) -> Array:
    """(number,) typed keys on the devices, the i-th ``fold_in(key, i)``.

    Raises:
        ValueError: the number is no multiple of that of the devices.
    """
    if number % over.size or number < 1:
        nearest = max(over.size, number - number % over.size)
        raise ValueError(f"number: {number} scenarios do not spread evenly over {over.size} devices; take {nearest}.")
    share = NamedSharding(over, PartitionSpec(AXIS))
    draw = jax.jit(lambda key: jax.vmap(jax.random.fold_in, (None, 0))(key, jnp.arange(number)), out_shardings=share)
    return draw(key)


def spread(over: Mesh, function: Callable, donate: bool = False) -> Callable:
    """``jit(vmap(function))`` with the leading axis of every argument and result split over the devices.

    Args:
        function: of one scenario's arrays, such as ``lambda key: rollout(scenario, policy, key, 100)``. What it closes
            over, the scenario say, is on every device.
        donate: the memory of the arguments is used for the results, as in ``states = step(states)``.
    """
    share = PartitionSpec(AXIS)
    on_each = jax.shard_map(jax.vmap(function), mesh=over, in_specs=share, out_specs=share, check_vma=False)
    return jax.jit(on_each, donate_argnums=(0,) if donate else ())
