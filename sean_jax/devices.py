"""Scenarios spread over devices: one CPU, some GPUs, or those of many hosts, with the same code.

The mesh has one axis, ``scenarios``. What a scenario draws comes from its number alone, so it does not depend on how
many devices or hosts there are. Scenarios never speak to one another, so devices exchange nothing, but for whether a
loop of rays is over where XLA has one: on CPUs, on GPUs before NVIDIA's Hopper, and in double precision.
(``shard_map``, which would spare that, makes XLA crash while it compiles for two GPUs: seen with jax 0.11.2.)
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec
from jaxtyping import PyTree

from sean_jax.base import Array

AXIS = "scenarios"


def mesh(devices: Sequence[object] | None = None) -> Mesh:
    """A mesh with one axis, ``scenarios``.

    Args:
        devices: in a row; all devices of all hosts if None.
    """
    chosen = jax.devices() if devices is None else list(devices)
    return jax.make_mesh((len(chosen),), (AXIS,), axis_types=(AxisType.Auto,), devices=chosen)


def keys(over: Mesh, key: Array, number: int) -> Array:
    """Keys on the devices, one for each scenario.

    Args:
        key: () typed PRNG key.

    Returns:
        (number,) typed keys, the i-th ``fold_in(key, i)``.

    Raises:
        ValueError: the number is no multiple of that of the devices.
    """
    if number % over.size or number < 1:
        nearest = max(over.size, number - number % over.size)
        raise ValueError(f"number: {number} scenarios do not spread evenly over {over.size} devices; take {nearest}.")
    share = NamedSharding(over, PartitionSpec(AXIS))
    draw = jax.jit(lambda key: jax.vmap(jax.random.fold_in, (None, 0))(key, jnp.arange(number)), out_shardings=share)
    return draw(key)


def replicate(over: Mesh, tree: PyTree) -> PyTree:
    """A scenario, or any other arrays, on every device of the mesh: what ``shard`` wants as the fixed argument.

    Returns:
        The same arrays, on all devices.
    """
    return _put(tree, NamedSharding(over, PartitionSpec()))


def split(over: Mesh, tree: PyTree, axis: int = 0) -> PyTree:
    """Arrays of all scenarios, each device with its own part of them.

    Args:
        tree: arrays with an axis of the scenarios, a multiple of the number of devices; the same in every process.

    Returns:
        The same arrays, split over the devices.
    """
    return _put(tree, NamedSharding(over, PartitionSpec(*axis * (None,), AXIS)))


def _put(tree: PyTree, sharding: NamedSharding) -> PyTree:
    """The arrays placed; keys go as numbers, since jax (0.10.2) places no keys on the devices of other processes."""

    def put(leaf: Array) -> Array:
        if not (isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)):
            return place(leaf)
        return jax.random.wrap_key_data(place(jax.random.key_data(leaf)), impl=jax.random.key_impl(leaf))

    def place(leaf: Array) -> Array:
        if sharding.is_fully_addressable or (isinstance(leaf, jax.Array) and not leaf.is_fully_addressable):
            return jax.device_put(leaf, sharding)
        own = np.asarray(jnp.asarray(leaf))  # device_put would gather it from all processes, and refuse NaN
        return jax.make_array_from_callback(own.shape, sharding, lambda index: own[index])

    return jax.tree.map(put, tree)


def shard(over: Mesh, function: Callable, donate: bool = False) -> Callable:
    """``jit(vmap(function))`` over all arguments but the first, whose leading axis is split over the devices.

    Args:
        function: ``(fixed, ...)``, such as ``lambda scenario, key: rollout(scenario, policy, key, 100)``. The fixed
            argument is one that ``replicate`` gave; the others are those of one scenario, as are the results.
        donate: the memory of all but the first is used for the results, as in ``states = step(scenario, states)``.
    """

    run = shard_jit(over, function, donate)
    return lambda fixed, *others: run(fixed, others)


def shard_jit(over: Mesh, function: Callable, donate: bool = False) -> Any:
    """As ``shard``, but called with all but the first argument in a tuple: what can be lowered and compiled ahead.

    Args:
        function: as of ``shard``.
        donate: as of ``shard``.

    Returns:
        A jitted ``(fixed, (...))``.
    """
    split, whole = NamedSharding(over, PartitionSpec(AXIS)), NamedSharding(over, PartitionSpec())

    def on_all(fixed: PyTree, others: tuple) -> PyTree:
        return jax.vmap(function, (None, *(0 for _ in others)))(fixed, *others)

    given = (1,) if donate else ()
    return jax.jit(on_all, in_shardings=(whole, split), out_shardings=split, donate_argnums=given)
