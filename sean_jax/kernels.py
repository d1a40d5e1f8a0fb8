"""GPU kernels of this package, written in Pallas (Mosaic GPU): a launch for a whole batch, shared among devices."""

from collections.abc import Callable, Sequence
from functools import cache
from importlib import import_module
from typing import Any

import jax
import jax.numpy as jnp
from jax.experimental.custom_partitioning import custom_partitioning
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from sean_jax.base import Array

WIDTH = 128  # threads of a program
HOPPER = 9.0  # compute capability of the oldest GPUs that the kernels were tried on

Call = Callable[..., tuple[Array, ...]]
"""``call(*operands)`` of (scenarios, columns), or (1, columns) for all scenarios, gives arrays (scenarios, columns)."""


@cache
def available() -> bool:
    """Whether the kernels run on the GPU of this machine; True without a GPU, for compilation for another machine."""
    try:
        import_module("jax.experimental.pallas.mosaic_gpu")
    except ImportError:
        return False
    device = jax.devices()[0]
    if device.platform == "cpu":
        return True
    try:
        return float(device.compute_capability) >= HOPPER
    except (AttributeError, ValueError):  # not one of NVIDIA's
        return False


def batch(call: Call, outputs: int) -> Call:
    """The same function for operands of (1, columns). Under ``vmap`` all scenarios are one call."""

    @jax.custom_batching.custom_vmap
    def launch(*operands: Array) -> tuple[Array, ...]:
        return _split(call, outputs, operands)(*operands)

    @launch.def_vmap
    def _(size: int, batched: list[bool], *operands: Array) -> tuple[tuple[Array, ...], tuple[bool, ...]]:
        inner = max(
            operand.shape[1] if one else operand.shape[0] for operand, one in zip(operands, batched, strict=True)
        )
        merged = []
        for operand, one in zip(operands, batched, strict=True):
            if not one and operand.shape[0] == 1:  # it stays one for all, and is not copied
                merged.append(operand)
                continue
            operand = operand if one else operand[None]
            all_of_batch = jnp.broadcast_to(operand, (size, inner, operand.shape[-1]))
            merged.append(all_of_batch.reshape(size * inner, -1))
        results = tuple(out.reshape(size, inner, -1) for out in launch(*merged))
        return results, tuple(True for _ in results)

    return launch


def _split(call: Call, outputs: int, operands: Sequence[Array]) -> Call:
    """The call for devices that share the scenarios. XLA, which cannot look into it, would run all on each device."""
    split_call = custom_partitioning(lambda *operands: call(*operands))  # it refuses a partial
    of_all = [operand.shape[0] == 1 for operand in operands]

    def partition(mesh: Mesh, given: Sequence, results: Sequence) -> tuple:
        split = results[0].sharding
        whole = NamedSharding(split.mesh, PartitionSpec())
        arguments = tuple(whole if one else split for one in of_all)
        return mesh, call, tuple(split for _ in results), arguments

    axes = [(f"one{i}" if one else "scenarios", f"column{i}") for i, one in enumerate(of_all)]
    arguments, results = (
        ", ".join(" ".join(each) for each in side) for side in (axes, [("scenarios", "result")] * outputs)
    )
    whole = [name for each in axes for name in each if name != "scenarios"]
    factors = (*whole, "result")
    split_call.def_partition(partition, sharding_rule=f"{arguments} -> {results}", need_replication_factors=factors)
    return split_call


def thread_number() -> Any:
    """() int32: the number of the thread in its program. Scalars of a kernel differ between threads from here on."""
    from jax.experimental.mosaic.gpu import FragmentedArray, utils
    from jax.experimental.pallas import mosaic_gpu

    kind = mosaic_gpu.ShapeDtypeStruct((), jnp.int32, layout=mosaic_gpu.Layout.WG_SPLAT(()))

    @mosaic_gpu.inline_mgpu(return_type=kind)
    def number(*_: Any) -> Any:
        return FragmentedArray.splat(utils.thread_idx(), (), is_signed=True)

    return number()
