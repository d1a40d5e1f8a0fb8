"""The waves of a cost map's window on a GPU, in one kernel (Pallas, Mosaic GPU).

A warp has one window, in registers: a thread has two columns. A sweep goes down the rows; then the window is turned by
90 degrees, so four sweeps go in all directions. No window waits until another one has settled.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import kernels
from sean_jax.base import Array

SIDE = 2 * kernels.WARP  # cells along a side of a window

Rows = list[tuple[Any, Any]]  # two cells of each row


def supports(wave: Array) -> bool:
    """Whether the kernel can settle a wave: a window of ``SIDE`` x ``SIDE`` cells in single precision."""
    return wave.shape == (SIDE, SIDE) and wave.dtype == np.float32 and kernels.available()


def settle(rule: Callable, tolerance: float, far: float, wave: Array, cost: Array) -> Array:
    """The wave after rounds of four sweeps, of which the last lowers no cell by more than a tolerance in any sweep.

    Args:
        rule: the value of a cell by the lower neighbors of each axis and by its cost.
        far: value beyond the window.
    """
    call = kernels.batch(partial(_call, rule, tolerance, far), 1)
    (result,) = call(wave.reshape(1, -1), jnp.stack([cost, cost.T]).reshape(1, -1))
    return result.reshape(wave.shape)


def _call(rule: Callable, tolerance: float, far: float, *operands: Array, interpret: bool = False) -> tuple[Array, ...]:
    """The kernel, for operands of ``kernels.Call``."""
    wave = operands[0]
    windows, lanes = max(operand.shape[0] for operand in operands), math.isqrt(wave.shape[1]) // 2
    out = (jax.ShapeDtypeStruct((windows, wave.shape[1]), wave.dtype),)
    kernel = partial(_kernel, rule, tolerance, far, lanes)
    return kernels.launch_warps(kernel, "wave", windows, lanes, out, *operands, interpret=interpret)


def _kernel(rule: Callable, tolerance: float, far: Any, lanes: int, window: Any, lane: Any, *references: Any) -> None:
    """A thread of a window."""
    wave, cost, result = references
    wave_at, cost_at = (kernels.row(each, window, result.shape[0]) for each in (wave, cost))
    side, far, none = 2 * lanes, wave.dtype.type(far), wave.dtype.type(0.0)
    to_left, to_right = ((lane ^ (lane + way)) & (lanes - 1) for way in (-1, 1))

    def body(carry: tuple) -> tuple:
        turn, change, rows = carry
        quarter = turn & 3
        change = jnp.where(quarter == 0, none, change)
        # The costs are there as they are, and transposed; one or both of their axes are reversed.
        upwards, leftwards = (quarter == 1) | (quarter == 2), quarter >= 2
        first = (quarter & 1) * (side * side) + jnp.where(upwards, side * (side - 1), 0)
        first = first + jnp.where(leftwards, side - 1 - 2 * lane, 2 * lane)
        down, across = jnp.where(upwards, -side, side), jnp.where(leftwards, -1, 1)
        before, swept = (far, far), []
        for row, (own, after) in enumerate(zip(rows, [*rows[1:], (far, far)], strict=True)):
            at = first + row * down
            beside = (
                jnp.minimum(jnp.where(lane == 0, far, kernels.exchange(own[1], to_left)), own[1]),
                jnp.minimum(jnp.where(lane == lanes - 1, far, kernels.exchange(own[0], to_right)), own[0]),
            )
            costs = cost[cost_at, at], cost[cost_at, at + across]
            before = tuple(map(jnp.minimum, own, map(rule, map(jnp.minimum, before, after), beside, costs)))
            for old, new in zip(own, before, strict=True):
                change = jnp.maximum(change, old - new)
            swept.append(before)
        for distance in _distances(lanes):
            change = jnp.maximum(change, kernels.exchange(change, distance))
        return turn + 1, change, _transpose(swept, lane)[::-1]

    def goes_on(carry: tuple) -> Any:
        return ((carry[0] & 3) != 0) | (kernels.uniform(carry[1]) > tolerance)

    places = [(row * side + 2 * lane, row * side + 2 * lane + 1) for row in range(side)]
    rows = [(wave[wave_at, left], wave[wave_at, right]) for left, right in places]
    change = jnp.where(lane >= 0, far, none)
    _, _, rows = jax.lax.while_loop(goes_on, body, (np.int32(0), change, rows))
    for (left, right), values in zip(places, rows, strict=True):
        result[window, left], result[window, right] = values


def _distances(lanes: int) -> list[int]:
    return [1 << bit for bit in range((lanes - 1).bit_length())]


def _transpose(rows: Rows, lane: Any) -> Rows:
    """The transposed window: bit by bit, the number of a thread changes places with the number of a pair of rows."""
    cells = [[*row] for row in rows]
    for distance in _distances(len(rows) // 2):
        upper = (lane & distance) != 0
        for row, here in enumerate(cells):
            for k in () if row & 2 * distance else (0, 1):
                there = cells[row + 2 * distance]
                come = kernels.exchange(jnp.where(upper, here[k], there[k]), distance)
                here[k], there[k] = jnp.where(upper, come, here[k]), jnp.where(upper, there[k], come)
    return [(cells[row & ~1][row & 1], cells[row | 1][row & 1]) for row in range(len(rows))]
