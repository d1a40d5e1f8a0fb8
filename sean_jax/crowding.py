"""Where people crowd (section IV-D): density over the floor, and flow along the edges of the Behavior Graph.

Both are read from positions alone, so whoever moved the people, they are measured alike: a person has walked the edge
from u to v who comes to node v and was last at node u.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from sean_jax.base import Array, Environment, Frame, Scenario
from sean_jax.geometry import length
from sean_jax.graph import BehaviorGraph, graph_of

CELL = 0.5  # m, side of the cells in which people are counted
AT_NODE = 1.0  # m from a node's disc: people aim at any of its points and have arrived 1 m from there (SEAN 2.0)
NOWHERE = -1  # in place of a node, for who was at none yet


@struct.dataclass
class Congestion:
    """People's density and flow in each of K spans of time; M nodes of the graph, 0 without one."""

    time: Array  # (K,) s, end of each span
    density: Array  # (K, rows, columns) people per m2, mean over the span; row 0 at the lowest y
    flow: Array  # (K, M, M) people per minute who came from the row's node to the column's, by the edge between them


def congestion(
    scenario: Scenario, frames: Frame, span: float = 10.0, cells: tuple[int, int] | None = None
) -> Congestion:
    """Density and flow of the people in the frames of a rollout.

    Args:
        frames: (T, ...), or with batch axes before T, which the result has as well. All frames count, those after
            the end of an episode too.
        span: s, over which is averaged; the last span may be shorter.
        cells: rows and columns of the grid over the floor; cells of about half a metre if None, which a traced
            scenario does not allow.

    The densities times the area of a cell add up to the number of people who are present: who is off the floor counts
    for the nearest cell. Under ``jit`` give ``cells``, or close over the scenario.

    Raises:
        ValueError: the span is shorter than a control step, or cells are missing under jit.
    """
    if frames.active.ndim > 1:
        return jax.vmap(lambda each: congestion(scenario, each, span, cells))(frames)
    stride = round(span / scenario.time_step)
    if stride < 1:
        raise ValueError(f"span: {span:g} s is shorter than the control step of {scenario.time_step:g} s.")
    rows, columns = grid(scenario.environment) if cells is None else cells
    steps = frames.active.shape[0]
    number = -(-steps // stride)
    index = jnp.arange(steps, dtype=jnp.int32) // stride
    ends = np.minimum((np.arange(number) + 1) * stride, steps)
    lasts = np.diff(ends, prepend=0)  # steps in each span

    cell = cell_of(scenario.environment, (rows, columns), frames.people)  # (T, N)
    people = jnp.zeros((number, rows * columns), float)
    people = people.at[index[:, None], cell].add(frames.present.astype(float))
    floor = scenario.environment.floor
    area = (floor[2] - floor[0]) * (floor[3] - floor[1]) / (rows * columns)
    density = people.reshape(number, rows, columns) / (area * jnp.asarray(lasts, float)[:, None, None])

    graph = graph_of(scenario)
    minutes = jnp.asarray(lasts * scenario.time_step / 60.0, float)[:, None, None]
    flow = _walks(graph, frames, index, number) / minutes
    return Congestion(time=jnp.asarray(ends * scenario.time_step, float), density=density, flow=flow)


def grid(environment: Environment) -> tuple[int, int]:
    """Rows and columns of cells of about half a metre that cover the floor."""
    try:
        x0, y0, x1, y1 = np.asarray(environment.floor, float)
    except jax.errors.TracerArrayConversionError as error:
        message = "cells: are needed where the scenario is traced; give (rows, columns), or close over the scenario."
        raise ValueError(message) from error
    return math.ceil((y1 - y0) / CELL - 1e-6), math.ceil((x1 - x0) / CELL - 1e-6)


def cell_of(environment: Environment, cells: tuple[int, int], points: Array) -> Array:
    """(...) int32 number of the cell of a grid over the floor, row by row from the lowest, that each point is in.

    ``points`` (..., 2) m; those off the floor are taken to the nearest cell.
    """
    rows, columns = cells
    floor = environment.floor
    x = (points[..., 0] - floor[0]) * (columns / (floor[2] - floor[0]))
    y = (points[..., 1] - floor[1]) * (rows / (floor[3] - floor[1]))
    column = jnp.clip(x.astype(jnp.int32), 0, columns - 1)
    return jnp.clip(y.astype(jnp.int32), 0, rows - 1) * columns + column


def follow(graph: BehaviorGraph, last: Array, people: Array, present: Array) -> tuple[Array, Array]:
    """(N,) int32 node that each of the people (N, 2) [m] was at last, and (N,) bool who walked an edge to it just now.

    ``last`` (N,) int32 is the node that they were at last until now, ``NOWHERE`` if they were at none yet.
    """
    gap = people[:, None] - graph.position[None, :]
    beyond = length(gap[..., 0], gap[..., 1]) - graph.radius[None, :]  # (N, M) m
    nearest = jnp.argmin(beyond, axis=1).astype(jnp.int32)
    here = present & (jnp.min(beyond, axis=1) < AT_NODE)
    walked = here & (last != NOWHERE) & (last != nearest) & jnp.isfinite(graph.weight[last, nearest])
    return jnp.where(here, nearest, jnp.where(present, last, NOWHERE)), walked


def _walks(graph: Any, frames: Frame, index: Array, number: int) -> Array:
    """(number, M, M) people who walked each edge in the spans whose ``index`` (T,) the frames have."""
    if graph is None:
        return jnp.zeros((number, 0, 0), float)
    nodes = graph.radius.shape[0]

    def one(carry, frame):
        last, count = carry
        people, present, span = frame
        now, walked = follow(graph, last, people, present)
        return (now, count.at[span, last, now].add(walked.astype(float))), None

    nowhere = jnp.full(frames.present.shape[1:], NOWHERE, jnp.int32)
    start = nowhere, jnp.zeros((number, nodes, nodes), float)
    return jax.lax.scan(one, start, (frames.people, frames.present, index))[0][1]
