"""What is counted over the steps of a batch beside the metrics: where people were, which situations met, and more.

These are sums over all episodes, so no episode has to be kept: heat maps, flows along the graph's edges, times of sets
of situations, and two checks of the simulation itself.
"""

import functools
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from sean_jax import crowding, geometry
from sean_jax.base import Array, Scenario, State, Trajectory
from sean_jax.graph import graph_of
from sean_jax.runner import Record
from sean_jax.scenario import frame

FRAMES = 4  # episodes of which the frames are recorded


@struct.dataclass
class Tally:
    """Running counts over the steps of a batch of B episodes in which an episode was active."""

    heat: Array  # (rows, columns) int32 person-steps per cell of the floor, row 0 lowest
    walks: Array  # (M, M) int32 people who walked the edge from the row's node to the column's
    node: Array  # (B, N) int32 node that each person was at last, -1 before the first
    together: Array  # (2 ** S,) int32 steps per set of situations, situation s is bit s
    penetration: Array  # () m, deepest that a body was in an obstacle or off the floor, negative: closest to it
    group_size: Array  # (G,) int32 most members seen in each group


@dataclass
class Finished:
    """The results of a batch of B episodes, as numpy arrays."""

    completed: np.ndarray  # (B,)
    timed_out: np.ndarray  # (B,)
    steps: np.ndarray  # (B,)
    metrics: dict[str, np.ndarray]  # (B,) or (B, 1 + S)
    tally: Tally
    frames: list[Trajectory]  # (T, ...) of the first episodes
    seconds: float  # s, taken to simulate


def record(scenario: Scenario, size: int, frames: int = FRAMES) -> Record:
    """What a run keeps of batches of the scenario's episodes: a ``Tally``, and the frames of the first episodes.

    Returns:
        The record for a ``Runner``.
    """
    cells = crowding.grid_shape(scenario.environment)
    return Record(functools.partial(_init, cells), functools.partial(_update, min(frames, size)))


def _init(cells: tuple[int, int], scenario: Scenario, states: State) -> Tally:
    size, graph = states.tick.shape[0], graph_of(scenario)
    nodes = 0 if graph is None else len(graph.names)
    return Tally(
        heat=jnp.zeros(cells, jnp.int32),
        walks=jnp.zeros((nodes, nodes), jnp.int32),
        node=jnp.full((size, scenario.people), crowding.NO_NODE, jnp.int32),
        together=jnp.zeros((2 ** len(scenario.situations),), jnp.int32),
        penetration=jnp.full((), -1e9, float),
        group_size=jnp.zeros(states.groups.radius.shape[-1:], jnp.int32),
    )


def _update(
    count: int, scenario: Scenario, before: State, after: State, actions: Array, active: Array, tally: Tally
) -> tuple[Tally, Trajectory]:
    """One more step of B episodes, and the frames of the first ``count``."""
    frames = jax.vmap(frame)(before, after, actions[0])
    present = after.pedestrians.present
    here = present & active[:, None]
    x, y = frames.people[..., 0], frames.people[..., 1]
    rows, columns = tally.heat.shape
    cell = crowding.cell_of(scenario.environment, (rows, columns), frames.people)
    node, walks = tally.node, tally.walks
    if (graph := graph_of(scenario)) is not None:
        node, walked = jax.vmap(crowding.track_nodes, (None, 0, 0, 0))(graph, tally.node, frames.people, present)
        walks = walks.at[tally.node, node].add((walked & active[:, None]).astype(jnp.int32))
    distance, _, _ = jax.vmap(geometry.from_box, (None, None, 0))(x, y, scenario.environment.obstacles)
    edge = geometry.to_border(scenario.environment, x, y)
    nearest = jnp.minimum(jnp.min(distance, 0, initial=jnp.inf), edge)
    inside = jnp.where(here, scenario.forces.walking.radius - nearest, -jnp.inf)
    bits = jnp.asarray(2 ** np.arange(frames.situations.shape[-1]), jnp.int32)
    situations = jnp.sum(jnp.where(frames.situations, bits[None, :], 0), -1)
    index = jnp.arange(tally.group_size.shape[0], dtype=jnp.int32)
    members = jnp.sum((frames.group[..., None] == index[None, None, :]) & here[..., None], 1, dtype=jnp.int32)
    tally = replace(
        tally,
        heat=tally.heat.ravel().at[cell].add(here.astype(jnp.int32)).reshape(rows, columns),
        walks=walks,
        node=node,
        together=tally.together.at[situations].add(active.astype(jnp.int32)),
        penetration=jnp.maximum(tally.penetration, jnp.max(inside, initial=-jnp.inf)),
        group_size=jnp.maximum(tally.group_size, jnp.max(members, 0)),
    )
    return tally, jax.tree.map(lambda leaf: leaf[:count], frames)


def episodes(chunks: list[Trajectory], count: int) -> list[Trajectory]:
    """The frames of each of the first episodes.

    Args:
        chunks: frames (T, F, ...) of one chunk of time after another.

    Returns:
        Frames (T, ...) of each episode, cut after its last active step.
    """
    if not chunks:
        return []
    frames = jax.tree.map(lambda *xs: np.concatenate(xs), *chunks)
    lengths = [max(1, int(frames.active[:, i].sum())) for i in range(min(count, frames.active.shape[1]))]
    return [jax.tree.map(lambda leaf: leaf[:n, i], frames) for i, n in enumerate(lengths)]  # noqa: B023
