"""Lower bounds of time: the operations, special functions and bytes of a program, and the rates of a device.

They are counted in the jaxpr of the program that is timed, with its kernels: once for each number computed, whether by
an addition, a product, a comparison or a choice. Equal expressions count once and unused ones never, as in XLA.
Divisions, roots, exponentials and angles are special functions. Moving numbers is free, and so are integers in a
kernel, which are addresses. The bytes are the state that a turn of the outermost loop reads and writes.
"""

import math
import os
import re
import time
from collections import Counter
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.extend.core import Literal

from sean_jax.cli import xla_flags
from sean_jax.core.gpu_kernels import WIDTH

SPECIAL = frozenset(
    "acos acosh asin asinh atan atan2 atanh cbrt cos cosh div erf erf_inv erfc exp exp2 expm1 log log1p logistic pow "
    "rem rsqrt sin sinh sqrt tan tanh".split()
)
FREE = frozenset(
    "abs axis_index bitcast_convert_type broadcast broadcast_in_dim complex concatenate convert_element_type copy "
    "copy_p device_put dynamic_slice dynamic_update_slice empty expand_dims gather get imag inline_mgpu_p iota name "
    "neg optimization_barrier pad platform_index random_unwrap random_wrap real reshape rev scatter "
    "sharding_constraint slice split squeeze stop_gradient swap transpose".split()
)
OF_INPUTS = ("reduce_", "arg", "cum")  # primitives that take an operation for each number given
OF_KEYS = frozenset("random_bits random_fold_in random_seed random_split threefry2x32".split())
THREEFRY = 40  # operations for 32 random bits: twenty rounds of three, and the keys, make two words


class Rates(NamedTuple):
    """What a device does in a second."""

    operations: float
    special: float
    bytes: float


# By device_kind. NVIDIA's data sheets of A100 (2021), H100 (2023) and H200 (2024): bandwidth, and half of the FP32
# operations, since they count a product with a sum as two and XLA keeps them apart. A multiprocessor evaluates 16
# special functions in a clock cycle beside 64 (A100) or 128 operations: CUDA C++ Programming Guide, "Throughput of
# Native Arithmetic Instructions".
DEVICES = {
    "NVIDIA A100-SXM4-40GB": Rates(9.75e12, 9.75e12 / 4, 1.555e12),
    "NVIDIA A100-SXM4-80GB": Rates(9.75e12, 9.75e12 / 4, 2.039e12),
    "NVIDIA A100-PCIE-40GB": Rates(9.75e12, 9.75e12 / 4, 1.555e12),
    "NVIDIA A100 80GB PCIe": Rates(9.75e12, 9.75e12 / 4, 1.935e12),
    "NVIDIA H100 80GB HBM3": Rates(33.5e12, 33.5e12 / 8, 3.35e12),
    "NVIDIA H100 PCIe": Rates(25.6e12, 25.6e12 / 8, 2.0e12),
    "NVIDIA H100 NVL": Rates(30e12, 30e12 / 8, 3.9e12),
    "NVIDIA H200": Rates(33.5e12, 33.5e12 / 8, 4.8e12),
}


@cache
def rates() -> Rates:
    """The rates of the first device: of its data sheet, or measured in about two seconds."""
    return DEVICES.get(jax.devices()[0].device_kind) or _measured()


def floor(needs: dict[str, float], rates: Rates, devices: int = 1) -> tuple[float, str]:
    """How many units a second the devices can make at most, and what binds: a key of the needs of one unit."""
    seconds = {name: need / getattr(rates, name) / devices for name, need in needs.items()}
    slowest = max(seconds, key=lambda name: seconds[name])
    return 1.0 / max(seconds[slowest], 1e-30), slowest


# ------------------------------------------------------------------ counting


def count(program: Any, turns: dict[str, float], platform: str) -> dict[str, float]:
    """Operations, special functions and bytes of a program, as ``jit(f).trace(...).jaxpr``.

    Args:
        turns: of the loops that end by data, by the name of their kernel or scope; 1 for others.
        platform: the device that it is compiled for, such as "cpu" or "gpu".
    """
    totals = _Count(turns, platform, "").of(program.jaxpr)
    return {"operations": totals["operations"], "special": totals["special"], "bytes": float(_moved(program.jaxpr))}


class _Count:
    """Counts of a part of a program: an acyclic graph of results, in which equal ones are one."""

    def __init__(self, turns: dict[str, float], platform: str, kernel: str) -> None:
        self.turns, self.platform, self.kernel = turns, platform, kernel
        self.nodes: list[tuple[Counter, list]] = []  # what a result costs, and the results that it is made of
        self.known: dict[Any, int] = {}
        self.roots: list[int] = []  # results that are stored

    def of(self, jaxpr: Any) -> Counter:
        """Of a jaxpr, without results that nobody uses."""
        open_nodes = [value[0] for value in self._walk(jaxpr, [self._new({}, []) for _ in jaxpr.invars])] + self.roots
        used: set = set()
        while open_nodes:
            node = open_nodes.pop()
            if isinstance(node, int) and node not in used:
                used.add(node)
                open_nodes += [value[0] for value in self.nodes[node][1]]
        total: Counter = Counter()
        for node in used:
            total.update(self.nodes[node][0])
        return total

    def _new(self, cost: dict, inputs: list) -> tuple:
        self.nodes.append((Counter(cost), inputs))
        return len(self.nodes) - 1, 0

    def _walk(self, jaxpr: Any, inputs: list) -> list:
        values: dict[Any, tuple] = dict(zip(jaxpr.invars, inputs, strict=True))

        def read(var: Any) -> tuple:
            if isinstance(var, Literal):
                return "literal", str(var.val), str(var.aval)
            if var not in values:  # a constant
                values[var] = self._new({}, [])
            return values[var]

        for equation in jaxpr.eqns:
            arguments = [read(var) for var in equation.invars]
            inner = self._called(equation)
            if inner is not None:
                given = arguments[len(arguments) - len(inner.invars) :]
                results = self._walk(inner, given if len(given) == len(inner.invars) else [])
            else:
                key = equation.primitive.name, *arguments, *(str(value) for value in equation.params.values())
                if _inner(equation) or key not in self.known:
                    self.known[key] = self._new(self._cost(equation), arguments)[0]
                node = self.known[key]
                results = [(node, i) for i in range(len(equation.outvars))]
                if equation.primitive.name == "swap":
                    self.roots.append(node)
            values.update(zip(equation.outvars, results, strict=True))
        return [read(var) for var in jaxpr.outvars]

    def _called(self, equation: Any) -> Any:
        """The jaxpr that an equation calls once in this place; None if it calls none."""
        name, inner = equation.primitive.name, _inner(equation)
        if name in ("scan", "while", "mpmd_map") or not inner:
            return None
        if name == "cond":
            platforms = equation.params.get("branches_platforms")
            if platforms is None:
                return None
            here = [one is None or self.platform in one for one in platforms]
            return inner[here.index(True)]
        return inner[0]

    def _cost(self, equation: Any) -> Counter:
        name, params, inner = equation.primitive.name, equation.params, _inner(equation)
        parts = [(each, self._part(each)) for each in inner]
        if name == "scan":
            return _times(params["length"], parts[0][1])
        if name == "while":
            words = [*re.findall(r"\w+", str(equation.source_info.name_stack))[::-1], self.kernel]
            turns = next((self.turns[word] for word in words if word in self.turns), 1.0)
            return _times(turns, sum((part for _, part in parts), Counter()))
        if name == "mpmd_map":  # a kernel of this package; a thread has one number of each array
            kernel = _Count(self.turns, self.platform, params["name"]).of(inner[0])
            return _times(WIDTH * math.prod(params["meshes"][0].grid), kernel)
        if name == "cond":
            return min((part for _, part in parts), key=lambda part: sum(part.values()))
        return Counter({"special" if name in SPECIAL else "operations": self._numbers(equation)})

    def _part(self, jaxpr: Any) -> Counter:
        return _Count(self.turns, self.platform, self.kernel).of(jaxpr)

    def _numbers(self, equation: Any) -> float:
        """How many numbers an equation takes an operation for."""
        name, inputs, outputs = equation.primitive.name, equation.invars, equation.outvars
        if self.kernel and not any(jnp.issubdtype(var.aval.dtype, jnp.floating) for var in (*inputs, *outputs)):
            return 0
        if name in FREE:
            return 0
        if name in OF_KEYS:
            return THREEFRY * max(2, self._size(outputs))
        if name == "dot_general":
            (contracted, _), _ = equation.params["dimension_numbers"]
            return 2 * self._size(outputs) * math.prod(inputs[0].aval.shape[axis] for axis in contracted)
        if name == "sort":
            longest = inputs[0].aval.shape[equation.params["dimension"]]
            return self._size(inputs[:1]) * max(1.0, math.log2(max(longest, 2)))
        if name.startswith("scatter"):
            return self._size(inputs[-1:])
        return self._size(inputs if name.startswith(OF_INPUTS) else outputs)

    def _size(self, variables: Any) -> float:
        sizes = [math.prod(getattr(var.aval, "shape", ())) for var in variables]
        return sum(max(1.0, size / WIDTH) for size in sizes) if self.kernel else sum(sizes)


def _times(number: float, part: Counter) -> Counter:
    return Counter({key: number * value for key, value in part.items()})


def _inner(equation: Any) -> list:
    """The jaxprs among the parameters of an equation."""
    values = [each for value in equation.params.values() for each in (value if isinstance(value, tuple) else (value,))]
    return [getattr(each, "jaxpr", each) for each in values if hasattr(getattr(each, "jaxpr", each), "eqns")]


def _moved(jaxpr: Any) -> int:
    """Bytes that the turns of the outermost loop read of the loop's state and write to it."""
    for equation in jaxpr.eqns:
        if equation.primitive.name == "scan":
            params = equation.params
            body = getattr(params["jaxpr"], "jaxpr", params["jaxpr"])
            consts = params["num_consts"] if "num_consts" in params else len(params["ft_in"].unpack()[0])  # jax 0.12
            read = {var for inside in body.eqns for var in inside.invars if not isinstance(var, Literal)}
            state = set(body.invars[consts:])
            moved = [*(var for var in state & read), *(var for var in body.outvars if var not in state)]
            return equation.params["length"] * sum(
                math.prod(var.aval.shape) * getattr(var.aval.dtype, "itemsize", 8) for var in moved
            )
        found = max(map(_moved, _inner(equation)), default=0)
        if found:
            return found
    return 0


# ------------------------------------------------------------------ rates of an unknown device


def _measured() -> Rates:
    on_cpu = jax.devices()[0].platform == "cpu"
    some, many = (2**20, 2**24) if on_cpu else (2**22, 2**27)

    def products(x: jax.Array) -> jax.Array:
        rows = [x + k for k in range(8)]  # independent, so none waits for another
        for _ in range(32):
            rows = [row * 0.999 + x for row in rows]
        return sum(rows[1:], rows[0])

    def divisions(x: jax.Array) -> jax.Array:
        return 1.0 / (x + 1.5)

    def roots(x: jax.Array) -> jax.Array:
        return jax.lax.rsqrt(x + 1.0)

    def often(function: Callable) -> Callable:
        return lambda x: function(function(function(function(x))))

    special = max(4 * _rate(often(function), some) for function in (divisions, roots))
    return Rates(2 * 8 * 32 * _rate(products, some), special, 8 * _rate(lambda x: x + 1.0, many, 2))


def _rate(function: Callable, size: int, turns: int = 4) -> float:
    """Numbers a second that a function of each takes, best of some runs."""
    x = jnp.linspace(0.0, 1.0, size)
    run = jax.jit(lambda x: jax.lax.scan(lambda x, _: (function(x), None), x, length=turns)[0]).lower(x)
    # The emitter of loops that the command line chooses does not vectorize these.
    chosen = xla_flags.LOOPS in os.environ.get("XLA_FLAGS", "")
    run = run.compile({xla_flags.LOOPS.removeprefix("--"): True} if chosen else None)
    best = math.inf
    for _ in range(10):
        began = time.perf_counter()
        jax.block_until_ready(run(x))
        best = min(best, time.perf_counter() - began)
    return size * turns / best
