"""Ways, stays at groups and preferred speeds of people on a graph, measured from their positions alone.

The same is measured of simulated and of recorded people. A person has walked the edge from u to v as ``congestion``
counts it. The next edge from v, a *turn*, has more information than the flow of edges: a person who turns around had v
as a goal.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int, PyTree

from sean_jax.core import random_streams
from sean_jax.core.data_types import Array, Scenario, State
from sean_jax.graph import BehaviorGraph
from sean_jax.people.behaviors.graph_choices import GraphMemory
from sean_jax.people.density import NO_NODE, track_nodes
from sean_jax.simulation import scenario as stages

STANDING = 0.3  # m/s, below which a person stands
WALKING = 0.5  # m/s, above which a person walks
SPEED_TIME = 0.5  # s, over which a speed is measured
SHORTEST_STAY = 1.0  # s; a shorter one is a hesitation
SHIFT = 1.5  # s, for which a person in a group may move, to make room, without an end of the stay
UNHINDERED = 0.7  # share of the time walked at less than the preferred speed, for others are in the way at times
MIN_WALK = 3.0  # s, of walking for a preferred speed


@dataclass(frozen=True)
class FlowMeasure:
    """What people did on a graph of M nodes with G groups. Measures add up."""

    edges: Float[np.ndarray, "M M"]  # people who walked from the row's node to the column's
    turns: Float[np.ndarray, "U M U"]  # people who came from the first node over the second to the third, U = M + 1:
    # index M means entering or leaving
    stays: tuple[np.ndarray, ...]  # (K,) s, of each group: stays observed from begin to end
    members: tuple[np.ndarray, ...]  # (K,) s, of each group: the time with 0, 1, 2, ... members
    speeds: Float[np.ndarray, "P"]  # m/s, the preferred speed of each person who walked for long enough
    seconds: float  # measured

    def __add__(self, other: "FlowMeasure") -> "FlowMeasure":
        return FlowMeasure(
            self.edges + other.edges,
            self.turns + other.turns,
            tuple(np.concatenate(pair) for pair in zip(self.stays, other.stays, strict=True)),
            tuple(_added(*pair) for pair in zip(self.members, other.members, strict=True)),
            np.concatenate([self.speeds, other.speeds]),
            self.seconds + other.seconds,
        )

    @property
    def flow(self) -> Float[np.ndarray, "M M"]:
        """(M, M) people per minute from the row's node to the column's."""
        return self.edges * (60.0 / self.seconds)


def measure_flows(
    graph: BehaviorGraph,
    position: Float[np.ndarray, "T N 2"],
    present: Bool[np.ndarray, "T N"],
    time_step: float,
) -> FlowMeasure:
    """Ways, stays and speeds of people on a graph, from positions (T, N, 2) m, ``time_step`` s apart.

    Args:
        present: (T, N); after an absent row a person counts as another person.
    """
    last, walked = (np.asarray(part) for part in _nodes(graph, jnp.asarray(position, float), jnp.asarray(present)))
    edges, turns = _ways(last, walked, present, len(graph.names))
    speed = _speeds(position, present, time_step)
    stands = present & (speed < STANDING)
    stays, members = [], []
    for node in np.asarray(graph.groups):
        away = np.linalg.norm(position - np.asarray(graph.position, float)[node], axis=-1)
        within = present & (away < float(graph.radius[node]))
        here = _joined(within & stands, within, round(SHIFT / time_step))
        stays.append(_stays(here, present, time_step))
        members.append(np.bincount(here.sum(1)) * time_step)
    return FlowMeasure(
        edges, turns, tuple(stays), tuple(members), _preferred(speed, present, time_step), len(present) * time_step
    )


@jax.jit
def _nodes(
    graph: BehaviorGraph, position: Float[Array, "T N 2"], present: Bool[Array, "T N"]
) -> tuple[Int[Array, "T N"], Bool[Array, "T N"]]:
    """(T, N) the node at which each person was last, and whether they have just walked an edge to it."""

    def step(last, row):
        now, walked = track_nodes(graph, last, *row)
        return now, (now, walked)

    return jax.lax.scan(step, jnp.full(position.shape[1], NO_NODE, jnp.int32), (position, present))[1]


def _ways(last: np.ndarray, walked: np.ndarray, present: np.ndarray, nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """(M, M) walks along edges, and (M + 1, M, M + 1) turns, of (T, N) nodes."""
    edges, turns = np.zeros((nodes, nodes)), np.zeros((nodes + 1, nodes, nodes + 1))
    for column, begin, end in _runs(present):
        row = last[begin:end, column]
        changes = np.flatnonzero((np.diff(row, prepend=NO_NODE) != 0) & (row != NO_NODE))
        before, arrived = nodes, -1  # where they came from, and where they are since
        for index in changes:
            node = row[index]
            if arrived >= 0 and walked[begin + index, column]:
                edges[arrived, node] += 1
                if before >= 0:
                    turns[before, arrived, node] += 1
                before, arrived = arrived, node
            else:  # the first node, or one to which no edge leads
                before, arrived = nodes if arrived < 0 else -1, node
        if 0 <= before < nodes:
            turns[before, arrived, nodes] += 1
    return edges, turns


def _runs(flags: np.ndarray) -> Iterator[tuple[int, int, int]]:
    """Column, begin and end of each run of true in (T, N)."""
    edges = np.diff(np.pad(flags, ((1, 1), (0, 0))).astype(np.int8), axis=0)
    for column in range(flags.shape[1]):
        for begin, end in np.flatnonzero(edges[:, column]).reshape(-1, 2).tolist():
            yield column, begin, end


def _speeds(position: np.ndarray, present: np.ndarray, time_step: float) -> np.ndarray:
    """(T, N) m/s, over half a second around each row, or the part of it in which the person is present."""
    half = max(1, round(SPEED_TIME / 2 / time_step))
    speed = np.zeros(present.shape)
    for column, begin, end in _runs(present):
        row = np.arange(begin, end)
        after, before = np.minimum(row + half, end - 1), np.maximum(row - half, begin)
        gap = np.linalg.norm(position[after, column] - position[before, column], axis=-1)
        speed[row, column] = gap / np.maximum((after - before) * time_step, time_step)
    return speed


def _joined(here: np.ndarray, within: np.ndarray, longest: int) -> np.ndarray:
    """(T, N) presence with gaps of at most ``longest`` rows closed, if people stay within reach (T, N)."""
    joined = here.copy()
    for column, begin, end in _runs(~here):
        if begin > 0 and end < len(here) and end - begin <= longest and within[begin:end, column].all():
            joined[begin:end, column] = True
    return joined


def _stays(here: np.ndarray, present: np.ndarray, time_step: float) -> np.ndarray:
    """(K,) s, stays of people; without stays that began before, or ended after, the measurement."""
    stays = []
    for column, begin, end in _runs(here):
        complete = begin > 0 and end < len(here) and present[begin - 1, column] and present[end, column]
        if complete and (end - begin) * time_step >= SHORTEST_STAY:
            stays.append((end - begin) * time_step)
    return np.array(stays)


def _preferred(speed: np.ndarray, present: np.ndarray, time_step: float) -> np.ndarray:
    """(P,) m/s, the preferred speed of each person: a high quantile of walking speeds."""
    speeds = []
    for column, begin, end in _runs(present):
        walking = speed[begin:end, column]
        walking = walking[walking > WALKING]
        if len(walking) * time_step >= MIN_WALK:
            speeds.append(np.quantile(walking, UNHINDERED))
    return np.array(speeds)


def _added(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The sum of two arrays, of which the shorter has zeros at its end."""
    size = max(len(a), len(b))
    return np.pad(a, (0, size - len(a))) + np.pad(b, (0, size - len(b)))


# ------------------------------------------------------------------ simulation

FAR = 1e3  # m, at which the robot stands


@struct.dataclass
class Calls:
    """How often people at each of M nodes were called to each of G groups. Measures add up."""

    candidates: Float[Array, "M"]  # departures of people who were not on the way to a group
    sent: Float[Array, "M G"]  # of these, people sent to a group
    continued: Float[Array, "M G"]  # departures on the way to the same group
    replaced: Float[Array, "M G"]  # people on the way there who are replaced

    def __add__(self, other: "Calls") -> "Calls":
        return jax.tree.map(jnp.add, self, other)

    @property
    def chance_sent(self) -> Float[Array, "M G"]:
        """(M, G) the probability at a node of being sent to a group."""
        return self.sent / jnp.maximum(self.candidates, 1.0)[:, None]

    @property
    def chance_replaced(self) -> Float[Array, "M G"]:
        """(M, G) the probability that a person at a node on the way to a group is replaced by another."""
        return self.replaced / jnp.maximum(self.continued + self.replaced, 1.0)


def people_alone(
    scenario: Scenario, key: Array, steps: int, every: int = 1
) -> tuple[Float[Array, "T N 2"], Bool[Array, "T N"]]:
    """Positions (T, N, 2) m and presence (T, N) of people without a robot, a row each ``every`` steps."""

    position, present, _ = _simulate(scenario, key, steps, every, lambda before, after: None)
    return position, present


def people_called(
    scenario: Scenario, graph: BehaviorGraph, key: Array, steps: int, every: int = 1
) -> tuple[Float[Array, "T N 2"], Bool[Array, "T N"], Calls]:
    """As ``people_alone``, and how people were called to groups in all steps."""
    count, groups = graph.radius.shape[0], graph.groups.shape[0]
    group_of = jnp.full(count, groups).at[graph.groups].set(jnp.arange(groups))  # of a node; G is none

    def calls(before: GraphMemory, after: GraphMemory) -> Calls:
        onward = after.hop != before.hop
        target = jnp.where(before.stay > 0, groups, group_of[before.goal])
        heads, same = target < groups, after.goal == before.goal

        def counted(people: Bool[Array, "N"], group: Array) -> Array:
            return jnp.zeros((count, groups + 1)).at[before.hop, group].add(people.astype(float))

        return Calls(
            candidates=counted(onward & ~heads, target)[:, groups],
            sent=counted(onward & ~heads, group_of[after.goal])[:, :groups],
            continued=counted(onward & heads & same, target)[:, :groups],
            replaced=counted(heads & ~same, target)[:, :groups],
        )

    position, present, counted = _simulate(scenario, key, steps, every, calls)
    return position, present, jax.tree.map(lambda part: part.sum((0, 1)), counted)


def _simulate(
    scenario: Scenario, key: Array, steps: int, every: int, look: Callable
) -> tuple[Float[Array, "T N 2"], Bool[Array, "T N"], PyTree]:
    """Positions and presence in rows, and ``look(memory before, memory after)`` of all steps, by row."""

    def one(state: State, _: None) -> tuple[State, PyTree]:
        before = state.memory
        state = stages.direct_pedestrians(scenario, state, jax.random.fold_in(state.streams.people, state.tick))
        observed = look(before, state.memory)
        return replace(stages.move_pedestrians(scenario, state), tick=state.tick + 1), observed

    def row(state: State, _: None) -> tuple[State, tuple]:
        state, observed = jax.lax.scan(one, state, length=every)
        return state, (state.pedestrians.position, state.pedestrians.present, observed)

    return jax.lax.scan(row, begin_alone(scenario, key), length=steps // every)[1]


def begin_alone(scenario: Scenario, key: Array) -> State:
    """A state with people at their starts and the robot far away, without a task, which would take long to compile."""
    blank = jax.eval_shape(lambda key: stages.reset(scenario, key), key)
    state = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), blank.replace(streams=None))
    pedestrians, groups, memory = scenario.behavior.reset(scenario, key)
    robot = state.robot.replace(position=jnp.full(2, FAR), heading=jnp.asarray([1.0, 0.0]))
    return state.replace(
        streams=random_streams.streams(key), pedestrians=pedestrians, groups=groups, memory=memory, robot=robot
    )
