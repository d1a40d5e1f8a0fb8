"""Floors of the programs of ``sean bench``: what a device would make if it did nothing but what a program needs.

    python benchmarks/roofline.py --parts step depth images crowd --batches 64 1024
    python benchmarks/roofline.py --on "NVIDIA H100 80GB HBM3"     without measuring, on any machine

A program needs operations, special functions and bytes. They are counted in the jaxpr of the program that is timed,
with its kernels: once for each number computed, whether by an addition, a product, a comparison or a choice.
Equal expressions count once and unused ones never, as in XLA. Divisions, roots, exponentials and angles are special
functions. Moving numbers is free, and so are integers in a kernel, which are addresses. The bytes are the state
that a turn of the outermost loop reads and writes.
"""

import math
import re
from collections import Counter
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Literal
from options import Option, parse
from scipy.spatial import KDTree
from timing import device, least

import sean_jax
from sean_jax import sensors
from sean_jax.cli import bench
from sean_jax.cli.bench import programs
from sean_jax.cli.bench.programs import Program
from sean_jax.core.data_types import FAR, ObstacleGrid, Pedestrians, Scenario, State
from sean_jax.core.geometry import nearby_obstacles
from sean_jax.core.gpu_kernels import WIDTH
from sean_jax.sensors import cameras, mounts
from sean_jax.sensors.raycast import Rays, intersect, kernel
from sean_jax.simulation.scenario_stack import Stack
from sean_jax.social_forces import Forces, model, neighbors

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
SAMPLE = 64  # scenarios whose pairs and bodies in sight are counted
IMAGE = 64, 48  # pixels
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
    totals = _Count(turns, platform, "").total(program.jaxpr)
    return {"operations": totals["operations"], "special": totals["special"], "bytes": float(_moved(program.jaxpr))}


class _Count:
    """Counts of a part of a program: an acyclic graph of results, in which equal ones are one."""

    def __init__(self, turns: dict[str, float], platform: str, kernel: str) -> None:
        self.turns, self.platform, self.kernel = turns, platform, kernel
        self.costs: list[Counter] = []  # of each result
        self.inputs: list[list] = []  # the results that each is made of
        self.known: dict[Any, int] = {}
        self.stored: list[int] = []  # results that a kernel writes to memory

    def total(self, jaxpr: Any) -> Counter:
        """The cost of a jaxpr, without results that nobody uses."""
        outputs = self._walk(jaxpr, [self._result({}, []) for _ in jaxpr.invars])
        unvisited = [value[0] for value in outputs] + self.stored
        used: set[int] = set()
        while unvisited:
            result = unvisited.pop()
            if isinstance(result, int) and result not in used:
                used.add(result)
                unvisited += [value[0] for value in self.inputs[result]]

        total: Counter = Counter()
        for result in used:
            total.update(self.costs[result])
        return total

    def _result(self, cost: dict, inputs: list) -> tuple[int, int]:
        """A new result; values of the walk are a result and the number of its output."""
        self.costs.append(Counter(cost))
        self.inputs.append(inputs)
        return len(self.costs) - 1, 0

    def _walk(self, jaxpr: Any, inputs: list) -> list:
        """The values of a jaxpr's outputs, by the values of its inputs."""
        values: dict[Any, tuple] = dict(zip(jaxpr.invars, inputs, strict=True))
        for equation in jaxpr.eqns:
            arguments = [self._read(values, var) for var in equation.invars]
            values.update(zip(equation.outvars, self._outputs(equation, arguments), strict=True))
        return [self._read(values, var) for var in jaxpr.outvars]

    def _read(self, values: dict[Any, tuple], var: Any) -> tuple:
        if isinstance(var, Literal):
            return "literal", str(var.val), str(var.aval)
        if var not in values:  # a constant
            values[var] = self._result({}, [])
        return values[var]

    def _outputs(self, equation: Any, arguments: list) -> list[tuple]:
        called = self._called(equation)
        if called is not None:
            inputs = arguments[len(arguments) - len(called.invars) :]
            return self._walk(called, inputs if len(inputs) == len(called.invars) else [])

        name = equation.primitive.name
        key = name, *arguments, *(str(value) for value in equation.params.values())
        if _inner(equation) or key not in self.known:
            self.known[key] = self._result(self._cost(equation), arguments)[0]
        result = self.known[key]
        if name == "swap":
            self.stored.append(result)
        return [(result, k) for k in range(len(equation.outvars))]

    def _called(self, equation: Any) -> Any:
        """The jaxpr that an equation calls once in this place; None if it calls none."""
        name, inner = equation.primitive.name, _inner(equation)
        if name in ("scan", "while", "mpmd_map") or not inner:
            return None
        if name != "cond":
            return inner[0]
        platforms = equation.params.get("branches_platforms")
        if platforms is None:
            return None
        chosen = [names is None or self.platform in names for names in platforms]
        return inner[chosen.index(True)]

    def _cost(self, equation: Any) -> Counter:
        name, params, inner = equation.primitive.name, equation.params, _inner(equation)
        if name == "mpmd_map":  # a kernel of this package; a thread has one number of each array
            kernel_cost = _Count(self.turns, self.platform, params["name"]).total(inner[0])
            return _times(WIDTH * math.prod(params["meshes"][0].grid), kernel_cost)

        costs = [_Count(self.turns, self.platform, self.kernel).total(jaxpr) for jaxpr in inner]
        if name == "scan":
            return _times(params["length"], costs[0])
        if name == "while":
            words = [*re.findall(r"\w+", str(equation.source_info.name_stack))[::-1], self.kernel]
            turns = next((self.turns[word] for word in words if word in self.turns), 1.0)
            return _times(turns, sum(costs, Counter()))
        if name == "cond":
            return min(costs, key=lambda cost: sum(cost.values()))
        return Counter({"special" if name in SPECIAL else "operations": self._numbers(equation)})

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


def _times(number: float, cost: Counter) -> Counter:
    return Counter({key: number * value for key, value in cost.items()})


def _inner(equation: Any) -> list:
    """The jaxprs among the parameters of an equation."""
    jaxprs = []
    for value in equation.params.values():
        for part in value if isinstance(value, tuple) else (value,):
            jaxpr = getattr(part, "jaxpr", part)
            if hasattr(jaxpr, "eqns"):
                jaxprs.append(jaxpr)
    return jaxprs


def _moved(jaxpr: Any) -> int:
    """Bytes that the turns of the outermost loop read of the loop's state and write to it."""
    for equation in jaxpr.eqns:
        if equation.primitive.name == "scan":
            params = equation.params
            body = getattr(params["jaxpr"], "jaxpr", params["jaxpr"])
            constants = params["num_consts"] if "num_consts" in params else len(params["ft_in"].unpack()[0])  # jax 0.12
            read = {var for inside in body.eqns for var in inside.invars if not isinstance(var, Literal)}
            state = set(body.invars[constants:])
            moved = [*(state & read), *(var for var in body.outvars if var not in state)]
            sizes = [math.prod(var.aval.shape) * getattr(var.aval.dtype, "itemsize", 8) for var in moved]
            return params["length"] * sum(sizes)
        moved_inside = max(map(_moved, _inner(equation)), default=0)
        if moved_inside:
            return moved_inside
    return 0


# ------------------------------------------------------------------ turns of loops that end by data


def pair_turns(forces: Forces, people: Pedestrians, grid: ObstacleGrid | None) -> dict[str, float]:
    """Turns of the loops over pairs of people (batch, N) and obstacles, if they visited only those within reach."""
    cutoff = model.cutoff(forces)
    reach = float(forces.walking.perception if cutoff is None else cutoff)
    numbers = []
    for position, present in zip(people.position[:SAMPLE], people.present[:SAMPLE], strict=True):
        tree = KDTree(np.asarray(position)[np.asarray(present)])
        numbers.append((tree.count_neighbors(tree, reach) - tree.n) / len(position))
    within = float(np.mean(numbers))

    turns = {"within_reach": within, "neighbors": within / (3 * neighbors.PART)}
    if grid is not None:
        rows = nearby_obstacles(grid, people.position[:SAMPLE, :, 0], people.position[:SAMPLE, :, 1])
        turns["obstacles"] = float((np.asarray(rows[..., 0]) != FAR).sum(-1).mean())
    return turns


def ray_turns(scenario: Scenario, states: State, camera: cameras.Camera, bundles: Sequence[Rays]) -> dict[str, float]:
    """Turns of the loops over bodies, if each tile of rays tested only the bodies in its sight."""

    def sights(state: State) -> list[jax.Array]:
        view = mounts.sensor_view(scenario, state, camera)
        return [family.in_sight for bundle in bundles for family in intersect.families(view, bundle)]

    in_sight = [np.asarray(sight) for sight in jax.jit(jax.vmap(sights))(states)]
    if not in_sight:
        return {}
    bodies = [sight.sum(-1).mean() for sight in in_sight]  # of a family that a tile has in sight
    words = [-(-sight.shape[-1] // kernel.BITS) for sight in in_sight]
    tasks = [max(1, sight.shape[1] // intersect.SHARE) / sight.shape[1] * intersect.CHUNK for sight in in_sight]
    return {
        "raycast": float(np.sum(bodies) / np.sum(words)),
        "first": float(np.mean(bodies)),
        "nearest": float(np.mean(np.divide(bodies, tasks))),
    }


def crowd_turns(program: Program) -> dict[str, float]:
    """Turns of the loops of ``programs.crowd``."""
    forces, grid, people = program.fixed
    return pair_turns(forces, people, grid)


def step_turns(scenario: Scenario, program: Program, image: tuple[int, int] | None) -> dict[str, float]:
    """Turns of the loops of ``programs.stepping`` in one scenario."""
    states = jax.tree.map(lambda leaf: leaf[:SAMPLE], program.carried[0])
    turns = pair_turns(scenario.forces, states.pedestrians, scenario.environment.obstacle_grid)
    return turns if image is None else turns | image_turns(scenario, program, *image)


def image_turns(scenario: Scenario, program: Program, width: int, height: int) -> dict[str, float]:
    """Turns of the loops of ``programs.images`` of the depth camera in one scenario."""
    states = jax.tree.map(lambda leaf: leaf[:SAMPLE], program.carried[0])
    camera = sensors.camera(scenario, "depth", width=width, height=height)
    return ray_turns(scenario, states, camera, cameras.bands(camera)[0])


def needs(program: Program, turns: dict[str, float], platform: str) -> dict[str, float]:
    """Operations, special functions and bytes of one unit of a program of ``sean bench``."""
    counts = count(program.run.trace(*program.fixed, program.carried).jaxpr, turns, platform)
    return {name: value / program.count / program.turns for name, value in counts.items()}


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
    run = jax.jit(lambda x: jax.lax.scan(lambda x, _: (function(x), None), x, length=turns)[0])
    return size * turns / least(lambda: run(x), repeats=10)


# ------------------------------------------------------------------ the table


def cases(parts: list[str], batches: list[int], people: int) -> Any:
    """Part, batch, program, and turns of its loops."""
    scenario = sean_jax.make("warehouse", people=people)
    floors = Stack(scenario, {})
    for batch in batches:
        turns = bench.turns(batch)
        if "step" in parts:
            program = programs.stepping(floors, batch, turns)
            yield "step", batch, program, step_turns(scenario, program, None)
        if "depth" in parts:
            program = programs.stepping(floors, batch, turns, IMAGE)
            yield "depth", batch, program, step_turns(scenario, program, IMAGE)
        if "images" in parts:
            program = programs.images(floors, "depth", batch, *IMAGE, turns)
            yield "images", batch, program, image_turns(scenario, program, *IMAGE)
        if "crowd" in parts:
            program = programs.crowd(people, batch, turns)
            yield "crowd", batch, program, crowd_turns(program)


def main() -> None:
    """Print the table."""
    names = ["step", "depth", "images", "crowd"]
    options = parse(
        __doc__,
        parts=Option(names, choices=names),
        batches=[64],
        people=62,
        on=Option(None, "another device, whose floors need no measuring", choices=list(DEVICES)),
    )
    device_rates = DEVICES[options.on] if options.on else rates()
    platform = "gpu" if options.on else jax.devices()[0].platform
    words = ", ".join(f"{rate:.2g} {name}" for name, rate in device_rates._asdict().items())
    print(f"{options.on or device()}: {words} a second")
    print(
        f"{'part':>7}{'B':>7}{'operations':>12}{'special':>10}{'bytes':>10}{'floor /s':>10}  {'bound by':<11}"
        f"{'per second':>11}{'share':>8}"
    )
    for part, batch, program, turns in cases(options.parts, options.batches, options.people):
        unit = needs(program, turns, platform)
        most, bound = floor(unit, device_rates)
        counts = f"{unit['operations']:12.0f}{unit['special']:10.0f}{unit['bytes']:10.0f}"
        row = f"{part:>7}{batch:7d}{counts}{most:10.3g}  {bound:<11}"
        if not options.on:
            per_second = programs.measure(program, 3, 0.5)["per_second"]
            row += f"{per_second:11.4g}{100 * per_second / most:7.1f}%"
        print(row, flush=True)


if __name__ == "__main__":
    main()
