"""How long a compiled program takes, what it needs of memory, and how long compiling it took."""

import dataclasses
import time
from collections.abc import Callable
from typing import Any

import jax
import numpy as np


@dataclasses.dataclass(frozen=True)
class Row:
    """One line of the table."""

    part: str  # of options.PARTS
    what: str  # counted, such as "scenario-steps"
    batch: int  # scenarios at once
    people: int
    pixels: int  # of an image, 0 for none
    devices: int
    per_second: float  # of what is counted; for the part compile the seconds themselves
    microseconds: float  # of a call that does one of each scenario
    compile_seconds: float
    scenario_bytes: float  # of state and of temporary memory, for each scenario


@dataclasses.dataclass(frozen=True)
class Program:
    """A jitted function ``run(*fixed, carried) -> carried`` that does ``count`` things ``turns`` times in a row."""

    run: Callable
    fixed: tuple
    carried: Any
    count: int
    turns: int


def measure(program: Program, repeats: int, seconds: float) -> dict[str, float]:
    """Figures of a ``Row``: medians over ``repeats`` timings of about ``seconds`` each, after a warm-up."""
    began = time.perf_counter()
    compiled = program.run.lower(*program.fixed, program.carried).compile()
    compiling = time.perf_counter() - began
    memory = compiled.memory_analysis()
    # What is donated counts once: the results lie where the arguments were.
    used = memory.temp_size_in_bytes + _size(program.carried) if memory else float("nan")
    carried = jax.block_until_ready(compiled(*program.fixed, program.carried))
    began = time.perf_counter()
    carried = jax.block_until_ready(compiled(*program.fixed, carried))
    calls = max(1, round(seconds / max(time.perf_counter() - began, 1e-6)))
    spent = []
    for _ in range(repeats):
        began = time.perf_counter()
        for _ in range(calls):
            carried = compiled(*program.fixed, carried)
        jax.block_until_ready(carried)
        spent.append((time.perf_counter() - began) / calls / program.turns)
    each = float(np.median(spent))
    return {
        "per_second": program.count / each,
        "microseconds": 1e6 * each,
        "compile_seconds": compiling,
        "bytes": used,
    }


def _size(tree: Any) -> int:
    return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(tree) if hasattr(leaf, "itemsize"))
