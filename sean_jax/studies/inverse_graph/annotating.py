"""A fit put into words: the annotation of a graph with the weights that were found, and graph.yaml of it."""

import json

import numpy as np

from sean_jax.graph.annotation import Annotation, Edge, Node
from sean_jax.studies.inverse_graph.fitting import GraphFit

MEDIUM = 0.02  # by which both factors of an edge may differ from 1 and still be "medium"


def fitted(annotation: Annotation, fit: GraphFit, closed: bool, source: str) -> Annotation:
    """An annotation with the weights, stays and capacities of a fit.

    Factors are given relative to the middle one of all edges, because only their ratios matter.

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


def text(annotation: Annotation) -> str:
    """The annotation as graph.yaml, a node and an edge a line.

    Args:
        annotation: without mistakes.
    """
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
    """Weights with a mean of 1 among those that count, to three digits."""
    value = np.exp(logarithm - logarithm[counted].max())
    return [float(_digits(each)) for each in np.clip(value / value[counted].mean(), 0.0, 1e6)]


def _digits(value: float) -> float:
    return float(f"{value:.3g}")
