"""GPU kernels of this package, written in Pallas (Mosaic GPU): a launch for a whole batch, shared among devices."""

from collections.abc import Callable, Sequence
from functools import cache, partial
from importlib import import_module
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental.custom_partitioning import custom_partitioning
from jax.extend.core import ClosedJaxpr, Literal
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from sean_jax.core.data_types import Array

WIDTH = 128  # threads of a program
WARP = 32  # threads that exchange scalars
HOPPER = 9.0  # compute capability of the oldest GPUs that the kernels were tried on

PRIMITIVES = frozenset(
    "abs add add_any and atan2 broadcast_in_dim clamp convert_element_type copy cos div eq erf exp exp2 ge gt "
    "integer_pow le log logistic lt max min mul ne neg not or rem rsqrt select_n sign sin sqrt square "
    "stop_gradient sub tanh xor".split()
)
CALLS = frozenset(("custom_jvp_call", "jit", "pjit", "closed_call", "custom_vjp_call", "remat2", "checkpoint"))

Call = Callable[..., tuple[Array, ...]]
"""``call(*operands)`` gives arrays (scenarios, columns). An operand has a row for each scenario, one for all, or R
rows, one for each of R equal parts of the scenarios, such as the scenarios on one floor.
"""


def row(operand: Any, scenario: Any, scenarios: int) -> Any:
    """The row of a scenario in an operand or its reference."""
    rows = operand.shape[0]
    if rows == scenarios:
        return scenario
    return 0 if rows == 1 else jax.lax.div(scenario, np.int32(scenarios // rows))


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
        parts = _even(operands)
        return _split(call, outputs, parts)(*parts)

    @launch.def_vmap
    def _(size: int, batched: list[bool], *operands: Array) -> tuple[tuple[Array, ...], tuple[bool, ...]]:
        merged = []
        for operand, is_batched in zip(operands, batched, strict=True):
            if not is_batched and operand.shape[0] > 1:
                operand = jnp.broadcast_to(operand, (size, *operand.shape))
            merged.append(operand.reshape(-1, operand.shape[-1]))  # rows that are shared are not copied
        results = tuple(out.reshape(size, -1, out.shape[-1]) for out in launch(*merged))
        return results, tuple(True for _ in results)

    return launch


def _even(operands: Sequence[Array]) -> list[Array]:
    """The operands, with rows of their own for all scenarios where devices would not have equally many rows."""
    scenarios = max(operand.shape[0] for operand in operands)
    even = []
    for operand in operands:
        rows = operand.shape[0]
        if rows not in (1, scenarios) and rows % jax.device_count() != 0:
            operand = jnp.repeat(operand, scenarios // rows, axis=0)
        even.append(operand)
    return even


def _split(call: Call, outputs: int, operands: Sequence[Array]) -> Call:
    """The call for devices that share the scenarios. XLA, which cannot look into it, would run all on each device."""
    split_call = custom_partitioning(lambda *operands: call(*operands))  # it refuses a partial
    counts = [operand.shape[0] for operand in operands]
    shared = [count == 1 for count in counts]  # one row for all scenarios

    def partition(mesh: Mesh, arguments: Sequence, results: Sequence) -> tuple:
        split = results[0].sharding
        whole = NamedSharding(split.mesh, PartitionSpec())
        shardings = tuple(whole if is_shared else split for is_shared in shared)
        return mesh, call, tuple(split for _ in results), shardings

    # The rule names the axes of each operand; those that devices need as a whole are listed.
    scenarios = max(counts)
    axes = []
    whole = []
    for i, count in enumerate(counts):
        if count == 1:
            rows = f"one{i}"
            whole.append(rows)
        else:
            rows = "scenarios" if count == scenarios else f"part{i}"
        axes.append(f"{rows} column{i}")
        whole.append(f"column{i}")
    results = ", ".join(["scenarios result"] * outputs)
    split_call.def_partition(
        partition,
        sharding_rule=f"{', '.join(axes)} -> {results}",
        need_replication_factors=(*whole, "result"),
    )
    return split_call


def launch(
    kernel: Callable, name: str, grid: tuple[int, ...], out: tuple, *operands: Array, interpret: bool
) -> tuple[Array, ...]:
    """Run ``kernel(index, *references)`` in each program of the grid; ``index(axis)`` gives the program's number.

    ``interpret`` runs it in XLA, on a CPU as well.
    """
    from jax.experimental import pallas
    from jax.experimental.pallas import mosaic_gpu

    if interpret:
        kernel = partial(kernel, pallas.program_id)
        return tuple(pallas.pallas_call(kernel, grid=grid, out_shape=out, interpret=True)(*operands))
    names = tuple(f"axis{axis}" for axis in range(len(grid)))
    return mosaic_gpu.kernel(
        partial(kernel, lambda axis: jax.lax.axis_index(names[axis])),
        out_type=out,
        grid=grid,
        grid_names=names,
        compiler_params=mosaic_gpu.CompilerParams(unsafe_no_auto_barriers=True),  # no program reads what it writes
        kernel_name=name,
    )(*operands)


def launch_threads(
    kernel: Callable, name: str, threads: int, out: tuple, *operands: Array, interpret: bool
) -> tuple[Array, ...]:
    """Run ``kernel(number, *references)`` in scalars, for each number of a thread."""

    def program(index: Callable, *references: Any) -> None:
        number = index(0)
        if not interpret:  # threads of the last program that are too many repeat the first
            number = jax.lax.rem(number * WIDTH + _thread_number(), np.int32(threads))
        kernel(number, *references)

    grid = (threads if interpret else -(-threads // WIDTH),)
    return launch(program, name, grid, out, *operands, interpret=interpret)


def launch_warps(
    kernel: Callable, name: str, warps: int, lanes: int, out: tuple, *operands: Array, interpret: bool
) -> tuple[Array, ...]:
    """Run ``kernel(warp, lane, *references)`` in scalars of each thread of that many warps.

    ``interpret`` runs it in vectors of a warp's scalars. There a warp may have fewer lanes than ``WARP``.
    """
    if interpret:

        def program(index: Callable, *references: Any) -> None:
            kernel(index(0), jax.lax.iota(jnp.int32, lanes), *references)

        return launch(program, name, (warps,), out, *operands, interpret=True)

    def thread(number: Any, *references: Any) -> None:
        kernel(jax.lax.div(number, np.int32(WARP)), number & (WARP - 1), *references)

    return launch_threads(thread, name, warps * WARP, out, *operands, interpret=False)


def _thread_number() -> Any:
    """() int32: the number of the thread in its program. Scalars of a kernel differ between threads from here on."""
    from jax.experimental.mosaic.gpu import FragmentedArray, utils
    from jax.experimental.pallas import mosaic_gpu

    kind = mosaic_gpu.ShapeDtypeStruct((), jnp.int32, layout=mosaic_gpu.Layout.WG_SPLAT(()))

    @mosaic_gpu.inline_mgpu(return_type=kind)
    def number(*_: Any) -> Any:
        return FragmentedArray.splat(utils.thread_idx(), (), is_signed=True)

    return number()


def uniform(value: Any) -> Any:
    """The scalar that all threads of a warp have alike."""
    return value[0] if value.ndim else value


def exchange(value: Any, distance: Any) -> Any:
    """The scalar of the thread whose number differs in those bits, below ``WARP``. All threads of a warp take part."""
    if value.ndim:
        return value[jax.lax.iota(jnp.int32, value.size) ^ distance]
    from jax.experimental.mosaic.gpu import FragmentedArray, utils
    from jax.experimental.pallas import mosaic_gpu

    layout = mosaic_gpu.Layout.WG_SPLAT(())
    fixed = isinstance(distance, int)

    @mosaic_gpu.inline_mgpu(
        arg_types=(layout,) if fixed else (layout, layout),
        return_type=mosaic_gpu.ShapeDtypeStruct((), value.dtype, layout=layout),
    )
    def swap(*context_and_scalars: Any) -> Any:
        scalar = context_and_scalars[1]
        bits = distance if fixed else context_and_scalars[2].registers.flat[0]
        other = utils.shfl_bfly(scalar.registers.flat[0], bits)
        return FragmentedArray.splat(other, (), is_signed=scalar.is_signed)

    return swap(value) if fixed else swap(value, distance)


def elementwise(program: ClosedJaxpr) -> bool:
    """Whether a kernel can evaluate a program: elementwise functions of scalars, without constants of its own."""
    if program.consts:
        return False
    for equation in program.jaxpr.eqns:
        inner = _inner(equation)
        if inner is not None:
            if not elementwise(inner):
                return False
        elif equation.primitive.name not in PRIMITIVES:
            return False
        elif any(getattr(var.aval, "shape", ()) for var in equation.outvars):
            return False
    return True


def _inner(equation: Any) -> ClosedJaxpr | None:
    """The function that an equation calls; None if it calls none."""
    if equation.primitive.name not in CALLS:
        return None
    inner = equation.params.get("jaxpr") or equation.params["call_jaxpr"]
    return inner if isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, ())


def evaluate(program: ClosedJaxpr, *values: Any) -> list:
    """The results of a program of scalars, in functions that Mosaic knows."""
    known: dict[Any, Any] = dict(zip(program.jaxpr.invars, values, strict=True))

    def read(var: Any) -> Any:
        return jnp.asarray(var.val, jnp.result_type(var.aval)) if isinstance(var, Literal) else known[var]

    for equation in program.jaxpr.eqns:
        arguments = list(map(read, equation.invars))
        inner = _inner(equation)
        name = equation.primitive.name
        if inner is not None:
            results = evaluate(inner, *arguments)
        elif name == "convert_element_type":
            results = [_convert(arguments[0], equation.params["new_dtype"])]
        elif name == "integer_pow":
            results = [_power(arguments[0], equation.params["y"])]
        elif name in OWN:
            results = [OWN[name](*arguments)]
        else:
            results = [equation.primitive.bind(*arguments, **equation.params)]
        known.update(zip(equation.outvars, results, strict=True))
    return list(map(read, program.jaxpr.outvars))


def _convert(x: Array, dtype: Any) -> Array:
    if x.dtype == dtype:
        return x
    if jnp.dtype(dtype) == jnp.dtype(bool):
        return x != 0
    return (jnp.where(x, 1, 0) if x.dtype == jnp.dtype(bool) else x).astype(dtype)


def _power(x: Array, exponent: int) -> Array:
    if exponent < 0:
        return 1.0 / _power(x, -exponent)
    if exponent == 1:
        return x
    root = _power(x, exponent // 2)
    return root * root * x if exponent % 2 else root * root


def _root(x: Array) -> Array:
    return jnp.where(x > 0.0, x * jax.lax.rsqrt(jnp.where(x > 0.0, x, 1.0)), x)


OWN: dict[str, Callable] = {
    "add_any": jnp.add,
    "copy": lambda x: x,
    "stop_gradient": lambda x: x,
    "sqrt": _root,
}


def scalars(function: Callable) -> Callable:
    """The function of pytrees of scalars, in functions that Mosaic knows."""

    def known(*arguments: Any) -> Any:
        values = jax.tree.leaves(arguments)
        program, shape = jax.make_jaxpr(function, return_shape=True)(*jax.tree.map(_scalar, arguments))
        return jax.tree.unflatten(jax.tree.structure(shape), evaluate(program, *values))

    return known


def _scalar(value: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct((), jnp.result_type(value))
