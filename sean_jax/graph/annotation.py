"""The annotation of a Behavior Graph (section IV-D): graph.yaml, its checks, and the graph it defines."""

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import pydantic
from jaxtyping import Bool, Float

from sean_jax.core.bounds import MAX_DURATION, Coordinate, Duration, Radius, RelativeChance
from sean_jax.core.data_types import Array, Environment, Obstacles
from sean_jax.core.devices import to_device
from sean_jax.core.geometry import crosses_box, signed_distances_on_host
from sean_jax.core.messages import shorten
from sean_jax.core.padding import in_programs
from sean_jax.graph.behavior_graph import FLOWS, NO_EDGE, BehaviorGraph, Timetable, routes
from sean_jax.graph.formation import reach
from sean_jax.io import cache, files

NODE_CLEARANCE = 0.3  # m, from a node's centre to obstacles and to the floor's edge
Factor = Annotated[float, pydantic.Field(ge=1e-3, le=1e3)]  # by which the length of an edge is multiplied
Rate = Annotated[float, pydantic.Field(ge=0, le=100)]  # people/s
ERRAND = (4.0, 30.0)  # s, at a waypoint, on a trip
ROOMY = 0.9  # m, radius of a waypoint's disc, above which there is room for an errand
RATE = 1.0  # people/s, at an entrance
STRICT = pydantic.ConfigDict(extra="forbid", allow_inf_nan=False)
MIN_SPAWN = 1e-3  # a much smaller number is 0 in single precision
CODE = "graph/annotation", "core/geometry"  # that the places depend on
PERSON = 0.25  # m, free radius around a place: a body of 0.2 m and a margin
N_PLACES = 64  # of a node
ROUND = 256  # candidates a node in one round
NODES = 16  # the number of nodes is rounded up to a multiple, so that floors share programs
FULL_ROUNDS = 4  # with candidates from the whole disc, before discs shrink
SHRINK = 0.7  # of the disc's radius, each later round


class Bus(pydantic.BaseModel):
    """A bus, train or lift that brings people again and again."""

    model_config = STRICT

    every: Annotated[float, pydantic.Field(ge=1, le=MAX_DURATION)]  # s
    people: Annotated[int, pydantic.Field(ge=1, le=1_000)]  # in each, at most
    first: Duration = 0.0  # s, of the episode


class Entrance(pydantic.BaseModel):
    """How people come in. In a file, ``true`` is an entrance without further keys, and a number its rate."""

    model_config = STRICT

    rate: Rate | None = None  # people/s; None: ``RATE``
    # s of the episode, begin and end of each interval in which somebody comes in; None: always
    times: Annotated[list[list[Duration]], pydantic.Field(min_length=1, max_length=100)] | None = None
    bus: Bus | None = None  # instead of a rate

    @pydantic.model_validator(mode="before")
    @classmethod
    def _of_short_form(cls, value: Any) -> Any:
        if isinstance(value, bool):
            return {}
        if isinstance(value, int | float):
            return {"rate": value}
        if not isinstance(value, dict | Entrance):
            raise ValueError(
                f"{shorten(repr(value))} is not an entrance; write true, a number of people/s or a mapping"
            )
        return value

    @property
    def mean_rate(self) -> float:
        """People/s who come in while it is open, of a bus on average."""
        if self.bus is not None:
            return self.bus.people / self.bus.every
        return RATE if self.rate is None else self.rate


def _none_for_zero(value: Any) -> Any:
    """None in place of ``false`` and of a rate of 0."""
    return None if isinstance(value, int | float) and value == 0 else value


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
    visit: tuple[Duration, Duration] | None = None  # s, the same on trips; None: ``stay``
    errand: tuple[Duration, Duration] | None = None  # s, minimum and maximum, at a waypoint on trips; None: ``ERRAND``
    entrance: Annotated[Entrance | None, pydantic.BeforeValidator(_none_for_zero)] = None  # on trips; None: none
    id: Annotated[int, pydantic.Field(ge=-(2**31), lt=2**31)] | None = None  # number in the source graph


class Edge(pydantic.BaseModel):
    """Two directed edges between a pair of nodes, with the paper's pair of weights <c_uv, c_vu>."""

    model_config = STRICT

    between: tuple[str, str]
    flow: Literal["medium", "high", "low", "forward", "backward"] | None = None  # medium if weights is absent too
    weights: tuple[Factor, Factor] | None = None  # there and back, instead of flow


class Trips(pydantic.BaseModel):
    """Further nodes and edges, on which people walk on trips alone."""

    model_config = STRICT

    nodes: Annotated[dict[str, Node], pydantic.Field(max_length=500)] = {}
    edges: Annotated[list[Edge], pydantic.Field(max_length=5000)] = []


class Annotation(pydantic.BaseModel):
    """The content of graph.yaml."""

    model_config = STRICT

    version: Literal[1]
    source: str = ""
    c_min: Annotated[float, pydantic.Field(ge=1e-3, lt=1)]
    c_max: Annotated[float, pydantic.Field(gt=1, le=1e3)]
    nodes: Annotated[dict[str, Node], pydantic.Field(min_length=1, max_length=500)]
    edges: Annotated[list[Edge], pydantic.Field(max_length=5000)]
    trips: Trips | None = None

    def with_trips(self) -> "Annotation":
        """The annotation with the nodes and edges of trips among the others."""
        if self.trips is None:
            return self
        nodes = self.nodes | self.trips.nodes
        return self.model_copy(update={"nodes": nodes, "edges": self.edges + self.trips.edges, "trips": None})

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
        factors_of_flow = self.flow_factors()

        def distance(flow: str) -> float:
            factors = factors_of_flow[flow]
            return sum(math.log(weight / factor) ** 2 for weight, factor in zip(weights, factors, strict=True))

        return min(factors_of_flow, key=distance)

    def factors_of(self, edge: Edge) -> tuple[float, float]:
        """The factors of an edge's length in both directions: its weights, or the factors of its flow."""
        return edge.weights or self.flow_factors()[self.flow_of(edge)]


def read_graph(path: Path | str, environment: Environment, trips: bool = False) -> BehaviorGraph:
    """The graph of a ``graph.yaml``.

    Args:
        trips: with the nodes and edges on which people walk on trips alone.

    Raises:
        FileError: lists all mistakes of the file, with line, key and cure.
    """
    read = files.load(path, Annotation, check, lambda graph: check_against(graph, environment))
    return build_graph(read.with_trips() if trips else read, environment)


def build_graph(annotation: Annotation, environment: Environment | None, seed: int = 0) -> BehaviorGraph:
    """Arrays and tables of a checked annotation.

    Args:
        environment: whose obstacles bound the places in the nodes' discs; None: all places are the centers.
        seed: draws the places.
    """
    # The nodes, in the order of the file.
    nodes = list(annotation.nodes.values())
    position = np.array([node.position for node in nodes], np.float64)
    radius = np.array([node.radius for node in nodes], np.float64)
    is_group = np.array([node.kind == "group" for node in nodes], bool)
    capacity = np.array([node.capacity or 0 for node in nodes], np.int32)
    groups = np.flatnonzero(is_group)

    # Paths are found here once, in float64: a step of the behavior looks them up.
    flow, edge_cost = _edges(annotation, position)
    cost, next_hop = routes(edge_cost, is_group)

    # Each seat of a group is a row, because members come and go one by one.
    arrays = dict(
        position=position,
        radius=radius,
        is_group=is_group,
        capacity=capacity,
        stay=np.array([node.stay or (0.0, 0.0) for node in nodes], float),
        visit=np.array([node.visit or node.stay or (0.0, 0.0) for node in nodes], float),
        errand=np.array([_errand(node) for node in nodes], float),
        entrance=np.array([node.entrance.mean_rate if node.entrance else 0.0 for node in nodes], float),
        timetable=_timetable(nodes),
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


def _timetable(nodes: list[Node]) -> Timetable:
    """When people come in at entrances, a row for each interval and each bus."""
    open_node, times, bus_node, buses = [], [], [], []
    for index, node in enumerate(nodes):
        entrance = node.entrance
        if entrance is not None and entrance.bus is not None:
            bus_node.append(index)
            buses.append(entrance.bus)
        elif entrance is not None and entrance.times is not None:
            open_node += [index] * len(entrance.times)
            times += entrance.times
    return Timetable(
        open_node=np.array(open_node, np.int32),  # pyright: ignore[reportArgumentType]
        open=np.array(times, float).reshape(-1, 2),  # pyright: ignore[reportArgumentType]
        bus_node=np.array(bus_node, np.int32),  # pyright: ignore[reportArgumentType]
        every=np.array([bus.every for bus in buses], float),  # pyright: ignore[reportArgumentType]
        first=np.array([bus.first for bus in buses], float),  # pyright: ignore[reportArgumentType]
        people=np.array([bus.people for bus in buses], np.int32),  # pyright: ignore[reportArgumentType]
    )


def _errand(node: Node) -> tuple[float, float]:
    """Limits [s] of the time at a waypoint; 0 where people who stand would be in the way of others, as in a door."""
    if node.kind == "group":
        return 0.0, 0.0
    if node.errand is not None:
        return node.errand
    return ERRAND if node.radius >= ROOMY else (0.0, 0.0)


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
        forward, backward = annotation.factors_of(edge)
        cost[a, b] = length * forward
        cost[b, a] = length * backward
        flow[a, b] = FLOWS.index(category)
        flow[b, a] = FLOWS.index(reverse.get(category, category))
    return flow, cost


@jax.jit
def in_sight(boxes: Obstacles, center: Float[Array, "P 2"], points: Float[Array, "P 2"]) -> Bool[Array, "P"]:
    """Whether a person can walk straight from a centre [m] to a point [m], pair by pair."""
    cross_boxes = jax.vmap(crosses_box, in_axes=(None, None, None, None, 0, None))
    pairs_cross = jax.vmap(cross_boxes, in_axes=(0, 0, 0, 0, None, None))
    px, py, qx, qy = center[:, 0], center[:, 1], points[:, 0], points[:, 1]
    return ~jnp.any(pairs_cross(px, py, qx, qy, boxes, PERSON), axis=1)


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
    radius = np.array(radius, np.float64)
    position = np.asarray(position, np.float32)
    chosen = [np.zeros((0, 2), np.float32) for _ in range(count)]
    rounds = 0
    while min(len(points) for points in chosen) < N_PLACES:
        distance = np.sqrt(generator.uniform(size=(count, ROUND))) * radius[:, None]
        angle = generator.uniform(0.0, 2.0 * np.pi, (count, ROUND))
        offset = np.stack([distance * np.cos(angle), distance * np.sin(angle)], -1)
        drawn = (np.asarray(position, np.float64)[:, None, :] + offset).astype(np.float32)  # (M, ROUND, 2)

        free = _are_free(environment, position, drawn)
        for node in range(count):
            chosen[node] = np.concatenate([chosen[node], drawn[node, free[node]]])[:N_PLACES]
        rounds += 1
        if rounds >= FULL_ROUNDS:
            radius *= SHRINK
        if rounds > 100:
            raise ValueError("a node's centre is not clear of obstacles.")
    return np.stack(chosen)


def _are_free(
    environment: Environment, position: Float[np.ndarray, "M 2"], points: Float[np.ndarray, "M K 2"]
) -> Bool[np.ndarray, "M K"]:
    """Whether points [m] are in sight of the centres of their nodes and away from the edge of the floor."""
    count, size = points.shape[:2]
    padding = (0, -count % NODES)
    center = np.repeat(np.pad(position, [padding, (0, 0)], mode="edge"), size, axis=0)
    padded = np.pad(points, [padding, (0, 0), (0, 0)]).reshape(-1, 2)
    visible = in_sight(in_programs(environment.obstacles), jnp.asarray(center, float), jnp.asarray(padded, float))
    _, to_edge = signed_distances_on_host(environment, points.reshape(-1, 2))
    return np.asarray(visible).reshape(-1, size)[:count] & (to_edge.reshape(count, size) >= PERSON)


def check(annotation: Annotation) -> Iterator[files.Problem]:
    """Mistakes in the fields of an annotation, wherever its nodes lie."""
    problems = list(_check_graph(annotation))
    yield from problems
    if annotation.trips is None:
        return
    for name in annotation.trips.nodes:
        if name in annotation.nodes:
            yield ("trips", "nodes", name), "there is another node of that name; rename one of them"
    for location, text in _check_graph(annotation.with_trips()):
        if (location, text) not in problems:
            yield _location_in_file(annotation, location), text


def _location_in_file(annotation: Annotation, location: tuple[str | int, ...]) -> tuple[str | int, ...]:
    """Where a node or an edge of ``with_trips`` stands in the file."""
    if annotation.trips is None or len(location) < 2:
        return location
    kind, item, *others = location
    if kind == "nodes" and item in annotation.trips.nodes:
        return "trips", *location
    if kind == "edges" and isinstance(item, int) and item >= len(annotation.edges):
        return "trips", "edges", item - len(annotation.edges), *others
    return location


def _check_graph(annotation: Annotation) -> Iterator[files.Problem]:
    """Mistakes in the nodes and edges of an annotation, without those of trips."""
    nodes = annotation.nodes
    for name, node in nodes.items():
        yield from _check_group(name, node) if node.kind == "group" else _check_waypoint(name, node)
    waypoints = [node for node in nodes.values() if node.kind == "waypoint"]
    if not waypoints:
        yield ("nodes",), "none is a waypoint; people need at least one to go to when the groups are full"
    elif not any(_weight(node) >= MIN_SPAWN for node in waypoints):
        yield ("nodes",), f"no waypoint has a weight of {MIN_SPAWN:g} or more; give at least one 'weight: 1'"
    if not any(node.spawn >= MIN_SPAWN for node in nodes.values()):
        yield ("nodes",), f"no spawn is {MIN_SPAWN:g} or more; give at least one node 'spawn: 1'"

    yield from _check_edges(annotation)
    if all(name in nodes for edge in annotation.edges for name in edge.between):
        yield from _unreachable(annotation)  # a misspelled name would seem to cut nodes off


def _check_group(name: str, node: Node) -> Iterator[files.Problem]:
    if node.capacity is None:
        yield ("nodes", name, "capacity"), "is missing; a group needs one, such as 'capacity: 4'"
    if node.weight is not None:
        yield ("nodes", name, "weight"), "only a waypoint has one and this is a group; remove it"
    if node.errand is not None:
        yield ("nodes", name, "errand"), "only a waypoint has one and this is a group; give a visit, or remove it"
    if node.entrance:
        yield ("nodes", name, "entrance"), "only a waypoint can be one and this is a group; remove it"
    yield from _check_order(name, "visit", node.visit)
    if node.stay is None:
        yield ("nodes", name, "stay"), "is missing; a group needs one in seconds, such as 'stay: [5, 10]'"
    yield from _check_order(name, "stay", node.stay)


def _check_waypoint(name: str, node: Node) -> Iterator[files.Problem]:
    for key in ("capacity", "stay", "visit"):
        if getattr(node, key) is not None:
            text = "only a group has one and this is a waypoint; remove it, or make the kind 'group'"
            yield ("nodes", name, key), text

    yield from _check_order(name, "errand", node.errand)
    if node.entrance is not None:
        yield from _check_entrance(name, node.entrance)


def _check_entrance(name: str, entrance: Entrance) -> Iterator[files.Problem]:
    location = ("nodes", name, "entrance")
    for key in ("rate", "times"):
        if entrance.bus is not None and getattr(entrance, key) is not None:
            yield (*location, key), "a bus is given as well; remove one of them"
    for index, interval in enumerate(entrance.times or []):
        text = _sequence(tuple(interval))
        if len(interval) != 2:
            yield (*location, "times", index), f"{text} is not an interval; give its begin and its end, in seconds"
        elif interval[0] >= interval[1]:
            yield (*location, "times", index), f"{text} does not end after it begins; give the earlier time first"


def _check_order(name: str, key: str, limits: tuple[float, float] | None) -> Iterator[files.Problem]:
    if limits is not None and limits[0] > limits[1]:
        low, high = limits
        yield ("nodes", name, key), f"[{low:g}, {high:g}] is not ordered; give the shorter time first"


def _check_edges(annotation: Annotation) -> Iterator[files.Problem]:
    edge_of: dict[frozenset[str], int] = {}
    for index, edge in enumerate(annotation.edges):
        location = ("edges", index)
        for side, name in enumerate(edge.between):
            if name not in annotation.nodes:
                hint = files.suggest(name, annotation.nodes) or "; add it to nodes or remove the edge"
                yield (*location, "between", side), f"there is no node '{name}'{hint}"
        pair = frozenset(edge.between)
        if len(pair) == 1:
            yield (*location, "between"), f"the edge leads from '{edge.between[0]}' to itself; remove it"
        elif pair in edge_of:
            yield (*location, "between"), f"edges[{edge_of[pair]}] already joins these two; remove one of them"
        edge_of.setdefault(pair, index)
        if edge.weights is not None and edge.flow is not None:
            yield (*location, "weights"), "flow is given as well; remove one of them"


def _unreachable(annotation: Annotation) -> Iterator[files.Problem]:
    """Nodes that people cannot reach without crossing a group. Both directions of an edge have a finite cost."""
    nodes = annotation.nodes
    neighbors: dict[str, set[str]] = {name: set() for name in nodes}
    for edge in annotation.edges:
        a, b = edge.between
        neighbors[a].add(b)
        neighbors[b].add(a)

    # The largest component that a waypoint reaches.
    largest: set[str] = set()
    for name, node in nodes.items():
        if node.kind == "waypoint" and name not in largest:
            largest = max(largest, _reachable(name, nodes, neighbors), key=len)
    start = next((name for name in nodes if name in largest and nodes[name].kind == "waypoint"), "")
    for name in nodes:
        if start and name not in largest:
            yield ("nodes", name), f"no path over waypoints leads here from '{start}'; add an edge to a waypoint"


def _reachable(start: str, nodes: dict[str, Node], neighbors: dict[str, set[str]]) -> set[str]:
    """The nodes to which paths over waypoints lead."""
    reached = {start}
    pending = [start]
    while pending:
        name = pending.pop()
        if nodes[name].kind == "waypoint":
            new = neighbors[name] - reached
            reached |= new
            pending += new
    return reached


def check_against(annotation: Annotation, environment: Environment) -> Iterator[files.Problem]:
    """Mistakes in where the nodes lie: off the floor, in obstacles or without room."""
    nodes = annotation.with_trips().nodes
    points = np.array([node.position for node in nodes.values()])
    to_box, to_edge = signed_distances_on_host(environment, points)
    for (name, node), box, edge in zip(nodes.items(), to_box, to_edge, strict=True):
        location = _location_in_file(annotation, ("nodes", name, "position"))
        point = f"[{node.position[0]:g}, {node.position[1]:g}]"
        room = min(box, edge)
        needed = reach(node.capacity) + PERSON if node.kind == "group" and node.capacity else 0.0
        if edge < 0:
            floor = ", ".join(f"{value:g}" for value in np.asarray(environment.floor))
            yield location, f"{point} is not on the floor [{floor}]; move it"
        elif box <= 0:
            yield location, f"{point} is inside an obstacle; move it by {NODE_CLEARANCE - box:.2f} m or more"
        elif room < NODE_CLEARANCE:
            nearest = "obstacle" if box < edge - 1e-3 else "edge of the floor"
            yield location, f"{point} is {room:.2f} m from an {nearest}, less than {NODE_CLEARANCE:g} m; move it"
        elif room < needed:
            yield (
                location,
                f"{point} has {room:.2f} m of room where a group of {node.capacity} needs {needed:.2f} m; move it or "
                "lower its capacity",
            )


def to_yaml(annotation: Annotation) -> str:
    """An annotation without mistakes as graph.yaml, a node and an edge a line."""
    lines = [f"version: {annotation.version}", f"source: {json.dumps(annotation.source)}"]
    lines += [f"c_min: {annotation.c_min:g}", f"c_max: {annotation.c_max:g}", ""]
    lines += _graph_lines(annotation.nodes, annotation.edges)
    if annotation.trips is not None:
        further = _graph_lines(annotation.trips.nodes, annotation.trips.edges)
        lines += ["", "trips:", *(f"  {line}" if line else "" for line in further)]
    return "\n".join(lines) + "\n"


def _graph_lines(nodes: dict[str, Node], edges: list[Edge]) -> list[str]:
    """The lines of nodes and edges."""
    lines = ["nodes:" if nodes else "nodes: {}"]
    lines += [f"  {json.dumps(name)}: {{{_node_fields(node)}}}" for name, node in nodes.items()]
    lines += ["", "edges:" if edges else "edges: []"]
    for edge in edges:
        names = ", ".join(json.dumps(name) for name in edge.between)
        flow = f"weights: {_sequence(edge.weights)}" if edge.weights is not None else f"flow: {edge.flow or 'medium'}"
        lines.append(f"  - {{between: [{names}], {flow}}}")
    return lines


def _node_fields(node: Node) -> str:
    fields = [f"kind: {node.kind}", f"position: {_sequence(node.position)}", f"radius: {node.radius:.9g}"]
    if node.id is not None:
        fields.append(f"id: {node.id:.9g}")
    fields.append(f"spawn: {node.spawn:.9g}")
    if node.weight is not None:
        fields.append(f"weight: {node.weight:.9g}")
    if node.kind == "group" and node.capacity is not None and node.stay is not None:
        fields += [f"capacity: {node.capacity}", f"stay: {_sequence(node.stay)}"]

    # What trips add to it.
    if node.visit is not None:
        fields.append(f"visit: {_sequence(node.visit)}")
    if node.errand is not None:
        fields.append(f"errand: {_sequence(node.errand)}")
    if node.entrance is not None:
        fields.append(f"entrance: {_entrance_text(node.entrance)}")
    return ", ".join(fields)


def _entrance_text(entrance: Entrance) -> str:
    """The value of ``entrance``, in its shortest form."""
    if entrance.bus is not None:
        bus = entrance.bus
        return f"{{bus: {{every: {bus.every:.9g}, people: {bus.people}, first: {bus.first:.9g}}}}}"
    rate = "" if entrance.rate is None else f"{entrance.rate:.9g}"
    if entrance.times is None:
        return rate or "true"
    times = ", ".join(_sequence(tuple(interval)) for interval in entrance.times)
    return f"{{rate: {rate}, times: [{times}]}}" if rate else f"{{times: [{times}]}}"


def _sequence(values: tuple[float, ...]) -> str:
    return "[" + ", ".join(f"{value:.9g}" for value in values) + "]"
