"""How long a compiled program takes, what it needs of memory, and how long compiling it took."""

import dataclasses
import time
from collections.abc import Callable
from typing import Any, TypedDict

import jax
import numpy as np


@dataclasses.dataclass(frozen=True)
class Row:
    """One row of the table."""

    part: str  # a key of bench.parts.MEASURES
    what: str  # the unit that is counted, such as "scenario-steps"
    batch: int  # scenarios at once
    people: int
    pixels: int  # of an image, 0 for none
    devices: int
    per_second: float  # units; for the part "compile" the seconds themselves
    microseconds: float  # of one turn of the whole batch
    compile_seconds: float
    scenario_bytes: float  # state and temporary memory of one scenario


class Setup(TypedDict):
    """The machine and the scenario of a measurement, as bench.json has them."""

    command: str
    device: str
    devices: int
    memory: int  # bytes, 0 if unknown
    environment: str
    people: int
    robot: str
    dynamics: str
    time_step: float  # s
    crowd_steps: int  # in one control step
    versions: dict[str, str]


@dataclasses.dataclass(frozen=True)
class Program:
    """A jitted function ``run(*fixed, carried) -> carried`` that computes ``count`` units ``turns`` times in a row."""

    run: Callable
    fixed: tuple
    carried: Any
    count: int
    turns: int


def measure(program: Program, repeats: int, seconds: float) -> dict[str, float]:
    """Compile a program and time it, after a warm-up.

    Returns:
        ``per_second``, ``microseconds`` and ``compile_seconds`` as in ``Row``, and ``bytes``, the state and the
        temporary memory of the whole batch (NaN if the compiler does not report it).
    """
    began = time.perf_counter()
    compiled = program.run.lower(*program.fixed, program.carried).compile()
    compiling = time.perf_counter() - began
    memory = compiled.memory_analysis()
    # Donated arguments count once: the results lie where the arguments were.
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
