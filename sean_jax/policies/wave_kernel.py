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
    is_window = wave.shape == (SIDE, SIDE)
    is_single = wave.dtype == np.float32
    return is_window and is_single and gpu_kernels.available()


def settle(rule: Callable, tolerance: float, far: float, wave: Array, cost: Array) -> Array:
    """The wave after rounds of four sweeps, of which the last lowers no cell by more than a tolerance in any sweep.

    Args:
        rule: the value of a cell by the lower neighbors of each axis and by its cost.
        far: value beyond the window.
    """
    launch = partial(_call, rule, tolerance, far)
    call = gpu_kernels.batch(launch, 1)
    as_it_is = _skew(cost)
    flipped = _skew(cost[::-1])
    costs = jnp.stack([as_it_is, flipped])
    (result,) = call(wave.reshape(1, -1), costs.reshape(1, -1))
    return result.reshape(wave.shape)


def _skew(cells: Array) -> Array:
    """The cells in the order in which the threads of a sweep read them: row t - l of the columns 2l and 2l + 1."""
    side = len(cells)
    times = side + side // 2 - 1
    column = np.arange(side)
    time = np.arange(times)[:, None]
    row = (time - column // 2) % side
    return cells[row, column]


def _call(rule: Callable, tolerance: float, far: float, *operands: Array, interpret: bool = False) -> tuple[Array, ...]:
    """The kernel, for operands of ``gpu_kernels.Call``."""
    wave = operands[0]
    cells = wave.shape[1]
    windows = max(len(operand) for operand in operands)
    lanes = math.isqrt(cells) // 2
    result = jax.ShapeDtypeStruct((windows, cells), wave.dtype)
    kernel = partial(_kernel, rule, tolerance, far, lanes)
    return gpu_kernels.launch_warps(kernel, "wave", windows, lanes, (result,), *operands, interpret=interpret)


def _kernel(rule: Callable, tolerance: float, far: Any, lanes: int, window: Any, lane: Any, *references: Any) -> None:
    """A thread of a window."""
    wave, cost, result = references
    windows = result.shape[0]
    wave_row = gpu_kernels.row(wave, window, windows)
    cost_row = gpu_kernels.row(cost, window, windows)

    # ``exchange`` swaps by xor, so the distance to a neighbor is the xor of both numbers.
    to_left = (lane ^ (lane + -1)) & (lanes - 1)
    to_right = (lane ^ (lane + 1)) & (lanes - 1)
    far = wave.dtype.type(far)
    zero = wave.dtype.type(0.0)
    warp = Warp(lane, lanes, far, to_left, to_right)

    def sweep(carry: tuple) -> tuple:
        # Four sweeps, one in each diagonal direction, are a round (fast sweeping; Zhao 2005); its change counts.
        sweeps, change, rows = carry
        quarter = sweeps & 3
        change = jnp.where(quarter == 0, zero, change)
        order = _cost_order(warp, quarter)
        read_cost = partial(_read, cost, cost_row)
        rows, change = _sweep(rule, warp, [*rows], change, read_cost, order)

        # All threads must stop together: one that went on would wait for the others' exchanges.
        for distance in _distances(lanes):
            change = jnp.maximum(change, gpu_kernels.exchange(change, distance))

        of_columns = (quarter & 1) != 0
        return sweeps + 1, change, _flip(rows, of_columns, lane)

    def goes_on(carry: tuple) -> Any:
        sweeps, change, _ = carry
        is_within_round = (sweeps & 3) != 0
        return is_within_round | (gpu_kernels.uniform(change) > tolerance)

    # Each thread begins a row later than its left neighbor: slot s holds row s - lane.
    cells = []
    rows = []
    for slot in range(warp.side):
        row = (slot - lane) & (warp.side - 1)
        cells.append(row * warp.side + 2 * lane)
    for cell in cells:
        rows.append((wave[wave_row, cell], wave[wave_row, cell + 1]))

    # ``lane >= 0`` always holds: it gives the constant the layout of a thread's value, as a loop's carry needs.
    change = jnp.where(lane >= 0, far, zero)
    _, _, rows = jax.lax.while_loop(goes_on, sweep, (np.int32(0), change, rows))

    # The window lives in registers; only the settled wave goes to memory.
    for cell, (left, right) in zip(cells, rows, strict=True):
        result[window, cell] = left
        result[window, cell + 1] = right


def _read(cost: Any, row: Any, index: Any) -> Any:
    return cost[row, index]


def _cost_order(warp: Warp, quarter: Any) -> CostOrder:
    """The costs are there as they are, and with their rows flipped; both axes of either may be reversed."""
    reverse = quarter >= 2
    down = jnp.where(reverse, -warp.side, warp.side)
    across = jnp.where(reverse, -1, 1)

    cells = warp.times * warp.side  # of one of the two
    first = 2 * warp.lane
    first = jnp.where(reverse, cells - 1 - first, first)
    first = first + (quarter & 1) * cells
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
            if time < warp.lanes:
                runs = warp.lane <= time
            else:
                runs = warp.lane > time - warp.side
            new = jnp.where(runs, new[0], old[0]), jnp.where(runs, new[1], old[1])
        for old_cell, new_cell in zip(old, new, strict=True):
            change = jnp.maximum(change, old_cell - new_cell)
        rows[slot] = new
    return rows, change


def _settle_row(rule: Callable, warp: Warp, rows: Rows, time: int, read_cost: Callable, order: CostOrder) -> Cells:
    """The two cells of a thread's row by their neighbors, the left cell first."""
    side = warp.side
    index = order.first + time * order.down  # of the left cell's cost
    above = rows[(time - 1) % side]
    cells = rows[time % side]
    below = rows[(time + 1) % side]

    # The left neighbor is a row ahead, the right one a row behind: their cells beside are in other slots.
    from_left = gpu_kernels.exchange(above[1], warp.to_left)
    left = jnp.where(warp.lane == 0, warp.far, from_left)
    from_right = gpu_kernels.exchange(below[0], warp.to_right)
    right = jnp.where(warp.lane == warp.lanes - 1, warp.far, from_right)

    # Beyond the first row and the last one the wave is far.
    if time < warp.lanes:
        is_first_row = warp.lane == time
        above = tuple(jnp.where(is_first_row, warp.far, value) for value in above)
    if time >= side - 1:
        is_last_row = warp.lane == time - side + 1
        below = tuple(jnp.where(is_last_row, warp.far, value) for value in below)

    # The right cell has the new value of the left one.
    vertical = tuple(map(jnp.minimum, above, below))
    horizontal = jnp.minimum(left, cells[1])
    cost = read_cost(index)
    first = jnp.minimum(cells[0], rule(vertical[0], horizontal, cost))

    horizontal = jnp.minimum(first, right)
    cost = read_cost(index + order.across)
    second = jnp.minimum(cells[1], rule(vertical[1], horizontal, cost))
    return first, second


def _distances(lanes: int) -> list[int]:
    """Powers of two, by which all threads of a warp exchange."""
    return [1 << bit for bit in range((lanes - 1).bit_length())]


def _flip(rows: Rows, columns: Any, lane: Any) -> Rows:
    """The window with its columns flipped, or else its rows. The order of the slots spares registers."""
    side = len(rows)
    lanes = side // 2
    flipped: list = [None] * side
    for slot in sorted(range(side), key=lambda slot: min(slot, (lanes - slot) % side)):
        own = rows[side - 1 - slot]
        across = rows[(slot + lanes - 1) % side]
        cells = []
        for own_cell, across_cell in zip(own, across[::-1], strict=True):
            exchanged = gpu_kernels.exchange(across_cell, lanes - 1)
            cells.append(jnp.where(columns, exchanged, own_cell))
        flipped[slot] = tuple(cells)

    # A thread's rows go on by twice its number, bit by bit.
    for distance in _distances(lanes):
        move = partial(jnp.where, (lane & distance) != 0)
        before = [*flipped]
        for slot in sorted(range(side), key=lambda slot: (slot % (2 * distance), -slot)):
            moved = before[slot - 2 * distance]
            flipped[slot] = tuple(map(move, moved, before[slot]))
    return flipped
