"""Weights, stays and preferred speeds of a graph, fitted to what people did on it.

Weights follow the gradient of the likelihood of what was measured (``flow_model``), with a temperature that falls from
several metres to a fraction of one: at first all ways contribute gradients, and in the end people choose ways as
in the behavior. Stays and speeds need no gradient: a few numbers describe their distributions.
"""

import json
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from sean_jax.base import Array
from sean_jax.graph import BehaviorGraph
from sean_jax.graph.annotation import Annotation, Edge, Node
from sean_jax.progress import Progress
from sean_jax.studies.inverse_graph.flow_model import (
    SELDOM,
    Flows,
    FlowWeights,
    expected_flows,
    layout,
    log_likelihood,
    log_odds,
    weights_of,
)
from sean_jax.studies.inverse_graph.measuring import Calls, FlowMeasure

WARM = 4.0  # m, temperature at the beginning
TEMPERATURE = 0.25  # m, in the end
LEARNING_RATE = 0.05
STEPS = 600
PARTS = 12  # progress is shown after each
PLAIN = 2e-3  # by which factors are drawn to 1, and weights to one another, where there are no walks
HELD = 0.5  # share of the time for which a group holds as many members as its capacity
FEWEST_STAYS = 5  # for a distribution


@dataclass(frozen=True)
class GraphFit:
    """A graph of M nodes with G groups, as people walk on it."""

    weights: FlowWeights
    flows: Flows  # that these weights make, for one walk from a start to a goal
    stay: Float[np.ndarray, "G 2"]  # s, minimum and maximum; NaN of a group where hardly any stay was seen
    capacity: np.ndarray  # (G,) people at once; 0 where nobody stood
    speed: tuple[float, float]  # m/s, mean and standard deviation of the preferred speeds; NaN without walkers
    loss: Float[np.ndarray, "K"]  # minus the log likelihood, in the course of the fit


def fit_flows(
    graph: BehaviorGraph,
    measured: FlowMeasure,
    closed: bool = True,
    temperature: float = TEMPERATURE,
    calls: Calls | None = None,
    steps: int = STEPS,
    progress: Progress | None = None,
) -> GraphFit:
    """Find the weights with which people walk as they were seen to walk.

    What a graph is annotated with, apart from its nodes and edges, is not used: all edges begin with their lengths.

    Args:
        closed: whether people go on from goal to goal, as in a simulation, or enter and leave, as in a recording.
        temperature: m, of route choice in the end.
        calls: how people were called to groups, if that is known and not to be fitted, in a closed population.
    """
    import optax

    place, progress = layout(graph), progress or Progress()
    replaced = None if calls is None else calls.chance_replaced
    edges, turns = (jnp.asarray(part, float) for part in (measured.edges, measured.turns))
    count = edges.shape[0]
    if closed:  # people enter and leave only because the measurement begins and ends
        turns = turns.at[count].set(0.0).at[:, :, count].set(0.0)
    joined = np.isfinite(np.asarray(place.length))
    part = max(1, steps // PARTS)
    schedule = WARM * (temperature / WARM) ** np.minimum(np.arange(part * PARTS) / (0.8 * part * PARTS), 1.0)
    optimizer = optax.adam(optax.cosine_decay_schedule(LEARNING_RATE, part * PARTS, 0.1))

    def with_calls(weights: FlowWeights) -> FlowWeights:
        return weights if calls is None else replace(weights, sent=log_odds(calls.chance_sent))

    def loss(weights: FlowWeights, warmth: Array) -> Array:
        flows = expected_flows(place, with_calls(weights), warmth, closed, replaced)
        spread = [
            jnp.var(weights.goal),
            jnp.var(weights.start),
            jnp.sum((weights.sent - SELDOM) ** 2) / max(weights.sent.size, 1),
        ]
        spread.append(jnp.sum(jnp.where(joined, weights.factor, 0.0) ** 2) / max(joined.sum().item(), 1))
        return PLAIN * sum(spread[1:], spread[0]) - log_likelihood(flows, edges, turns)

    @jax.jit
    def descend(carry, warmth):
        def step(carry, warmth):
            weights, momentum = carry
            value, slope = jax.value_and_grad(loss)(weights, warmth)
            change, momentum = optimizer.update(slope, momentum)
            return (optax.apply_updates(weights, change), momentum), value

        return jax.lax.scan(step, carry, warmth)

    weights = jax.tree.map(jnp.zeros_like, weights_of(graph))
    weights = weights.replace(sent=weights.sent + SELDOM)
    carry, values = (weights, optimizer.init(weights)), []
    progress.start("fitting weights", PARTS)
    for number, warmth in enumerate(np.split(schedule, PARTS)):
        with jax.numpy_dtype_promotion("standard"):  # optax raises floats to integer powers
            carry, value = descend(carry, jnp.asarray(warmth, float))
        values.append(np.asarray(value))
        progress.update(number + 1, f"loss {values[-1][-1]:.4f}")
    stay, capacity = _groups(measured)
    speeds = measured.speeds
    weights = with_calls(carry[0])
    return GraphFit(
        weights=weights,
        flows=jax.jit(expected_flows, static_argnums=3)(place, weights, temperature, closed, replaced),
        stay=stay,
        capacity=capacity,
        speed=(float(np.mean(speeds)), float(np.std(speeds))) if len(speeds) else (np.nan, np.nan),
        loss=np.concatenate(values),
    )


def _groups(measured: FlowMeasure) -> tuple[np.ndarray, np.ndarray]:
    """(G, 2) s stays, and (G,) capacities.

    Stays are uniform between two times, by the median and the interquartile range: stays that were broken off, or that
    ended late, bias these less than the extremes.
    """
    stays = [_limits(each) if len(each) >= FEWEST_STAYS else (np.nan, np.nan) for each in measured.stays]
    capacity = [
        int(np.max(np.flatnonzero(np.cumsum(times[::-1])[::-1] >= HELD * measured.seconds), initial=0))
        for times in measured.members
    ]
    return np.array(stays).reshape(-1, 2), np.array(capacity, int)


def _limits(stays: np.ndarray) -> tuple[float, float]:
    lower, middle, upper = (float(value) for value in np.quantile(stays, [0.25, 0.5, 0.75]))
    return max(middle - (upper - lower), 0.0), middle + (upper - lower)


def flow_error(expected: np.ndarray, measured: np.ndarray) -> float:
    """The total variation of flows (M, M) in any units: sum of absolute differences of their shares, from 0 to 2.

    NaN if one has no walks at all.
    """
    totals = float(np.sum(expected)), float(np.sum(measured))
    if not min(totals) > 0.0:
        return float("nan")
    return float(np.abs(expected / totals[0] - measured / totals[1]).sum())


# ------------------------------------------------------------------ graph.yaml

MEDIUM = 0.02  # by which both factors of an edge may differ from 1 and still be "medium"


def annotate(annotation: Annotation, fit: GraphFit, closed: bool, source: str) -> Annotation:
    """An annotation with the weights, stays and capacities of a fit.

    Factors are relative to the median edge, because only their ratios matter.

    Args:
        closed: whether people were in a closed population; otherwise where they enter becomes ``spawn``.
    """
    names = list(annotation.nodes)
    is_group = np.array([node.kind == "group" for node in annotation.nodes.values()])
    weight = _relative(np.asarray(fit.weights.goal, float), ~is_group)
    spawn = _relative(np.asarray(fit.weights.start, float), np.ones(len(names), bool))
    group_of = {name: number for number, name in enumerate(np.array(names)[is_group])}
    nodes: dict[str, Node] = {}
    for number, (name, node) in enumerate(annotation.nodes.items()):
        changes: dict[str, object] = {}
        if not closed:
            changes["spawn"] = spawn[number]
        if node.kind == "waypoint":
            changes["weight"] = weight[number]
        else:
            stay, capacity = fit.stay[group_of[name]], int(fit.capacity[group_of[name]])
            if np.isfinite(stay).all():
                changes["stay"] = (round(float(stay[0]), 1), round(float(stay[1]), 1))
            if capacity >= 2:
                changes["capacity"] = capacity
        nodes[name] = node.model_copy(update=changes)
    factor = np.asarray(fit.weights.factor, float)
    index = {name: number for number, name in enumerate(names)}
    ends = [[index[name] for name in edge.between] for edge in annotation.edges]
    middle = np.median([factor[a, b] for pair in ends for a, b in (pair, pair[::-1])]) if ends else 0.0
    edges = []
    for edge, (a, b) in zip(annotation.edges, ends, strict=True):
        there, back = (_digits(np.clip(np.exp(value - middle), 1e-3, 1e3)) for value in (factor[a, b], factor[b, a]))
        plain = max(abs(there - 1.0), abs(back - 1.0)) <= MEDIUM
        edges.append(Edge(between=edge.between, weights=None if plain else (there, back)))
    return annotation.model_copy(update={"nodes": nodes, "edges": edges, "source": source})


def graph_yaml(annotation: Annotation) -> str:
    """An annotation without mistakes as graph.yaml, a node and an edge a line."""
    lines = [f"version: {annotation.version}", f"source: {json.dumps(annotation.source)}"]
    lines += [f"c_min: {annotation.c_min:g}", f"c_max: {annotation.c_max:g}", "", "nodes:"]
    for name, node in annotation.nodes.items():
        parts = [f"kind: {node.kind}", f"position: {_list(node.position)}", f"radius: {node.radius:.9g}"]
        parts += [f"{key}: {getattr(node, key):.9g}" for key in ("id",) if getattr(node, key) is not None]
        parts.append(f"spawn: {node.spawn:.9g}")
        if node.weight is not None:
            parts.append(f"weight: {node.weight:.9g}")
        if node.kind == "group" and node.capacity is not None and node.stay is not None:
            parts += [f"capacity: {node.capacity}", f"stay: {_list(node.stay)}"]
        lines.append(f"  {json.dumps(name)}: {{{', '.join(parts)}}}")
    lines += ["", "edges:" if annotation.edges else "edges: []"]
    for edge in annotation.edges:
        flow = f"weights: {_list(edge.weights)}" if edge.weights is not None else f"flow: {edge.flow or 'medium'}"
        lines.append(f"  - {{between: [{', '.join(json.dumps(name) for name in edge.between)}], {flow}}}")
    return "\n".join(lines) + "\n"


def _list(values: tuple[float, ...]) -> str:
    return "[" + ", ".join(f"{value:.9g}" for value in values) + "]"


def _relative(logarithm: np.ndarray, counted: np.ndarray) -> list[float]:
    """Weights with a mean of 1 over the counted ones, to three digits."""
    value = np.exp(logarithm - logarithm[counted].max())
    return [float(_digits(each)) for each in np.clip(value / value[counted].mean(), 0.0, 1e6)]


def _digits(value: float) -> float:
    return float(f"{value:.3g}")
