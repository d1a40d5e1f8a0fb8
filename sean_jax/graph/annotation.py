"""The annotation of a Behavior Graph (section IV-D): graph.yaml, its checks, and the graph it defines."""

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

import jax
import jax.numpy as jnp
import numpy as np
import pydantic
from jaxtyping import Bool, Float

from sean_jax.core.bounds import Coordinate, Duration, Radius, RelativeChance
from sean_jax.core.data_types import Array, Environment, Obstacles
from sean_jax.core.devices import to_device
from sean_jax.core.geometry import crosses_box, signed_distances_on_host
from sean_jax.core.padding import in_programs
from sean_jax.graph.behavior_graph import FLOWS, NO_EDGE, BehaviorGraph, routes
from sean_jax.graph.formation import reach
from sean_jax.io import cache, files

NODE_CLEARANCE = 0.3  # m, from a node's centre to obstacles and to the floor's edge
Factor = Annotated[float, pydantic.Field(ge=1e-3, le=1e3)]  # by which the length of an edge is multiplied
STRICT = pydantic.ConfigDict(extra="forbid", allow_inf_nan=False)
MIN_SPAWN = 1e-3  # a much smaller number is 0 in single precision
CODE = "graph/annotation", "core/geometry"  # that the places depend on
PERSON = 0.25  # m, free radius around a place: a body of 0.2 m and a margin
N_PLACES = 64  # of a node
ROUND = 256  # candidates a node in one round
NODES = 16  # the number of nodes is rounded up to a multiple, so that floors share programs
FULL_ROUNDS = 4  # with candidates from the whole disc, before discs shrink
SHRINK = 0.7  # of the disc's radius, each later round


class Node(pydantic.BaseModel):
    """A waypoint that people pass, or a group where they stand and talk."""

    model_config = STRICT

    kind: Literal["waypoint", "group"]
    position: tuple[Coordinate, Coordinate]  # m
    radius: Radius  # m
    spawn: RelativeChance = 0.0  # weight of the node as a start, relative to the other nodes
    weight: RelativeChance | None = None  # chance with which a waypoint is a goal, relative to the others; None: 1
    capacity: Annotated[int, pydantic.Field(ge=2, le=32)] | None = None  # people, of a group
    stay: tuple[Duration, Duration] | None = None  # s, minimum and maximum, of a group
    id: Annotated[int, pydantic.Field(ge=-(2**31), lt=2**31)] | None = None  # number in the source graph


class Edge(pydantic.BaseModel):
    """Two directed edges between a pair of nodes, with the paper's pair of weights <c_uv, c_vu>."""

    model_config = STRICT

    between: tuple[str, str]
    flow: Literal["medium", "high", "low", "forward", "backward"] | None = None  # medium if weights is absent too
    weights: tuple[Factor, Factor] | None = None  # there and back, instead of flow


class Annotation(pydantic.BaseModel):
    """The content of graph.yaml."""

    model_config = STRICT

    version: Literal[1]
    source: str = ""
    c_min: Annotated[float, pydantic.Field(ge=1e-3, lt=1)]
    c_max: Annotated[float, pydantic.Field(gt=1, le=1e3)]
    nodes: Annotated[dict[str, Node], pydantic.Field(min_length=1, max_length=500)]
    edges: Annotated[list[Edge], pydantic.Field(max_length=5000)]

    def flow_factors(self) -> dict[str, tuple[float, float]]:
        """The paper's pairs <c_uv, c_vu>: category of flow -> factors of an edge's length, there and back."""
        low, high = self.c_min, self.c_max
        pairs = {"medium": (1.0, 1.0), "high": (low, low), "low": (high, high)}
        return pairs | {"forward": (1.0, high), "backward": (high, 1.0)}

    def flow_of(self, edge: Edge) -> str:
        """The category of flow of an edge: its ``flow``, or that with the factors nearest to its weights, as ratios."""
        weights = edge.weights
        if weights is None:
            return edge.flow or "medium"

        def away(factors: tuple[float, float]) -> float:
            return sum(math.log(weight / factor) ** 2 for weight, factor in zip(weights, factors, strict=True))

        pairs = self.flow_factors()
        return min(pairs, key=lambda flow: away(pairs[flow]))

    def factors_of(self, edge: Edge) -> tuple[float, float]:
        """The factors of an edge's length in both directions: its weights, or the factors of its flow."""
        return edge.weights or self.flow_factors()[self.flow_of(edge)]


def read(path: Path | str, environment: Environment) -> BehaviorGraph:
    """The graph of a ``graph.yaml``.

    Raises:
        FileError: lists all mistakes of the file, with line, key and cure.
    """
    return build(files.load(path, Annotation, check, lambda graph: check_against(graph, environment)), environment)


def build(annotation: Annotation, environment: Environment | None, seed: int = 0) -> BehaviorGraph:
    """Arrays and tables of a checked annotation.

    Args:
        environment: whose obstacles bound the places in the nodes' discs; None: all places are the centers.
        seed: draws the places.
    """
    nodes = list(annotation.nodes.values())
    position = np.array([node.position for node in nodes], np.float64)
    radius = np.array([node.radius for node in nodes], np.float64)
    is_group = np.array([node.kind == "group" for node in nodes], bool)
    capacity = np.array([node.capacity or 0 for node in nodes], np.int32)
    flow, edge_cost = _edges(annotation, position)
    cost, next_hop = routes(edge_cost, is_group)
    groups = np.flatnonzero(is_group)
    arrays = dict(
        position=position,
        radius=radius,
        is_group=is_group,
        capacity=capacity,
        stay=np.array([node.stay or (0.0, 0.0) for node in nodes], float),
        spawn=np.array([node.spawn for node in nodes], float),
        weight=np.array([0.0 if node.kind == "group" else _weight(node) for node in nodes], float),
        flow=flow,
        edge_cost=edge_cost,
        cost=cost,
        next_hop=next_hop.astype(np.int32),
        waypoints=np.flatnonzero(~is_group).astype(np.int32),
        groups=groups.astype(np.int32),
        seat_group=np.repeat(np.arange(len(groups)), capacity[groups]).astype(np.int32),
        seat_node=np.repeat(groups, capacity[groups]).astype(np.int32),
        places=position[:, None] if environment is None else places(environment, position, radius, seed),
    )
    return BehaviorGraph(**to_device(arrays), names=tuple(annotation.nodes))


def _weight(node: Node) -> float:
    return 1.0 if node.weight is None else node.weight


def _edges(annotation: Annotation, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(M, M) category of flow of each directed edge, and (M, M) m its cost."""
    index = {name: number for number, name in enumerate(annotation.nodes)}
    flow = np.full((len(index), len(index)), NO_EDGE, np.int32)
    cost = np.full((len(index), len(index)), np.inf)
    reverse = {"forward": "backward", "backward": "forward"}
    for edge in annotation.edges:
        a, b = (index[name] for name in edge.between)
        length = float(np.hypot(*(position[a] - position[b])))
        category = annotation.flow_of(edge)
        there, back = annotation.factors_of(edge)
        cost[a, b], cost[b, a] = length * there, length * back
        flow[a, b] = FLOWS.index(category)
        flow[b, a] = FLOWS.index(reverse.get(category, category))
    return flow, cost


@jax.jit
def in_sight(boxes: Obstacles, center: Float[Array, "P 2"], points: Float[Array, "P 2"]) -> Bool[Array, "P"]:
    """Whether a person can walk straight from a centre [m] to a point [m], pair by pair."""
    each_box = jax.vmap(crosses_box, in_axes=(None, None, None, None, 0, None))
    each_pair = jax.vmap(each_box, in_axes=(0, 0, 0, 0, None, None))
    px, py, qx, qy = center[:, 0], center[:, 1], points[:, 0], points[:, 1]
    return ~jnp.any(each_pair(px, py, qx, qy, boxes, PERSON), axis=1)


def places(environment: Environment, position: np.ndarray, radius: np.ndarray, seed: int = 0) -> np.ndarray:
    """Points (M, 64, 2) [m] uniform over the part of each node's disc that is free and in sight of its centre.

    Goals are such points, not centres (section IV-D). They are drawn on the host, once for all processes. Where a disc
    has too little room, the other points are nearer to its centre, which must be clear of obstacles and of the floor's
    edge by more than the radius of a person.

    Args:
        position: (M, 2) m, of the nodes.
        radius: (M,) m, of their discs.

    Raises:
        ValueError: the centre of a node is not clear.
    """
    boxes = environment.obstacles
    inputs = environment.floor, boxes.center, boxes.half_extent, boxes.yaw, position, radius, seed
    draw = lambda: {"places": _draw_places(environment, position, radius, seed)}  # noqa: E731
    return cache.load_or_build("places", CODE, inputs, draw)["places"]


def _draw_places(environment: Environment, position: np.ndarray, radius: np.ndarray, seed: int) -> np.ndarray:
    count = len(position)
    generator = np.random.default_rng(seed)
    chosen = [np.zeros((0, 2), np.float32) for _ in range(count)]
    radius = np.array(radius, np.float64)
    position = np.asarray(position, np.float32)
    spare = -count % NODES
    center = jnp.asarray(np.repeat(np.pad(position, [(0, spare), (0, 0)], mode="edge"), ROUND, axis=0), float)
    boxes = in_programs(environment.obstacles)
    rounds = 0
    while min(len(points) for points in chosen) < N_PLACES:
        distance = np.sqrt(generator.uniform(size=(count, ROUND))) * radius[:, None]
        angle = generator.uniform(0.0, 2.0 * np.pi, (count, ROUND))
        offset = np.stack([distance * np.cos(angle), distance * np.sin(angle)], -1)
        drawn = (np.asarray(position, np.float64)[:, None, :] + offset).astype(np.float32)
        flat = np.pad(drawn, [(0, spare), (0, 0), (0, 0)]).reshape(-1, 2)
        visible = np.asarray(in_sight(boxes, center, jnp.asarray(flat, float))).reshape(-1, ROUND)[:count]
        to_edge = signed_distances_on_host(environment, drawn.reshape(-1, 2))[1]
        free = visible & (to_edge.reshape(count, ROUND) >= PERSON)
        chosen = [np.concatenate([old, new[ok]])[:N_PLACES] for old, new, ok in zip(chosen, drawn, free, strict=True)]
        rounds += 1
        if rounds >= FULL_ROUNDS:
            radius *= SHRINK
        if rounds > 100:
            raise ValueError("a node's centre is not clear of obstacles.")
    return np.stack(chosen)


def check(annotation: Annotation) -> Iterator[files.Problem]:
    """Mistakes in the fields of an annotation, wherever its nodes lie."""
    for name, node in annotation.nodes.items():
        if node.kind == "group":
            if node.capacity is None:
                yield ("nodes", name, "capacity"), "is missing; a group needs one, such as 'capacity: 4'"
            if node.weight is not None:
                yield ("nodes", name, "weight"), "only a waypoint has one and this is a group; remove it"
            if node.stay is None:
                yield ("nodes", name, "stay"), "is missing; a group needs one in seconds, such as 'stay: [5, 10]'"
            elif node.stay[0] > node.stay[1]:
                yield (
                    ("nodes", name, "stay"),
                    f"[{node.stay[0]:g}, {node.stay[1]:g}] is not ordered; give the shorter time first",
                )
        else:
            for key in ("capacity", "stay"):
                if getattr(node, key) is not None:
                    cure = "remove it, or make the kind 'group'"
                    yield ("nodes", name, key), f"only a group has one and this is a waypoint; {cure}"
    if not any(node.kind == "waypoint" for node in annotation.nodes.values()):
        yield ("nodes",), "none is a waypoint; people need at least one to go to when the groups are full"
    elif not any(_weight(node) >= MIN_SPAWN for node in annotation.nodes.values() if node.kind == "waypoint"):
        yield ("nodes",), f"no waypoint has a weight of {MIN_SPAWN:g} or more; give at least one 'weight: 1'"
    if not any(node.spawn >= MIN_SPAWN for node in annotation.nodes.values()):
        yield ("nodes",), f"no spawn is {MIN_SPAWN:g} or more; give at least one node 'spawn: 1'"
    edge_of: dict[frozenset[str], int] = {}
    for number, edge in enumerate(annotation.edges):
        here = ("edges", number)
        unknown = [side for side in (0, 1) if edge.between[side] not in annotation.nodes]
        for side in unknown:
            word = edge.between[side]
            hint = files.suggest(word, annotation.nodes) or "; add it to nodes or remove the edge"
            yield (*here, "between", side), f"there is no node '{word}'{hint}"
        pair = frozenset(edge.between)
        if len(pair) == 1:
            yield (*here, "between"), f"the edge leads from '{edge.between[0]}' to itself; remove it"
        elif pair in edge_of:
            yield (*here, "between"), f"edges[{edge_of[pair]}] already joins these two; remove one of them"
        edge_of.setdefault(pair, number)
        if edge.weights is not None and edge.flow is not None:
            yield (*here, "weights"), "flow is given as well; remove one of them"
    if all(name in annotation.nodes for edge in annotation.edges for name in edge.between):
        yield from _unreachable(annotation)  # a misspelled name would seem to cut nodes off


def _unreachable(annotation: Annotation) -> Iterator[files.Problem]:
    """Nodes that people cannot reach without crossing a group. Both directions of an edge have a finite cost."""
    nodes = annotation.nodes
    beside: dict[str, set[str]] = {name: set() for name in nodes}
    for edge in annotation.edges:
        a, b = edge.between
        beside[a].add(b)
        beside[b].add(a)
    best: set[str] = set()
    for name, node in nodes.items():
        if node.kind == "group" or name in best:
            continue
        reached, pending = {name}, [name]
        while pending:
            here = pending.pop()
            if nodes[here].kind == "waypoint":
                new = beside[here] - reached
                reached |= new
                pending += new
        best = max(best, reached, key=len)
    start = next((name for name in nodes if name in best and nodes[name].kind == "waypoint"), "")
    for name in nodes:
        if start and name not in best:
            yield ("nodes", name), f"no path over waypoints leads here from '{start}'; add an edge to a waypoint"


def check_against(annotation: Annotation, environment: Environment) -> Iterator[files.Problem]:
    """Mistakes in where the nodes lie: off the floor, in obstacles or without room."""
    to_box, to_edge = signed_distances_on_host(
        environment, np.array([node.position for node in annotation.nodes.values()])
    )
    for (name, node), box, edge in zip(annotation.nodes.items(), to_box, to_edge, strict=True):
        here = ("nodes", name, "position")
        ring = reach(node.capacity) + PERSON if node.kind == "group" and node.capacity else 0.0
        free = min(box, edge)
        place = f"[{node.position[0]:g}, {node.position[1]:g}]"
        if edge < 0:
            floor = ", ".join(f"{value:g}" for value in np.asarray(environment.floor))
            yield here, f"{place} is not on the floor [{floor}]; move it"
        elif box <= 0:
            yield here, f"{place} is inside an obstacle; move it by {NODE_CLEARANCE - box:.2f} m or more"
        elif free < NODE_CLEARANCE:
            what = "obstacle" if box < edge - 1e-3 else "edge of the floor"
            yield here, f"{place} is {free:.2f} m from an {what}, less than {NODE_CLEARANCE:g} m; move it"
        elif free < ring:
            cure = "move it or lower its capacity"
            yield here, f"{place} has {free:.2f} m of room where a group of {node.capacity} needs {ring:.2f} m; {cure}"


def to_yaml(annotation: Annotation) -> str:
    """An annotation without mistakes as graph.yaml, a node and an edge a line."""
    lines = [f"version: {annotation.version}", f"source: {json.dumps(annotation.source)}"]
    lines += [f"c_min: {annotation.c_min:g}", f"c_max: {annotation.c_max:g}", "", "nodes:"]
    for name, node in annotation.nodes.items():
        parts = [f"kind: {node.kind}", f"position: {_sequence(node.position)}", f"radius: {node.radius:.9g}"]
        parts += [f"{key}: {getattr(node, key):.9g}" for key in ("id",) if getattr(node, key) is not None]
        parts.append(f"spawn: {node.spawn:.9g}")
        if node.weight is not None:
            parts.append(f"weight: {node.weight:.9g}")
        if node.kind == "group" and node.capacity is not None and node.stay is not None:
            parts += [f"capacity: {node.capacity}", f"stay: {_sequence(node.stay)}"]
        lines.append(f"  {json.dumps(name)}: {{{', '.join(parts)}}}")
    lines += ["", "edges:" if annotation.edges else "edges: []"]
    for edge in annotation.edges:
        flow = f"weights: {_sequence(edge.weights)}" if edge.weights is not None else f"flow: {edge.flow or 'medium'}"
        lines.append(f"  - {{between: [{', '.join(json.dumps(name) for name in edge.between)}], {flow}}}")
    return "\n".join(lines) + "\n"


def _sequence(values: tuple[float, ...]) -> str:
    return "[" + ", ".join(f"{value:.9g}" for value in values) + "]"
