"""The waves of a cost map's window on a GPU, in one kernel (Pallas, Mosaic GPU).

A warp has one window, in registers: a thread has two columns. Each thread is one row behind its left neighbor, so a
sweep has new values from above and from the left. Then rows or columns are flipped, in turn, so four sweeps go in all
directions. No window waits until another one has settled.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax.core import gpu_kernels
from sean_jax.core.data_types import Array

SIDE = 2 * gpu_kernels.WARP  # cells along a side of a window

Rows = list[tuple[Any, Any]]  # two cells of each row


def supports(wave: Array) -> bool:
    """Whether the kernel can settle a wave: a window of ``SIDE`` x ``SIDE`` cells in single precision."""
    return wave.shape == (SIDE, SIDE) and wave.dtype == np.float32 and gpu_kernels.available()


def settle(rule: Callable, tolerance: float, far: float, wave: Array, cost: Array) -> Array:
    """The wave after rounds of four sweeps, of which the last lowers no cell by more than a tolerance in any sweep.

    Args:
        rule: the value of a cell by the lower neighbors of each axis and by its cost.
        far: value beyond the window.
    """
    call = gpu_kernels.batch(partial(_call, rule, tolerance, far), 1)
    (result,) = call(wave.reshape(1, -1), jnp.stack([_skew(cost), _skew(cost[::-1])]).reshape(1, -1))
    return result.reshape(wave.shape)


def _skew(cells: Array) -> Array:
    """The cells in the order in which the threads of a sweep read them: row t - l of the columns 2l and 2l + 1."""
    side = len(cells)
    columns = np.arange(side)
    return cells[(np.arange(side + side // 2 - 1)[:, None] - columns // 2) % side, columns]


def _call(rule: Callable, tolerance: float, far: float, *operands: Array, interpret: bool = False) -> tuple[Array, ...]:
    """The kernel, for operands of ``kernels.Call``."""
    wave = operands[0]
    windows, lanes = max(operand.shape[0] for operand in operands), math.isqrt(wave.shape[1]) // 2
    out = (jax.ShapeDtypeStruct((windows, wave.shape[1]), wave.dtype),)
    kernel = partial(_kernel, rule, tolerance, far, lanes)
    return gpu_kernels.launch_warps(kernel, "wave", windows, lanes, out, *operands, interpret=interpret)


def _kernel(rule: Callable, tolerance: float, far: Any, lanes: int, window: Any, lane: Any, *references: Any) -> None:
    """A thread of a window."""
    wave, cost, result = references
    wave_at, cost_at = (gpu_kernels.row(each, window, result.shape[0]) for each in (wave, cost))
    side, far, none = 2 * lanes, wave.dtype.type(far), wave.dtype.type(0.0)
    to_left, to_right = ((lane ^ (lane + way)) & (lanes - 1) for way in (-1, 1))

    def body(carry: tuple) -> tuple:
        turn, change, rows = carry
        quarter = turn & 3
        change = jnp.where(quarter == 0, none, change)
        # The costs are there as they are, and with their rows flipped; both axes of either may be reversed.
        reverse, times = quarter >= 2, side + lanes - 1
        down, across = jnp.where(reverse, -side, side), jnp.where(reverse, -1, 1)
        first = jnp.where(reverse, times * side - 1 - 2 * lane, 2 * lane) + (quarter & 1) * (times * side)
        rows = [*rows]
        for time in range(times):
            slot, before, after = (number % side for number in (time, time - 1, time + 1))
            at = first + time * down
            above, own, below = rows[before], rows[slot], rows[after]
            left = jnp.where(lane == 0, far, gpu_kernels.exchange(above[1], to_left))
            right = jnp.where(lane == lanes - 1, far, gpu_kernels.exchange(below[0], to_right))
            if time < lanes:
                above = tuple(jnp.where(lane == time, far, value) for value in above)
            if time >= side - 1:
                below = tuple(jnp.where(lane == time - side + 1, far, value) for value in below)
            near = tuple(map(jnp.minimum, above, below))
            one = jnp.minimum(own[0], rule(near[0], jnp.minimum(left, own[1]), cost[cost_at, at]))
            other = jnp.minimum(own[1], rule(near[1], jnp.minimum(one, right), cost[cost_at, at + across]))
            if not lanes - 1 <= time < side:  # some threads have not begun, or have ended
                runs = lane <= time if time < lanes else lane > time - side
                one, other = jnp.where(runs, one, own[0]), jnp.where(runs, other, own[1])
            for old, new in zip(own, (one, other), strict=True):
                change = jnp.maximum(change, old - new)
            rows[slot] = one, other
        for distance in _distances(lanes):
            change = jnp.maximum(change, gpu_kernels.exchange(change, distance))
        return turn + 1, change, _flip(rows, (quarter & 1) != 0, lane)

    def goes_on(carry: tuple) -> Any:
        return ((carry[0] & 3) != 0) | (gpu_kernels.uniform(carry[1]) > tolerance)

    places = [((slot - lane) & (side - 1)) * side + 2 * lane for slot in range(side)]
    rows = [(wave[wave_at, place], wave[wave_at, place + 1]) for place in places]
    change = jnp.where(lane >= 0, far, none)
    _, _, rows = jax.lax.while_loop(goes_on, body, (np.int32(0), change, rows))
    for place, (left, right) in zip(places, rows, strict=True):
        result[window, place], result[window, place + 1] = left, right


def _distances(lanes: int) -> list[int]:
    return [1 << bit for bit in range((lanes - 1).bit_length())]


def _flip(rows: Rows, columns: Any, lane: Any) -> Rows:
    """The window with its columns flipped, or else its rows. The order of the slots spares registers."""
    side, lanes = len(rows), len(rows) // 2
    cells: list = [None] * side
    for slot in sorted(range(side), key=lambda slot: min(slot, (lanes - slot) % side)):
        here, there = rows[side - 1 - slot], rows[(slot + lanes - 1) % side]
        cells[slot] = tuple(jnp.where(columns, gpu_kernels.exchange(there[1 - k], lanes - 1), here[k]) for k in (0, 1))
    for distance in _distances(lanes):  # a thread's rows go on by twice its number
        moves, before = (lane & distance) != 0, [*cells]
        for slot in sorted(range(side), key=lambda slot: (slot % (2 * distance), -slot)):
            cells[slot] = tuple(map(partial(jnp.where, moves), before[slot - 2 * distance], before[slot]))
    return cells
