"""Lower bounds of time from counted operations, special functions and bytes of a program, and a device's rates.

python benchmarks/floors.py                                 counts, and the bounds of one H200
python benchmarks/floors.py --measured DIR/bench.json       and the share of the bound that ``sean bench`` reached

Operations are counted in the program's jaxpr, once for each number computed: additions, products,
comparisons, choices and integer work alike. Divisions, roots, exponentials and angles are special functions. Bytes are
the state's, read once and written once. ``--turns`` is the number of iterations of loops that depend on the data; a
ray meets four bodies of each family, and a person in a large crowd has 48 neighbors.
"""

import argparse
import json
import math
from collections import Counter
from pathlib import Path
from typing import Any

import jax

import sean_jax
from sean_jax import kernels, sensors, social_forces
from sean_jax.bench import programs, workload
from sean_jax.raycast.intersect import SHARE
from sean_jax.scenario import reset, step

SPECIAL = {"exp", "exp2", "log", "log1p", "expm1", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sqrt",
           "rsqrt", "cbrt", "div", "pow", "tanh", "erf", "erf_inv", "logistic", "rem"}  # fmt: skip
FREE = {"broadcast_in_dim", "reshape", "squeeze", "transpose", "slice", "concatenate", "pad", "gather", "iota", "copy",
        "dynamic_slice", "dynamic_update_slice", "scatter", "split", "rev", "real", "imag", "complex", "stop_gradient",
        "convert_element_type", "bitcast_convert_type", "random_wrap", "random_unwrap", "optimization_barrier",
        "device_put", "expand_dims", "empty", "broadcast", "copy_p"}  # fmt: skip
FROM_INPUT = {"reduce_sum", "reduce_max", "reduce_min", "reduce_and", "reduce_or", "reduce_prod", "argmax", "argmin",
              "cumsum", "cummax", "reduce_xor", "cumprod"}  # fmt: skip
THREEFRY = 40  # operations for each 32 random bits: twenty rounds of three, and the keys, make two words


def size(variables: Any) -> int:
    """Number of elements of all variables."""
    return sum(math.prod(getattr(v.aval, "shape", ())) for v in variables)


def count(jaxpr: Any, turns: int) -> Counter:
    """Operations and special functions of a jaxpr; ``turns`` iterations for each loop of unknown length."""
    total: Counter = Counter()
    for equation in jaxpr.eqns:
        name, out = equation.primitive.name, size(equation.outvars)
        inner = [value for key, value in equation.params.items() if key in ("jaxpr", "call_jaxpr", "fun_jaxpr")]
        times = 1
        if name == "scan":
            times = equation.params["length"]
        elif name == "while":
            inner, times = [equation.params["body_jaxpr"]], turns
        elif name in ("cond", "platform_index"):
            inner = [equation.params["branches"][-1]] if name == "cond" else []
        if inner:
            for each in inner:
                part = count(getattr(each, "jaxpr", each), turns)
                total.update({key: times * value for key, value in part.items()})
        elif name in FREE or name == "platform_index":
            continue
        elif name in SPECIAL:
            total["special"] += out
        elif name in FROM_INPUT:
            total["simple"] += size(equation.invars)
        elif name == "dot_general":
            (contracted, _), _ = equation.params["dimension_numbers"]
            total["simple"] += 2 * out * math.prod(equation.invars[0].aval.shape[k] for k in contracted)
        elif name == "sort":
            longest = equation.invars[0].aval.shape[equation.params["dimension"]]
            total["simple"] += int(size(equation.invars[:1]) * max(1.0, math.log2(max(longest, 2))))
        elif name in ("random_bits", "threefry2x32", "random_fold_in", "random_split", "random_seed"):
            total["simple"] += THREEFRY * max(2, out)
        else:
            total["simple"] += out
    return total


def bytes_of(tree: Any) -> int:
    """Bytes of all arrays of a tree; a key has 8."""
    return sum(leaf.size * getattr(leaf.dtype, "itemsize", 8) for leaf in jax.tree.leaves(tree))


def rows(people: int, turns: int) -> dict[str, tuple[str, Counter, float, float]]:
    """name -> (part of ``sean bench``, counts, bytes, number of items that these counts make)."""
    scenario = sean_jax.make("warehouse", people=people)
    state = jax.eval_shape(lambda key: reset(scenario, key), jax.random.key(0))
    whole = jax.make_jaxpr(lambda s: step(scenario, s, programs.circles(scenario, s, s.streams.policy)))(state)
    eye = sensors.camera(scenario, "depth", width=64, height=48)
    kernels.available = lambda: False  # the same law in loops that can be counted
    image = count(jax.make_jaxpr(lambda s: sensors.depth(scenario, s, eye))(state).jaxpr, SHARE * turns)
    moved = 2.0 * bytes_of(state)
    pixels = 4.0 * 64 * 48
    programs_by_name = {
        "scenario-steps": ("step", count(whole.jaxpr, turns), moved, 1.0),
        "depth images 64x48": ("images", image, pixels, 1.0),
        "scenario-steps with one": (
            "depth", count(whole.jaxpr, turns) + image, moved + pixels, 1.0
        ),
    }  # fmt: skip
    parameters = social_forces.preset("helbing1995")
    for number in (62, 1000, 10_000):
        crowd, grid, _ = workload.crowd(number, 32)
        one = jax.make_jaxpr(lambda p: social_forces.integrate(parameters, p, grid, None, None, 0.05))  # noqa: B023
        counted = count(one(jax.eval_shape(lambda: crowd)).jaxpr, 2)  # noqa: B023
        programs_by_name[f"agent-steps, N = {number}"] = (
            f"crowd {number}",
            counted,
            2.0 * bytes_of(crowd),
            float(number),
        )
    return programs_by_name


def main() -> None:
    """Print the table."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--simple", type=float, default=3.3e13, help="operations per second of the device")
    arguments.add_argument("--special", type=float, default=4.2e12, help="special functions per second")
    arguments.add_argument("--bytes", type=float, default=4.8e12, help="bytes per second")
    arguments.add_argument("--turns", type=int, default=1, help="iterations of loops that depend on the data")
    arguments.add_argument("--people", type=int, default=62)
    arguments.add_argument("--measured", type=Path, default=None, help="bench.json of sean bench")
    chosen = arguments.parse_args()
    best: dict[str, float] = {}
    if chosen.measured:
        for row in json.loads(chosen.measured.read_text(encoding="utf-8"))["rows"]:
            if row["part"] == "images" and row["pixels"] != 64 * 48 or row["devices"] > 1:
                continue
            name = f"crowd {row['people']}" if row["part"] == "crowd" else row["part"]
            best[name] = max(best.get(name, 0.0), row["per_second"])
    print(f"{'for each':<26}{'simple':>11}{'special':>10}{'bytes':>10}{'floor /s':>11}  {'bound by':<9}{'of it':>7}")
    for name, (part, counted, moved, number) in rows(chosen.people, chosen.turns).items():
        need = {"simple": counted["simple"] / number, "special": counted["special"] / number, "bytes": moved / number}
        seconds = {key: need[key] / getattr(chosen, key) for key in need}
        slowest = max(seconds, key=lambda key: seconds[key])
        share = f"{100 * best[part] * seconds[slowest]:6.1f}%" if part in best else "-"
        print(f"{name:<26}{need['simple']:11.0f}{need['special']:10.0f}{need['bytes']:10.0f}"
              f"{1 / seconds[slowest]:11.3g}  {slowest:<9}{share:>7}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
