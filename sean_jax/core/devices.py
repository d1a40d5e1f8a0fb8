"""CPU, GPU and several of them: functions in two forms, arrays put on a device, scenarios spread over a mesh.

A mesh has one axis, ``scenarios``. Random draws of a scenario come from its number alone, so they do not depend on the
number of devices or hosts. Devices exchange nothing but whether a loop of rays is over, where XLA has one: on CPUs, on
GPUs before NVIDIA's Hopper, and in double precision. (``shard_map``, which would spare that, makes XLA crash while it
compiles for two GPUs, with jax 0.11.2.)
"""

import re
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import Array
from jax.custom_derivatives import SymbolicZero
from jax.errors import JaxRuntimeError
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec
from jaxtyping import PyTree

AXIS = "scenarios"


def is_out_of_memory(error: BaseException) -> bool:
    """Whether the error is XLA's for a device without free memory; it has two messages."""
    text = str(error)
    says_so = re.search("RESOURCE_EXHAUSTED|out of memory", text, re.IGNORECASE)
    return isinstance(error, JaxRuntimeError) and bool(says_so)


def by_platform(cpu: Callable, default: Callable) -> Callable:
    """One function with two forms; the platform that it is compiled for chooses ``cpu`` or ``default`` (all others).

    Derivatives take ``cpu`` on all platforms: tracing both takes seconds.
    """

    @jax.custom_jvp
    def function(*arguments: PyTree) -> PyTree:
        return jax.lax.platform_dependent(*arguments, cpu=cpu, default=default)

    @partial(function.defjvp, symbolic_zeros=True)
    def _(arguments: tuple, tangents: tuple) -> tuple:
        leaves, structure = jax.tree.flatten(arguments)
        changes = {}  # number of a leaf -> its tangent; reverse mode would compute the cotangents of the others too
        for i, tangent in enumerate(jax.tree.leaves(tangents)):
            if not isinstance(tangent, SymbolicZero):
                changes[i] = tangent

        def of_changing(*values: Array) -> PyTree:
            replaced = [*leaves]
            for i, value in zip(changes, values, strict=True):
                replaced[i] = value
            return cpu(*structure.unflatten(replaced))

        return jax.jvp(of_changing, [leaves[i] for i in changes], [*changes.values()])

    return function


def to_device(tree: PyTree) -> PyTree:
    """The numpy arrays of a pytree on the default device, numbers in the current precision.

    Nothing is compiled, while ``jnp.asarray`` compiles a copy for each new shape.
    """

    def convert(leaf: Any) -> np.ndarray:
        array = np.asarray(leaf)
        return array.astype(float) if np.issubdtype(array.dtype, np.floating) else array

    return jax.device_put(jax.tree.map(convert, tree))


def on_host(function: Callable) -> Callable:
    """The function of arrays computed by the CPU, with its result on the default device: for a program that runs once,
    and that takes longer to compile for a GPU than to run on a CPU.
    """

    def call(*arguments: Any) -> PyTree:
        if jax.default_backend() == "cpu":
            return function(*arguments)
        cpu = jax.local_devices(backend="cpu")[0]
        with jax.default_device(cpu):
            result = function(*jax.device_put(arguments, cpu))
        return jax.device_put(result, jax.local_devices()[0])

    return call


def scalar(value: float) -> Any:  # a numpy array, for the fields of dataclasses of jax arrays
    """A () float parameter of a module-level table; programs use it in the default precision, unknown at import."""
    return np.asarray(value, float)


def parameter(value: float) -> Any:
    """A field of a dataclass whose default is the ``scalar`` of a value."""
    return struct.field(default_factory=lambda: scalar(value))


# ------------------------------------------------------------------ several devices


def mesh(devices: Sequence[object] | None = None) -> Mesh:
    """A mesh with one axis, ``scenarios``, over devices in a row; over all devices of all hosts if None."""
    chosen = jax.devices() if devices is None else list(devices)
    return jax.make_mesh((len(chosen),), (AXIS,), axis_types=(AxisType.Auto,), devices=chosen)


def keys(over: Mesh, key: Array, number: int) -> Array:
    """(number,) typed keys on the devices, one a scenario: the i-th is ``fold_in(key, i)``.

    Raises:
        ValueError: the number is no multiple of the number of devices.
    """
    if number % over.size or number < 1:
        nearest = max(over.size, number - number % over.size)
        raise ValueError(f"number: {number} scenarios do not spread evenly over {over.size} devices; take {nearest}.")

    def draw(key: Array) -> Array:
        return jax.vmap(jax.random.fold_in, (None, 0))(key, jnp.arange(number))

    return jax.jit(draw, out_shardings=NamedSharding(over, PartitionSpec(AXIS)))(key)


def replicate(over: Mesh, tree: PyTree) -> PyTree:
    """A scenario, or any other arrays, on every device of the mesh: the fixed argument of ``shard``."""
    return _put(tree, NamedSharding(over, PartitionSpec()))


def split(over: Mesh, tree: PyTree, axis: int = 0) -> PyTree:
    """Arrays of all scenarios, each device with its part of them.

    Args:
        tree: arrays with an axis of scenarios, a multiple of the number of devices; the same in every process.
    """
    return _put(tree, NamedSharding(over, PartitionSpec(*axis * (None,), AXIS)))


def place(tree: PyTree, shardings: PyTree) -> PyTree:
    """Arrays on devices by the shardings of a prefix of the tree."""
    return jax.tree.map(lambda sharding, part: _put(part, sharding), shardings, tree)


def _put(tree: PyTree, sharding: NamedSharding) -> PyTree:
    """The arrays placed; keys go as numbers, since jax (0.10.2) places no keys on the devices of other processes."""

    def put(leaf: Array) -> Array:
        if not (isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)):
            return place(leaf)
        return jax.random.wrap_key_data(place(jax.random.key_data(leaf)), impl=jax.random.key_impl(leaf))

    def place(leaf: Array) -> Array:
        if sharding.is_fully_addressable or (isinstance(leaf, jax.Array) and not leaf.is_fully_addressable):
            return jax.device_put(leaf, sharding)
        array = np.asarray(jnp.asarray(leaf))  # device_put would gather it from all processes, and refuse NaN
        return jax.make_array_from_callback(array.shape, sharding, lambda index: array[index])

    return jax.tree.map(put, tree)


def shard(over: Mesh, function: Callable, donate: bool = False) -> Callable:
    """``jit(vmap(function))`` over all arguments but the first, whose leading axis is split over the devices.

    Args:
        function: ``(fixed, ...)``, such as ``lambda scenario, key: rollout(scenario, policy, key, 100)``: the fixed
            argument from ``replicate``, then arguments and results of one scenario.
        donate: results reuse the memory of all arguments but the first, as in ``states = step(scenario, states)``.
    """

    run = shard_jit(over, function, donate)
    return lambda fixed, *others: run(fixed, others)


def shard_jit(over: Mesh, function: Callable, donate: bool = False) -> Any:
    """As ``shard``, but a jitted ``(fixed, (...))``, which can be lowered and compiled ahead."""
    split = NamedSharding(over, PartitionSpec(AXIS))
    whole = NamedSharding(over, PartitionSpec())

    def on_all(fixed: PyTree, others: tuple) -> PyTree:
        return jax.vmap(function, (None, *(0 for _ in others)))(fixed, *others)

    donated = (1,) if donate else ()
    return jax.jit(on_all, in_shardings=(whole, split), out_shardings=split, donate_argnums=donated)
