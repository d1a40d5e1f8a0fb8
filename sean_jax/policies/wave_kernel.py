"""The waves of a cost map's window on a GPU, in one kernel (Pallas, Mosaic GPU).

A warp has one window, in registers: a thread has two columns. Each thread is one row behind its left neighbor, so a
sweep has new values from above and from the left. Then rows or columns are flipped, in turn, so four sweeps go in all
directions. No window waits until another one has settled.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax.core import gpu_kernels
from sean_jax.core.data_types import Array

SIDE = 2 * gpu_kernels.WARP  # cells along a side of a window

Cells = tuple[Any, Any]  # the two columns of a thread in one row
Rows = list[Cells]  # of all rows, by slot


class Warp(NamedTuple):
    """A thread, and the warp that has its window."""

    lane: Any  # number of the thread
    lanes: int  # threads of a window, each with two columns
    far: Any  # value beyond the window
    to_left: Any  # for ``gpu_kernels.exchange`` with the thread of the columns to the left
    to_right: Any

    @property
    def side(self) -> int:
        """Cells along a side of the window."""
        return 2 * self.lanes

    @property
    def times(self) -> int:
        """Rows that a sweep takes one after another: the last thread begins ``lanes - 1`` rows late."""
        return self.side + self.lanes - 1


class CostOrder(NamedTuple):
    """Where a sweep reads the costs of a thread's cells."""

    first: Any  # index of the first column's first cell
    down: Any  # from a row to the next
    across: Any  # from the first column to the second


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
    costs = jnp.stack([_skew(cost), _skew(cost[::-1])])  # as they are, and with their rows flipped
    (result,) = call(wave.reshape(1, -1), costs.reshape(1, -1))
    return result.reshape(wave.shape)


def _skew(cells: Array) -> Array:
    """The cells in the order in which the threads of a sweep read them: row t - l of the columns 2l and 2l + 1."""
    side = len(cells)
    column = np.arange(side)
    time = np.arange(side + side // 2 - 1)[:, None]
    return cells[(time - column // 2) % side, column]


def _call(rule: Callable, tolerance: float, far: float, *operands: Array, interpret: bool = False) -> tuple[Array, ...]:
    """The kernel, for operands of ``gpu_kernels.Call``."""
    wave = operands[0]
    windows = max(operand.shape[0] for operand in operands)
    lanes = math.isqrt(wave.shape[1]) // 2
    out = (jax.ShapeDtypeStruct((windows, wave.shape[1]), wave.dtype),)
    kernel = partial(_kernel, rule, tolerance, far, lanes)
    return gpu_kernels.launch_warps(kernel, "wave", windows, lanes, out, *operands, interpret=interpret)


def _kernel(rule: Callable, tolerance: float, far: Any, lanes: int, window: Any, lane: Any, *references: Any) -> None:
    """A thread of a window."""
    wave, cost, result = references
    wave_row = gpu_kernels.row(wave, window, result.shape[0])
    cost_row = gpu_kernels.row(cost, window, result.shape[0])

    # ``exchange`` swaps by xor, so the distance to a neighbor is the xor of both numbers.
    to_left, to_right = ((lane ^ (lane + step)) & (lanes - 1) for step in (-1, 1))
    warp = Warp(lane, lanes, wave.dtype.type(far), to_left, to_right)
    zero = wave.dtype.type(0.0)

    def sweep(carry: tuple) -> tuple:
        # Four sweeps, one in each diagonal direction, are a round (fast sweeping; Zhao 2005); its change counts.
        sweeps, change, rows = carry
        quarter = sweeps & 3
        change = jnp.where(quarter == 0, zero, change)
        order = _cost_order(warp, quarter)
        rows, change = _sweep(rule, warp, [*rows], change, partial(_read, cost, cost_row), order)

        # All threads must stop together: one that went on would wait for the others' exchanges.
        for distance in _distances(lanes):
            change = jnp.maximum(change, gpu_kernels.exchange(change, distance))
        return sweeps + 1, change, _flip(rows, (quarter & 1) != 0, lane)

    def goes_on(carry: tuple) -> Any:
        sweeps, change, _ = carry
        return ((sweeps & 3) != 0) | (gpu_kernels.uniform(change) > tolerance)

    # Each thread begins a row later than its left neighbor: slot s holds row s - lane.
    cells = [((slot - lane) & (warp.side - 1)) * warp.side + 2 * lane for slot in range(warp.side)]
    rows = [(wave[wave_row, cell], wave[wave_row, cell + 1]) for cell in cells]

    # ``lane >= 0`` always holds: it gives the constant the layout of a thread's value, as a loop's carry needs.
    change = jnp.where(lane >= 0, warp.far, zero)
    _, _, rows = jax.lax.while_loop(goes_on, sweep, (np.int32(0), change, rows))

    # The window lives in registers; only the settled wave goes to memory.
    for cell, (left, right) in zip(cells, rows, strict=True):
        result[window, cell], result[window, cell + 1] = left, right


def _read(cost: Any, row: Any, index: Any) -> Any:
    return cost[row, index]


def _cost_order(warp: Warp, quarter: Any) -> CostOrder:
    """The costs are there as they are, and with their rows flipped; both axes of either may be reversed."""
    reverse = quarter >= 2
    cells = warp.times * warp.side  # of one of the two
    down = jnp.where(reverse, -warp.side, warp.side)
    across = jnp.where(reverse, -1, 1)
    first = jnp.where(reverse, cells - 1 - 2 * warp.lane, 2 * warp.lane) + (quarter & 1) * cells
    return CostOrder(first, down, across)


def _sweep(
    rule: Callable, warp: Warp, rows: Rows, change: Any, read_cost: Callable, order: CostOrder
) -> tuple[Rows, Any]:
    """The rows after a sweep downward and to the right, and the greatest change of a cell of this thread."""
    for time in range(warp.times):
        slot = time % warp.side
        old = rows[slot]
        new = _settle_row(rule, warp, rows, time, read_cost, order)
        if not warp.lanes - 1 <= time < warp.side:  # some threads have not begun, or have ended
            runs = warp.lane <= time if time < warp.lanes else warp.lane > time - warp.side
            new = jnp.where(runs, new[0], old[0]), jnp.where(runs, new[1], old[1])
        for old_cell, new_cell in zip(old, new, strict=True):
            change = jnp.maximum(change, old_cell - new_cell)
        rows[slot] = new
    return rows, change


def _settle_row(rule: Callable, warp: Warp, rows: Rows, time: int, read_cost: Callable, order: CostOrder) -> Cells:
    """The two cells of a thread's row by their neighbors, the left cell first."""
    index = order.first + time * order.down
    above, cells, below = (rows[(time + step) % warp.side] for step in (-1, 0, 1))

    # The left neighbor is a row ahead, the right one a row behind: their cells beside are in other slots.
    from_left = gpu_kernels.exchange(above[1], warp.to_left)
    left = jnp.where(warp.lane == 0, warp.far, from_left)
    from_right = gpu_kernels.exchange(below[0], warp.to_right)
    right = jnp.where(warp.lane == warp.lanes - 1, warp.far, from_right)

    # Beyond the first row and the last one the wave is far.
    if time < warp.lanes:
        is_first_row = warp.lane == time
        above = tuple(jnp.where(is_first_row, warp.far, value) for value in above)
    if time >= warp.side - 1:
        is_last_row = warp.lane == time - warp.side + 1
        below = tuple(jnp.where(is_last_row, warp.far, value) for value in below)

    vertical = tuple(map(jnp.minimum, above, below))
    horizontal = jnp.minimum(left, cells[1])
    first = jnp.minimum(cells[0], rule(vertical[0], horizontal, read_cost(index)))
    horizontal = jnp.minimum(first, right)
    second = jnp.minimum(cells[1], rule(vertical[1], horizontal, read_cost(index + order.across)))
    return first, second


def _distances(lanes: int) -> list[int]:
    """Powers of two, by which all threads of a warp exchange."""
    return [1 << bit for bit in range((lanes - 1).bit_length())]


def _flip(rows: Rows, columns: Any, lane: Any) -> Rows:
    """The window with its columns flipped, or else its rows. The order of the slots spares registers."""
    side, lanes = len(rows), len(rows) // 2
    flipped: list = [None] * side
    for slot in sorted(range(side), key=lambda slot: min(slot, (lanes - slot) % side)):
        own = rows[side - 1 - slot]
        across = rows[(slot + lanes - 1) % side]
        flipped[slot] = tuple(
            jnp.where(columns, gpu_kernels.exchange(across[1 - column], lanes - 1), own[column]) for column in (0, 1)
        )

    # A thread's rows go on by twice its number, bit by bit.
    for distance in _distances(lanes):
        moves = (lane & distance) != 0
        before = [*flipped]
        for slot in sorted(range(side), key=lambda slot: (slot % (2 * distance), -slot)):
            flipped[slot] = tuple(map(partial(jnp.where, moves), before[slot - 2 * distance], before[slot]))
    return flipped
