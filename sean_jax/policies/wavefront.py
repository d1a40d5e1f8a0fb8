"""The global plan on a cost map: a wave that runs from where the goal is, over some control steps (GlobalPlanner).

ROS plans over the whole map. Here the map is a window around the robot, and what lies beyond is taken from the exact
tables of shortest paths: the wave starts at the window's border with the way that is left from there, and at the goal
if that lies inside. So people change the plan only within the window. A sweep moves the wave on by one cell everywhere.
"""

import jax
import jax.numpy as jnp

from sean_jax.base import Array, Scenario, State
from sean_jax.geometry import length
from sean_jax.policies.costmap import MOST, TOUCHES, Window, cell_of, middles
from sean_jax.policies.outlook import Outlook, remaining

NEUTRAL, FACTOR = 50.0, 3.0  # of global_planner: what a free cell costs, and how much the map counts
SIDES = ((1, 0), (-1, 0), (0, 1), (0, -1))
CORNERS = ((1, 1), (1, -1), (-1, 1), (-1, -1))
FAR = 1e6  # m, of cells that the wave has not reached


def resistance(costs: Array) -> Array:
    """Metres of free way that a metre of way through a cell of that cost is worth: at most 252 / 50."""
    return jnp.where(costs >= TOUCHES, FAR, jnp.minimum(NEUTRAL + FACTOR * costs, MOST) / NEUTRAL)


def begin(scenario: Scenario, state: State, outlook: Outlook, over: Window, costs: Array) -> Array:
    """(C, C) m, the wave before the first sweep: what is left from the border and around the goal, FAR elsewhere."""
    count = costs.shape[0]
    x, y = middles(over, count)
    edge = jnp.concatenate([jnp.arange(count, dtype=jnp.int32)] * 2)
    low, high = jnp.zeros(count, jnp.int32), jnp.full(count, count - 1, jnp.int32)
    i = jnp.concatenate([edge, low, high])
    j = jnp.concatenate([low, high, edge])
    left = remaining(scenario, state, outlook, x[i, j], y[i, j])
    left = jnp.where(jnp.isfinite(left) & (costs[i, j] < TOUCHES), left, FAR)
    wave = jnp.full_like(costs, FAR).at[i, j].set(left)
    to_goal = length(x - state.task.goal[0], y - state.task.goal[1])
    return jnp.where(to_goal < over.cell, to_goal, wave)


def sweep(wave: Array, resisting: Array, cell: Array) -> Array:
    """(C, C) m, the wave one cell on: the least of each cell's own and its eight neighbours' way and the step there."""
    padded = jnp.pad(wave, 1, constant_values=FAR)
    count = wave.shape[0]

    def least(steps: tuple) -> Array:
        moved = [padded[1 + i : 1 + i + count, 1 + j : 1 + j + count] for i, j in steps]
        return jnp.minimum(jnp.minimum(moved[0], moved[1]), jnp.minimum(moved[2], moved[3]))

    step = cell * resisting
    return jnp.minimum(wave, jnp.minimum(least(SIDES) + step, least(CORNERS) + jnp.asarray(2**0.5, float) * step))


def descend(wave: Array, over: Window, x: Array, y: Array, points: int) -> tuple[Array, Array]:
    """(points,) m and m: the plan from a place x, y [m], from cell to cell down the wave."""
    count = wave.shape[0]
    padded = jnp.pad(wave, 1, constant_values=2.0 * FAR)
    ways = jnp.asarray(((0, 0), *SIDES, *CORNERS), jnp.int32)

    def one(here: tuple, _) -> tuple[tuple, tuple]:
        i, j = here
        best = ways[jnp.argmin(padded[1 + i + ways[:, 0], 1 + j + ways[:, 1]])]
        here = i + best[0], j + best[1]
        return here, here

    _, (i, j) = jax.lax.scan(one, cell_of(over, count, x, y), length=points)
    return over.origin[0] + over.cell * i.astype(float), over.origin[1] + over.cell * j.astype(float)
