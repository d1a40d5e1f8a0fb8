"""Density of people over the floor, and their flow along the edges of the Behavior Graph (section IV-D).

Both are computed from positions alone, so they are the same for all pedestrian models: a person who arrives at node v
and was last at node u has walked the edge from u to v.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int

from sean_jax.core.data_types import Array, Environment, Scenario, Trajectory
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import length
from sean_jax.graph import BehaviorGraph, graph_of

CELL = 0.5  # m, side of the cells in which people are counted
ARRIVAL_DISTANCE = 1.0  # m from a node's disc: people aim at any of its points and arrive 1 m from there (SEAN 2.0)
NO_NODE = -1  # no node so far


@struct.dataclass
class Congestion:
    """Density and flow of people in each of K spans of time; M nodes of the graph, 0 without one."""

    time: Float[Array, "K"]  # s, end of each span
    density: Float[Array, "K rows columns"]  # people per m2, mean over the span; row 0 at the lowest y
    flow: Float[Array, "K M M"]  # people per minute who walked the edge from the row's node to the column's


def congestion(
    scenario: Scenario, frames: Trajectory, span: float = 10.0, cells: tuple[int, int] | None = None
) -> Congestion:
    """Density and flow of the people in the frames of a rollout.

    The densities times the area of a cell add up to the number of people present: people off the floor count for the
    nearest cell. Under ``jit`` give ``cells``, or close over the scenario.

    Args:
        frames: (T, ...), or with batch axes before T, which the result has as well. All frames count, also after the
            end of an episode.
        span: s, of the average; the last span may be shorter.
        cells: rows and columns of the grid over the floor; None: cells of about half a metre, not for a traced
            scenario.

    Raises:
        InputError: the span is shorter than a control step, or cells are missing under jit.
    """
    if frames.active.ndim > 1:
        return jax.vmap(lambda episode: congestion(scenario, episode, span, cells))(frames)

    # A span is a whole number of steps, so that each frame counts in one span.
    stride = round(span / scenario.time_step)
    if stride < 1:
        raise InputError(f"span: {span:g} s is shorter than the control step of {scenario.time_step:g} s.")

    # The last span may be shorter; its own length divides it, or it would look less crowded.
    steps = frames.active.shape[0]
    n_spans = -(-steps // stride)
    span_index = jnp.arange(steps, dtype=jnp.int32) // stride  # (T,), the span of each frame
    ends = (np.arange(n_spans) + 1) * stride  # (K,) steps
    ends = np.minimum(ends, steps)
    lengths = np.diff(ends, prepend=0)  # (K,) steps
    time = jnp.asarray(ends * scenario.time_step, float)

    # Each frame counts everybody there, so the density is an average over time, not a number of visitors.
    environment = scenario.environment
    if cells is None:
        cells = grid_shape(environment)
    n_cells = cells[0] * cells[1]
    cell = cell_of(environment, cells, frames.people)  # (T, N)
    people = jnp.zeros((n_spans, n_cells), float)  # (K, cells)
    present = frames.present.astype(float)
    people = people.at[span_index[:, None], cell].add(present)

    # Cells divide the floor evenly, so they are only about half a metre wide.
    width, height = _floor_size(environment)
    area = width * height / n_cells  # m2
    n_frames = jnp.asarray(lengths, float)[:, None, None]  # (K, 1, 1)
    people = people.reshape(n_spans, *cells)  # (K, rows, columns)
    density = people / (area * n_frames)

    # Flow is in walks a minute along directed edges of the Behavior Graph; without a graph it is empty.
    graph = graph_of(scenario)
    minutes = jnp.asarray(lengths * scenario.time_step / 60.0, float)
    walks = _walks_by_edge(graph, frames, span_index, n_spans)  # (K, M, M)
    flow = walks / minutes[:, None, None]
    return Congestion(time=time, density=density, flow=flow)


def _floor_size(environment: Environment) -> tuple[Array, Array]:
    """Width and height [m] of the floor."""
    floor = environment.floor
    width = floor[2] - floor[0]
    height = floor[3] - floor[1]
    return width, height


def grid_shape(environment: Environment) -> tuple[int, int]:
    """Rows and columns of the grid of cells of about half a metre that covers the floor.

    Raises:
        InputError: the environment is traced.
    """
    try:
        x0, y0, x1, y1 = np.asarray(environment.floor, float)
    except jax.errors.TracerArrayConversionError as error:
        message = "cells: are needed where the scenario is traced; give (rows, columns), or close over the scenario."
        raise InputError(message) from error
    rows = math.ceil((y1 - y0) / CELL - 1e-6)
    columns = math.ceil((x1 - x0) / CELL - 1e-6)
    return rows, columns


def cell_of(environment: Environment, cells: tuple[int, int], points: Float[Array, "*shape 2"]) -> Int[Array, "*shape"]:
    """The cell of each point [m] in a grid over the floor, numbered row by row from the lowest y.

    Points off the floor are in the nearest cell.
    """
    rows, columns = cells
    floor = environment.floor
    width, height = _floor_size(environment)
    x = (points[..., 0] - floor[0]) * (columns / width)  # in cells
    y = (points[..., 1] - floor[1]) * (rows / height)
    column = jnp.clip(x.astype(jnp.int32), 0, columns - 1)
    row = jnp.clip(y.astype(jnp.int32), 0, rows - 1)
    return row * columns + column


def track_nodes(
    graph: BehaviorGraph, last: Int[Array, "N"], people: Float[Array, "N 2"], present: Bool[Array, "N"]
) -> tuple[Int[Array, "N"], Bool[Array, "N"]]:
    """The last node of each person, and whether they have just walked an edge to it.

    Args:
        last: last node before this step, ``NO_NODE`` if there was none.
        people: m, positions.
    """
    gap = people[:, None] - graph.position[None, :]  # (N, M, 2) m
    beyond = length(gap[..., 0], gap[..., 1]) - graph.radius[None, :]  # (N, M) m
    nearest = jnp.argmin(beyond, axis=1).astype(jnp.int32)
    least = jnp.min(beyond, axis=1)
    arrived = present & (least < ARRIVAL_DISTANCE)
    has_edge = jnp.isfinite(graph.edge_cost[last, nearest])
    is_edge = (last != NO_NODE) & (last != nearest) & has_edge

    # Whoever leaves the scene comes back from no node.
    last = jnp.where(present, last, NO_NODE)
    node = jnp.where(arrived, nearest, last)
    return node, arrived & is_edge


def _walks_by_edge(graph: BehaviorGraph | None, frames: Trajectory, span_index: Array, n_spans: int) -> Array:
    """(n_spans, M, M) people who walked each edge in each span; ``span_index`` (T,) is the span of each frame."""
    if graph is None:
        return jnp.zeros((n_spans, 0, 0), float)
    nodes = graph.radius.shape[0]

    def count_frame(carry, frame):
        last, count = carry
        people, present, span = frame
        node, walked = track_nodes(graph, last, people, present)
        count = count.at[span, last, node].add(walked.astype(float))
        return (node, count), None

    nowhere = jnp.full(frames.present.shape[1:], NO_NODE, jnp.int32)
    no_walks = jnp.zeros((n_spans, nodes, nodes), float)
    rows = frames.people, frames.present, span_index
    (_, count), _ = jax.lax.scan(count_frame, (nowhere, no_walks), rows)
    return count
